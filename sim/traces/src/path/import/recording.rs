//! Poses with orientations in a frame of their own, as TUM and EyeNavGS record them.

use glam::DVec3;

use crate::path::axes::{Axis, Convention, Given, QuatOrder, RawPose, choose};
use crate::path::parse::Options;
use crate::path::place::geo;
use crate::path::{COORDINATE_MAX, CameraPath, POSES_MAX, PathError, Pose, QUATERNION_TOLERANCE, SECONDS_MAX};

/// A quaternion's length this far from 1 is rounding, and not reported.
const LENGTH_ROUNDING: f64 = 1e-6;

/// Poses as they are read, with what was repaired.
pub(super) struct Recording<'a> {
    pub(super) name: &'a str,
    pub(super) poses: Vec<RawPose>,
    /// What the file's header says about the order of a quaternion's components.
    pub(super) claimed: Option<QuatOrder>,
    /// Time of the first pose, seconds.
    start: f64,
    dropped: usize,
    renormalised: usize,
    /// Largest distance of a quaternion's length from 1.
    length_error: f64,
}

impl<'a> Recording<'a> {
    pub(super) fn new(name: &'a str) -> Recording<'a> {
        Recording { name, poses: Vec::new(), claimed: None, start: 0.0, dropped: 0, renormalised: 0, length_error: 0.0 }
    }

    /// No line was taken.
    pub(super) fn is_untouched(&self) -> bool {
        self.poses.is_empty()
    }

    pub(super) fn line_error(&self, line: usize, message: String) -> PathError {
        PathError::Line { name: self.name.to_owned(), line, message }
    }

    /// Takes a pose: seconds, x, y, z, and a quaternion in the file's order.
    pub(super) fn push(&mut self, line: usize, seconds: f64, numbers: [f64; 7]) -> Result<(), PathError> {
        if let Some(bad) = [seconds].iter().chain(&numbers).find(|number| !number.is_finite()) {
            return Err(self.line_error(line, format!("{bad}; expected finite numbers")));
        }
        let [x, y, z, quaternion @ ..] = numbers;
        let position = DVec3::new(x, y, z);
        if position.abs().max_element() > COORDINATE_MAX {
            let message = format!("a position of {position}; expected at most {COORDINATE_MAX}");
            return Err(self.line_error(line, message));
        }
        let length = f64::sqrt(quaternion.iter().map(|q| q * q).sum());
        // At worst infinite, for the numbers are finite.
        if (length - 1.0).abs() > QUATERNION_TOLERANCE {
            let message =
                format!("a quaternion of length {length}; expected 1, or within {QUATERNION_TOLERANCE} of it");
            return Err(self.line_error(line, message));
        }
        if self.poses.is_empty() {
            self.start = seconds;
        }
        let time = seconds - self.start;
        if time > SECONDS_MAX {
            let message = format!("{time} s after the first pose; expected at most {SECONDS_MAX}");
            return Err(self.line_error(line, message));
        }
        if self.poses.last().is_some_and(|previous| time <= previous.time) {
            self.dropped += 1;
            return Ok(());
        }
        if self.poses.len() == POSES_MAX {
            return Err(self.line_error(line, format!("one pose more than the {POSES_MAX} expected at most")));
        }
        if (length - 1.0).abs() > LENGTH_ROUNDING {
            self.renormalised += 1;
            self.length_error = self.length_error.max((length - 1.0).abs());
        }
        self.poses.push(RawPose { time, position, numbers: quaternion });
        Ok(())
    }

    /// The path, with axes, order and up as given or as the motion says, and these notes.
    pub(super) fn finish(
        self,
        default: Convention,
        notes: Vec<String>,
        options: &Options,
    ) -> Result<CameraPath, PathError> {
        let total = self.poses.len() + self.dropped;
        if self.dropped > self.poses.len() {
            let message = format!(
                "{} of {total} times are not later than the one before; expected increasing times",
                self.dropped
            );
            return Err(PathError::Whole { name: self.name.to_owned(), message });
        }
        let given = Given { order: options.quat_order, axes: options.camera_axes, up: options.up };
        let (convention, reason) = choose(&self.poses, default, given);
        let camera = convention.axes.from_canonical();
        // Poses take the place of raw poses, in the same memory.
        let poses = self.poses.into_iter().map(|raw| Pose {
            time: raw.time,
            position: raw.position,
            orientation: convention.order.quaternion(raw.numbers).normalize() * camera,
        });
        let mut path = CameraPath::new(self.name, poses.collect(), convention.up.vector())?;
        path.add_note(reason);
        for note in notes {
            path.add_note(note);
        }
        if let Some(claimed) = self.claimed.filter(|claimed| *claimed != convention.order) {
            path.add_note(format!("mind: the header says {claimed}, but the data are read as {}", convention.order));
        }
        if self.dropped > 0 {
            path.add_note(format!(
                "{} of {total} poses dropped whose time was not later than the one before",
                self.dropped
            ));
        }
        if self.renormalised > 0 {
            path.add_note(format!(
                "{} of {total} quaternions renormalised, whose length was off by up to {:.1e}",
                self.renormalised, self.length_error
            ));
        }
        match options.crs {
            None => Ok(path),
            Some(code) if convention.up == Axis::Z => geo::from_projected(path, code),
            Some(code) => {
                let message =
                    format!("up is {}; coordinates in EPSG:{code} expected +z up (see --path-up)", convention.up);
                Err(PathError::Whole { name: self.name.to_owned(), message })
            }
        }
    }
}
