//! Paths and projected coordinate systems: from one onto the Earth, and into a world that lies on it.

use foresight_index::geodesy::{Geodetic, Projection};
use foresight_index::world::{Georeference, World};
use glam::{DQuat, DVec3};

use crate::path::frame::across;
use crate::path::{CameraPath, Frame, Heights, PathError, Pose};

/// Half the step to the north from which a grid's convergence is taken, radians (about 600 m).
const CONVERGENCE_STEP: f64 = 1e-4;

/// How far above and below a world's middle a path is over it at least, metres.
const HEIGHT_REACH: f64 = 1e5;

/// A path in a world, by its coordinates.
pub struct Placed {
    /// In the world's space.
    pub path: CameraPath,
    /// Whether a pose lies over the world.
    pub is_over: bool,
}

/// Angle of true north in a grid, clockwise from the grid's north, radians; a projection's errors as text.
fn convergence(projection: &Projection, at: Geodetic) -> Result<f64, String> {
    let pole = 0.5 * std::f64::consts::PI;
    let shifted = |by: f64| Geodetic { latitude: (at.latitude + by).clamp(-pole, pole), ..at };
    let south = projection.forward(shifted(-CONVERGENCE_STEP)).map_err(|error| error.to_string())?;
    let north = projection.forward(shifted(CONVERGENCE_STEP)).map_err(|error| error.to_string())?;
    Ok(libm::atan2(north.x - south.x, north.y - south.y))
}

/// A path whose positions are coordinates in a projected system (x east, y north, z height), on the Earth. Orientations
/// are turned by the grid's convergence.
///
/// # Errors
/// An unknown system, coordinates outside of it.
pub(in crate::path) fn from_projected(path: CameraPath, code: u32) -> Result<CameraPath, PathError> {
    let whole = |message: String| PathError::Whole { name: path.name.clone(), message };
    let projection = Projection::from_epsg(code).map_err(|error| whole(error.to_string()))?;
    let mut poses = Vec::with_capacity(path.poses.len());
    for pose in &path.poses {
        let fail = |error: String| whole(format!("at {} s: {error}; expected coordinates in EPSG:{code}", pose.time));
        let here = projection.inverse(pose.position).map_err(|error| fail(error.to_string()))?;
        // Grid axes to east and north.
        let turn = DQuat::from_rotation_z(convergence(&projection, here).map_err(fail)?);
        let orientation = (DQuat::from_mat3(&here.east_north_up()) * turn * pose.orientation).normalize();
        // The height stays what it is: of which surface the file does not say.
        let position = Geodetic { height: pose.position.z, ..here }.to_ecef();
        poses.push(Pose { time: pose.time, position, orientation });
    }
    let mut on_earth = CameraPath::on_earth(&path.name, poses, Heights::SeaLevel)?;
    on_earth.notes = path.notes;
    on_earth.add_note(format!("positions are in EPSG:{code}; heights taken as above sea level"));
    Ok(on_earth)
}

/// Puts a path into a world by the coordinates of both.
///
/// In a world in Earth-centred coordinates the path stays as it is, its recorded heights taken as above the ellipsoid.
/// In a projected system each position is projected, and each orientation goes through local east, north and up and the
/// grid's convergence. Recorded heights above sea level or by air pressure are taken as the system's own: national
/// systems count from about sea level; heights above the ellipsoid become those above that of the system's datum.
/// Heights above the ground are above the world's.
///
/// With `height` the whole path is lifted along each pose's vertical until its lowest pose over the world (or, where none
/// is, of all) stands that many metres above the ground.
///
/// # Errors
/// A path or a world without coordinates, a position that the world's system cannot express.
pub fn place(path: &CameraPath, height: Option<f64>, world: &World) -> Result<Placed, PathError> {
    let whole = |message: String| PathError::Whole { name: path.name.clone(), message };
    let (georeference, heights) = match (world.georeference, path.frame) {
        (Some(georeference), Frame::Earth(heights)) => (georeference, heights),
        (None, Frame::Earth(_)) => {
            let message = "carries no geographic coordinates; expected a placement `centre`";
            return Err(whole(format!("world {} {message}", world.name)));
        }
        (Some(_), Frame::Local) => {
            let message = "this path carries no geographic coordinates; expected a placement `centre`, or --path-crs if \
                           its positions are in a projected system";
            return Err(whole(message.to_owned()));
        }
        (None, Frame::Local) => {
            let message = "carry geographic coordinates; expected a placement `centre`";
            return Err(whole(format!("neither this path nor world {} {message}", world.name)));
        }
    };
    let is_ecef = georeference == Georeference::Ecef;
    let mut placed = match georeference {
        Georeference::Ecef => path.clone(),
        Georeference::Epsg(code) => project(path, code, heights).map_err(whole)?,
    };
    let vertical = |position: DVec3| if is_ecef { path.level_axes(position).z_axis } else { world.up };
    let clearance = |position: DVec3| Some(position.dot(world.up) - world.ground_height(position)?);

    let over = Footprint::new(world);
    let count = placed.poses.iter().filter(|pose| over.holds(pose.position)).count();
    if heights == Heights::Ground {
        for pose in &mut placed.poses {
            let above = if is_ecef {
                Geodetic::from_ecef(pose.position).map_or(0.0, |here| here.height)
            } else {
                pose.position.dot(world.up)
            };
            let lift = above - clearance(pose.position).unwrap_or(0.0);
            pose.position += vertical(pose.position) * lift;
        }
    }
    if let Some(height) = height {
        let lowest = placed
            .poses
            .iter()
            .filter(|pose| count == 0 || over.holds(pose.position))
            .filter_map(|pose| clearance(pose.position))
            .fold(f64::INFINITY, f64::min);
        if !lowest.is_finite() {
            return Err(whole(format!("world {}: no ground under this path", world.name)));
        }
        let lift = height - lowest;
        for pose in &mut placed.poses {
            pose.position += vertical(pose.position) * lift;
        }
        placed.add_note(format!("placed by coordinates, then lifted by {lift:+.2} m"));
    }
    placed.check()?;
    placed.add_note(if count > 0 {
        format!("placed by coordinates: {count} of {} poses lie over the world", placed.poses.len())
    } else {
        let bounds = world.tree.bounds(world.tree.root());
        let nearest = placed.poses.iter().map(|pose| {
            let p = pose.position;
            p.distance(p.clamp(bounds.min, bounds.max))
        });
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        format!("mind: placed by coordinates, the path comes no nearer than {:.3} km to the world", nearest * 1e-3)
    });
    if height.is_none() {
        let note = match (is_ecef, heights) {
            (true, Heights::Ellipsoid) => None,
            (true, Heights::SeaLevel | Heights::Pressure) => Some(format!(
                "mind: the path's heights are {heights}, the world's above the ellipsoid: in Europe sea level is 40 to \
                 55 m higher than that; geo,height=M stands the path that high above the ground"
            )),
            (false, Heights::SeaLevel) => None,
            (false, Heights::Pressure | Heights::Ellipsoid) => Some(format!(
                "mind: the path's heights are {heights}, the world's of its projected system, mostly above sea level: \
                 they may differ by some 10 m (pressure) or 50 m (ellipsoid); geo,height=M stands the path that high \
                 above the ground"
            )),
            (_, Heights::Ground) => Some("heights are above the world's ground".to_owned()),
        };
        placed.notes.extend(note);
    }
    Ok(Placed { path: placed, is_over: count > 0 })
}

fn project(path: &CameraPath, code: u32, heights: Heights) -> Result<CameraPath, String> {
    let projection = Projection::from_epsg(code).map_err(|error| error.to_string())?;
    let mut poses = Vec::with_capacity(path.poses.len());
    for pose in &path.poses {
        let fail =
            |error: String| format!("at {} s: {error}; expected a path within the world's EPSG:{code}", pose.time);
        let here = Geodetic::from_ecef(pose.position).ok_or_else(|| fail("the Earth's centre".to_owned()))?;
        let mut position = projection.forward(here).map_err(|error| fail(error.to_string()))?;
        if heights != Heights::Ellipsoid {
            position.z = here.height;
        }
        let turn = DQuat::from_rotation_z(-convergence(&projection, here).map_err(fail)?);
        let level_from_earth = DQuat::from_mat3(&here.east_north_up().transpose());
        poses.push(Pose {
            time: pose.time,
            position,
            orientation: (turn * level_from_earth * pose.orientation).normalize(),
        });
    }
    Ok(CameraPath {
        name: path.name.clone(),
        poses,
        frame: Frame::Local,
        up: DVec3::Z,
        notes: path.notes.clone(),
        ..*path
    })
}

/// A world's bounds seen along its up, as far as its own width above and below: the other side of the Earth is not over
/// the world.
struct Footprint {
    axes: [DVec3; 3],
    low: [f64; 3],
    high: [f64; 3],
}

impl Footprint {
    fn new(world: &World) -> Footprint {
        let (right, ahead) = across(world.up);
        let axes = [right, ahead, world.up];
        let bounds = world.tree.bounds(world.tree.root());
        let (centre, half) = (0.5 * (bounds.min + bounds.max), 0.5 * (bounds.max - bounds.min));
        let mut reach = axes.map(|axis| half.dot(axis.abs()));
        reach[2] = HEIGHT_REACH.max(2.0 * half.length());
        let middle = axes.map(|axis| centre.dot(axis));
        Footprint { axes, low: [0, 1, 2].map(|k| middle[k] - reach[k]), high: [0, 1, 2].map(|k| middle[k] + reach[k]) }
    }

    fn holds(&self, position: DVec3) -> bool {
        (0..3).all(|k| (self.low[k]..=self.high[k]).contains(&position.dot(self.axes[k])))
    }
}
