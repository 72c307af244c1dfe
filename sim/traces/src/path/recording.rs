//! The project's own recordings: JSON lines, a header and then a pose a line.
//!
//! ```text
//! {"format":"foresight-recording","schema_version":1,"frame":"local","up":[0.0,0.0,1.0]}
//! {"t":0.0,"position":[1.0,2.0,3.0],"orientation":[0.0,0.0,0.0,1.0],"fov_y":1.047,"viewport":[1920,1080]}
//! {"t":0.016,"position":[1.1,2.0,3.0],"orientation":[0.0,0.0,0.0,1.0]}
//! ```
//!
//! `t` is in seconds, on any clock, and increases. `position` is in metres, in a frame whose up is the header's; or, where
//! `frame` is `earth`, in Earth-centred, Earth-fixed coordinates, whose heights are above what the header's `heights` says:
//! `ellipsoid` (also if absent), `sea-level`, `pressure` or `ground`. `orientation` is x, y, z, w of the unit quaternion
//! that turns a camera looking along −z with +y up into the frame. `fov_y` (vertical, radians) and `viewport` (pixels) may
//! be left out: then those of the line before hold. Further fields are ignored. A line is written at once, so a recording
//! that was cut off lacks the end of its last line at most.

use std::io::Write;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::value::RawValue;

use crate::text_lines::{LINE_BYTES_MAX, TextLines};

use super::parse::Options;
use super::{
    COORDINATE_MAX, CameraPath, Frame, Heights, POSES_MAX, PathError, Pose, QUATERNION_TOLERANCE, SECONDS_MAX,
};

/// What the header's `format` says.
pub const FORMAT: &str = "foresight-recording";

/// Version that is written. Raised when a field changes its meaning or goes away; newer ones are refused.
pub const SCHEMA_VERSION: u32 = 1;

/// A quaternion's length this far from 1 is rounding, and not reported.
const LENGTH_ROUNDING: f64 = 1e-6;

/// The header's `frame`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum FrameName {
    Local,
    Earth,
}

/// The header's `heights`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum HeightsName {
    Ellipsoid,
    SeaLevel,
    Pressure,
    Ground,
}

impl From<Heights> for HeightsName {
    fn from(heights: Heights) -> HeightsName {
        match heights {
            Heights::Ellipsoid => HeightsName::Ellipsoid,
            Heights::SeaLevel => HeightsName::SeaLevel,
            Heights::Pressure => HeightsName::Pressure,
            Heights::Ground => HeightsName::Ground,
        }
    }
}

impl From<HeightsName> for Heights {
    fn from(name: HeightsName) -> Heights {
        match name {
            HeightsName::Ellipsoid => Heights::Ellipsoid,
            HeightsName::SeaLevel => Heights::SeaLevel,
            HeightsName::Pressure => Heights::Pressure,
            HeightsName::Ground => Heights::Ground,
        }
    }
}

/// A pose at a time, as it is recorded.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sample {
    /// Seconds.
    pub t: f64,
    /// Metres.
    pub position: [f64; 3],
    /// x, y, z, w.
    pub orientation: [f64; 4],
    /// Vertical field of view, radians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fov_y: Option<f64>,
    /// Width and height, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub viewport: Option<[u32; 2]>,
}

/// Writes a recording as it is made.
#[derive(Debug)]
pub struct Writer<W> {
    name: String,
    out: W,
}

impl<W: Write> Writer<W> {
    /// Writes the header. `name` is for messages.
    ///
    /// # Errors
    /// What the output says; an up without direction.
    pub fn new(name: &str, out: W, frame: Frame, up: DVec3) -> Result<Writer<W>, PathError> {
        let (frame, heights) = match frame {
            Frame::Local => (FrameName::Local, None),
            Frame::Earth(heights) => (FrameName::Earth, Some(heights.into())),
        };
        let (format, up_numbers) = (FORMAT.to_owned(), up.to_array());
        let header = Header { format, schema_version: SCHEMA_VERSION, frame, heights, up: up_numbers };
        let mut writer = Writer { name: name.to_owned(), out };
        if up.try_normalize().is_none() {
            let message = format!("up {up}; expected a direction");
            return Err(PathError::Whole { name: writer.name, message });
        }
        writer.line(&header)?;
        Ok(writer)
    }

    /// Writes a line.
    ///
    /// # Errors
    /// What the output says; a sample with a number that is not finite.
    pub fn push(&mut self, sample: &Sample) -> Result<(), PathError> {
        let numbers = [&[sample.t][..], &sample.position, &sample.orientation, sample.fov_y.as_slice()].concat();
        if let Some(bad) = numbers.iter().find(|number| !number.is_finite()) {
            let message = format!("{bad} in the pose at {} s; expected finite numbers", sample.t);
            return Err(PathError::Whole { name: self.name.clone(), message });
        }
        self.line(sample)
    }

    fn line(&mut self, content: &impl Serialize) -> Result<(), PathError> {
        let written = serde_json::to_vec(content).map_err(std::io::Error::from).and_then(|mut line| {
            line.push(b'\n');
            // At once: what is cut off is cut off within one line.
            self.out.write_all(&line)
        });
        written.map_err(|source| PathError::Io { name: self.name.clone(), source })
    }

    /// The output, flushed.
    ///
    /// # Errors
    /// What the output says.
    pub fn finish(mut self) -> Result<W, PathError> {
        match self.out.flush() {
            Ok(()) => Ok(self.out),
            Err(source) => Err(PathError::Io { name: self.name, source }),
        }
    }
}

#[derive(Serialize, Deserialize)]
struct Header {
    format: String,
    schema_version: u32,
    frame: FrameName,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    heights: Option<HeightsName>,
    up: [f64; 3],
}

/// What every version's header states.
#[derive(Deserialize)]
struct Version {
    format: String,
    schema_version: u64,
}

/// A number read to the last bit.
struct Exact(f64);

impl<'de> Deserialize<'de> for Exact {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Exact, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?.get();
        let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
        number.map(Exact).ok_or_else(|| serde::de::Error::custom(format!("`{text:.40}` is no finite number")))
    }
}

#[derive(Deserialize)]
struct Line {
    t: Exact,
    position: [Exact; 3],
    orientation: [Exact; 4],
    fov_y: Option<f64>,
    viewport: Option<[u32; 2]>,
}

/// A recording as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Which frame positions are in.
    pub frame: Frame,
    /// Unit vector.
    pub up: DVec3,
    /// In order of time; what a line leaves out is filled in from the line before, quaternions are unit.
    pub samples: Vec<Sample>,
    /// What was repaired.
    pub notes: Vec<String>,
}

/// Whether the first line is the header of a recording, of whatever version.
pub fn is_recording(bytes: &[u8]) -> bool {
    let first = TextLines::new(bytes).ok().and_then(|mut lines| lines.next());
    first.is_some_and(|(_, line)| {
        line.starts_with('{') && serde_json::from_str::<Version>(&line).is_ok_and(|header| header.format == FORMAT)
    })
}

/// Reads a recording. A truncated last line, lines whose time is not later than the one before, and quaternions within 10⁻²
/// of unit length are repaired, and noted.
///
/// # Errors
/// A newer schema, a header or line of another form, a number out of range, too many poses, more times out of order than in
/// order. Messages name the line.
pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Recording, PathError> {
    let wrong = |line: usize, message: String| PathError::Line { name: name.to_owned(), line, message };
    let mut lines = TextLines::new(bytes)
        .map_err(|line| wrong(line, format!("is longer than {LINE_BYTES_MAX} bytes; expected a pose a line")))?
        .peekable();
    let Some((number, first)) = lines.next() else {
        let message = "is empty; expected the header of a foresight-recording".to_owned();
        return Err(PathError::Whole { name: name.to_owned(), message });
    };
    let header_error = |error: serde_json::Error| wrong(number, format!("{error}; expected a {FORMAT} header"));
    let version: Version = serde_json::from_str(&first).map_err(header_error)?;
    if version.format != FORMAT {
        return Err(wrong(number, format!("a format of `{:.40}`; expected {FORMAT}", version.format)));
    }
    if version.schema_version != u64::from(SCHEMA_VERSION) {
        return Err(wrong(
            number,
            format!("schema version {}; this program reads {SCHEMA_VERSION}", version.schema_version),
        ));
    }
    let header: Header = serde_json::from_str(&first).map_err(header_error)?;
    let up = DVec3::from(header.up)
        .try_normalize()
        .ok_or_else(|| wrong(number, format!("up {:?}; expected a direction", header.up)))?;
    let frame = match header.frame {
        FrameName::Local => Frame::Local,
        FrameName::Earth => Frame::Earth(header.heights.map_or(Heights::Ellipsoid, Heights::from)),
    };
    let mut recording = Recording { frame, up, samples: Vec::new(), notes: Vec::new() };
    let (mut dropped, mut renormalised) = (0usize, 0usize);
    let ends_whole = bytes.ends_with(b"\n");
    let mut start = None;
    while let Some((number, text)) = lines.next() {
        let line: Line = match serde_json::from_str(&text) {
            Ok(line) => line,
            Err(_) if lines.peek().is_none() && !ends_whole => {
                recording.notes.push(format!("line {number}, the last, is truncated: dropped"));
                break;
            }
            Err(error) => {
                let message = format!("{error}; expected t, position of 3 and orientation of 4 numbers");
                return Err(wrong(number, message));
            }
        };
        let mut sample = line.sample();
        check(&sample).map_err(|message| wrong(number, message))?;
        let previous = recording.samples.last();
        let since = sample.t - *start.get_or_insert(sample.t);
        if since > SECONDS_MAX {
            return Err(wrong(number, format!("{since} s after the first; expected at most {SECONDS_MAX:e}")));
        }
        if previous.is_some_and(|previous| sample.t <= previous.t) {
            dropped += 1;
            continue;
        }
        sample.fov_y = sample.fov_y.or(previous.and_then(|p| p.fov_y));
        sample.viewport = sample.viewport.or(previous.and_then(|p| p.viewport));
        let orientation = DQuat::from_array(sample.orientation);
        if (orientation.length() - 1.0).abs() > LENGTH_ROUNDING {
            renormalised += 1;
            sample.orientation = orientation.normalize().to_array();
        }
        if recording.samples.len() == POSES_MAX {
            return Err(wrong(number, format!("one pose more than the {POSES_MAX} expected at most")));
        }
        recording.samples.push(sample);
    }
    if dropped > recording.samples.len() {
        let message = format!("{dropped} times are not later than the one before; expected increasing times");
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    if dropped > 0 {
        recording.notes.push(format!("{dropped} poses dropped whose time was not later than the one before"));
    }
    if renormalised > 0 {
        recording.notes.push(format!("{renormalised} quaternions renormalised"));
    }
    Ok(recording)
}

impl Line {
    fn sample(self) -> Sample {
        Sample {
            t: self.t.0,
            position: self.position.map(|number| number.0),
            orientation: self.orientation.map(|number| number.0),
            fov_y: self.fov_y,
            viewport: self.viewport,
        }
    }
}

/// What is out of range, and what was expected.
fn check(sample: &Sample) -> Result<(), String> {
    if let Some(far) = sample.position.iter().find(|x| x.abs() > COORDINATE_MAX) {
        return Err(format!("a coordinate of {far}; expected at most {COORDINATE_MAX:e}"));
    }
    let length = DQuat::from_array(sample.orientation).length();
    if (length - 1.0).abs() > QUATERNION_TOLERANCE || length.is_nan() {
        return Err(format!("a quaternion of length {length}; expected 1, or within {QUATERNION_TOLERANCE} of it"));
    }
    if let Some(fov_y) = sample.fov_y.filter(|fov_y| !(*fov_y > 0.0 && *fov_y < std::f64::consts::PI)) {
        return Err(format!("fov_y {fov_y}; expected radians between 0 and π"));
    }
    match sample.viewport {
        Some([width, height]) if width == 0 || height == 0 => {
            Err(format!("a viewport of {width} × {height} pixels; expected at least 1 × 1"))
        }
        _ => Ok(()),
    }
}

/// A recording as a path, its first time 0.
///
/// # Errors
/// As [`from_bytes`], and fewer than 2 poses.
pub fn path_from_bytes(name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    let recording = from_bytes(name, bytes)?;
    let start = recording.samples.first().map_or(0.0, |first| first.t);
    let poses = recording.samples.iter().map(|sample| Pose {
        time: sample.t - start,
        position: sample.position.into(),
        orientation: DQuat::from_array(sample.orientation),
    });
    let mut path = match recording.frame {
        Frame::Local => CameraPath::new(name, poses.collect(), recording.up)?,
        Frame::Earth(heights) => CameraPath::on_earth(name, poses.collect(), heights)?,
    };
    for note in recording.notes {
        path.add_note(note);
    }
    if options.camera_axes.is_some() || options.quat_order.is_some() || options.up.is_some() {
        path.add_note("a recording states its axes, its up and the order of its quaternions: those given are not used");
    }
    let first = recording.samples.first();
    if let Some(fov_y) = first.and_then(|first| first.fov_y) {
        let varies = if recording.samples.iter().any(|s| s.fov_y != Some(fov_y)) { ", then others" } else { "" };
        path.add_note(format!("recorded with a field of view of {:.2}°{varies} (see --fov)", fov_y.to_degrees()));
    }
    if let Some([width, height]) = first.and_then(|first| first.viewport) {
        let others = recording.samples.iter().any(|s| s.viewport != Some([width, height]));
        let varies = if others { ", then others" } else { "" };
        path.add_note(format!("recorded with a viewport of {width} × {height}{varies} (see --viewport)"));
    }
    Ok(path)
}
