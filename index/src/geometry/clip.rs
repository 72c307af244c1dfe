//! What of a triangle lies in a cell. Cut points are computed from the whole triangle and the planes that meet there, by
//! the same arithmetic in every cell that shares them: neighbours agree to the bit.

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};

use crate::octree::{Cell, Octree};

/// What belongs to a cell: a box whose upper faces belong to the neighbours, except where the grid ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Region {
    /// The box, metres.
    pub(super) bounds: Aabb,
    /// Whether the upper face along each axis belongs to a neighbour.
    shared: [bool; 3],
}

/// A corner of what is left of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Corner {
    /// Metres in the world.
    pub(super) at: DVec3,
    /// Texture coordinates.
    pub(super) uv: DVec2,
    /// Tint, linear light.
    pub(super) tint: DVec3,
    /// The triangle's edges that it lies on, a bit each: edge i goes from corner i to corner i + 1.
    edges: u8,
    /// The planes that it was cut by, a bit each: lower and upper face along x, y, z.
    planes: u8,
}

impl Region {
    /// What belongs to `cell`. Where the grid ends, the box is a millionth of its side larger: corners that rounding has
    /// moved are not lost.
    pub(super) fn of(octree: &Octree, cell: Cell) -> Region {
        let Aabb { mut min, mut max } = octree.bounds(cell);
        let count = octree.cells_at(cell.level);
        let slack = 1e-6 * (max - min).max_element();
        let mut shared = [true; 3];
        for axis in 0..3 {
            if cell.place[axis] == 0 {
                min[axis] -= slack;
            }
            if cell.place[axis] + 1 >= count[axis] {
                max[axis] += slack;
                shared[axis] = false;
            }
        }
        Region { bounds: Aabb { min, max }, shared }
    }

    /// The part of a triangle in the region: a convex polygon in `polygon`, empty if there is none. What lies in a shared
    /// upper face as a whole belongs to the neighbour.
    pub(super) fn clip(&self, whole: &Whole, polygon: &mut Vec<Corner>) {
        polygon.clear();
        let Whole { corners, uv, tint } = whole;
        let Aabb { min, max } = self.bounds;
        let (low, high) = (corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2]));
        if low.cmpgt(max).any() || high.cmplt(min).any() || !(low.is_finite() && high.is_finite()) {
            return;
        }
        for axis in 0..3 {
            if self.shared[axis] && low[axis] >= max[axis] {
                return;
            }
        }
        let edges = [0b101, 0b011, 0b110];
        polygon.extend((0..3).map(|i| Corner { at: corners[i], uv: uv[i], tint: tint[i], edges: edges[i], planes: 0 }));
        let mut from = Vec::new();
        for plane in 0..6 {
            let (axis, upper) = (plane / 2, plane % 2 == 1);
            let face = if upper { max[axis] } else { min[axis] };
            let inside = |at: DVec3| if upper { at[axis] <= face } else { at[axis] >= face };
            if (upper && high[axis] <= face) || (!upper && low[axis] >= face) {
                continue;
            }
            std::mem::swap(&mut from, polygon);
            polygon.clear();
            for (i, here) in from.iter().enumerate() {
                let next = &from[(i + 1) % from.len()];
                if inside(here.at) {
                    let on_face = u8::from(here.at[axis] == face) << plane;
                    polygon.push(Corner { planes: here.planes | on_face, ..*here });
                }
                // A cut through a corner is that corner.
                if inside(here.at) != inside(next.at) && here.at[axis] != face && next.at[axis] != face {
                    polygon.push(whole.cut(here, next, plane, face, &self.bounds));
                }
            }
        }
        let on_upper = |axis: usize| polygon.iter().all(|c| c.at[axis] >= max[axis]);
        let elsewhere = (0..3).any(|axis| self.shared[axis] && on_upper(axis));
        if polygon.len() < 3 || elsewhere || !polygon.iter().all(|c| c.at.is_finite()) {
            polygon.clear();
        }
    }
}

/// A triangle as it was given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Whole {
    pub(super) corners: [DVec3; 3],
    pub(super) uv: [DVec2; 3],
    /// Linear light.
    pub(super) tint: [DVec3; 3],
}

/// A point of a triangle, with the weights of its corners.
type Share = (DVec3, [f64; 3]);

impl Whole {
    /// Where the side from `one` to `other` meets a plane.
    fn cut(&self, one: &Corner, other: &Corner, plane: usize, face: f64, bounds: &Aabb) -> Corner {
        let axis = plane / 2;
        let edges = one.edges & other.edges;
        let planes = one.planes & other.planes;
        let known = if edges != 0 {
            self.on_edge(edges.trailing_zeros() as usize, axis, face)
        } else {
            let first = planes.trailing_zeros() as usize;
            (planes != 0).then(|| self.on_line(first, bounds, axis, face)).flatten()
        };
        let Some((mut at, share)) = known else {
            let t = ((face - one.at[axis]) / (other.at[axis] - one.at[axis])).clamp(0.0, 1.0);
            let mut at = one.at.lerp(other.at, t);
            at[axis] = face;
            let (uv, tint) = (one.uv.lerp(other.uv, t), one.tint.lerp(other.tint, t));
            return Corner { at, uv, tint, edges, planes: planes | 1 << plane };
        };
        at[axis] = face;
        let uv = self.uv[0] * share[0] + self.uv[1] * share[1] + self.uv[2] * share[2];
        let tint = self.tint[0] * share[0] + self.tint[1] * share[1] + self.tint[2] * share[2];
        Corner { at, uv, tint, edges, planes: planes | 1 << plane }
    }

    /// A point of an edge, from its lesser end on.
    fn on_edge(&self, edge: usize, axis: usize, face: f64) -> Option<Share> {
        let (mut a, mut b) = (edge, (edge + 1) % 3);
        if self.corners[b].to_array() < self.corners[a].to_array() {
            std::mem::swap(&mut a, &mut b);
        }
        let t = (face - self.corners[a][axis]) / (self.corners[b][axis] - self.corners[a][axis]);
        let at = self.corners[a] + (self.corners[b] - self.corners[a]) * t;
        let mut share = [0.0; 3];
        (share[a], share[b]) = (1.0 - t, t);
        (at.is_finite() && (0.0..=1.0).contains(&t)).then_some((at, share))
    }

    /// The triangle's point where two faces of the box along different axes meet.
    fn on_line(&self, first: usize, bounds: &Aabb, axis: usize, face: f64) -> Option<Share> {
        let one = first / 2;
        if one == axis {
            return None;
        }
        let third = 3 - one - axis;
        let mut faces = [0.0; 3];
        faces[one] = if first % 2 == 1 { bounds.max[one] } else { bounds.min[one] };
        faces[axis] = face;
        // In the plane of both axes, in rising order so that the order of cutting does not matter.
        let (i, j) = (one.min(axis), one.max(axis));
        let flat = |at: DVec3| DVec2::new(at[i], at[j]);
        let [a, b, c] = self.corners.map(flat);
        let point = DVec2::new(faces[i], faces[j]);
        let area = (b - a).perp_dot(c - a);
        let (v, w) = ((point - a).perp_dot(c - a) / area, (b - a).perp_dot(point - a) / area);
        let slack = -1e-9..=1.0 + 1e-9;
        if !(slack.contains(&v) && slack.contains(&w) && slack.contains(&(1.0 - v - w))) {
            return None;
        }
        let [p, q, r] = self.corners;
        faces[third] = p[third] + (q[third] - p[third]) * v + (r[third] - p[third]) * w;
        Some((DVec3::from_array(faces), [1.0 - v - w, v, w]))
    }
}
