//! A recorded head that rides on a vehicle's path.
//!
//! With the vehicle at pose (p, q) and the head at (h, r), in the frame of the head's mean heading R and mean position h̄,
//!
//! ```text
//! orientation = q · R⁻¹ · r ,   position = p + q · R⁻¹ · (h − h̄) / s
//! ```
//!
//! so the head looks where the vehicle looks, on average, and turns and leans about it as it was recorded; s is the number
//! of the recording's units in a metre. A head that ends before the vehicle goes on backwards, then forwards again: nothing
//! jumps.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use super::parse::{self, Options};
use super::{CameraPath, POSES_MAX, PathError, Pose};

/// Below this length the mean of the horizontal viewing directions says nothing.
const MEAN_MIN: f64 = 0.05;
/// A viewing direction with less than this horizontally has no heading.
const HORIZONTAL_MIN: f64 = 1e-3;
/// A head's pose so near to one of the vehicle's is left out, seconds.
const NEAR_SECONDS: f64 = 1e-6;

/// A head with the number of its units in a metre.
#[derive(Clone, Debug)]
pub struct Head {
    recorded: CameraPath,
    units_per_metre: f64,
    is_stated: bool,
}

impl Head {
    /// Reads `FILE[,scale=UNITS_PER_METRE]`: any path with orientations. Positions are taken as metres without a scale;
    /// those of EyeNavGS are metres times an initial scale that their files do not state.
    ///
    /// # Errors
    /// A scale that is not positive and finite, and all errors of [`parse::from_file`].
    pub fn from_specification(spec: &str) -> Result<Head, PathError> {
        let (file, scale) = match spec.rsplit_once(",scale=") {
            Some((file, scale)) => (file, Some(scale)),
            None => (spec, None),
        };
        let units_per_metre = scale.map_or(Ok(1.0), |text| {
            text.parse::<f64>().ok().filter(|s| s.is_finite() && *s > 0.0).ok_or_else(|| PathError::Option {
                given: spec.to_owned(),
                message: format!("scale {text}; expected the units of the file in a metre, such as 0.64"),
            })
        })?;
        Head::new(parse::from_file(Path::new(file), &Options::default())?, scale.is_some().then_some(units_per_metre))
    }

    /// A recorded head; without a scale its units are taken as metres.
    ///
    /// # Errors
    /// A scale that is not positive and finite.
    pub fn new(recorded: CameraPath, units_per_metre: Option<f64>) -> Result<Head, PathError> {
        let scale = units_per_metre.unwrap_or(1.0);
        if !(scale.is_finite() && scale > 0.0) {
            let message = format!("a scale of {scale}; expected a positive number");
            return Err(PathError::Whole { name: recorded.name().to_owned(), message });
        }
        Ok(Head { recorded, units_per_metre: scale, is_stated: units_per_metre.is_some() })
    }

    /// The head's turns and translations on the vehicle's path, a pose at every time of either.
    ///
    /// # Errors
    /// A head that never looks anywhere but up and down, more than [`POSES_MAX`] poses, translations that lead out of range.
    pub fn ride(&self, vehicle: &CameraPath) -> Result<CameraPath, PathError> {
        let head = &self.recorded;
        let (heading, note) = self.mean_heading()?;
        let heading_from_frame = heading.conjugate();
        let count = head.poses().len() as f64;
        let mean = head.poses().iter().fold(DVec3::ZERO, |sum, pose| sum + pose.position / count);
        let times = self.times(vehicle)?;
        let length = head.duration();
        let poses = times.into_iter().map(|time| {
            let (position, orientation) = vehicle.at(time);
            let (head_position, head_orientation) = head.at(there_and_back(time, length));
            let lean = heading_from_frame * (head_position - mean) / self.units_per_metre;
            Pose {
                time,
                position: position + orientation * lean,
                orientation: (orientation * heading_from_frame * head_orientation).normalize(),
            }
        });
        let mut path = vehicle.with_poses(poses.collect())?;
        vehicle.notes().iter().for_each(|note| path.add_note(note.clone()));
        path.add_note(format!("carries the head of {}", head.name()));
        head.notes().iter().for_each(|note| path.add_note(format!("head: {note}")));
        if let Some(note) = note {
            path.add_note(note);
        }
        if !self.is_stated {
            path.add_note(
                "head: positions taken as metres; those of EyeNavGS need scale=, which the file does not state",
            );
        }
        if length < vehicle.duration() {
            path.add_note(format!("head: {length:.1} s long, played forwards and backwards in turn"));
        }
        Ok(path)
    }

    /// Turns a camera that looks along −z with +y up into one that looks along the head's mean heading.
    fn mean_heading(&self) -> Result<(DQuat, Option<String>), PathError> {
        let (poses, up) = (self.recorded.poses(), self.recorded.up());
        let horizontal = |pose: &Pose| {
            let forward = pose.orientation * DVec3::NEG_Z;
            forward - up * forward.dot(up)
        };
        let mean = poses.iter().fold(DVec3::ZERO, |sum, pose| sum + horizontal(pose)) / poses.len() as f64;
        let (forward, note) = if mean.length() >= MEAN_MIN {
            (mean, None)
        } else {
            let first = poses.iter().map(horizontal).find(|h| h.length() >= HORIZONTAL_MIN);
            let message = "looks up or down all the time; expected a head with a heading".to_owned();
            let none = || PathError::Whole { name: self.recorded.name().to_owned(), message };
            let note = "head: turns around evenly, so its first heading stands for the mean";
            (first.ok_or_else(none)?, Some(note.to_owned()))
        };
        let back = -forward.normalize();
        // Horizontal and unit, so right is unit as well.
        let axes = DMat3::from_cols(up.cross(back), up, back);
        Ok((DQuat::from_mat3(&axes).normalize(), note))
    }

    /// The vehicle's times, and between them the head's, there and back.
    fn times(&self, vehicle: &CameraPath) -> Result<Vec<f64>, PathError> {
        let (end, length) = (vehicle.duration(), self.recorded.duration());
        let rounds = libm::ceil(end / length);
        let expected = rounds * self.recorded.poses().len() as f64 + vehicle.poses().len() as f64;
        if expected > POSES_MAX as f64 {
            let name = vehicle.name().to_owned();
            let message = format!("{expected} poses with this head; expected at most {POSES_MAX}");
            return Err(PathError::Whole { name, message });
        }
        let mut times: Vec<f64> = vehicle.poses().iter().map(|pose| pose.time).collect();
        for round in 0..rounds as u64 {
            let begins = round as f64 * length;
            let within = |pose: &Pose| if round % 2 == 0 { begins + pose.time } else { begins + length - pose.time };
            times.extend(self.recorded.poses().iter().map(within).filter(|time| *time > 0.0 && *time < end));
        }
        times.sort_by(f64::total_cmp);
        let own = vehicle.poses();
        let near_own = |time: f64| {
            let next = own.partition_point(|pose| pose.time < time);
            let near = |i: usize| own.get(i).is_some_and(|pose| (pose.time - time).abs() <= NEAR_SECONDS);
            let is_own = own.get(next).is_some_and(|pose| pose.time == time);
            !is_own && (near(next) || next.checked_sub(1).is_some_and(near))
        };
        times.retain(|&time| !near_own(time));
        times.dedup();
        Ok(times)
    }
}

/// Time in a recording of `length` that is played forwards, backwards, forwards … for ever.
fn there_and_back(time: f64, length: f64) -> f64 {
    let within = libm::fmod(time, 2.0 * length);
    if within <= length { within } else { 2.0 * length - within }
}
