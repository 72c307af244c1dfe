//! Environment maps: which of them a viewpoint needs, and what they show in place of the list (\[DRVW\] §6).
//!
//! Space is divided into cubical cells of side s. At a vertex w of the grid a *map* is a cube of six depth images that show
//! what lies outside the cube of half side D = k·s around w. The maps at the eight vertices of the viewpoint's cell all show
//! what lies outside the cell grown by D on each side; that is *far*, and is drawn from the maps alone.
//!
//! **Which are drawn.** The cell is cut into six tetrahedra along its diagonal (Kuhn); the four maps at the vertices of the
//! one that holds the viewpoint are drawn. The viewpoint v is a convex combination of them, and so
//! - behind a straight edge nothing is missing: the half-space from which a point past the edge is visible contains v, and
//!   therefore one of the four;
//! - of every plane one of the four is at least as high over it as v. A map's samples of a plane seen from height h and
//!   distance d lie d²/h apart along the ray and d apart across it, so that seen from v those of that map are at most
//!   (1 + √3/k)² and 1 + √3/k times as far apart as in the map, √3·s being the farthest that two points of a cell are apart.
//!
//! The triangulation is mirrored from cell to cell, so that all tetrahedra of a cell share the vertex whose three numbers
//! are even, its *base*. That map is made first and whole; the other seven leave out what it shows as well: at the same
//! depth, and with samples at most 1.12 times as far apart. So most of what is far is drawn once instead of four times.
//!
//! One map at the nearest vertex would have neither: there, what an edge at distance D uncovers is up to ½√3·s·p/D =
//! ½√3·p/k pixels wide, p pixels to a radian, and less than a pixel only for k > ½√3·p, 360 at 640 × 480. What four cannot
//! make good is a slit between two edges that none of them sees through: narrower than √3·p/k pixels at distance D, and
//! than √3·p·s/d pixels at a distance d beyond it. k is the trade between that and how often maps are made.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use std::collections::BTreeSet;

/// A vertex of the grid, in sides from the world's origin.
pub type Vertex = [i64; 3];

/// How environment maps are made and used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnvironmentSettings {
    /// s, the side of a cell, metres.
    pub side: f64,
    /// k: what is farther than so many sides from the cell is far. At least 2.
    pub multiple: f64,
    /// Points that are drawn into maps in a frame. One content, and one step of a face, is done in a frame at least.
    pub points_per_frame: u64,
}

/// Settings out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {value}; expected {expected}")]
pub struct EnvironmentError {
    /// Which.
    pub field: &'static str,
    /// As given.
    pub value: f64,
    /// What it may be.
    pub expected: &'static str,
}

/// Sides that a cell may have, metres.
pub const SIDE: std::ops::RangeInclusive<f64> = 1e-3..=1e9;

/// Share of the world's largest side that is near, on each side of the viewpoint, where no side is given.
const NEAR_SHARE: f64 = 1.0 / 8.0;

/// Beyond so many sides from the origin there is no grid: f64 would not tell neighbours apart.
const VERTEX_MAX: f64 = 1e15;

/// How far outside its cell a viewpoint may be before it gets another, and how far outside the cell whose maps are there it
/// may still be shown by them, in sides.
const LEAVE: f64 = 0.1;
const GRACE: f64 = 0.5;

impl EnvironmentSettings {
    /// Cells of a side, far beyond 8 sides, 2¹⁹ points a frame.
    pub fn with_side(side: f64) -> EnvironmentSettings {
        EnvironmentSettings { side, multiple: 8.0, points_per_frame: 1 << 19 }
    }

    /// For a world: an eighth of the largest side of its box around the viewpoint is near.
    pub fn for_world(bounds: &Aabb) -> EnvironmentSettings {
        let largest = if bounds.is_empty() { 0.0 } else { (bounds.max - bounds.min).max_element() };
        let of_one = EnvironmentSettings::with_side(1.0);
        let side = NEAR_SHARE * largest / of_one.multiple;
        EnvironmentSettings::with_side(if side.is_finite() { side.clamp(*SIDE.start(), *SIDE.end()) } else { 1.0 })
    }

    /// D, metres.
    pub fn distance(&self) -> f64 {
        self.multiple * self.side
    }

    /// Refuses what makes no sense.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn check(&self) -> Result<(), EnvironmentError> {
        let fields = [
            ("side", self.side, SIDE.contains(&self.side), "0.001 to 1e9 metres"),
            ("multiple", self.multiple, (2.0..=1e6).contains(&self.multiple), "2 to 1e6 sides"),
            ("points_per_frame", self.points_per_frame as f64, self.points_per_frame > 0, "more than 0"),
        ];
        let wrong = fields.into_iter().find(|&(_, _, holds, _)| !holds);
        wrong.map_or(Ok(()), |(field, value, _, expected)| Err(EnvironmentError { field, value, expected }))
    }
}

/// A cell of the grid, by its least vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Cell(pub Vertex);

/// Where a vertex is, metres.
pub fn place(vertex: Vertex, side: f64) -> DVec3 {
    DVec3::from_array(vertex.map(|steps| steps as f64)) * side
}

impl Cell {
    /// The cell that holds a point; `None` where there is no grid.
    pub fn around(point: DVec3, side: f64) -> Option<Cell> {
        let steps = (point / side).floor();
        let is_there = steps.is_finite() && steps.abs().max_element() <= VERTEX_MAX;
        is_there.then(|| Cell(steps.to_array().map(|steps| steps as i64)))
    }

    /// The cell of a viewpoint whose cell was `before`: that one as long as the point is within a tenth of a side of it, so that
    /// standing on a border changes nothing.
    pub fn follow(before: Option<Cell>, point: DVec3, side: f64) -> Option<Cell> {
        before.filter(|cell| cell.holds(point, side, LEAVE)).or_else(|| Cell::around(point, side))
    }

    /// Whether a viewpoint may still be shown by the maps of this cell, while those of its own are made.
    pub fn still_serves(self, point: DVec3, side: f64) -> bool {
        self.holds(point, side, GRACE)
    }

    fn holds(self, point: DVec3, side: f64, margin: f64) -> bool {
        let at = point / side - place(self.0, 1.0);
        at.cmpge(DVec3::splat(-margin)).all() && at.cmple(DVec3::splat(1.0 + margin)).all()
    }

    /// Its eight vertices.
    pub fn vertices(self) -> [Vertex; 8] {
        core::array::from_fn(|corner| core::array::from_fn(|axis| self.0[axis] + (corner >> axis & 1) as i64))
    }

    /// The vertex of even numbers.
    pub fn base(self) -> Vertex {
        self.0.map(|step| step + (step & 1))
    }

    /// The vertices of the tetrahedron that holds a point of the cell, the base first; of a point outside, of the one
    /// nearest in the order of its coordinates. Kuhn's six are numbered by the order of the coordinates as seen from the base.
    pub fn tetrahedron(self, point: DVec3, side: f64) -> [Vertex; 4] {
        let base = self.base();
        let from_base = (point / side - place(base, 1.0)).to_array();
        // Into the cell.
        let steps: [i64; 3] = core::array::from_fn(|axis| if base[axis] == self.0[axis] { 1 } else { -1 });
        let mut axes = [0, 1, 2];
        let depth = |axis: usize| from_base[axis] * steps[axis] as f64;
        axes.sort_by(|&a: &usize, &b: &usize| depth(b).total_cmp(&depth(a)));
        let mut vertices = [base; 4];
        for step in 1..4 {
            vertices[step] = vertices[step - 1];
            vertices[step][axes[step - 1]] += steps[axes[step - 1]];
        }
        vertices
    }

    /// Whether a box lies outside the cell grown by `distance` on all sides: then all eight maps show all of it.
    pub fn is_far(self, bounds: &Aabb, side: f64, distance: f64) -> bool {
        let low = place(self.0, side) - distance;
        let high = place(self.0, side) + side + distance;
        !bounds.is_empty() && (bounds.min.cmpgt(high).any() || bounds.max.cmplt(low).any())
    }
}

/// Vertices whose maps are missing: the base, then the nearest to the viewpoint first.
pub fn missing(cell: Cell, held: &BTreeSet<Vertex>, point: DVec3, side: f64) -> Vec<Vertex> {
    let mut missing: Vec<Vertex> = cell.vertices().into_iter().filter(|vertex| !held.contains(vertex)).collect();
    let distance = |vertex: &Vertex| place(*vertex, side).distance_squared(point);
    let later = |vertex: &Vertex| *vertex != cell.base();
    missing.sort_by(|a, b| later(a).cmp(&later(b)).then(distance(a).total_cmp(&distance(b))).then(a.cmp(b)));
    missing
}

/// Pixels along a face's side, for `pixels_per_radian` of the picture: the least power of two, or one and a half times one,
/// with as many to a radian in the middle of the face, where they are fewest. 64 to 2048.
pub fn face_side(pixels_per_radian: f64) -> u32 {
    let wanted = 2.0 * pixels_per_radian;
    let sides = (6..=11).flat_map(|power| [1u32 << power, 3 << (power - 1)]);
    sides.into_iter().take_while(|&side| side <= 2048).find(|&side| f64::from(side) >= wanted).unwrap_or(2048)
}

#[cfg(test)]
#[path = "environment_tests.rs"]
mod tests;
