//! Camera paths: recorded or made poses over time, and the pose between them.

mod axes;
mod built_in;
mod facts;
mod frame;
pub mod head;
mod import;
pub mod look;
pub mod parse;
pub mod place;
pub mod recording;
pub mod teleport;
pub mod turn;

#[cfg(test)]
mod head_tests;
#[cfg(test)]
mod parse_tests;
#[cfg(test)]
mod path_tests;
#[cfg(test)]
mod recording_tests;

use glam::{DMat3, DQuat, DVec3};

pub use axes::{Axis, CameraAxes, QuatOrder};
pub use built_in::built_in;
pub use facts::PathFacts;
pub use frame::{Frame, Heights, across};
pub(crate) use import::g_nettrack_time;
pub use look::Look;
pub use place::Placement;

/// Farthest coordinate accepted, metres.
pub const COORDINATE_MAX: f64 = 1e12;

/// Longest path accepted, seconds.
pub const SECONDS_MAX: f64 = 1e9;

/// Most poses accepted.
pub const POSES_MAX: usize = 20_000_000;

/// How far a quaternion's length may be from 1 for it to be renormalised instead of refused.
pub const QUATERNION_TOLERANCE: f64 = 1e-2;

/// A gap is a step of more than this many median steps …
const GAP_STEPS: f64 = 10.0;
/// … or of more than this many seconds, unless the median step is more than half of that.
const GAP_SECONDS: f64 = 2.0;

/// A jump is a step of at most this many seconds (1 ms, and the rounding of times), and of at most this share of the median step …
const JUMP_SECONDS: f64 = 1.000_001e-3;
const JUMP_STEPS: f64 = 0.1;
/// … across which the camera is more than this many times as fast as in the median step.
const JUMP_SPEEDS: f64 = 100.0;

/// Why there is no path.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    /// The file could not be read.
    #[error("{name}: {source}")]
    Io {
        /// The file.
        name: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The content is of no path format that is read here.
    #[error(
        "{name}, line {line}: `{found}` is not a supported path format; expected TUM lines (`t x y z qx qy qz qw`), an \
         EyeNavGS table (a header with ViewIndex, PositionX, …), GPX, IGC, KML, ADS-B JSON (a list of records), a folder \
         of comma2k19, a G-NetTrack table (a header with Timestamp, Longitude, Latitude, …) or a foresight-recording (JSON \
         lines)"
    )]
    Unsupported {
        /// The file.
        name: String,
        /// Line, counted from 1.
        line: usize,
        /// The beginning of the line.
        found: String,
    },
    /// A line of a recognised format is wrong.
    #[error("{name}, line {line}: {message}")]
    Line {
        /// The file.
        name: String,
        /// Line, counted from 1.
        line: usize,
        /// What was found and what was expected.
        message: String,
    },
    /// A place of a recognised format that is no line is wrong.
    #[error("{name}, {place}: {message}")]
    Place {
        /// The file.
        name: String,
        /// A JSON path, a byte offset or an element.
        place: String,
        /// What was found and what was expected.
        message: String,
    },
    /// The path as a whole is wrong.
    #[error("{name}: {message}")]
    Whole {
        /// The path.
        name: String,
        /// What was found and what was expected.
        message: String,
    },
    /// An option or a placement is wrong.
    #[error("`{given}`: {message}")]
    Option {
        /// As given.
        given: String,
        /// What was expected.
        message: String,
    },
}

/// Where the camera is at a time, and how it is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Seconds from the start of the path.
    pub time: f64,
    /// Position, metres, in the path's frame.
    pub position: DVec3,
    /// Unit quaternion, path's frame from camera; the camera looks along −z, with +y up.
    pub orientation: DQuat,
}

/// A camera's path: at least two poses, times strictly increasing from 0.
///
/// Between poses the position follows the cubic Hermite curve whose tangents are centred differences,
/// (p_{i+1} − p_{i−1}) / (t_{i+1} − t_{i−1}), one-sided at the ends and beside a gap; the orientation goes along the
/// shortest arc at constant speed. A *gap* is a step of more than 10 median steps, or of more than 2 s where the
/// median step is at most half of that; across it the position goes straight, so that nothing overshoots. A *jump* is
/// a step of at most 1 ms and a tenth of the median step, faster than 100 times the median speed: a teleport, or a cut.
/// The pose before it holds until it ends, and the motion on either side is as if the other were not there.
/// Before its start and after its end the camera rests, unless the path is looped.
#[derive(Clone, Debug)]
pub struct CameraPath {
    name: String,
    poses: Vec<Pose>,
    frame: Frame,
    /// Unit length; on the Earth that at the first pose.
    up: DVec3,
    notes: Vec<String>,
    /// The middle one of the steps between poses, seconds.
    median_step: f64,
    /// A longer step is a gap, seconds.
    gap: f64,
    /// A step of at most so many seconds, faster than so many metres a second, is a jump.
    jump: (f64, f64),
    looped: bool,
}

impl CameraPath {
    /// A path of these poses, in a frame with this up. Quaternions are made exactly unit; gaps are noted.
    ///
    /// # Errors
    /// Fewer than 2 or more than [`POSES_MAX`] poses, times that do not increase strictly from 0 to at most
    /// [`SECONDS_MAX`], a coordinate that is not finite or beyond [`COORDINATE_MAX`], a quaternion whose length is
    /// farther than [`QUATERNION_TOLERANCE`] from 1, an up of no direction.
    pub fn new(name: &str, poses: Vec<Pose>, up: DVec3) -> Result<CameraPath, PathError> {
        let whole = |message: String| PathError::Whole { name: name.to_owned(), message };
        let up = up.try_normalize().ok_or_else(|| whole(format!("up {up}; expected a direction")))?;
        let mut path = CameraPath {
            name: name.to_owned(),
            poses,
            frame: Frame::Local,
            up,
            notes: Vec::new(),
            median_step: 0.0,
            gap: f64::INFINITY,
            jump: (0.0, 0.0),
            looped: false,
        };
        path.check()?;
        path.find_gaps();
        Ok(path)
    }

    /// Other poses in the same frame, under the same name, without notes but those on gaps and jumps.
    ///
    /// # Errors
    /// As [`CameraPath::new`].
    pub fn with_poses(&self, poses: Vec<Pose>) -> Result<CameraPath, PathError> {
        let mut path = CameraPath { poses, notes: Vec::new(), looped: false, ..self.clone() };
        path.check()?;
        path.find_gaps();
        Ok(path)
    }

    /// A path of poses in Earth-centred coordinates, whose heights are above this.
    ///
    /// # Errors
    /// As [`CameraPath::new`].
    pub fn on_earth(name: &str, poses: Vec<Pose>, heights: Heights) -> Result<CameraPath, PathError> {
        let up = poses.first().map_or(DVec3::Z, |pose| frame::earth_axes(pose.position).z_axis);
        let mut path = CameraPath::new(name, poses, up)?;
        path.frame = Frame::Earth(heights);
        Ok(path)
    }

    fn check(&mut self) -> Result<(), PathError> {
        let whole = |message: String| PathError::Whole { name: self.name.clone(), message };
        match self.poses.len() {
            0 => return Err(whole("holds no pose; a path needs at least 2 poses".to_owned())),
            1 => return Err(whole("holds one pose; a path needs at least 2 poses".to_owned())),
            n if n > POSES_MAX => return Err(whole(format!("holds {n} poses; expected at most {POSES_MAX}"))),
            _ => {}
        }
        let mut previous = None;
        for (i, pose) in self.poses.iter_mut().enumerate() {
            let in_order = previous.map_or(pose.time == 0.0, |previous| pose.time > previous);
            if !in_order || pose.time > SECONDS_MAX {
                return Err(whole(format!(
                    "pose {i} is at {} s; expected times that increase from 0 to at most {SECONDS_MAX}",
                    pose.time
                )));
            }
            previous = Some(pose.time);
            // Not a NaN, which `max_element` would pass over.
            if !(pose.position.is_finite() && pose.position.abs().max_element() <= COORDINATE_MAX) {
                return Err(whole(format!(
                    "pose {i} is at {}; expected finite coordinates of at most {COORDINATE_MAX}",
                    pose.position
                )));
            }
            let length = pose.orientation.length();
            if length.is_nan() || (length - 1.0).abs() > QUATERNION_TOLERANCE {
                return Err(whole(format!("pose {i} has a quaternion of length {length}; expected 1")));
            }
            pose.orientation = pose.orientation.normalize();
        }
        Ok(())
    }

    fn find_gaps(&mut self) {
        let mut steps: Vec<f64> = self.poses.windows(2).map(|pair| pair[1].time - pair[0].time).collect();
        let middle = steps.len() / 2;
        let median = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
        self.median_step = median;
        self.gap = (GAP_STEPS * median).min(GAP_SECONDS.max(2.0 * median));
        let gaps = steps.iter().filter(|&&step| step > self.gap).count();
        if gaps > 0 {
            let longest = steps.iter().copied().fold(0.0, f64::max);
            self.notes.push(format!(
                "{gaps} gaps longer than {:.3} s, the longest {longest:.3} s: crossed in a straight line",
                self.gap
            ));
        }
        let speed = |pair: &[Pose]| pair[0].position.distance(pair[1].position) / (pair[1].time - pair[0].time);
        let mut speeds: Vec<f64> = self.poses.windows(2).map(speed).collect();
        let median_speed = *speeds.select_nth_unstable_by(middle, f64::total_cmp).1;
        self.jump = (JUMP_SECONDS.min(JUMP_STEPS * median), JUMP_SPEEDS * median_speed);
        let jumps = (1..self.poses.len()).filter(|&i| self.jumps_to(i)).count();
        if jumps > 0 {
            self.notes.push(format!("{jumps} jumps within {:.3} ms", self.jump.0 * 1e3));
        }
    }

    /// Whether the camera jumps from the pose before to pose `i`.
    pub fn jumps_to(&self, i: usize) -> bool {
        let Some([a, b]) = i.checked_sub(1).and_then(|before| self.poses.get(before..=i)) else { return false };
        let step = b.time - a.time;
        step <= self.jump.0 && a.position.distance(b.position) > self.jump.1 * step
    }

    /// The path as named.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The poses, times from 0.
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// The frame of its positions and orientations.
    pub fn frame(&self) -> Frame {
        self.frame
    }

    /// Unit vector that is up in the path's frame; on the Earth, where up differs from place to place, at its first pose.
    pub fn up(&self) -> DVec3 {
        self.up
    }

    /// Two level axes and up at a position, as columns; on the Earth east, north and up.
    pub fn level_axes(&self, position: DVec3) -> DMat3 {
        match self.frame {
            Frame::Earth(_) => frame::earth_axes(position),
            Frame::Local => {
                let (right, ahead) = frame::across(self.up);
                DMat3::from_cols(right, ahead, self.up)
            }
        }
    }

    /// The middle one of the steps between poses, seconds.
    pub fn median_step(&self) -> f64 {
        self.median_step
    }

    /// A longer step between two poses is a gap, seconds.
    pub fn gap(&self) -> f64 {
        self.gap
    }

    /// What was repaired, assumed or done.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Adds a note.
    pub fn add_note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    /// Seconds from the first to the last pose; of a looped path one round.
    pub fn duration(&self) -> f64 {
        self.poses.last().map_or(0.0, |pose| pose.time)
    }

    /// Position and unit orientation at a time in seconds, in O(log n). A time before the start, or NaN, is the start.
    pub fn at(&self, time: f64) -> (DVec3, DQuat) {
        let duration = self.duration();
        let time = if self.looped && time > duration && time.is_finite() { libm::fmod(time, duration) } else { time };
        let next = self.poses.partition_point(|pose| pose.time <= time);
        let Some(i) = next.checked_sub(1) else { return (self.poses[0].position, self.poses[0].orientation) };
        let a = self.poses[i];
        let Some(b) = self.poses.get(next) else { return (a.position, a.orientation) };
        if self.jumps_to(next) {
            return (a.position, a.orientation);
        }
        let step = b.time - a.time;
        let u = (time - a.time) / step;
        let chord = b.position - a.position;
        // The curve's departure from the chord: zero where both tangents are the chord.
        let from = self.tangent_step(i, step) - chord;
        let to = self.tangent_step(next, step) - chord;
        let bend = if step > self.gap { DVec3::ZERO } else { (from * (1.0 - u) - to * u) * (u * (1.0 - u)) };
        (a.position + chord * u + bend, shortest_arc(a.orientation, b.orientation, u))
    }

    /// Tangent at pose `i` times `step`: centred difference, one-sided at an end, beside a gap or beside a jump.
    fn tangent_step(&self, i: usize, step: f64) -> DVec3 {
        let is_break = |b: usize| self.poses[b].time - self.poses[b - 1].time > self.gap || self.jumps_to(b);
        let before = if i == 0 || is_break(i) { i } else { i - 1 };
        let after = if i + 1 == self.poses.len() || is_break(i + 1) { i } else { i + 1 };
        if before == after {
            return DVec3::ZERO;
        }
        let (a, b) = (self.poses[before], self.poses[after]);
        // The quotient is at most 1, however small the steps.
        (b.position - a.position) * (step / (b.time - a.time))
    }

    /// The path begun again whenever it ends. Where its ends differ, the camera jumps, which is noted.
    pub fn looped(&self) -> CameraPath {
        let mut path = CameraPath { looped: true, ..self.clone() };
        if let (Some(first), Some(last)) = (self.poses.first(), self.poses.last()) {
            let jump = first.position.distance(last.position);
            path.notes.push(format!("repeats every {} s, with a jump of {jump:.3} m", last.time));
        }
        path
    }

    /// BLAKE3 of the poses, up, whether it is on the Earth, and whether it is looped; not of the name.
    pub fn hash(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        let earth = if self.frame == Frame::Local { 0 } else { 2 };
        hasher.update(&[earth + u8::from(self.looped)]);
        let mut put = |values: &[f64]| {
            for value in values {
                hasher.update(&value.to_bits().to_le_bytes());
            }
        };
        put(&self.up.to_array());
        for pose in &self.poses {
            put(&[pose.time]);
            put(&pose.position.to_array());
            put(&pose.orientation.to_array());
        }
        hasher.finalize()
    }
}

/// From `a` to `b` along the shortest arc, at constant angular speed.
fn shortest_arc(a: DQuat, b: DQuat, u: f64) -> DQuat {
    let cosine = a.dot(b);
    let (b, cosine) = if cosine < 0.0 { (-b, -cosine) } else { (b, cosine) };
    // The half-chord gives the angle exactly where the cosine is close to 1.
    let angle = 2.0 * libm::asin((0.5 * (b - a).length()).min(1.0));
    if angle < 1e-6 || cosine > 1.0 - 1e-14 {
        return (a * (1.0 - u) + b * u).normalize();
    }
    (a * libm::sin((1.0 - u) * angle) + b * libm::sin(u * angle)).normalize()
}
