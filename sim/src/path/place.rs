//! Putting a path into a world.

use std::fmt;
use std::str::FromStr;

use glam::{DQuat, DVec3};

use super::{CameraPath, PathError, Pose};

/// How a path is put into a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placement {
    /// By geographic coordinates.
    Geo,
    /// The path's middle over the world's centre.
    Centre {
        /// Height of the path's middle above the ground at the world's centre, metres.
        height: f64,
        /// Turn about the world's up, counter-clockwise seen from above, degrees.
        yaw: f64,
        /// Factor on the path's extent.
        scale: f64,
    },
}

impl Default for Placement {
    fn default() -> Placement {
        Placement::Centre { height: 2.0, yaw: 0.0, scale: 1.0 }
    }
}

impl fmt::Display for Placement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Placement::Geo => f.write_str("geo"),
            Placement::Centre { height, yaw, scale } => write!(f, "centre,height={height},yaw={yaw},scale={scale}"),
        }
    }
}

impl FromStr for Placement {
    type Err = PathError;

    /// `geo`, or `centre` followed by any of `,height=M`, `,yaw=DEGREES`, `,scale=X`.
    fn from_str(text: &str) -> Result<Placement, PathError> {
        let fail = |message: String| PathError::Option { given: text.to_owned(), message };
        let mut parts = text.split(',');
        match parts.next() {
            Some("geo") if text == "geo" => return Ok(Placement::Geo),
            Some("centre") => {}
            _ => return Err(fail("expected geo, or centre,height=2,yaw=0,scale=1".to_owned())),
        }
        let (mut height, mut yaw, mut scale) = (2.0, 0.0, 1.0);
        for part in parts {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            let (slot, range) = match key {
                "height" => (&mut height, -1e7..=1e9),
                "yaw" => (&mut yaw, -1e6..=1e6),
                "scale" => (&mut scale, 1e-9..=1e9),
                _ => return Err(fail(format!("unknown key `{key}`; expected height, yaw or scale"))),
            };
            *slot = match value.parse::<f64>() {
                Ok(number) if range.contains(&number) => number,
                _ => {
                    let (low, high) = (range.start(), range.end());
                    return Err(fail(format!("{key} `{value}`; expected a number from {low} to {high}")));
                }
            };
        }
        Ok(Placement::Centre { height, yaw, scale })
    }
}

/// Where a world is, as far as a path needs to know.
#[derive(Clone, Copy, Debug)]
pub struct Site {
    /// Any point on the vertical through the world's middle.
    pub centre: DVec3,
    /// The world's up; need not be unit.
    pub up: DVec3,
    /// Height of the ground there: its coordinate along the unit up.
    pub ground_height: f64,
}

/// Puts the path into a world. Its up becomes the world's, by the smallest rotation, then it is turned by yaw and scaled
/// about its middle: the middle of its bounding box across the world's up, at the median height of its poses.
///
/// # Errors
/// `geo` for a path without geographic coordinates, a site that is not finite, a result farther out than
/// [`super::COORDINATE_MAX`].
pub fn place(path: &CameraPath, placement: &Placement, site: &Site) -> Result<CameraPath, PathError> {
    let whole = |message: String| PathError::Whole { name: path.name.clone(), message };
    let Placement::Centre { height, yaw, scale } = *placement else {
        return Err(whole("this path carries no geographic coordinates; expected a placement `centre`".to_owned()));
    };
    let up =
        site.up.try_normalize().ok_or_else(|| whole(format!("a world's up of {}; expected a direction", site.up)))?;
    if !(site.centre.is_finite() && site.ground_height.is_finite()) {
        return Err(whole("a world's centre or ground that is not finite; expected metres".to_owned()));
    }
    let turn = DQuat::from_axis_angle(up, yaw.to_radians()) * DQuat::from_rotation_arc(path.up, up);
    let turn = turn.normalize();

    // Relative to the first pose, so that map coordinates keep their precision.
    let origin = path.poses[0].position;
    let turned = |pose: &Pose| turn * (pose.position - origin);
    let (east, north) = across(up);
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let mut heights = Vec::with_capacity(path.poses.len());
    for pose in &path.poses {
        let p = turned(pose);
        for (k, axis) in [east, north].into_iter().enumerate() {
            low[k] = low[k].min(p.dot(axis));
            high[k] = high[k].max(p.dot(axis));
        }
        heights.push(p.dot(up));
    }
    let middle = heights.len() / 2;
    let median = *heights.select_nth_unstable_by(middle, f64::total_cmp).1;
    let middle = east * (0.5 * (low[0] + high[0])) + north * (0.5 * (low[1] + high[1])) + up * median;
    let target = site.centre + up * (site.ground_height + height - site.centre.dot(up));

    let poses = path.poses.iter().map(|pose| Pose {
        time: pose.time,
        position: target + (turned(pose) - middle) * scale,
        orientation: turn * pose.orientation,
    });
    let mut placed =
        CameraPath { poses: poses.collect(), up, notes: path.notes.clone(), name: path.name.clone(), ..*path };
    placed.check()?;
    Ok(placed)
}

/// Two unit vectors across `up` and each other: axes of the frame where `up` is one.
fn across(up: DVec3) -> (DVec3, DVec3) {
    let a = up.abs();
    // The axis after the dominant one, so that z gives x and y gives z.
    let seed = if a.z >= a.x && a.z >= a.y {
        DVec3::X
    } else if a.y >= a.x {
        DVec3::Z
    } else {
        DVec3::Y
    };
    let east = (seed - up * seed.dot(up)).normalize();
    (east, up.cross(east))
}
