//! Paths on the Earth in flat and in georeferenced worlds, against closed forms.

use foresight_index::geodesy::{Geodetic, Projection};
use foresight_index::ground::Ground;
use foresight_index::world::{self, Georeference, World, built_in_city};
use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, Representation};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

use super::super::look::{Aim, aim};
use super::super::parse::{Options, from_file};
use super::super::{CameraPath, Frame, Heights, Pose, built_in, turn};
use super::flatten::flatten;
use super::geo::from_projected as read_projected;
use super::{Placement, geo, into_world};
use crate::recorded::data;

/// A path through places by degrees and metres, a second apart, looking along its motion.
fn flight(places: &[[f64; 3]], heights: Heights) -> CameraPath {
    let pose = |(second, [latitude, longitude, height]): (usize, &[f64; 3])| Pose {
        time: second as f64,
        position: Geodetic::from_degrees(*latitude, *longitude, *height).to_ecef(),
        orientation: DQuat::IDENTITY,
    };
    let path = CameraPath::on_earth("flight", places.iter().enumerate().map(pose).collect(), heights).unwrap();
    aim(&path, Aim::Motion)
}

/// A world of one box whose ground is at a height.
fn world(min: DVec3, max: DVec3, ground: f64, up: DVec3, georeference: Option<Georeference>) -> World {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    let rep = Representation { wire_bytes: 1, decoded_bytes: 1, error: 0.0, prerequisite: None, direction: None };
    builder.add(rep).unwrap();
    builder.close(Some(Aabb { min, max }), 1.0).unwrap();
    let tree = builder.finish().unwrap();
    World { name: "box".into(), tree, up, ground: Ground::Flat(ground), georeference, ..built_in_city() }
}

fn forward(orientation: DQuat) -> DVec3 {
    orientation * -DVec3::Z
}

#[test]
fn a_square_on_the_ellipsoid_stays_a_square() {
    // Corners 1 km east and north of a middle, 100 m up, by the axes there; the drop by curvature is 0.08 m.
    let middle = Geodetic::from_degrees(47.0, 8.0, 100.0);
    let axes = middle.east_north_up();
    let corners = [[-1e3, -1e3], [1e3, -1e3], [1e3, 1e3], [-1e3, 1e3], [-1e3, -1e3]].map(|[east, north]| {
        let corner = Geodetic::from_ecef(middle.to_ecef() + axes * DVec3::new(east, north, 0.0)).unwrap();
        [corner.latitude.to_degrees(), corner.longitude.to_degrees(), 100.0]
    });
    let flat = flatten(&flight(&corners, Heights::Ellipsoid)).unwrap();
    assert_eq!((flat.frame(), flat.up()), (Frame::Local, DVec3::Z));
    for (k, pair) in flat.poses().windows(2).enumerate() {
        let side = pair[1].position - pair[0].position;
        // Feet lie 100 m below: shorter by 100 m / R.
        assert!((side.length() - 2e3 * (1.0 - 100.0 / 6.38e6)).abs() < 1e-3, "{k}: {}", side.length());
        let expected = [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y][k];
        assert!(side.normalize().distance(expected) < 1e-6);
        assert!((pair[0].position.z - 100.0).abs() < 1e-8 && pair[0].orientation.is_normalized());
    }
    assert!((flat.poses()[2].orientation * DVec3::Y).distance(DVec3::Z) < 1e-3);
    assert!(flat.notes().iter().all(|note| !note.contains("changes its length")));
}

#[test]
fn a_long_flight_keeps_its_speed_and_its_heading() {
    // Along the equator arcs are a·Δλ, to either side of the antimeridian, and the motion is straight.
    let places: Vec<[f64; 3]> = (0..=20).map(|k| [0.0, 170.0 + f64::from(k), 10_000.0]).collect();
    let flat = flatten(&flight(&places, Heights::Pressure)).unwrap();
    for pair in flat.poses().windows(2) {
        let step = pair[1].position - pair[0].position;
        assert!(step.distance(DVec3::X * 6_378_137.0 * 1f64.to_radians()) < 1e-3, "{step}");
        // A second ahead along the chord the Earth has dropped by half a degree; at the ends by more.
        assert!(forward(pair[0].orientation).distance(DVec3::X) < 0.03, "{}", forward(pair[0].orientation));
    }
    // Along a parallel at 60° north, 30° long: the way bends to the map's north at its ends, and the camera with it.
    let places: Vec<[f64; 3]> = (0..=300).map(|k| [60.0, f64::from(k) * 0.1, 10_000.0]).collect();
    let flat = flatten(&flight(&places, Heights::Pressure)).unwrap();
    let poses = flat.poses();
    for k in [2, 150, 298] {
        let along = (poses[k + 1].position - poses[k - 1].position).normalize();
        assert!(forward(poses[k].orientation).distance(along) < 0.01, "{k}: {along}");
        assert!((poses[k].orientation * DVec3::Y).z > 0.999_99);
    }
    assert!(poses[2].position.y > poses[150].position.y + 9e4 && forward(poses[2].orientation).y < -0.1);
    // Around the world there is no middle: whatever comes out is finite.
    let places: Vec<[f64; 3]> = (0..=36).map(|k| [0.0, f64::from(k) * 10.0, 0.0]).collect();
    for pose in flatten(&flight(&places, Heights::Ellipsoid)).unwrap().poses() {
        assert!(pose.position.is_finite() && pose.orientation.is_normalized());
    }
}

/// Of a flight north through a place, in UTM zone 33 (central meridian 15°): the placed path.
fn north_through(latitude: f64, longitude: f64) -> geo::Placed {
    let places = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k| [latitude + k * 1e-4, longitude, 300.0]);
    let utm = Projection::from_epsg(32633).unwrap();
    let here = utm.forward(Geodetic::from_degrees(latitude, longitude, 0.0)).unwrap();
    let half = DVec3::new(500.0, 500.0, 50.0);
    let world = world(here - half, here + half, 250.0, DVec3::Z, Some(Georeference::Epsg(32633)));
    geo::place(&flight(&places, Heights::SeaLevel), None, &world).unwrap()
}

#[test]
fn true_north_leaves_the_grid_by_its_convergence() {
    for (longitude, latitude) in [(15.0, 47.0), (18.0, 47.0), (12.0, 60.0), (17.0, -30.0)] {
        let placed = north_through(latitude, longitude);
        assert!(placed.is_over);
        // γ = tan⁻¹(tan Δλ sin φ) on a sphere; the ellipsoid changes it by less than 10⁻⁵ within a zone.
        let east = f64::to_radians(longitude - 15.0);
        let gamma = libm::atan(libm::tan(east) * libm::sin(f64::to_radians(latitude)));
        let expected = DVec3::new(-libm::sin(gamma), libm::cos(gamma), 0.0);
        let pose = placed.path.poses()[2];
        assert!(forward(pose.orientation).distance(expected) < 2e-5, "{longitude}: {}", forward(pose.orientation));
        let along = (placed.path.poses()[3].position - placed.path.poses()[1].position).normalize();
        assert!(forward(pose.orientation).distance(along) < 1e-6, "{longitude}: {along}");
        assert!((pose.orientation * DVec3::Y).distance(DVec3::Z) < 1e-6 && (pose.position.z - 300.0).abs() < 1e-6);
        assert_eq!((placed.path.frame(), placed.path.up()), (Frame::Local, DVec3::Z));
    }
    assert!((north_through(47.0, 15.0).path.poses()[2].position.x - 500_000.0).abs() < 1e-5);
}

#[test]
fn there_and_back_through_a_grid() {
    let path = CameraPath::new(
        "t",
        (0..50)
            .map(|k| {
                let k = f64::from(k);
                let position = DVec3::new(458_000.0 + 3.0 * k, 5_429_000.0 - 2.0 * k, 150.0 + 0.1 * k);
                Pose { time: k, position, orientation: DQuat::from_rotation_z(0.1 * k) * DQuat::from_rotation_x(1.0) }
            })
            .collect(),
        DVec3::Z,
    )
    .unwrap();
    let earth = read_projected(path.clone(), 32632).unwrap();
    assert_eq!(earth.frame(), Frame::Earth(Heights::SeaLevel));
    let (low, high) = (DVec3::new(457_000.0, 5_428_000.0, 0.0), DVec3::new(459_000.0, 5_430_000.0, 300.0));
    let there = world(low, high, 0.0, DVec3::Z, Some(Georeference::Epsg(32632)));
    let back = geo::place(&earth, None, &there).unwrap();
    assert!(back.is_over);
    for (a, b) in path.poses().iter().zip(back.path.poses()) {
        assert!(a.position.distance(b.position) < 1e-4, "{} {}", a.position, b.position);
        assert!(a.orientation.angle_between(b.orientation) < 1e-7);
    }
    let refused = read_projected(path.clone(), 999_999).unwrap_err().to_string();
    assert!(refused.contains("999999"), "{refused}");
    let message = |error: super::PathError| error.to_string();
    let no_crs = geo::place(&path, None, &there).map(|_| ()).map_err(message).unwrap_err();
    assert!(no_crs.contains("this path carries no geographic coordinates") && no_crs.contains("--path-crs"));
    let city = built_in_city();
    let no_world = geo::place(&earth, None, &city).map(|_| ()).map_err(message).unwrap_err();
    assert!(no_world.contains(&format!("world {} carries no geographic coordinates", city.name)), "{no_world}");
    let neither = geo::place(&built_in(), None, &city).map(|_| ()).map_err(message).unwrap_err();
    assert!(neither.contains("neither this path nor world"), "{neither}");
}

#[test]
fn paths_are_lifted_to_the_ground() {
    let middle = Geodetic::from_degrees(45.0, 7.0, 200.0);
    let (up, centre) = (middle.east_north_up().z_axis, middle.to_ecef());
    let half = DVec3::splat(3000.0);
    let earth = world(centre - half, centre + half, centre.dot(up), up, Some(Georeference::Ecef));
    let places = [0.0, 1.0, 2.0, 3.0].map(|k| [45.0 + k * 1e-3, 7.0, 250.0 + 10.0 * k]);
    let path = flight(&places, Heights::Ellipsoid);
    let as_is = geo::place(&path, None, &earth).unwrap();
    for (a, b) in path.poses().iter().zip(as_is.path.poses()) {
        assert_eq!(a.position, b.position);
    }
    assert!(as_is.is_over && as_is.path.notes().last().unwrap().contains("4 of 4 poses lie over the world"));
    let lifted = geo::place(&path, Some(2.0), &earth).unwrap().path;
    assert!(lifted.notes().iter().any(|note| note.contains("lifted by -48.00 m")), "{:?}", lifted.notes());
    for (a, b) in path.poses().iter().zip(lifted.poses()) {
        let vertical = path.level_axes(a.position).z_axis;
        assert!((b.position - a.position).distance(vertical * -48.0) < 1e-6);
    }
    // Heights above the ground follow the world's.
    let ground = geo::place(&flight(&places, Heights::Ground), None, &earth).unwrap().path;
    assert!((ground.poses()[0].position.dot(up) - centre.dot(up) - 250.0).abs() < 1e-6);
    // Far away, on the other side and at the same place by another reckoning.
    let far = flight(&[[-45.0, -173.0, 0.0], [-45.0, -173.001, 0.0]], Heights::Pressure);
    let placed = geo::place(&far, None, &earth).unwrap();
    assert!(!placed.is_over && placed.path.notes().iter().any(|note| note.contains("comes no nearer than 127")));
    assert!(placed.path.notes().iter().any(|note| note.contains("the world's above the ellipsoid")));
}

#[test]
fn without_a_placement_coordinates_count_where_both_meet() {
    let middle = Geodetic::from_degrees(45.0, 7.0, 200.0);
    let (up, centre) = (middle.east_north_up().z_axis, middle.to_ecef());
    let half = DVec3::splat(3000.0);
    let earth = world(centre - half, centre + half, centre.dot(up), up, Some(Georeference::Ecef));
    let near = flight(&[[45.0, 7.0, 250.0], [45.001, 7.0, 250.0]], Heights::Ellipsoid);
    assert_eq!(into_world(&near, None, &earth).unwrap().1, Placement::Geo { height: None });
    let far = flight(&[[46.0, 7.0, 250.0], [46.001, 7.0, 250.0]], Heights::Ellipsoid);
    let (placed, placement) = into_world(&far, None, &earth).unwrap();
    assert_eq!(placement, Placement::default());
    assert!(placed.notes().last().unwrap().contains("it does not come over this world"), "{:?}", placed.notes());
    assert!((placed.at(0.5).0.dot(up) - centre.dot(up) - 2.0).abs() < 1e-6);
    let local = turn::steady(5.0, 10.0).unwrap();
    assert_eq!(into_world(&local, None, &earth).unwrap().1, Placement::default());
    // The flattened flight goes north in the city, z up.
    let (placed, _) = into_world(&near, None, &built_in_city()).unwrap();
    let moved = placed.at(1.0).0 - placed.at(0.0).0;
    assert!(moved.distance(DVec3::Y * 111.13) < 0.05, "{moved}");
    assert!(forward(placed.at(0.5).1).distance(DVec3::Y) < 1e-4);
}

#[test]
fn a_real_helicopter_over_the_real_city_beneath_it() {
    let (Some(paths), Some(scenes)) = (data("paths"), data("scenes")) else { return };
    let path = from_file(&paths.join("aircraft_rega_zh.json.gz"), &Options::default()).unwrap();
    let city = world::open(&scenes.join("zurich_subset_lod2.city.json")).unwrap();
    assert!(matches!(city.georeference, Some(Georeference::Epsg(2056))), "{:?}", city.georeference);
    let (placed, placement) = into_world(&path, None, &city).unwrap();
    assert_eq!(placement, Placement::Geo { height: None });
    // About half of its samples lie over the city, between its roofs and a kilometre above them.
    let over = placed.notes().iter().find(|note| note.contains("poses lie over the world")).unwrap();
    assert_eq!(over, "placed by coordinates: 154 of 337 poses lie over the world");
    let bounds = city.tree.bounds(city.tree.root());
    for pose in placed.poses() {
        let p = pose.position;
        if p.truncate().cmpge(bounds.min.truncate()).all() && p.truncate().cmple(bounds.max.truncate()).all() {
            assert!((10.0..1000.0).contains(&(p.z - city.ground_height(p).unwrap())), "{p}");
        }
    }
    // The scale of the grid is 1 to 10⁻⁴ here.
    let steps = path.poses().windows(2).zip(placed.poses().windows(2));
    for (earth, grid) in steps {
        let (a, b) = (earth[0].position.distance(earth[1].position), grid[0].position.distance(grid[1].position));
        assert!((a - b).abs() < 1e-3 * a + 1e-3, "{a} {b}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_flight_is_flattened_or_refused(places in prop::collection::vec([-90.0..90.0f64, -180.0..180.0, -1e4..1e7], 2..8)) {
        let path = flight(&places, Heights::Ellipsoid);
        if let Ok(flat) = flatten(&path) {
            for pose in flat.poses() {
                prop_assert!(pose.position.is_finite() && pose.orientation.is_normalized());
            }
        }
        let city = world(DVec3::splat(-1.0), DVec3::splat(1.0), 0.0, DVec3::Z, Some(Georeference::Epsg(32633)));
        if let Ok(placed) = geo::place(&path, Some(1.0), &city) {
            prop_assert!(placed.path.poses().iter().all(|pose| pose.position.is_finite()));
        }
    }

    #[test]
    fn a_camera_looks_where_it_is_aimed(target in [-1e3..1e3f64, -1e3..1e3, -1e3..1e3]) {
        let path = turn::steady(5.0, 4.0).unwrap();
        let target = DVec3::from_array(target);
        let aimed = aim(&path, Aim::Point(target));
        for pose in aimed.poses() {
            let d = target - pose.position;
            prop_assume!(d.length() > 1e-3);
            prop_assert!(forward(pose.orientation).distance(d.normalize()) < 1e-9);
            // Level: right lies across up.
            prop_assert!((pose.orientation * DVec3::X).z.abs() < 1e-9);
        }
    }
}
