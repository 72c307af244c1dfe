//! The cases: data only.
//!
//! Real worlds, paths and links where there are real ones; a recorded link is scaled where world and path need far less or far
//! more than it gives, so that the cases span starved (ρ > 2), matched and ample links. Scaling keeps a link's outages.

use super::{Case, Due};

/// Every case, in the order in which they run.
pub const CASES: &[Case] = &[
    Case {
        name: "walk",
        why: "Somebody walks through a building's worth of rooms with a camera in hand; the world is a real tileset, 16 × 16 times.",
        shows: "Large real tiles under a shaky view: what comes first, and what a small memory keeps.",
        due: Due::Open,
        replays: &[
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 120 \
             --link {data}/network/norway3g_car_10.txt --memory mu:0.5 --starts 3",
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 120 \
             --link {data}/network/mahimahi_ATT-LTE-driving.down --memory mu:0.5 --starts 3",
        ],
    },
    Case {
        name: "drive",
        why: "A vehicle at 7.5 m/s over the same real tiles.",
        shows: "Smooth motion, where prediction should pay.",
        due: Due::Open,
        replays: &[
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/drive_udel_garage.txt --quat-order wxyz \
             --camera-axes -z/-y --duration 120 --link {data}/network/norway3g_car_10.txt --memory mu:0.5 --starts 3",
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/drive_udel_garage.txt --quat-order wxyz \
             --camera-axes -z/-y --duration 120 --link {data}/network/mahimahi_ATT-LTE-driving.down --memory mu:0.5 --starts 3",
        ],
    },
    Case {
        name: "helicopter",
        why: "A rescue helicopter as recorded, over 40 km of generated terrain with fine imagery.",
        shows: "Fast, low and mostly straight flight over a world that is seen to the horizon.",
        due: Due::Open,
        replays: &[
            "--world terrain:size=40km,texels=2048 --path {data}/paths/aircraft_rega_zh.json.gz --place centre,height=150 --duration 240 \
             --link {data}/network/norway3g_car_10.txt --memory mu:0.5 --starts 3",
            "--world terrain:size=40km,texels=2048 --path {data}/paths/aircraft_rega_zh.json.gz --place centre,height=150 --duration 240 \
             --link {data}/network/hsr_lte_1529471145.txt --memory mu:1 --starts 3",
        ],
    },
    Case {
        name: "formation-flight",
        why: "An aircraft films another in formation, and so looks aside; over 240 km of generated terrain, by satellite.",
        shows: "A view that does not point where the motion goes, and a latency that varies.",
        due: Due::Open,
        replays: &[
            "--world terrain:size=240km,resolution=20m,texels=2048 --path {data}/paths/aircraft_dreamliner_airfrance.json.gz --icao24 3900fb --look other=39c424 \
             --place centre,height=3000 --from 3000 --duration 300 --link {data}/network/starlink_leocc_first60s.down,scale=0.05 --memory mu:0.5 --starts 3",
        ],
    },
    Case {
        name: "glider-dem",
        why: "A paraglider's flight log over a real elevation model, which has 0.1 MB in all, on a link of some kbit/s.",
        shows: "That what is small enough arrives whatever the policy: the order of the first minutes is all there is to win.",
        due: Due::Open,
        replays: &[
            "--world {data}/scenes/jacksboro_fault_dem.npz --path {data}/paths/glide_skytraxx21-2023-04-15.igc --place centre,height=300 --duration 600 \
             --link {data}/network/norway3g_car_10.txt,scale=0.001 --memory mu:0.5 --starts 3",
        ],
    },
    Case {
        name: "hike",
        why: "A hiker's track, recorded every 7 s to half an hour, over generated terrain of 5 m.",
        shows: "Walking pace and few positions: hardly anything to predict.",
        due: Due::Open,
        replays: &[
            "--world terrain:size=16km,resolution=5m,texels=1024 --path {data}/paths/hike_korita_zbevnica.gpx --duration 300 \
             --link {data}/network/ghent_lte_foot_0006.txt,scale=0.02 --memory mu:0.5 --starts 3",
        ],
    },
    Case {
        name: "head-ride",
        why: "A recorded head rides on a recorded car through a generated city.",
        shows: "Fast translation that is foreseeable under fast rotation that is not.",
        due: Due::Open,
        replays: &[
            "--world city:blocks=60 --path {data}/paths/drive_comma2k19_highway --head {data}/paths/vr_head_rutgers_nyc_user101.csv,scale=0.64 \
             --link {data}/network/norway3g_car_10.txt --memory mu:0.5 --starts 3",
            "--world city:blocks=60 --path {data}/paths/drive_comma2k19_highway --head {data}/paths/vr_head_rutgers_nyc_user101.csv,scale=0.64 \
             --link {data}/network/norway3g_car_10.txt,scale=0.3 --memory mu:0.5 --starts 3",
        ],
    },
    Case {
        name: "turn",
        why: "Half a turn within a second, and back.",
        shows: "What is left of the view behind: on the fast link memory decides, on the slow one the order.",
        due: Due::Open,
        replays: &[
            "--path turn --link constant:40Mbit,40ms --memory mu:0.5 --starts 1",
            "--path turn --link constant:1Mbit,40ms --memory mu:0.5 --starts 1",
        ],
    },
    Case {
        name: "teleport",
        why: "A walk that jumps 200 m every 10 s.",
        shows: "Starting over again and again: no prediction helps, what comes first does.",
        due: Due::Open,
        replays: &[
            "--path teleport --link constant:4Mbit,40ms --memory mu:1 --starts 1",
            "--path teleport --link constant:1Mbit,40ms --memory mu:1 --starts 1",
        ],
    },
    Case {
        name: "known-path",
        why: "The client announces its path for the next 10 s, as for a flight to a chosen place; only the first policy listens.",
        shows: "What an announced path is worth against the same policy that has to guess, the second row.",
        due: Due::Open,
        replays: &[
            "--path teleport --announce 10 --link constant:4Mbit,40ms --memory mu:1 --starts 1 --policy foresight:predictor=known-path,all,3d-tiles-renderer:parallel=6",
            "--world city:blocks=60 --path {data}/paths/drive_comma2k19_highway --announce 10 --link {data}/network/norway3g_car_10.txt \
             --memory mu:0.5 --starts 3 --policy foresight:predictor=known-path,all,3d-tiles-renderer:parallel=6",
        ],
    },
    Case {
        name: "memory",
        why: "The walk's first minute with a quarter, a half, the whole and twice of what its largest view needs.",
        shows: "What planned discards are worth as memory grows.",
        due: Due::Open,
        replays: &[
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 60 \
             --link {data}/network/mahimahi_ATT-LTE-driving.down --memory mu:0.25 --starts 3",
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 60 \
             --link {data}/network/mahimahi_ATT-LTE-driving.down --memory mu:0.5 --starts 3",
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 60 \
             --link {data}/network/mahimahi_ATT-LTE-driving.down --memory mu:1 --starts 3",
            "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 60 \
             --link {data}/network/mahimahi_ATT-LTE-driving.down --memory mu:2 --starts 3",
        ],
    },
    Case {
        name: "latency",
        why: "A small real city of many small objects, half a second and more away.",
        shows: "How well the pipeline is kept full: bytes are few, round trips are not.",
        due: Due::Open,
        replays: &[
            "--world {data}/scenes/delft_lod1.city.json --path {data}/paths/walk_udel_gore.txt --duration 60 --link constant:2Mbit,600ms --memory mu:2 --starts 1",
            "--world {data}/scenes/mamre_osm_lod1_terrain.city.json --path steady:speed=20,duration=60 --link constant:2Mbit,1200ms --memory mu:2 --starts 1",
        ],
    },
    Case {
        name: "moving-link",
        why: "A drive with the link that was recorded on it, scaled, through a generated city.",
        shows: "Outages where the camera is when they happen.",
        due: Due::Open,
        replays: &[
            "--world city:blocks=60 --path {data}/network/irish5g_driving_B_2019.12.16_07.22.43.csv --from 600 --duration 300 \
             --link {data}/network/irish5g_driving_B_2019.12.16_07.22.43.csv,start=600,scale=0.05 --memory mu:0.5 --starts 1",
            "--world city:blocks=60 --path {data}/network/irish5g_driving_B_2019.12.16_07.22.43.csv --from 600 --duration 300 \
             --link {data}/network/irish5g_driving_B_2019.12.16_07.22.43.csv,start=600,scale=0.01 --memory mu:0.5 --starts 1",
        ],
    },
    Case {
        name: "null",
        why: "A real helicopter over a real city model of 49 buildings, both where they really are.",
        shows: "Nothing: the model is complete within a moment, so that all policies must be level once the rivals aim at 1 px. If they are not, the comparison is wrong.",
        due: Due::Tie,
        replays: &[
            "--world {data}/scenes/zurich_subset_lod2.city.json --path {data}/paths/aircraft_rega_zh.json.gz --place geo \
             --link {data}/network/mahimahi_ATT-LTE-driving.down --memory 64MiB --error-target 1 --starts 3",
        ],
    },
    Case {
        name: "low-detail",
        why: "Blocks without windows, seen from a shaky walk on a link that hardly carries them: little detail to come, and a view that \
              swings. Prediction has been found to lose on such scenes (Lazem, VT TR-07-24).",
        shows: "Where predicting can do harm.",
        due: Due::Open,
        replays: &["--world {data}/scenes/delft_lod1.city.json --path {data}/paths/walk_udel_gore.txt --duration 120 \
             --link {data}/network/norway3g_car_10.txt,scale=0.02 --memory mu:1 --starts 3"],
    },
    Case {
        name: "starved-small",
        why: "Four blocks of a city through a very thin link.",
        shows: "The first covers and their order; later there is nothing left to do.",
        due: Due::Open,
        replays: &[
            "--world city:blocks=4 --path steady:speed=2,duration=60 --link constant:60kbit,80ms --memory mu:1 --starts 1",
        ],
    },
    Case {
        name: "asteroids",
        why: "29,264 models in space ([HIBR] §7's second scene), flown through at 100 m/s.",
        shows: "A world without a ground, with detail in every direction.",
        due: Due::Open,
        replays: &[
            "--world asteroids: --path steady:speed=100,duration=120 --link {data}/network/norway3g_car_10.txt,scale=0.05 --memory mu:0.5 --starts 3",
            "--world asteroids: --path turn:speed=100,duration=60 --link {data}/network/norway3g_car_10.txt,scale=0.2 --memory mu:0.5 --starts 3",
        ],
    },
];
