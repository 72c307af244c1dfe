//! A made path that walks, and every so often is somewhere else at once. z is up, the ground is not known.

use std::f64::consts::TAU;

use glam::DVec3;

use super::built_in::{RATE, look};
use super::turn::check;
use super::{CameraPath, PathError, Pose};
use crate::random::SplitMix64;

/// The last pose of a walk comes this long before the first of the next.
const JUMP_SECONDS: f64 = 1e-6;
/// Shortest walk between two jumps, seconds.
const EVERY_MIN: f64 = 0.1;
/// Longest jump, metres.
const DISTANCE_MAX: f64 = 1e7;
/// A jump is at least as far as the walk comes in this time, seconds.
const JUMP_OF_SECONDS: f64 = 1e-3;

/// From the origin straight on at a speed (m/s), looking ahead; every `every` seconds a jump of `distance` metres in a
/// direction and to a heading that the seed names; 60 poses a second. Where it has come farther than `distance` from the
/// origin, a jump that would lead away goes the opposite way.
///
/// # Errors
/// A speed that is not between 0 and 10⁶, a duration that is not at least 2 frames or above 10⁵ s, jumps that are not from
/// 0.1 s to the duration apart, a distance that is not more than the walk comes in 1 ms and at most 10⁷ m.
pub fn teleport(speed: f64, duration: f64, every: f64, distance: f64, seed: u64) -> Result<CameraPath, PathError> {
    let name = "teleport";
    check(name, speed, duration, 2.0 / RATE)?;
    let fail = |message: String| Err(PathError::Whole { name: name.to_owned(), message });
    if !(EVERY_MIN..=duration).contains(&every) {
        return fail(format!("a jump every {every} s; expected {EVERY_MIN} to the duration of {duration}"));
    }
    let least = JUMP_OF_SECONDS * speed;
    if !(distance > least && distance <= DISTANCE_MAX) {
        return fail(format!("a jump of {distance} m; expected more than {least} and at most {DISTANCE_MAX:e}"));
    }
    let mut random = SplitMix64::new(seed);
    let mut poses = Vec::new();
    let (mut start, mut yaw) = (DVec3::ZERO, 0.0);
    let mut walk = 0u64;
    loop {
        let begins = walk as f64 * every;
        let ends = (begins + every).min(duration);
        let is_last = ends >= duration;
        let heading = direction(yaw);
        let pose = |time: f64| Pose {
            time,
            position: start + heading * (speed * (time - begins)),
            orientation: look(yaw, 0.0, 0.0),
        };
        // Whole frames, but none so near the end that it would look like a jump.
        let frames = ((ends - begins - JUMP_OF_SECONDS) * RATE) as u64;
        poses.extend((0..=frames).map(|frame| pose(begins + frame as f64 / RATE)));
        if is_last {
            poses.push(pose(ends));
            return CameraPath::new(name, poses, DVec3::Z);
        }
        poses.push(pose(ends - JUMP_SECONDS));
        let from = start + heading * (speed * every);
        let mut towards = direction(TAU * random.uniform());
        if from.length() > distance && from.dot(towards) > 0.0 {
            towards = -towards;
        }
        start = from + towards * distance;
        yaw = TAU * random.uniform();
        walk += 1;
    }
}

fn direction(yaw: f64) -> DVec3 {
    DVec3::new(libm::cos(yaw), libm::sin(yaw), 0.0)
}
