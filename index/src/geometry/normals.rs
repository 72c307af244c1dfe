//! Normals for viewers that light what they show: smooth where surfaces bend, apart at creases.

use std::collections::HashMap;

use glam::DVec3;

use super::lattice::{Lattice, LatticeMesh};

/// Cosine of the angle between two triangles from which on their edge is a crease: 45°.
const CREASE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Where more triangles meet, each has its own normal: looking at all pairs would take too long.
const MEETING_MAX: usize = 64;

/// The mesh with a normal a vertex: the mean, weighted by area, of the triangles that meet there and are no crease away.
/// Vertices whose triangles disagree are there more than once. Triangles must have an area.
pub(super) fn shaded(mesh: &LatticeMesh, lattice: &Lattice) -> (LatticeMesh, Vec<[f32; 3]>) {
    let areas: Vec<DVec3> = mesh
        .triangles
        .iter()
        .map(|&t| {
            let [a, b, c] = mesh.corners(t, lattice);
            (b - a).cross(c - a)
        })
        .collect();
    // Looked up only, never walked through.
    let mut meeting: HashMap<([u16; 3], u32), Vec<u32>> = HashMap::new();
    for (number, triangle) in mesh.triangles.iter().enumerate() {
        for &vertex in triangle {
            let vertex = &mesh.vertices[vertex as usize];
            meeting.entry((vertex.at, vertex.group)).or_default().push(number as u32);
        }
    }
    let mut out = LatticeMesh::default();
    let mut normals = Vec::new();
    let mut known: HashMap<(u32, [i8; 3]), u32> = HashMap::new();
    for (triangle, area) in mesh.triangles.iter().zip(&areas) {
        let own = area.normalize_or(DVec3::Z);
        out.triangles.push(triangle.map(|number| {
            let vertex = mesh.vertices[number as usize];
            let there = meeting.get(&(vertex.at, vertex.group)).map_or(&[][..], |there| there);
            let smooth = |other: &&u32| areas[**other as usize].normalize_or(DVec3::Z).dot(own) >= CREASE;
            let sum = if there.len() > MEETING_MAX {
                own
            } else {
                there.iter().filter(smooth).map(|&other| areas[other as usize]).sum()
            };
            let normal = sum.normalize_or(own);
            #[expect(clippy::cast_possible_truncation, reason = "components of a unit vector")]
            let (bytes, narrow) =
                (normal.to_array().map(|v| (v * 127.0).round() as i8), normal.to_array().map(|v| v as f32));
            *known.entry((number, bytes)).or_insert_with(|| {
                out.vertices.push(vertex);
                normals.push(narrow);
                out.vertices.len() as u32 - 1
            })
        }));
    }
    (out, normals)
}
