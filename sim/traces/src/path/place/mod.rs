//! Putting a path into a world.

mod flatten;
pub mod geo;

#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;

use foresight_index::world::World;
use glam::{DQuat, DVec3};

use super::frame::across;
use super::{CameraPath, Frame, PathError, Pose};

/// How a path is put into a world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placement {
    /// Not at all: its positions are the world's own coordinates, as where it was recorded in this world.
    World,
    /// By geographic coordinates.
    Geo {
        /// Lifts the path until its lowest pose over the world is that many metres above the ground there.
        height: Option<f64>,
    },
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
            Placement::World => f.write_str("world"),
            Placement::Geo { height: None } => f.write_str("geo"),
            Placement::Geo { height: Some(height) } => write!(f, "geo,height={height}"),
            Placement::Centre { height, yaw, scale } => write!(f, "centre,height={height},yaw={yaw},scale={scale}"),
        }
    }
}

impl FromStr for Placement {
    type Err = PathError;

    /// `world`; `geo`, which `,height=M` may follow; or `centre` followed by any of `,height=M`, `,yaw=DEGREES`, `,scale=X`.
    fn from_str(text: &str) -> Result<Placement, PathError> {
        let fail = |message: String| PathError::Option { given: text.to_owned(), message };
        if text == "world" {
            return Ok(Placement::World);
        }
        let mut parts = text.split(',');
        let is_geo = match parts.next() {
            Some("geo") => true,
            Some("centre") => false,
            _ => return Err(fail("expected world, geo, or centre,height=2,yaw=0,scale=1".to_owned())),
        };
        let (mut height, mut yaw, mut scale) = (None, 0.0, 1.0);
        for part in parts {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            let range = match key {
                "height" => -1e7..=1e9,
                "yaw" if !is_geo => -1e6..=1e6,
                "scale" if !is_geo => 1e-9..=1e9,
                _ if is_geo => return Err(fail(format!("unknown key `{key}`; expected height"))),
                _ => return Err(fail(format!("unknown key `{key}`; expected height, yaw or scale"))),
            };
            let number = match value.parse::<f64>() {
                Ok(number) if range.contains(&number) => number,
                _ => {
                    let (low, high) = (range.start(), range.end());
                    return Err(fail(format!("{key} `{value}`; expected a number from {low} to {high}")));
                }
            };
            match key {
                "height" => height = Some(number),
                "yaw" => yaw = number,
                _ => scale = number,
            }
        }
        Ok(match is_geo {
            true => Placement::Geo { height },
            false => Placement::Centre { height: height.unwrap_or(2.0), yaw, scale },
        })
    }
}

/// Puts the path into a world: as asked, else by geographic coordinates where both have them and the path comes over the
/// world, else over its centre. Also says which it was.
///
/// # Errors
/// Those of [`place`] and [`geo::place`], a world without ground.
pub fn into_world(
    path: &CameraPath,
    placement: Option<Placement>,
    world: &World,
) -> Result<(CameraPath, Placement), PathError> {
    let mut away = None;
    if placement.is_none() && path.frame != Frame::Local && world.georeference.is_some() {
        match geo::place(path, None, world) {
            Ok(placed) if placed.is_over => return Ok((placed.path, Placement::Geo { height: None })),
            Ok(_) => away = Some("it does not come over this world by its coordinates".to_owned()),
            Err(error) => away = Some(error.to_string()),
        }
    }
    let placement = placement.unwrap_or_default();
    if let Placement::Geo { height } = placement {
        return Ok((geo::place(path, height, world)?.path, placement));
    }
    let centre = world.tree.bounds(world.tree.root()).centre();
    // Without a ground, as in space, heights count from the world's middle.
    let ground_height = world.ground_height(centre).unwrap_or_else(|| centre.dot(world.up));
    let mut placed = place(path, &placement, &Site { centre, up: world.up, ground_height })?;
    if let Some(reason) = away {
        placed.add_note(format!("placed over the world's centre: {reason}"));
    }
    Ok((placed, placement))
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

/// Puts the path over a world's centre. A path on the Earth is flattened first, see `flatten`. Its up becomes the world's, by the smallest rotation, then it is turned by yaw and scaled
/// about its middle: the middle of its bounding box across the world's up, at the median height of its poses.
///
/// # Errors
/// `geo` for a path without geographic coordinates, a site that is not finite, a result farther out than
/// [`super::COORDINATE_MAX`].
pub fn place(path: &CameraPath, placement: &Placement, site: &Site) -> Result<CameraPath, PathError> {
    let whole = |message: String| PathError::Whole { name: path.name.clone(), message };
    if *placement == Placement::World {
        return match path.frame {
            Frame::Local => Ok(path.clone()),
            Frame::Earth(_) => Err(whole("is on the Earth; expected a placement `geo` or `centre`".to_owned())),
        };
    }
    let Placement::Centre { height, yaw, scale } = *placement else {
        return Err(whole("a world without geographic coordinates; expected a placement `centre`".to_owned()));
    };
    let flat;
    let path = if path.frame == Frame::Local {
        path
    } else {
        flat = flatten::flatten(path)?;
        &flat
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
