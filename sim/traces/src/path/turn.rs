//! Made paths for measurements: straight on, and straight on with a sudden turn. z is up, the ground is not known.

use std::f64::consts::PI;

use glam::DVec3;

use super::built_in::{RATE, look, smoothstep};
use super::{CameraPath, PathError, Pose};

/// Seconds that [`turn`] takes to turn around.
pub const TURN_SECONDS: f64 = 1.0;

/// Longest made path, seconds.
const DURATION_MAX: f64 = 1e5;

/// Straight along +x from the origin at a constant speed (m/s), looking ahead; 60 poses a second.
///
/// # Errors
/// A speed that is not between 0 and 10⁶, a duration that is not at least 2 frames or above 10⁵ s.
pub fn steady(speed: f64, duration: f64) -> Result<CameraPath, PathError> {
    check("steady", speed, duration, 2.0 / RATE)?;
    frames("steady", duration, |time| (speed * time, 0.0))
}

/// Straight along +x from the origin at a speed (m/s), and in the middle of the duration a turn by 180° within
/// [`TURN_SECONDS`], and back the same way. While it turns by the angle of a smooth step, the speed goes as the cosine of
/// π times the share of the turn's time, so that the turn ends where it began.
///
/// # Errors
/// As [`steady`], and a duration that is not above [`TURN_SECONDS`].
pub fn turn(speed: f64, duration: f64) -> Result<CameraPath, PathError> {
    check("turn", speed, duration, TURN_SECONDS + 2.0 / RATE)?;
    let begins = 0.5 * (duration - TURN_SECONDS);
    frames("turn", duration, |time| {
        let share = (time - begins) / TURN_SECONDS;
        if share <= 0.0 {
            (speed * time, 0.0)
        } else if share < 1.0 {
            (speed * (begins + TURN_SECONDS / PI * libm::sin(PI * share)), PI * smoothstep(share))
        } else {
            (speed * (begins - (share - 1.0) * TURN_SECONDS), PI)
        }
    })
}

pub(super) fn check(name: &str, speed: f64, duration: f64, duration_min: f64) -> Result<(), PathError> {
    let fail = |message: String| Err(PathError::Whole { name: name.to_owned(), message });
    if !(0.0..=1e6).contains(&speed) {
        return fail(format!("a speed of {speed} m/s; expected 0 to 1e6"));
    }
    if !(duration_min..=DURATION_MAX).contains(&duration) {
        return fail(format!("a duration of {duration} s; expected {duration_min:.3} to {DURATION_MAX}"));
    }
    Ok(())
}

/// A path from x and yaw over time.
fn frames(name: &str, duration: f64, at: impl Fn(f64) -> (f64, f64)) -> Result<CameraPath, PathError> {
    let count = (duration * RATE) as usize;
    let poses = (0..=count).map(|frame| {
        let time = frame as f64 / RATE;
        let (x, yaw) = at(time);
        Pose { time, position: DVec3::new(x, 0.0, 0.0), orientation: look(yaw, 0.0, 0.0) }
    });
    CameraPath::new(name, poses.collect(), DVec3::Z)
}
