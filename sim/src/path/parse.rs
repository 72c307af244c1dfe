//! Camera paths from files.

use std::borrow::Cow;
use std::path::Path;

use glam::DVec3;

use crate::text_lines::{LINE_BYTES_MAX, TextLines};

use super::axes::{Axis, CameraAxes, Convention, Given, QuatOrder, RawPose, choose};
use super::{CameraPath, POSES_MAX, PathError, Pose, QUATERNION_TOLERANCE, recording};

/// Largest file read, bytes.
const FILE_BYTES_MAX: u64 = 2 << 30;

/// A quaternion's length this far from 1 is rounding, and not reported.
const LENGTH_ROUNDING: f64 = 1e-6;

/// What a file does not say, or says wrongly. What is absent is chosen from the motion.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// The camera's forward and up axes.
    pub camera_axes: Option<CameraAxes>,
    /// Order of a quaternion's components.
    pub quat_order: Option<QuatOrder>,
    /// Up of the frame that the positions are in.
    pub up: Option<Axis>,
}

/// Reads a file, see [`from_bytes`].
///
/// # Errors
/// A file that cannot be read, and all errors of [`from_bytes`].
pub fn from_file(file: &Path, options: &Options) -> Result<CameraPath, PathError> {
    let name = file.to_string_lossy();
    let io = |source| PathError::Io { name: name.clone().into_owned(), source };
    let size = std::fs::metadata(file).map_err(io)?.len();
    check_size(&name, size)?;
    from_bytes(&name, &std::fs::read(file).map_err(io)?, options)
}

/// Reads a file's content, recognised by itself: TUM (`t x y z qx qy qz qw`, seconds and metres, `#` begins a comment,
/// further columns are ignored), EyeNavGS (a table with a header, two rows a frame, of which those of view 0 are taken;
/// milliseconds, y up), or a recording of ours, see [`recording`].
///
/// Lines whose time is not later than the one before are dropped; quaternions of a length within 10⁻² of 1 are
/// renormalised; both are counted in the notes, and so is what was chosen from the motion.
///
/// # Errors
/// [`PathError`] names the line and what was expected of it.
pub fn from_bytes(name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    check_size(name, bytes.len() as u64)?;
    if recording::is_recording(bytes) {
        return recording::path_from_bytes(name, bytes, options);
    }
    let mut lines = text_lines(name, bytes)?;
    let mut recording =
        Recording { name, poses: Vec::new(), start: 0.0, dropped: 0, renormalised: 0, length_error: 0.0 };
    let Some((number, first)) = lines.next() else {
        let message = "is empty; expected poses over time".to_owned();
        return Err(PathError::Whole { name: name.to_owned(), message });
    };
    let (default, note) = match EyeNavColumns::find(&first) {
        Some(Ok(columns)) => (eye_nav(&mut recording, &columns, lines)?, None),
        Some(Err(missing)) => {
            return Err(recording.line_error(number, format!("a header without {missing}; expected that column")));
        }
        None => tum(&mut recording, (number, first), lines)?,
    };
    recording.finish(default, note, options)
}

fn check_size(name: &str, size: u64) -> Result<(), PathError> {
    if size <= FILE_BYTES_MAX {
        return Ok(());
    }
    let message = format!("{size} bytes; expected at most {FILE_BYTES_MAX}");
    Err(PathError::Whole { name: name.to_owned(), message })
}

fn text_lines<'a>(name: &str, bytes: &'a [u8]) -> Result<TextLines<'a>, PathError> {
    TextLines::new(bytes).map_err(|line| {
        let message = format!("is longer than {LINE_BYTES_MAX} bytes; expected short lines of text");
        PathError::Line { name: name.to_owned(), line, message }
    })
}

/// Poses as they are read, with what was repaired.
struct Recording<'a> {
    name: &'a str,
    poses: Vec<RawPose>,
    /// Time of the first pose, seconds.
    start: f64,
    dropped: usize,
    renormalised: usize,
    /// Largest distance of a quaternion's length from 1.
    length_error: f64,
}

impl Recording<'_> {
    fn line_error(&self, line: usize, message: String) -> PathError {
        PathError::Line { name: self.name.to_owned(), line, message }
    }

    /// Takes a pose: seconds, x, y, z, and a quaternion in the file's order.
    fn push(&mut self, line: usize, seconds: f64, numbers: [f64; 7]) -> Result<(), PathError> {
        if let Some(bad) = [seconds].iter().chain(&numbers).find(|number| !number.is_finite()) {
            return Err(self.line_error(line, format!("{bad}; expected finite numbers")));
        }
        let [x, y, z, quaternion @ ..] = numbers;
        let position = DVec3::new(x, y, z);
        if position.abs().max_element() > super::COORDINATE_MAX {
            let message = format!("a position of {position}; expected at most {}", super::COORDINATE_MAX);
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
        if time > super::SECONDS_MAX {
            let message = format!("{time} s after the first pose; expected at most {}", super::SECONDS_MAX);
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

    fn finish(self, default: Convention, note: Option<String>, options: &Options) -> Result<CameraPath, PathError> {
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
        if let Some(note) = note {
            path.add_note(note);
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
        Ok(path)
    }
}

/// Reads TUM lines; the note says how many lines have further columns.
fn tum(
    recording: &mut Recording<'_>,
    first: (usize, Cow<'_, str>),
    lines: TextLines<'_>,
) -> Result<(Convention, Option<String>), PathError> {
    let mut longer = 0usize;
    for (number, line) in std::iter::once(first).chain(lines) {
        let mut numbers = [0.0; 8];
        let mut fields = line.split_ascii_whitespace();
        for (i, slot) in numbers.iter_mut().enumerate() {
            let parsed = fields.next().map(str::parse::<f64>);
            *slot = match parsed {
                Some(Ok(value)) => value,
                _ if recording.poses.is_empty() => {
                    let found = line.chars().take(40).collect();
                    return Err(PathError::Unsupported { name: recording.name.to_owned(), line: number, found });
                }
                Some(Err(_)) => {
                    let message = format!("column {} is no number; expected `t x y z qx qy qz qw`", i + 1);
                    return Err(recording.line_error(number, message));
                }
                None => {
                    let message = format!("{i} columns; expected the 8 of `t x y z qx qy qz qw`");
                    return Err(recording.line_error(number, message));
                }
            };
        }
        longer += usize::from(fields.next().is_some());
        let [seconds, rest @ ..] = numbers;
        recording.push(number, seconds, rest)?;
    }
    let axes = CameraAxes { forward: Axis::Z, up: Axis::MINUS_Y };
    let note = (longer > 0).then(|| format!("{longer} lines with more than 8 columns: the others ignored"));
    Ok((Convention { order: QuatOrder::Xyzw, axes, up: Axis::Z }, note))
}

/// Where the columns of an EyeNavGS table are.
struct EyeNavColumns {
    view: usize,
    milliseconds: usize,
    /// Position and quaternion.
    pose: [usize; 7],
}

impl EyeNavColumns {
    /// `None` if this is no header of such a table; an error names the column that it lacks.
    fn find(header: &str) -> Option<Result<EyeNavColumns, &'static str>> {
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        let column = |name: &'static str| names.iter().position(|n| n.eq_ignore_ascii_case(name)).ok_or(name);
        let view = column("ViewIndex").ok()?;
        let pose = ["PositionX", "PositionY", "PositionZ", "QuaternionX", "QuaternionY", "QuaternionZ", "QuaternionW"];
        let find = || {
            let mut columns = [0; 7];
            for (slot, name) in columns.iter_mut().zip(pose) {
                *slot = column(name)?;
            }
            let milliseconds = column("timestep").or_else(|_| column("Timestamp"))?;
            Ok(EyeNavColumns { view, milliseconds, pose: columns })
        };
        Some(find())
    }
}

fn eye_nav(
    recording: &mut Recording<'_>,
    columns: &EyeNavColumns,
    lines: TextLines<'_>,
) -> Result<Convention, PathError> {
    for (number, line) in lines {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = |column: usize| {
            let field = fields.get(column).ok_or_else(|| {
                recording.line_error(number, format!("{} columns; expected a column {}", fields.len(), column + 1))
            })?;
            field
                .parse::<f64>()
                .map_err(|_| recording.line_error(number, format!("column {} is no number; expected one", column + 1)))
        };
        if value(columns.view)? != 0.0 {
            continue;
        }
        let seconds = value(columns.milliseconds)? * 1e-3;
        let mut numbers = [0.0; 7];
        for (slot, &column) in numbers.iter_mut().zip(&columns.pose) {
            *slot = value(column)?;
        }
        recording.push(number, seconds, numbers)?;
    }
    let axes = CameraAxes { forward: Axis::MINUS_Z, up: Axis::Y };
    Ok(Convention { order: QuatOrder::Xyzw, axes, up: Axis::Y })
}
