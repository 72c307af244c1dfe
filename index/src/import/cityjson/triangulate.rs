//! Faces with holes to triangles.

use earcut::Earcut;
use glam::{DVec2, DVec3};

/// What became of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Face {
    /// Triangles that cover its area.
    Covered,
    /// Triangles whose area is off by more than 1 %: the face crosses itself or is far from flat.
    Uneven,
    /// No area: nothing was added.
    Degenerate,
}

/// A face counts as without area below this multiple of its squared extent.
const FLAT: f64 = 1e-9;

/// Triangulates faces in their own planes by ear clipping; keeps its buffers.
pub(super) struct Triangulator {
    earcut: Earcut<f64>,
    corners: Vec<u32>,
    holes: Vec<u32>,
    plane: Vec<[f64; 2]>,
    found: Vec<u32>,
}

/// The area vector of a closed polygon (Newell): its length is the area, its direction the side from which the polygon
/// turns left. Taken about the first corner, so that it is precise far from the origin.
fn area_vector(ring: &[u32], vertices: &[DVec3]) -> DVec3 {
    let Some(&first) = ring.first() else { return DVec3::ZERO };
    let from = vertices[first as usize];
    let sides =
        ring.windows(2).map(|side| (vertices[side[0] as usize] - from).cross(vertices[side[1] as usize] - from));
    0.5 * sides.fold(DVec3::ZERO, |sum, side| sum + side)
}

impl Triangulator {
    pub(super) fn new() -> Triangulator {
        let (corners, holes, plane, found) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Triangulator { earcut: Earcut::new(), corners, holes, plane, found }
    }

    /// Adds the triangles of a face: its outer ring, then its holes, as indices of `vertices`. They turn the way the
    /// outer ring does. Corners repeated in succession count once; rings of less than three corners are left out.
    pub(super) fn add<'a>(
        &mut self,
        rings: impl Iterator<Item = &'a [u32]>,
        vertices: &[DVec3],
        triangles: &mut Vec<[u32; 3]>,
    ) -> Face {
        self.corners.clear();
        self.holes.clear();
        let (mut normal, mut area) = (DVec3::ZERO, 0.0);
        for (at, ring) in rings.enumerate() {
            let start = self.corners.len();
            for &corner in ring {
                if self.corners.len() == start || self.corners.last() != Some(&corner) {
                    self.corners.push(corner);
                }
            }
            while self.corners.len() > start + 1 && self.corners.last() == Some(&self.corners[start]) {
                self.corners.pop();
            }
            if self.corners.len() < start + 3 {
                self.corners.truncate(start);
                if at == 0 {
                    return Face::Degenerate;
                }
                continue;
            }
            let vector = area_vector(&self.corners[start..], vertices);
            if at == 0 {
                (normal, area) = (vector, vector.length());
            } else {
                self.holes.push(start as u32);
                area -= vector.length();
            }
        }
        let Some(&first) = self.corners.first() else { return Face::Degenerate };
        let from = vertices[first as usize];
        let reach = self.corners.iter().map(|&c| (vertices[c as usize] - from).abs().max_element()).fold(0.0, f64::max);
        let Some(normal) = normal.try_normalize().filter(|_| normal.length() > FLAT * reach * reach) else {
            return Face::Degenerate;
        };
        if let [a, b, c] = self.corners[..] {
            triangles.push([a, b, c]);
            return Face::Covered;
        }
        let right = normal.any_orthonormal_vector();
        let forward = normal.cross(right);
        self.plane.clear();
        self.plane.extend(self.corners.iter().map(|&corner| {
            let offset = vertices[corner as usize] - from;
            [offset.dot(right), offset.dot(forward)]
        }));
        self.earcut.earcut_slice(&self.plane, &self.holes, &mut self.found);
        let mut covered = 0.0;
        for triangle in self.found.chunks_exact(3) {
            let [a, b, c] = [triangle[0], triangle[1], triangle[2]];
            let at = |corner: u32| DVec2::from_array(self.plane[corner as usize]);
            let turn = (at(b) - at(a)).perp_dot(at(c) - at(a));
            let [a, b, c] = [a, b, c].map(|corner| self.corners[corner as usize]);
            if turn != 0.0 {
                covered += 0.5 * turn.abs();
                triangles.push(if turn > 0.0 { [a, b, c] } else { [a, c, b] });
            }
        }
        match covered {
            0.0 => Face::Degenerate,
            _ if (covered - area).abs() <= 0.01 * area.abs() => Face::Covered,
            _ => Face::Uneven,
        }
    }
}
