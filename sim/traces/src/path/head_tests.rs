//! A head on a vehicle, against what it must look at.

use glam::{DQuat, DVec3};

use super::head::Head;
use super::parse::{Options, from_file};
use super::{CameraPath, Pose, teleport, turn};
use crate::recorded::data;

fn forward(orientation: DQuat) -> DVec3 {
    orientation * DVec3::NEG_Z
}

/// A head in a frame with y up that looks along +x on average, turned aside by `yaw(t)` and leaning along its own right.
fn head(seconds: f64, yaw: impl Fn(f64) -> f64, right: impl Fn(f64) -> f64) -> CameraPath {
    let count = (seconds * 90.0) as u32;
    let poses = (0..=count).map(|k| {
        let time = f64::from(k) / 90.0;
        // −90° about y turns −z to +x, and right, +x, to +z.
        let mean = DQuat::from_rotation_y(-std::f64::consts::FRAC_PI_2);
        let position = DVec3::new(7.0, 1.6, 3.0 + right(time));
        Pose { time, position, orientation: mean * DQuat::from_rotation_y(yaw(time)) }
    });
    CameraPath::new("head", poses.collect(), DVec3::Y).unwrap()
}

#[test]
fn it_looks_aside_from_the_vehicle_and_leans_in_its_frame() {
    let vehicle = turn::steady(10.0, 20.0).unwrap();
    let wave = |t: f64| libm::sin(std::f64::consts::TAU * t);
    let recorded = head(3.0, |t| 0.5 * wave(t), |t| 0.64 * wave(t));
    let path = Head::new(recorded, Some(0.64)).unwrap().ride(&vehicle).unwrap();
    assert_eq!((path.duration(), path.up()), (20.0, DVec3::Z));
    for k in 0..=2000 {
        let t = f64::from(k) / 100.0;
        let there_and_back = if t % 6.0 <= 3.0 { t % 6.0 } else { 6.0 - t % 6.0 };
        let (p, q) = path.at(t);
        let wave = wave(there_and_back);
        // The vehicle looks along +x: left, where a positive yaw leads, is +y, and right −y.
        let looks = DVec3::new(libm::cos(0.5 * wave), libm::sin(0.5 * wave), 0.0);
        assert!(forward(q).distance(looks) < 2e-3, "at {t}: {} {looks}", forward(q));
        assert!((q * DVec3::Y).distance(DVec3::Z) < 1e-9);
        assert!(p.distance(DVec3::new(10.0 * t, -wave, 0.0)) < 2e-2, "at {t}: {p} {wave}");
    }
    // A frame in which nothing moves faster than the vehicle and the head together: no jump at the turns.
    for pair in path.poses().windows(2) {
        let limit = (10.0 + 7.0) * (pair[1].time - pair[0].time) + 1e-9;
        assert!(pair[0].position.distance(pair[1].position) <= limit, "at {}", pair[0].time);
    }
    assert!(path.notes().iter().any(|note| note.contains("forwards and backwards")), "{:?}", path.notes());
}

#[test]
fn a_head_at_rest_changes_nothing_and_jumps_stay_jumps() {
    let vehicle = teleport::teleport(3.0, 30.0, 4.0, 100.0, 2).unwrap();
    let path = Head::new(head(5.0, |_| 0.0, |_| 0.0), None).unwrap().ride(&vehicle).unwrap();
    assert!(path.notes().iter().any(|note| note.contains("taken as metres")), "{:?}", path.notes());
    for k in 0..=3000 {
        let t = f64::from(k) / 100.0;
        let ((p, q), (vehicle_p, vehicle_q)) = (path.at(t), vehicle.at(t));
        assert!(p.distance(vehicle_p) < 1e-9 && q.angle_between(vehicle_q) < 1e-7, "at {t}");
    }
    let jumps = |path: &CameraPath| (1..path.poses().len()).filter(|&i| path.jumps_to(i)).count();
    assert_eq!((jumps(&path), jumps(&vehicle)), (7, 7));
}

#[test]
fn heads_without_a_heading() {
    let vehicle = turn::steady(1.0, 5.0).unwrap();
    let around = head(4.0, |t| 0.5 * std::f64::consts::PI * t, |_| 0.0);
    let path = Head::new(around, None).unwrap().ride(&vehicle).unwrap();
    assert!(path.notes().iter().any(|note| note.contains("first heading")), "{:?}", path.notes());
    assert!(forward(path.at(0.0).1).distance(DVec3::X) < 1e-9);
    let down = Pose { time: 0.0, position: DVec3::ZERO, orientation: DQuat::IDENTITY };
    let down = CameraPath::new("down", vec![down, Pose { time: 1.0, ..down }], DVec3::Z).unwrap();
    let error = Head::new(down, None).unwrap().ride(&vehicle).unwrap_err().to_string();
    assert!(error.contains("expected a head with a heading"), "{error}");
    let short = head(0.05, |_| 0.0, |_| 0.0);
    let endless = turn::steady(1.0, 1e5).unwrap();
    assert!(Head::new(short, Some(-1.0)).is_err());
    let dense: Vec<Pose> = (0..2).map(|k| Pose { time: f64::from(k) * 1e-3, ..down_pose() }).collect();
    let dense = CameraPath::new("dense", dense, DVec3::Z).unwrap();
    assert!(Head::new(dense, None).unwrap().ride(&endless).unwrap_err().to_string().contains("at most"));
}

fn down_pose() -> Pose {
    Pose { time: 0.0, position: DVec3::ZERO, orientation: DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2) }
}

#[test]
fn recorded_heads_ride() {
    let Some(folder) = data("paths") else { return };
    let vehicle = turn::turn(15.0, 100.0).unwrap();
    for (scene, scale) in [("berlin", 0.8), ("nyc", 0.64), ("playroom", 2.7)] {
        let file = folder.join(format!("vr_head_rutgers_{scene}_user101.csv"));
        let recorded = from_file(&file, &Options::default()).unwrap();
        let path = Head::new(recorded, Some(scale)).unwrap().ride(&vehicle).unwrap();
        let far = path.poses().iter().map(|pose| pose.position.distance(vehicle.at(pose.time).0)).fold(0.0, f64::max);
        println!("{scene}: {} poses, at most {far:.2} m from the vehicle", path.poses().len());
        assert!(far < 5.0 && path.duration() == vehicle.duration());
    }
}
