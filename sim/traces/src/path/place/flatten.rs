//! A path on the Earth made flat.

use foresight_index::geodesy::Geodetic;
use glam::{DQuat, DVec3};

use crate::path::frame::earth_axes;
use crate::path::{CameraPath, Frame, PathError, Pose};

/// A change of length worth a note.
const STRETCH: f64 = 1e-3;

/// Flattens a path on the Earth to x east, y north, z the recorded height, from the middle of its extent.
///
/// The foot of each pose on the ellipsoid is put in the direction in which it lies from the middle, as far away as the
/// arc over the chord s = 2R sin⁻¹(c / 2R): the azimuthal equidistant projection, up to the ellipsoid's flattening.
/// Orientations are turned from the vertical of each pose to that of the middle by the smallest rotation, so what was
/// level stays level, and a camera along the motion stays along it.
pub(super) fn flatten(path: &CameraPath) -> Result<CameraPath, PathError> {
    let whole = |message: String| PathError::Whole { name: path.name.clone(), message };
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for pose in &path.poses {
        (low, high) = (low.min(pose.position), high.max(pose.position));
    }
    // A path around the world has its middle in the Earth's, where there is no vertical.
    let middle = Geodetic::from_ecef(0.5 * (low + high)).filter(|middle| middle.height > -1e6);
    let middle = middle.or_else(|| Geodetic::from_ecef(path.poses[0].position));
    let middle = middle.ok_or_else(|| whole("lies at the Earth's centre; expected it near its surface".to_owned()))?;
    let foot = Geodetic { height: 0.0, ..middle }.to_ecef();
    let level_from_earth = middle.east_north_up().transpose();
    let diameter = 2.0 * foot.length();

    let mut poses = Vec::with_capacity(path.poses.len());
    for pose in &path.poses {
        let here = Geodetic::from_ecef(pose.position).ok_or_else(|| {
            whole(format!("lies at the Earth's centre at {} s; expected it near its surface", pose.time))
        })?;
        let d = level_from_earth * (Geodetic { height: 0.0, ..here }.to_ecef() - foot);
        let (chord, across) = (d.length(), libm::hypot(d.x, d.y));
        let arc = diameter * libm::asin((chord / diameter).min(1.0));
        let stretch = if across > 0.0 { arc / across } else { 0.0 };
        let up = (level_from_earth * earth_axes(pose.position).z_axis).normalize();
        let turn = DQuat::from_rotation_arc(up, DVec3::Z) * DQuat::from_mat3(&level_from_earth);
        poses.push(Pose {
            time: pose.time,
            position: DVec3::new(d.x * stretch, d.y * stretch, here.height),
            orientation: (turn * pose.orientation).normalize(),
        });
    }
    let length = |poses: &[Pose]| poses.windows(2).map(|p| p[0].position.distance(p[1].position)).sum::<f64>();
    let (flat, round) = (length(&poses), length(&path.poses));
    let mut flattened = CameraPath {
        name: path.name.clone(),
        poses,
        frame: Frame::Local,
        up: DVec3::Z,
        notes: path.notes.clone(),
        ..*path
    };
    flattened.check()?;
    if round > 0.0 && (flat / round - 1.0).abs() > STRETCH {
        flattened.add_note(format!("flattened, which changes its length by {:+.2} %", 100.0 * (flat / round - 1.0)));
    }
    Ok(flattened)
}
