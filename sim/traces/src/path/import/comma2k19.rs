//! A segment's poses of comma2k19: `frame_times.npy` (s), `frame_positions.npy` (m) and `frame_orientations.npy`
//! (quaternions, real part first) in one folder, both in Earth-centred coordinates; the device looks along its +x, and
//! its +z points down.

use std::path::{Path, PathBuf};

use glam::{DQuat, DVec3};

use crate::path::axes::{CameraAxes, QuatOrder};
use crate::path::look::Look;
use crate::path::parse::{Options, read_file};
use crate::path::{CameraPath, Heights, PathError, Pose, QUATERNION_TOLERANCE};

use super::npy;

const FILES: [&str; 3] = ["frame_times.npy", "frame_positions.npy", "frame_orientations.npy"];

/// A camera that follows its motion less than this (mean cosine, weighted by distance) is worth a warning.
const FOLLOWS: f64 = 0.75;

/// A position farther from the Earth's surface is none of a drive, metres.
const HEIGHT_MAX: f64 = 1e5;

/// The beginning of a NumPy array.
pub(in crate::path) fn is_array(bytes: &[u8]) -> bool {
    bytes.starts_with(npy::MAGIC)
}

/// Does the folder hold a segment?
pub(in crate::path) fn is_folder(folder: &Path) -> bool {
    folder.join(FILES[1]).is_file()
}

/// Reads a folder.
pub(in crate::path) fn from_folder(folder: &Path, options: &Options) -> Result<CameraPath, PathError> {
    let name = folder.to_string_lossy();
    let [times, positions, orientations] = FILES.map(|file| -> Result<Vec<u8>, PathError> {
        let file: PathBuf = folder.join(file);
        read_file(&file)
    });
    read(&name, [&times?, &positions?, &orientations?], options)
}

/// Reads the three arrays.
pub(super) fn read(name: &str, arrays: [&[u8]; 3], options: &Options) -> Result<CameraPath, PathError> {
    let wrong = |file: usize, message: String| PathError::Place {
        name: name.to_owned(),
        place: FILES[file].to_owned(),
        message,
    };
    let mut parsed = Vec::with_capacity(3);
    for (file, (bytes, columns)) in arrays.into_iter().zip([1, 3, 4]).enumerate() {
        let array = npy::parse(bytes).map_err(|message| wrong(file, message))?;
        if array.columns != columns {
            return Err(wrong(file, format!("{} columns; expected {columns}", array.columns)));
        }
        parsed.push(array.values);
    }
    let [times, positions, orientations] = [&parsed[0], &parsed[1], &parsed[2]];
    let rows = times.len();
    if positions.len() != 3 * rows || orientations.len() != 4 * rows {
        let counts = (positions.len() / 3, orientations.len() / 4);
        let message = format!("{rows} times, {} positions, {} orientations; expected as many", counts.0, counts.1);
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    let other = matches!(options.look, Some(Look::Other(_)));
    if options.crs.is_some() || options.up.is_some() || options.icao24.is_some() || other {
        let message = "is comma2k19, one camera in Earth-centred coordinates; expected no --path-crs, --path-up, \
                       --icao24 or --look other";
        return Err(PathError::Whole { name: name.to_owned(), message: message.to_owned() });
    }
    let order = options.quat_order.unwrap_or(QuatOrder::Wxyz);
    let axes = options.camera_axes.unwrap_or(CameraAxes::PLUS_X_MINUS_Z);
    let camera = axes.from_canonical();
    let (mut poses, mut dropped): (Vec<Pose>, usize) = (Vec::with_capacity(rows), 0);
    let start = times.first().copied().unwrap_or(0.0);
    let vectors = positions.as_chunks::<3>().0.iter().zip(orientations.as_chunks::<4>().0);
    for (row, (time, (position, numbers))) in times.iter().zip(vectors).enumerate() {
        let position = DVec3::from_array(*position);
        let here = foresight_index::geodesy::Geodetic::from_ecef(position);
        if here.is_none_or(|here| here.height.abs() > HEIGHT_MAX) {
            return Err(wrong(1, format!("row {row}: {position}; expected metres from the Earth's centre")));
        }
        let quaternion = order.quaternion(*numbers);
        let length = quaternion.length();
        if length.is_nan() || (length - 1.0).abs() > QUATERNION_TOLERANCE {
            return Err(wrong(2, format!("row {row}: a quaternion of length {length}; expected 1")));
        }
        let time = time - start;
        if !time.is_finite() {
            return Err(wrong(0, format!("row {row}: {time}; expected finite seconds")));
        }
        if poses.last().is_some_and(|previous| time <= previous.time) {
            dropped += 1;
            continue;
        }
        let orientation: DQuat = quaternion.normalize() * camera;
        poses.push(Pose { time, position, orientation });
    }
    let mut path = CameraPath::on_earth(name, poses, Heights::Ellipsoid)?;
    let (follow, upright) = follow(&path);
    path.add_note(format!(
        "camera axes {axes}, quaternions {order}, in Earth-centred coordinates: forward follows the motion by \
         {follow:.2}, up the vertical by {upright:.2}"
    ));
    if follow < FOLLOWS {
        path.add_note("mind: the camera does not follow its motion; see --camera-axes and --quat-order");
    }
    if dropped > 0 {
        path.add_note(format!("{dropped} of {rows} poses dropped whose time was not later than the one before"));
    }
    Ok(path)
}

/// Mean cosines of the camera's forward with the motion, weighted by distance, and of its up with the vertical.
fn follow(path: &CameraPath) -> (f64, f64) {
    let (mut along, mut distance, mut upright) = (0.0, 0.0, 0.0);
    for pair in path.poses().windows(2) {
        let moved = pair[1].position - pair[0].position;
        distance += moved.length();
        along += (pair[0].orientation * -DVec3::Z).dot(moved);
        upright += (pair[0].orientation * DVec3::Y).dot(path.level_axes(pair[0].position).z_axis);
    }
    let steps = (path.poses().len() - 1) as f64;
    (if distance > 0.0 { along / distance } else { 0.0 }, upright / steps)
}
