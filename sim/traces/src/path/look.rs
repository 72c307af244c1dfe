//! Where the camera of a path looks that holds no orientations, or is to look elsewhere.

use std::fmt;
use std::str::FromStr;

use foresight_index::geodesy::Geodetic;
use glam::{DQuat, DVec3};

use super::built_in::look;
use super::{CameraPath, Frame, PathError};

/// Half the window that the direction of the motion is taken over, in median steps …
const HALF_WINDOW_STEPS: f64 = 2.0;
/// … and at least this many seconds.
const HALF_WINDOW_SECONDS: f64 = 0.5;
/// Slower than this share of the median speed across up, the camera rests and keeps its direction …
const REST_SHARE: f64 = 0.1;
/// … where that lies between these, m/s.
const REST_SPEEDS: [f64; 2] = [1e-3, 0.3];
/// Steepest view along the motion, degrees.
const PITCH_MAX: f64 = 45.0;

/// The note on a path whose camera was put along the motion for want of orientations.
pub(super) const ALONG_THE_MOTION: &str = "no orientations: the camera looks along the motion, level";

/// Where the camera is to look, as an option.
#[derive(Clone, Debug, PartialEq)]
pub enum Look {
    /// Along the motion.
    Motion,
    /// Straight down, the top of the picture along the motion.
    Down,
    /// At a position in the world, metres.
    Target(DVec3),
    /// At a place on the Earth: latitude and longitude (degrees), height over the ellipsoid (m).
    Geo([f64; 3]),
    /// At another aircraft of the same file, by its ICAO 24-bit address.
    Other(String),
}

impl fmt::Display for Look {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Look::Motion => f.write_str("motion"),
            Look::Down => f.write_str("down"),
            Look::Target(p) => write!(f, "target={},{},{}", p.x, p.y, p.z),
            Look::Geo([latitude, longitude, height]) => write!(f, "geo={latitude},{longitude},{height}"),
            Look::Other(icao24) => write!(f, "other={icao24}"),
        }
    }
}

impl FromStr for Look {
    type Err = PathError;

    /// `motion`, `down`, `target=X,Y,Z`, `geo=LATITUDE,LONGITUDE,HEIGHT` or `other=ICAO24`.
    fn from_str(text: &str) -> Result<Look, PathError> {
        let fail = |message: &str| PathError::Option { given: text.to_owned(), message: message.to_owned() };
        let numbers = |list: &str| {
            let mut fields = list.split(',');
            let mut next = || fields.next()?.trim().parse::<f64>().ok().filter(|v| v.abs() <= super::COORDINATE_MAX);
            let three = [next()?, next()?, next()?];
            fields.next().is_none().then_some(three)
        };
        match text.split_once('=') {
            None if text == "motion" => Ok(Look::Motion),
            None if text == "down" => Ok(Look::Down),
            Some(("target", list)) => numbers(list)
                .map(|position| Look::Target(position.into()))
                .ok_or_else(|| fail("expected target=X,Y,Z, metres in the world")),
            Some(("geo", list)) => numbers(list)
                .filter(|[latitude, longitude, height]| {
                    latitude.abs() <= 90.0 && longitude.abs() <= 360.0 && height.abs() <= 1e7
                })
                .map(Look::Geo)
                .ok_or_else(|| fail("expected geo=LATITUDE,LONGITUDE,HEIGHT, degrees and metres")),
            Some(("other", icao24)) if !icao24.is_empty() => Ok(Look::Other(icao24.to_ascii_lowercase())),
            _ => Err(fail("expected motion, down, target=X,Y,Z, geo=LATITUDE,LONGITUDE,HEIGHT or other=ICAO24")),
        }
    }
}

/// What the camera of a path is aimed at.
#[derive(Clone, Copy, Debug)]
pub enum Aim<'a> {
    /// Along the motion.
    Motion,
    /// Straight down, the top of the picture along the motion.
    Down,
    /// A position in the path's frame.
    Point(DVec3),
    /// Another path in the same frame, which began this many seconds before this one. While it is not under way, the
    /// camera looks along its own motion.
    Path(&'a CameraPath, f64),
}

/// The same path with a camera that is aimed at something, level.
///
/// The *motion* at a pose is the chord of the curve over a window centred there: 2 median steps and at least 0.5 s to
/// either side. Slower across up than a tenth of the median speed (at least 1 mm/s, at most 0.3 m/s), the camera rests
/// and keeps the direction that it had; before its first motion it has the first direction to come, without any the
/// second axis across up (north). Its pitch is kept within ±45°.
pub fn aim(path: &CameraPath, aim: Aim<'_>) -> CameraPath {
    let mut aimed = path.clone();
    aimed.notes.retain(|note| note != ALONG_THE_MOTION);
    let angles = angles(path, aim);
    for (pose, [yaw, pitch]) in aimed.poses.iter_mut().zip(angles) {
        pose.orientation = level(path, pose.position, yaw, pitch);
    }
    aimed
}

/// Aims the poses that have no orientation along the motion.
pub(super) fn complete(path: &mut CameraPath, has_orientation: &[bool]) {
    let angles = angles(path, Aim::Motion);
    for (i, [yaw, pitch]) in angles.into_iter().enumerate() {
        if !has_orientation.get(i).copied().unwrap_or(false) {
            path.poses[i].orientation = level(path, path.poses[i].position, yaw, pitch);
        }
    }
}

/// Applies an option to a path whose frame and file are known; a target in the world waits for the placement.
///
/// # Errors
/// A place on the Earth for a path that is not there, another aircraft where there is none.
pub fn apply(path: CameraPath, look: &Look) -> Result<CameraPath, PathError> {
    let fail = |message: &str| Err(PathError::Whole { name: path.name.clone(), message: message.to_owned() });
    let mut aimed = match look {
        Look::Target(_) => return Ok(path),
        Look::Motion => aim(&path, Aim::Motion),
        Look::Down => aim(&path, Aim::Down),
        Look::Geo(_) if path.frame == Frame::Local => {
            return fail("carries no geographic coordinates; expected --look target=X,Y,Z in the world");
        }
        Look::Geo([latitude, longitude, height]) => {
            aim(&path, Aim::Point(Geodetic::from_degrees(*latitude, *longitude, *height).to_ecef()))
        }
        Look::Other(_) => return fail("holds no other aircraft; --look other=ICAO24 expected ADS-B JSON"),
    };
    aimed.add_note(format!("the camera is aimed: {look}"));
    Ok(aimed)
}

/// Path's frame from camera.
fn level(path: &CameraPath, position: DVec3, yaw: f64, pitch: f64) -> DQuat {
    (DQuat::from_mat3(&path.level_axes(position)) * look(yaw, pitch, 0.0)).normalize()
}

/// Yaw from the first of the level axes counter-clockwise, and pitch upwards, at each pose; radians.
fn angles(path: &CameraPath, aim: Aim<'_>) -> Vec<[f64; 2]> {
    let motion = motion_angles(path);
    let steepest = 0.5 * std::f64::consts::PI;
    let mut last = motion.first().copied().unwrap_or([0.0; 2]);
    let at = |i: usize, along: [f64; 2], target: DVec3, last: [f64; 2]| {
        let position = path.poses[i].position;
        let d = path.level_axes(position).transpose() * (target - position);
        let across = libm::hypot(d.x, d.y);
        if d.length() < 1e-6 {
            return last;
        }
        let yaw = if across > 1e-9 * d.length() { libm::atan2(d.y, d.x) } else { along[0] };
        [yaw, libm::atan2(d.z, across)]
    };
    let one = |(i, along): (usize, [f64; 2])| {
        last = match aim {
            Aim::Motion => along,
            Aim::Down => [along[0], -steepest],
            Aim::Point(target) => at(i, along, target, last),
            Aim::Path(other, earlier) => {
                let time = path.poses[i].time + earlier;
                if (0.0..=other.duration()).contains(&time) { at(i, along, other.at(time).0, last) } else { along }
            }
        };
        last
    };
    motion.into_iter().enumerate().map(one).collect()
}

fn motion_angles(path: &CameraPath) -> Vec<[f64; 2]> {
    let half = (HALF_WINDOW_STEPS * path.median_step()).max(HALF_WINDOW_SECONDS);
    let (pitch_max, end) = (PITCH_MAX.to_radians(), path.duration());
    // (yaw, pitch) and speed across up.
    let moving: Vec<([f64; 2], f64)> = path
        .poses
        .iter()
        .map(|pose| {
            let (from, to) = ((pose.time - half).max(0.0), (pose.time + half).min(end));
            let moved = path.level_axes(pose.position).transpose() * (path.at(to).0 - path.at(from).0);
            let across = libm::hypot(moved.x, moved.y);
            let pitch = libm::atan2(moved.z, across).clamp(-pitch_max, pitch_max);
            ([libm::atan2(moved.y, moved.x), pitch], across / (to - from))
        })
        .collect();
    let mut speeds: Vec<f64> = moving.iter().map(|(_, speed)| *speed).filter(|&speed| speed > 0.0).collect();
    let middle = speeds.len() / 2;
    let median = if speeds.is_empty() { 0.0 } else { *speeds.select_nth_unstable_by(middle, f64::total_cmp).1 };
    let rest = (REST_SHARE * median).clamp(REST_SPEEDS[0], REST_SPEEDS[1]);
    let north = [0.5 * std::f64::consts::PI, 0.0];
    let mut last = moving.iter().find(|(_, speed)| *speed >= rest).map_or(north, |(angles, _)| *angles);
    let kept = |(angles, speed): ([f64; 2], f64)| {
        if speed >= rest {
            last = angles;
        }
        last
    };
    moving.into_iter().map(kept).collect()
}
