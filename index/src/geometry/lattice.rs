//! A cell's mesh on a lattice: positions are whole steps from the cell's least corner, so that what two cells share lies at
//! the same place in both, and every level's vertices are some of the finest level's.

use std::collections::{HashMap, HashSet};

use glam::DVec3;

use super::soup::Soup;
use crate::mesh::Triangle;
use crate::octree::{Cell, Octree};

/// Steps along the longest side of a cell.
pub const STEPS: u16 = 1 << 15;

/// The lattice of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Lattice {
    /// The cell's least corner, metres in the world.
    pub(super) origin: DVec3,
    /// Side of a step, metres; 32 bits, as a file holds it.
    pub(super) step: f32,
    /// Steps to the upper faces.
    last: [u16; 3],
}

impl Lattice {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the file's own numbers, within the cell"
    )]
    pub(super) fn of(octree: &Octree, cell: Cell) -> Lattice {
        let bounds = octree.bounds(cell);
        let size = bounds.max - bounds.min;
        let step = (size.max_element() / f64::from(STEPS)) as f32;
        let step = step.max(f32::MIN_POSITIVE);
        let last = size.to_array().map(|side| (side / f64::from(step)).round().clamp(0.0, f64::from(STEPS)) as u16);
        Lattice { origin: bounds.min, step, last }
    }

    /// The lattice's point nearest to one, metres from the least corner.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the cell")]
    pub(super) fn nearest(&self, at: DVec3) -> [u16; 3] {
        let steps = (at / f64::from(self.step)).round();
        std::array::from_fn(|axis| steps[axis].clamp(0.0, f64::from(self.last[axis])) as u16)
    }

    /// A point of the lattice, metres from the least corner.
    pub(super) fn position(&self, steps: [u16; 3]) -> DVec3 {
        DVec3::from_array(steps.map(f64::from)) * f64::from(self.step)
    }

    /// Whether a point lies in a face of the cell.
    pub(super) fn is_on_face(&self, steps: [u16; 3]) -> bool {
        (0..3).any(|axis| steps[axis] == 0 || steps[axis] >= self.last[axis])
    }
}

/// A vertex: where it is, what it shows there and in which group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Vertex {
    pub(super) at: [u16; 3],
    pub(super) uv: [u16; 2],
    /// sRGB.
    pub(super) tint: [u8; 3],
    pub(super) group: u32,
}

/// Triangles on the lattice. A triangle's vertices are of one group.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct LatticeMesh {
    pub(super) vertices: Vec<Vertex>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl LatticeMesh {
    /// The mesh of a soup: alike vertices are one, triangles with two corners in one place are left out, and so are repeated
    /// ones.
    pub(super) fn welded(soup: &Soup<'_>, lattice: &Lattice) -> LatticeMesh {
        let mut mesh = LatticeMesh::default();
        // Looked up only, never walked through.
        let mut known: HashMap<Vertex, u32> = HashMap::new();
        let mut seen: HashSet<[u32; 3]> = HashSet::new();
        for piece in &soup.pieces {
            let group = &soup.groups[piece.group as usize];
            let at = piece.corners.map(|corner| lattice.nearest(corner));
            if at[0] == at[1] || at[1] == at[2] || at[2] == at[0] {
                continue;
            }
            let triangle = std::array::from_fn(|i| {
                let uv = group.texture.map_or([0; 2], |(_, frame)| frame.narrowed(piece.uv[i]));
                let vertex = Vertex { at: at[i], uv, tint: piece.tint[i], group: piece.group };
                *known.entry(vertex).or_insert_with(|| {
                    mesh.vertices.push(vertex);
                    mesh.vertices.len() as u32 - 1
                })
            });
            if seen.insert(identity(triangle, group.two_sided)) {
                mesh.triangles.push(triangle);
            }
        }
        mesh
    }

    /// The corners of a triangle, metres from the least corner.
    pub(super) fn corners(&self, triangle: [u32; 3], lattice: &Lattice) -> Triangle {
        triangle.map(|vertex| lattice.position(self.vertices[vertex as usize].at))
    }

    /// The mesh with these triangles only, and the vertices that they need in order of first use.
    pub(super) fn with(&self, triangles: impl IntoIterator<Item = [u32; 3]>) -> LatticeMesh {
        const UNUSED: u32 = u32::MAX;
        let mut number = vec![UNUSED; self.vertices.len()];
        let mut out = LatticeMesh::default();
        for triangle in triangles {
            out.triangles.push(triangle.map(|vertex| {
                let number = &mut number[vertex as usize];
                if *number == UNUSED {
                    *number = out.vertices.len() as u32;
                    out.vertices.push(self.vertices[vertex as usize]);
                }
                *number
            }));
        }
        out
    }

    /// The mesh without triangles that have no area.
    pub(super) fn with_area(&self) -> LatticeMesh {
        self.with(self.triangles.iter().copied().filter(|&t| has_area(self.places(t))))
    }

    /// Places of a triangle's corners.
    pub(super) fn places(&self, triangle: [u32; 3]) -> [[u16; 3]; 3] {
        triangle.map(|vertex| self.vertices[vertex as usize].at)
    }
}

/// Whether a triangle is more than a line: exact, in whole steps.
pub(super) fn has_area(corners: [[u16; 3]; 3]) -> bool {
    let [a, b, c] = corners.map(|at| at.map(i64::from));
    let (u, v): ([i64; 3], [i64; 3]) = (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
    (0..3).any(|i| u[(i + 1) % 3] * v[(i + 2) % 3] != u[(i + 2) % 3] * v[(i + 1) % 3])
}

/// The same for all triangles that look the same: from the least vertex on, and either way round where both sides show.
fn identity(triangle: [u32; 3], two_sided: bool) -> [u32; 3] {
    let mut rotated = triangle;
    let least = (0..3).min_by_key(|&i| triangle[i]).unwrap_or(0);
    rotated.rotate_left(least);
    if two_sided && rotated[1] > rotated[2] {
        rotated.swap(1, 2);
    }
    rotated
}
