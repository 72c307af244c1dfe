//! Every recorded file is either read or refused with a reason, and `inspect` names its traps from the file alone.

use std::path::Path;
use std::time::Duration;

use foresight_tests::program;

const LIMIT: Duration = Duration::from_secs(120);

/// What `inspect` must say of a file, besides what kind it is.
const TRAPS: [(&str, &[&str]); 24] = [
    ("scenes/mars_dingo_gap_3dtiles", &["+y is taken as up", "declared boxes are 64 m high", "grid=16"]),
    ("scenes/cesium_metadata_granularities", &["20 representations"]),
    ("scenes/cesium_sparse_implicit_quadtree", &["32 representations"]),
    ("scenes/delft_lod1.city.json", &["CityJSON", "small"]),
    ("scenes/mamre_osm_lod1_terrain.city.json", &["transform is applied twice", "geographicalExtent", "left out"]),
    ("scenes/zurich_subset_lod2.city.json", &["CityJSON", "small"]),
    ("scenes/3dbag_tile5870.city.jsonl", &["CityJSON", "small"]),
    ("scenes/jacksboro_fault_dem.npz", &["elevation grid", "degrees"]),
    ("paths/drive_udel_garage.txt", &["the header says xyzw, but the data are read as wxyz", "-z/-y"]),
    ("paths/walk_udel_gore.txt", &["+z/+y", "more than 8 columns"]),
    ("paths/handheld_tumvi_room1_gt.txt", &["-y/+z"]),
    ("paths/handheld_tum_fr2_desk_gt.txt", &["the longest 11.987 s", "not later than the one before", "weak evidence"]),
    ("paths/survey_georeferenced_utm.tum", &["--path-crs", "+x/+z"]),
    ("paths/drive_comma2k19_highway", &["+x/-z", "wxyz", "Earth"]),
    ("paths/aircraft_dreamliner_airfrance.json.gz", &["2 aircraft", "--icao24", "by air pressure"]),
    ("paths/aircraft_rega_zh.json.gz", &["+70.4 m against the pressure altitude"]),
    ("paths/aircraft_zero_gravity.json.gz", &["by air pressure"]),
    ("paths/glide_skydrop-2019-04-15.igc", &["+80.3 m against the pressure altitudes"]),
    ("paths/glide_skytraxx21-2023-04-15.igc", &["+59.2 m against the pressure altitudes"]),
    ("paths/hike_korita_zbevnica.gpx", &["from 7.000 s to 2041.000 s", "no orientations"]),
    (
        "paths/vr_head_rutgers_berlin_user101.csv",
        &["moves within 2.9 m", "rather to ride on another path", "asymmetric", "ViewIndex 0", "units of the scene"],
    ),
    ("network/irish5g_driving_B_2019.12.16_07.22.43.csv", &["334 of 2617 rows", ": path", ": link", "334 rows share"]),
    ("network/irish5g_static_B_2020.02.14_13.21.26.csv", &["74 of 1013 rows", ": path", ": link"]),
    ("network/starlink_leocc_first60s.down", &["16.0 to 86.0 ms", ".delay"]),
];

/// Files that are refused, with what the message says.
const REFUSED: [(&str, &str); 1] = [("network/starlink_leocc_first60s.delay", "delay")];

fn inspect(folder: &Path, file: &str) -> program::Ended {
    program::sim(folder, &["inspect", file], LIMIT)
}

#[test]
fn every_file_is_read_or_refused_with_a_reason() {
    let Some(data) = foresight_tests::data() else { return };
    let mut files = 0;
    for kind in ["scenes", "paths", "network"] {
        let mut names: Vec<String> = std::fs::read_dir(data.join(kind))
            .expect("the folder can be listed")
            .map(|entry| entry.expect("an entry").file_name().into_string().expect("a readable name"))
            .filter(|name| !name.ends_with(".source.txt"))
            .collect();
        names.sort();
        for name in names.iter().map(|name| format!("{kind}/{name}")) {
            let ended = inspect(&data, &name);
            files += 1;
            assert!(!ended.stderr.contains("panicked"), "{name}: {}", ended.stderr);
            match REFUSED.iter().find(|(refused, _)| *refused == name) {
                Some((_, reason)) => {
                    assert_eq!(ended.code, Some(2), "{name}: {}", ended.stdout);
                    assert!(ended.stderr.contains(reason) && ended.stderr.contains("expected"), "{}", ended.stderr);
                }
                None => {
                    assert_eq!(ended.code, Some(0), "{name}: {}", ended.stderr);
                    let kind = ["world", "path", "link"]
                        [["scenes", "paths", "network"].iter().position(|k| *k == kind).expect("listed")];
                    assert!(ended.stdout.contains(&format!("{name}: {kind}")), "{name}: {}", ended.stdout);
                }
            }
        }
    }
    assert!(files >= 39, "{files} files");
}

#[test]
fn traps_are_named_from_the_file_alone() {
    let Some(data) = foresight_tests::data() else { return };
    for (name, expected) in TRAPS {
        let ended = inspect(&data, name);
        assert_eq!(ended.code, Some(0), "{name}: {}", ended.stderr);
        for text in expected {
            assert!(ended.stdout.contains(text), "{name} does not say {text:?}:\n{}", ended.stdout);
        }
    }
}

#[test]
fn the_helicopter_flies_over_the_city_by_their_coordinates() {
    let Some(data) = foresight_tests::data() else { return };
    let (world, path) = ("scenes/zurich_subset_lod2.city.json", "paths/aircraft_rega_zh.json.gz");
    let ended = program::sim(&data, &["inspect", world, path], LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let share = ended.stdout.lines().find_map(|line| line.trim().strip_prefix("placed by coordinates: "));
    let share = share.unwrap_or_else(|| panic!("not placed by coordinates:\n{}", ended.stdout));
    let numbers: Vec<f64> = share.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    assert!((0.4..0.55).contains(&(numbers[0] / numbers[1])), "{share}");
}
