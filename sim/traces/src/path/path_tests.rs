//! Interpolation, slices, placement and made paths against what they must be.

use glam::{DQuat, DVec3};
use proptest::prelude::*;

use super::place::{Placement, Site, place};
use super::{CameraPath, Pose, built_in, teleport, turn};

fn pose(time: f64, position: [f64; 3]) -> Pose {
    Pose { time, position: position.into(), orientation: DQuat::IDENTITY }
}

fn path(poses: Vec<Pose>) -> CameraPath {
    CameraPath::new("test", poses, DVec3::Z).unwrap()
}

fn forward(orientation: DQuat) -> DVec3 {
    orientation * -DVec3::Z
}

#[test]
fn straight_uniform_motion_is_exact() {
    // Times and coordinates are dyadic, so not even rounding is allowed.
    let poses = [0.0, 0.25, 0.5, 1.5, 1.75, 3.0].map(|t| pose(t, [1024.0 + 2.0 * t, -t, 8.0 * t]));
    let path = path(poses.to_vec());
    for k in 0..=384 {
        let t = f64::from(k) / 128.0;
        assert_eq!(path.at(t).0, DVec3::new(1024.0 + 2.0 * t, -t, 8.0 * t), "at {t}");
    }
}

#[test]
fn uniform_steps_reproduce_a_parabola() {
    // Centred differences are exact for a parabola in equal steps; the first and last step have one-sided tangents.
    let at = |t: f64| DVec3::new(t * t, 3.0 - 2.0 * t * t + t, 0.0);
    let poses = (0..12).map(|k| pose(f64::from(k) * 0.5, at(f64::from(k) * 0.5).to_array())).collect();
    let path = path(poses);
    for k in 50..500 {
        let t = f64::from(k) * 0.01;
        assert!(path.at(t).0.distance(at(t)) < 1e-12, "at {t}");
    }
}

#[test]
fn outside_the_path_the_camera_rests() {
    let path = path(vec![pose(0.0, [1.0, 0.0, 0.0]), pose(1.0, [2.0, 0.0, 0.0])]);
    for (t, x) in [(-5.0, 1.0), (0.0, 1.0), (1.0, 2.0), (9.0, 2.0), (f64::INFINITY, 2.0), (f64::NEG_INFINITY, 1.0)] {
        assert_eq!(path.at(t).0.x, x);
    }
    assert_eq!(path.at(f64::NAN).0.x, 1.0);
    let looped = path.looped();
    assert_eq!(looped.at(4.25).0.x, 1.25);
    assert_eq!(looped.duration(), 1.0);
    assert!(looped.at(f64::INFINITY).0.is_finite());
    assert_ne!(looped.hash(), path.hash());
}

#[test]
fn a_pause_of_an_hour_does_not_overshoot() {
    let mut poses: Vec<Pose> = (0..100).map(|k| pose(f64::from(k) * 0.01, [f64::from(k), 0.0, 0.0])).collect();
    let later = |k: i32| pose(3600.0 + f64::from(k) * 0.01, [99.0 + f64::from(k), 0.0, 5.0]);
    poses.extend((0..100).map(later));
    let path = path(poses);
    assert!(path.notes().iter().any(|note| note.starts_with("1 gaps")), "{:?}", path.notes());
    for k in 0..1000 {
        let (p, _) = path.at(0.99 + 3599.0 * f64::from(k) / 1000.0);
        assert!((99.0..=99.0 + 1e-9).contains(&p.x) && (0.0..=5.0).contains(&p.z), "{p}");
    }
    // The motion before it is as if the pause were not there.
    assert!((path.at(0.985).0.x - 98.5).abs() < 1e-9);
    assert!((path.at(3600.005).0.x - 99.5).abs() < 1e-9);
}

#[test]
fn orientations_take_the_shortest_arc_at_constant_speed() {
    let quarter = DQuat::from_rotation_z(1.0);
    let mut poses = vec![pose(0.0, [0.0; 3]), pose(1.0, [0.0; 3]), pose(2.0, [0.0; 3])];
    poses[1].orientation = -quarter;
    poses[2].orientation = DQuat::from_rotation_z(1.0 + 1e-9);
    let path = path(poses);
    for k in 0..=10 {
        let t = f64::from(k) / 10.0;
        assert!(path.at(t).1.angle_between(DQuat::from_rotation_z(t)) < 1e-7, "at {t}");
    }
    assert!(path.at(1.5).1.is_normalized());
}

#[test]
fn contradictory_poses_are_refused() {
    let new = |poses| CameraPath::new("t", poses, DVec3::Z).map(|_| ()).map_err(|error| error.to_string());
    assert!(new(vec![]).unwrap_err().contains("needs at least 2 poses"));
    assert!(new(vec![pose(0.0, [0.0; 3])]).unwrap_err().contains("needs at least 2 poses"));
    assert!(new(vec![pose(1.0, [0.0; 3]), pose(2.0, [0.0; 3])]).is_err());
    assert!(new(vec![pose(0.0, [0.0; 3]), pose(0.0, [0.0; 3])]).unwrap_err().contains("pose 1"));
    assert!(new(vec![pose(0.0, [0.0; 3]), pose(f64::NAN, [0.0; 3])]).is_err());
    assert!(new(vec![pose(0.0, [0.0; 3]), pose(1.0, [f64::NAN, 0.0, 0.0])]).is_err());
    assert!(new(vec![pose(0.0, [0.0; 3]), pose(1.0, [1e13, 0.0, 0.0])]).is_err());
    let mut zero = pose(1.0, [0.0; 3]);
    zero.orientation = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    assert!(new(vec![pose(0.0, [0.0; 3]), zero]).unwrap_err().contains("length 0"));
    assert!(CameraPath::new("t", vec![], DVec3::ZERO).is_err());
}

#[test]
fn placement_turns_up_to_up_and_keeps_the_speed() {
    // A path with y up that goes along −z, high above its own origin, and looks ahead.
    let poses = (0..=10).map(|k| pose(f64::from(k), [500.0, 40.0, -10.0 * f64::from(k)])).collect();
    let path = CameraPath::new("test", poses, DVec3::Y).unwrap();
    let placement: Placement = "centre,height=3".parse().unwrap();
    let site = Site { centre: DVec3::new(1000.0, 2000.0, 777.0), up: DVec3::Z * 2.0, ground_height: 25.0 };
    let placed = place(&path, &placement, &site).unwrap();
    assert_eq!(placed.up(), DVec3::Z);
    let (start, end) = (placed.at(0.0), placed.at(10.0));
    // Up stays up; −z of the path becomes +y.
    assert!(start.0.distance(DVec3::new(1000.0, 1950.0, 28.0)) < 1e-9, "{}", start.0);
    assert!(end.0.distance(DVec3::new(1000.0, 2050.0, 28.0)) < 1e-9, "{}", end.0);
    assert!(forward(start.1).distance(DVec3::Y) < 1e-12);
    assert!((start.1 * DVec3::Y).distance(DVec3::Z) < 1e-12);
    // A quarter turn counter-clockwise, and half the size.
    let placed = place(&path, &"centre,yaw=90,scale=0.5".parse().unwrap(), &site).unwrap();
    assert!(placed.at(0.0).0.distance(DVec3::new(1025.0, 2000.0, 27.0)) < 1e-9);
    assert!(forward(placed.at(0.0).1).distance(-DVec3::X) < 1e-12);
}

#[test]
fn placement_on_a_planet_keeps_the_millimetre() {
    let up = DVec3::new(0.6, 0.0, 0.8);
    let poses = (0..=100).map(|k| pose(f64::from(k) * 0.1, [5e5 + 0.001 * f64::from(k), 5.4e6, 160.0])).collect();
    let site = Site { centre: up * 6.4e6, up, ground_height: 6.4e6 };
    let placed = place(&path(poses), &Placement::default(), &site).unwrap();
    for pair in placed.poses().windows(2) {
        assert!((pair[0].position.distance(pair[1].position) - 0.001).abs() < 1e-8);
    }
    assert!((placed.at(5.0).0.dot(up) - 6.4e6 - 2.0).abs() < 1e-8);
    // Upside down is a rotation too.
    let below = Site { centre: DVec3::ZERO, up: -DVec3::Z, ground_height: 0.0 };
    assert!((place(&placed, &Placement::default(), &below).unwrap().at(5.0).0.z + 2.0).abs() < 1e-6);
}

#[test]
fn placements_are_parsed_and_refused() {
    assert_eq!("centre".parse::<Placement>().unwrap(), Placement::default());
    assert_eq!("geo".parse::<Placement>().unwrap(), Placement::Geo { height: None });
    assert_eq!("world".parse::<Placement>().unwrap(), Placement::World);
    assert!("world,height=2".parse::<Placement>().is_err());
    let text = "geo,height=3";
    assert_eq!(text.parse::<Placement>().unwrap().to_string(), text);
    let text = "centre,height=-7.5,yaw=10,scale=3";
    assert_eq!(text.parse::<Placement>().unwrap().to_string(), text);
    for bad in [
        "",
        "center?",
        "geo,yaw=3",
        "geo,height=x",
        "centre,height",
        "centre,height=nan",
        "centre,scale=0",
        "centre,x=1",
    ] {
        assert!(bad.parse::<Placement>().is_err(), "{bad}");
    }
    let site = Site { centre: DVec3::ZERO, up: DVec3::Z, ground_height: 0.0 };
    let error = place(&built_in(), &Placement::Geo { height: None }, &site).unwrap_err().to_string();
    assert!(error.contains("a world without geographic coordinates"), "{error}");
    for site in [
        Site { up: DVec3::ZERO, ..site },
        Site { up: DVec3::NAN, ..site },
        Site { centre: DVec3::INFINITY, ..site },
        Site { ground_height: f64::NAN, ..site },
        Site { ground_height: 1e300, ..site },
    ] {
        assert!(place(&built_in(), &Placement::default(), &site).is_err());
    }
}

#[test]
fn the_built_in_flight_is_what_it_says() {
    let path = built_in();
    assert_eq!((path.duration(), path.poses().len()), (60.0, 3601));
    assert!(path.notes().is_empty(), "{:?}", path.notes());
    for pair in path.poses().windows(2) {
        assert!(pair[0].position.distance(pair[1].position) * 60.0 < 65.0, "at {}", pair[0].time);
        assert!((2.0..230.0).contains(&pair[1].position.z), "{} at {}", pair[1].position, pair[1].time);
        assert!(pair[1].position.abs().max_element() < 1000.0);
        let turned = pair[0].orientation.angle_between(pair[1].orientation);
        assert!(turned * 60.0 < 460f64.to_radians(), "{turned} at {}", pair[0].time);
    }
    // No jump of speed either: an acceleration below 4 g.
    for three in path.poses().windows(3) {
        let bend = three[2].position - 2.0 * three[1].position + three[0].position;
        assert!(bend.length() * 3600.0 < 40.0, "{} at {}", bend.length() * 3600.0, three[1].time);
    }
    // Along the street, at rest, turned around, and over the centre with the head banked.
    assert!(path.at(27.0).0.y.abs() < 1e-9 && forward(path.at(27.0).1).distance(DVec3::X) < 0.05);
    assert_eq!(path.at(36.2).0, path.at(38.4).0);
    assert!(forward(path.at(36.4).1).angle_between(forward(path.at(37.4).1)) > 3.0);
    let nearest = (3200..3600).map(|k| path.at(f64::from(k) / 60.0).0.truncate().length()).fold(f64::MAX, f64::min);
    assert!(nearest < 50.0, "{nearest}");
    assert!((path.at(53.0).1 * DVec3::X).z.abs() > 0.3);
    assert_eq!(&path.hash().to_hex()[..16], "8abe62f88a758c1b");
}

#[test]
fn made_paths_for_measurements() {
    let path = turn::steady(10.0, 5.0).unwrap();
    assert!(path.at(2.5).0.distance(DVec3::new(25.0, 0.0, 0.0)) < 1e-9);
    assert!(forward(path.at(2.5).1).distance(DVec3::X) < 1e-12);
    let path = turn::turn(10.0, 21.0).unwrap();
    assert!((path.at(10.0).0.x - 100.0).abs() < 1e-9 && (path.at(11.0).0.x - 100.0).abs() < 1e-9);
    assert!((path.at(10.5).0.x - 100.0 - 10.0 / std::f64::consts::PI).abs() < 1e-9);
    assert!(path.at(21.0).0.length() < 1e-9);
    assert!(forward(path.at(9.9).1).distance(DVec3::X) < 1e-9 && forward(path.at(11.1).1).distance(-DVec3::X) < 1e-9);
    for (speed, duration) in [(-1.0, 5.0), (f64::NAN, 5.0), (1.0, 0.0), (1.0, f64::NAN), (1.0, 1e9)] {
        assert!(turn::steady(speed, duration).is_err() && turn::turn(speed, duration).is_err());
    }
    assert!(turn::turn(1.0, 1.0).is_err());
}

#[test]
fn a_teleport_is_instantaneous_and_leaves_no_trace_in_the_motion() {
    for gap in [1e-9, 1e-6, 1e-3] {
        let mut poses: Vec<Pose> = (0..60).map(|k| pose(f64::from(k) / 60.0, [f64::from(k), 0.0, 0.0])).collect();
        let end = 60.0 / 60.0 - gap;
        poses.push(pose(end, [60.0 * end, 0.0, 0.0]));
        poses.extend((60..120).map(|k| pose(f64::from(k) / 60.0, [5000.0, f64::from(k), 0.0])));
        let path = path(poses);
        assert!(path.notes().iter().any(|note| note.starts_with("1 jumps")), "{:?}", path.notes());
        for k in 0..=12_000 {
            let t = f64::from(k) / 6000.0;
            let (p, _) = path.at(t);
            let expected = match t {
                t if t >= 1.0 => DVec3::new(5000.0, 60.0 * t.min(119.0 / 60.0), 0.0),
                t => DVec3::new(60.0 * t.min(end), 0.0, 0.0),
            };
            assert!(p.distance(expected) < 1e-8, "at {t}, gap {gap}: {p}");
        }
    }
}

#[test]
fn the_made_teleports_walk_and_jump_as_told() {
    let path = teleport::teleport(2.0, 60.0, 7.5, 300.0, 1).unwrap();
    assert_eq!(path.duration(), 60.0);
    let jumps: Vec<usize> = (1..path.poses().len()).filter(|&i| path.jumps_to(i)).collect();
    assert_eq!(
        jumps.iter().map(|&i| path.poses()[i].time).collect::<Vec<_>>(),
        [7.5, 15.0, 22.5, 30.0, 37.5, 45.0, 52.5]
    );
    for i in 1..path.poses().len() {
        let (a, b) = (path.poses()[i - 1], path.poses()[i]);
        let (step, went) = (b.time - a.time, a.position.distance(b.position));
        if jumps.contains(&i) {
            assert!((1e-9..=1e-3).contains(&step) && (went - 300.0).abs() < 1e-5, "{step} s, {went} m");
        } else {
            assert!(
                (went - 2.0 * step).abs() < 1e-9 && forward(a.orientation).distance(forward(b.orientation)) < 1e-12
            );
            assert!(forward(a.orientation).distance((b.position - a.position) / went) < 1e-6);
        }
        assert!(b.position.length() < 1000.0 && b.position.z == 0.0);
    }
    assert_eq!(path.hash(), teleport::teleport(2.0, 60.0, 7.5, 300.0, 1).unwrap().hash());
    assert_ne!(path.hash(), teleport::teleport(2.0, 60.0, 7.5, 300.0, 2).unwrap().hash());
    let standing = teleport::teleport(0.0, 3.0, 1.0, 5.0, 1).unwrap();
    assert_eq!(standing.at(0.999).0, standing.at(0.0).0);
    assert!((standing.at(1.0).0.length() - 5.0).abs() < 1e-9);
    for (every, distance) in [(0.0, 5.0), (f64::NAN, 5.0), (99.0, 5.0), (1.0, 0.0), (1.0, f64::NAN), (1.0, 1e9)] {
        assert!(teleport::teleport(2.0, 60.0, every, distance, 1).is_err());
    }
}

prop_compose! {
    fn poses()(
        steps in proptest::collection::vec((prop_oneof![1e-9..1e-3f64, 0.01..0.02f64, 0.5..5.0f64, Just(3600.0)],
            prop::array::uniform3(-1e7..1e7f64), prop::array::uniform4(-1.0..1.0f64)), 2..20)
    ) -> Vec<Pose> {
        let mut time = -steps[0].0;
        steps.into_iter().map(|(step, position, q)| {
            time += step;
            let q = DQuat::from_array(q);
            let orientation = if q.length() > 1e-3 { q.normalize() } else { DQuat::IDENTITY };
            Pose { time, position: position.into(), orientation }
        }).collect()
    }
}

proptest! {
    #[test]
    fn poses_are_finite_unit_and_continuous(poses in poses(), at in prop::collection::vec(-0.1..1.1f64, 20)) {
        let path = CameraPath::new("test", poses, DVec3::Y).unwrap();
        for (i, pose) in path.poses().iter().enumerate() {
            let (p, q) = path.at(pose.time);
            prop_assert_eq!(p, pose.position);
            prop_assert!(q.angle_between(pose.orientation) < 1e-7);
            // From below it arrives at the pose.
            if path.jumps_to(i) {
                // Until then nothing of it is seen.
                let (p, q) = path.at(pose.time.next_down());
                let previous = path.poses()[i - 1];
                prop_assert_eq!((p, q), (previous.position, previous.orientation));
            } else if i > 0 {
                let previous = path.poses()[i - 1];
                let before = pose.time.next_down();
                let (p, q) = path.at(before);
                // An interval of floating-point numbers is the share ulp/step of the step.
                let share = (pose.time - before) / (pose.time - previous.time);
                prop_assert!(p.distance(pose.position) <= 1e-6 + share * 3e8, "{} {}", p, pose.position);
                prop_assert!(q.angle_between(pose.orientation) <= 1e-6 + share * 4.0);
            }
        }
        for share in at {
            let t = share * path.duration();
            let (p, q) = path.at(t);
            prop_assert!(p.is_finite() && q.is_finite() && (q.length() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_placed_path_is_a_similarity(poses in poses(), yaw in -400.0..400.0f64, scale in 0.1..10.0f64) {
        let path = CameraPath::new("test", poses, DVec3::Y).unwrap();
        let site = Site { centre: DVec3::new(1.0, 2.0, 3.0), up: DVec3::Z, ground_height: -5.0 };
        let placed = place(&path, &Placement::Centre { height: 1.0, yaw, scale }, &site).unwrap();
        for (a, b) in path.poses().windows(2).zip(placed.poses().windows(2)) {
            let (from, to) = (a[0].position.distance(a[1].position), b[0].position.distance(b[1].position));
            prop_assert!((from * scale - to).abs() < 1e-6);
            let climb = (b[1].position - b[0].position).z - scale * (a[1].position - a[0].position).y;
            prop_assert!(climb.abs() < 1e-6);
        }
    }
}
