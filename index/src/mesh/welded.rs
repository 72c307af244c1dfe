//! A mesh as a tile holds it, in 32-bit floats about an origin.

use std::collections::HashMap;

use glam::DVec3;

use super::Triangle;
use crate::format::glb;

/// A triangle of what a mesh stands for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Original {
    pub(crate) corners: Triangle,
    /// Diameter of the whole that it is a part of, metres: the error of leaving that out.
    pub(crate) whole: f64,
}

/// A mesh as it is uploaded: positions narrowed to f32 about an origin, each once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mesh {
    pub(super) origin: DVec3,
    pub(crate) positions: Vec<[f32; 3]>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// How far narrowing moved a corner at most, metres.
    pub(crate) narrowing: f64,
}

impl Mesh {
    /// Welds triangles: corners with the same narrowed position become one vertex, numbered by first appearance; triangles
    /// that lose a corner by it are dropped.
    pub(crate) fn weld(origin: DVec3, triangles: impl IntoIterator<Item = Triangle>) -> Mesh {
        let mut mesh = Mesh { origin, ..Mesh::default() };
        // Looked up only, never walked through.
        let mut known: HashMap<[u32; 3], u32> = HashMap::new();
        for corners in triangles {
            let vertices = corners.map(|corner| {
                let narrow = narrow(corner - origin);
                let off = (mesh.widen(narrow) - corner).length();
                mesh.narrowing = mesh.narrowing.max(off);
                *known.entry(narrow.map(f32::to_bits)).or_insert_with(|| {
                    mesh.positions.push(narrow);
                    (mesh.positions.len() - 1) as u32
                })
            });
            let [a, b, c] = vertices;
            if a != b && b != c && a != c {
                mesh.triangles.push(vertices);
            }
        }
        mesh
    }

    fn widen(&self, [x, y, z]: [f32; 3]) -> DVec3 {
        self.origin + DVec3::new(f64::from(x), f64::from(y), f64::from(z))
    }

    /// The triangles in world space.
    pub(crate) fn corners(&self) -> Vec<Triangle> {
        let at = |vertex: u32| self.widen(self.positions[vertex as usize]);
        self.triangles.iter().map(|triangle| triangle.map(at)).collect()
    }

    /// Bytes of the mesh as GLB, and in memory; `None` if it is empty or too large for either to be counted in 32 bits.
    pub(crate) fn sizes(&self) -> Option<(u32, u32)> {
        if self.triangles.is_empty() {
            return None;
        }
        let (positions, triangles) = (&self.positions[..], &self.triangles[..]);
        let wire = glb::encode(&glb::Mesh { origin: Some(self.origin), positions, normals: &[], triangles }).len();
        let decoded = glb::decoded_bytes(self.positions.len(), self.triangles.len());
        Some((u32::try_from(wire).ok()?, u32::try_from(decoded).ok()?))
    }
}

/// The one narrowing of positions: small offsets from a mesh's origin. Never −0, so that equal positions have equal bits.
#[expect(clippy::cast_possible_truncation, reason = "the narrowing itself; what it loses is counted in `narrowing`")]
fn narrow(offset: DVec3) -> [f32; 3] {
    offset.to_array().map(|value| value as f32 + 0.0)
}
