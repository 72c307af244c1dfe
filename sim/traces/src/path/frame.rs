//! What a path's coordinates are relative to.

use std::fmt;

use foresight_index::geodesy::Geodetic;
use glam::{DMat3, DVec3};

/// The frame that a path's positions and orientations are in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// Metres in a frame of the recording's own, with one up.
    Local,
    /// Earth-centred, Earth-fixed WGS 84 (EPSG:4978), metres; up is the ellipsoid's normal at each position. The heights
    /// over the ellipsoid are what the recording gives, which may be meant over something else.
    Earth(Heights),
}

/// What recorded heights are above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heights {
    /// The WGS 84 ellipsoid.
    Ellipsoid,
    /// Mean sea level (a geoid), which lies between 107 m below and 86 m above the ellipsoid.
    SeaLevel,
    /// Where the standard atmosphere has 1013.25 hPa: sea level up to the weather, about 8 m per hPa.
    Pressure,
    /// The ground, whose height the recording does not know; 0 where it holds no heights at all.
    Ground,
}

impl fmt::Display for Heights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Heights::Ellipsoid => "above the ellipsoid",
            Heights::SeaLevel => "above sea level",
            Heights::Pressure => "by air pressure",
            Heights::Ground => "above the ground",
        })
    }
}

/// East, north and up at a position in Earth-centred coordinates, as columns. At the Earth's centre any such axes.
pub(super) fn earth_axes(position: DVec3) -> DMat3 {
    let there = Geodetic::from_ecef(position).unwrap_or(Geodetic { latitude: 0.0, longitude: 0.0, height: 0.0 });
    there.east_north_up()
}

/// Two unit vectors across `up` (unit length) and each other, the second a quarter turn counter-clockwise from the first, seen
/// against `up`: axes of the frame where `up` is one.
pub fn across(up: DVec3) -> (DVec3, DVec3) {
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
