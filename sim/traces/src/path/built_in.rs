//! The flight that a replay uses when it is given no path.

use glam::{DMat3, DQuat, DVec3};

use super::{CameraPath, Pose};

/// Frames per second of made paths.
pub(super) const RATE: f64 = 60.0;

/// Seconds, position (m) and velocity (m/s). Between two knots the camera follows the cubic that meets both.
struct Knot {
    time: f64,
    position: [f64; 3],
    velocity: [f64; 3],
}

const fn knot(time: f64, position: [f64; 3], velocity: [f64; 3]) -> Knot {
    Knot { time, position, velocity }
}

/// In from the outskirts, down into the street along y = 0, along it, a stop, back and up out of it, over the centre.
const KNOTS: [Knot; 13] = [
    knot(0.0, [-940.0, -330.0, 170.0], [44.0, 18.0, -3.0]),
    knot(9.0, [-560.0, -120.0, 135.0], [40.0, 24.0, -5.0]),
    knot(14.0, [-375.0, -8.0, 80.0], [32.0, 6.0, -14.0]),
    knot(19.0, [-250.0, 0.0, 10.0], [20.0, 0.0, -6.0]),
    knot(22.0, [-197.0, 0.0, 3.0], [14.0, 0.0, 0.0]),
    knot(32.0, [-57.0, 0.0, 3.0], [14.0, 0.0, 0.0]),
    knot(36.0, [-29.0, 0.0, 3.0], [0.0, 0.0, 0.0]),
    knot(38.5, [-29.0, 0.0, 3.0], [0.0, 0.0, 0.0]),
    knot(43.0, [-85.0, 0.0, 45.0], [-22.0, 0.0, 18.0]),
    knot(47.0, [-165.0, 18.0, 125.0], [-16.0, 14.0, 18.0]),
    knot(51.0, [-160.0, 115.0, 180.0], [18.0, 28.0, 8.0]),
    knot(54.5, [-70.0, 130.0, 195.0], [32.0, -18.0, 2.0]),
    knot(60.0, [70.0, -40.0, 200.0], [26.0, -36.0, 0.0]),
];

/// Seconds, then yaw (0 along +x, counter-clockwise), pitch (up) and roll (right side down), degrees. Between two knots
/// each goes from one value to the other without a jump of speed.
const TURNS: [(f64, [f64; 3]); 12] = [
    (0.0, [22.0, -14.0, 0.0]),
    (9.0, [30.0, -16.0, 0.0]),
    (14.0, [10.0, -22.0, 12.0]),
    (19.0, [0.0, -10.0, 0.0]),
    (22.0, [0.0, 0.0, 0.0]),
    (36.5, [0.0, 2.0, 0.0]),
    (37.3, [180.0, 0.0, 0.0]),
    (43.0, [180.0, 14.0, 0.0]),
    (47.0, [138.0, 5.0, 18.0]),
    (51.0, [58.0, -18.0, 32.0]),
    (54.5, [-30.0, -32.0, 28.0]),
    (60.0, [-54.0, -38.0, 0.0]),
];

/// The built-in flight, for a city of about 2 km × 2 km around the origin, z up, ground at 0, with a street along y = 0:
/// 60 s at 60 poses a second. It comes in above the roofs, descends into the street, drives along it for 140 m, stops, turns
/// around within 0.8 s, climbs out and banks over the centre.
pub fn built_in() -> CameraPath {
    let end = KNOTS[KNOTS.len() - 1].time;
    let frames = (end * RATE) as usize;
    let poses = (0..=frames).map(|frame| {
        let time = frame as f64 / RATE;
        Pose { time, position: position_at(time), orientation: orientation_at(time) }
    });
    CameraPath::new("built-in flight", poses.collect(), DVec3::Z)
        .expect("the frames increase from 0, and the knots are finite")
}

fn position_at(time: f64) -> DVec3 {
    let next = KNOTS.partition_point(|knot| knot.time <= time).clamp(1, KNOTS.len() - 1);
    let (a, b) = (&KNOTS[next - 1], &KNOTS[next]);
    let step = b.time - a.time;
    let u = (time - a.time) / step;
    let (p, q) = (DVec3::from(a.position), DVec3::from(b.position));
    let from = DVec3::from(a.velocity) * step - (q - p);
    let to = DVec3::from(b.velocity) * step - (q - p);
    p + (q - p) * u + (from * (1.0 - u) - to * u) * (u * (1.0 - u))
}

fn orientation_at(time: f64) -> DQuat {
    let next = TURNS.partition_point(|turn| turn.0 <= time).clamp(1, TURNS.len() - 1);
    let (a, b) = (&TURNS[next - 1], &TURNS[next]);
    let s = smoothstep((time - a.0) / (b.0 - a.0));
    let [yaw, pitch, roll] = [0, 1, 2].map(|k| (a.1[k] + (b.1[k] - a.1[k]) * s).to_radians());
    look(yaw, pitch, roll)
}

/// 0 to 1 with speed and acceleration 0 at both ends: 6u⁵ − 15u⁴ + 10u³.
pub(super) fn smoothstep(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (u * (6.0 * u - 15.0) + 10.0)
}

/// World from camera where z is up: yaw from +x counter-clockwise, pitch upwards, roll with the right side down; radians.
pub(super) fn look(yaw: f64, pitch: f64, roll: f64) -> DQuat {
    // Looks along +x: right is −y, up is +z, back is −x.
    let level = DQuat::from_mat3(&DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X));
    let turned = DQuat::from_rotation_z(yaw) * level;
    (turned * DQuat::from_rotation_x(pitch) * DQuat::from_rotation_z(-roll)).normalize()
}
