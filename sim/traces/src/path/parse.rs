//! Camera paths from files.

use std::path::Path;

use super::axes::{Axis, CameraAxes, QuatOrder};
use super::import::{self, is_array, is_folder};
use super::look::{Look, apply};
use super::{CameraPath, PathError, recording};

pub use super::import::Format;

/// Largest file read, bytes.
const FILE_BYTES_MAX: u64 = 2 << 30;

/// What a file does not say, or says wrongly, and what is to be taken from it. Absent axes are chosen from the motion.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The camera's forward and up axes.
    pub camera_axes: Option<CameraAxes>,
    /// Order of a quaternion's components.
    pub quat_order: Option<QuatOrder>,
    /// Up of the frame that the positions are in.
    pub up: Option<Axis>,
    /// The projected system that positions in metres are in, by its EPSG code.
    pub crs: Option<u32>,
    /// The aircraft to take, by its ICAO 24-bit address.
    pub icao24: Option<String>,
    /// Where the camera looks; as recorded, or along the motion, if absent.
    pub look: Option<Look>,
}

/// Reads a file, see [`from_bytes`]; or a folder of comma2k19, which may also be named by a file in it.
///
/// # Errors
/// A file that cannot be read, and all errors of [`from_bytes`].
pub fn from_file(file: &Path, options: &Options) -> Result<CameraPath, PathError> {
    let folder = if is_folder(file) { Some(file) } else { None };
    let bytes = if folder.is_none() { read_file(file)? } else { Vec::new() };
    let folder = folder.or_else(|| file.parent().filter(|folder| is_array(&bytes) && is_folder(folder)));
    match folder {
        Some(folder) => looking(import::from_folder(folder, options)?, options),
        None => from_bytes(&file.to_string_lossy(), &bytes, options),
    }
}

/// Is this what [`from_file`] reads, though it looks like a world: a folder of comma2k19, or JSON that is a list?
pub fn is_path_like(file: &Path) -> bool {
    use std::io::Read;
    if file.is_dir() {
        return is_folder(file);
    }
    let mut first = [0; 64];
    let read = std::fs::File::open(file).and_then(|mut open| open.read(&mut first)).unwrap_or(0);
    first[..read].strip_prefix(b"\xef\xbb\xbf").unwrap_or(&first[..read]).trim_ascii_start().starts_with(b"[")
}

/// Reads a file's content, recognised by itself, decompressed if it is gzip:
/// - TUM (`t x y z qx qy qz qw`, seconds and metres, `#` begins a comment, further columns are ignored) and EyeNavGS (a
///   table with a header, two rows a frame, of which those of view 0 are taken; milliseconds, y up). Lines whose time is
///   not later than the one before are dropped; quaternions of a length within 10⁻² of 1 are renormalised; both are
///   counted in the notes, and so is what was chosen from the motion;
/// - our own recordings, see [`super::recording`];
/// - GPX, IGC, KML, ADS-B JSON and G-NetTrack tables: paths on the Earth, whose cameras look along the motion where the
///   file does not say otherwise;
/// - a recording of ours, see [`recording`].
///
/// # Errors
/// [`PathError`] names the place and what was expected there.
pub fn from_bytes(name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    check(name, bytes)?;
    if recording::is_recording(bytes) {
        return looking(recording::path_from_bytes(name, bytes, options)?, options);
    }
    looking(import::read(name, bytes, options)?, options)
}

/// Reads a file's content, decompressed, in the format given.
///
/// # Errors
/// As [`from_bytes`].
pub fn from_bytes_as(format: Format, name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    check(name, bytes)?;
    looking(import::read_as(format, name, bytes, options)?, options)
}

/// Reads the content of comma2k19's `frame_times.npy`, `frame_positions.npy` and `frame_orientations.npy`.
///
/// # Errors
/// An array of another form, more positions than times, positions off the Earth.
pub fn from_arrays(name: &str, arrays: [&[u8]; 3], options: &Options) -> Result<CameraPath, PathError> {
    looking(import::read_arrays(name, arrays, options)?, options)
}

fn check(name: &str, bytes: &[u8]) -> Result<(), PathError> {
    check_size(name, bytes.len() as u64)?;
    if bytes.trim_ascii().is_empty() {
        let message = "is empty; expected poses over time".to_owned();
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    if is_array(bytes) {
        let message = "is one NumPy array; expected a folder with frame_times.npy, frame_positions.npy and \
                       frame_orientations.npy"
            .to_owned();
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    Ok(())
}

/// Aims the camera as asked. Another aircraft was aimed at, or refused, where the file was read.
fn looking(path: CameraPath, options: &Options) -> Result<CameraPath, PathError> {
    match &options.look {
        None => Ok(path),
        Some(Look::Other(_)) => Ok(path),
        Some(look) => apply(path, look),
    }
}

/// A file's bytes, of limited size.
pub(super) fn read_file(file: &Path) -> Result<Vec<u8>, PathError> {
    let name = file.to_string_lossy();
    let io = |source| PathError::Io { name: name.clone().into_owned(), source };
    check_size(&name, std::fs::metadata(file).map_err(io)?.len())?;
    std::fs::read(file).map_err(io)
}

fn check_size(name: &str, size: u64) -> Result<(), PathError> {
    if size <= FILE_BYTES_MAX {
        return Ok(());
    }
    let message = format!("{size} bytes; expected at most {FILE_BYTES_MAX}");
    Err(PathError::Whole { name: name.to_owned(), message })
}
