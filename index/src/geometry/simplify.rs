//! Fewer triangles for the same surface, by meshoptimizer: edges are collapsed onto one of their ends, so that every vertex of
//! a coarser level is one of a finer. Vertices in the faces of the cell stay, and with them the line along which
//! neighbours meet, whatever levels they show.

use meshopt::{SimplifyOptions, SimplifyVertex, simplify_scale_decoder, simplify_sloppy_with_locks_decoder};
use meshopt::{VertexDataAdapter, simplify_with_attributes_and_locks, typed_to_bytes};

use super::lattice::{Lattice, LatticeMesh};
use super::parts::parts;
use super::soup::Group;

/// How much a texture's shift along the surface counts against a shift of the surface.
const TEXTURE_WEIGHT: f32 = 0.5;
/// Change of tint, of 1, that counts as much as the error that is allowed.
const TINT_ALLOWED: f32 = 0.25;
/// Σ of the squares of the vertices' valences above which vertices are clustered instead: collapsing takes time
/// proportional to it.
const VALENCES_MAX: u64 = 1 << 28;

/// A mesh, and the error that the library claims for it against what it was made of, metres.
pub(super) struct Simplified {
    pub(super) mesh: LatticeMesh,
    pub(super) claimed: f64,
}

/// The mesh with fewer triangles, within `error` metres by the library's account. Parts that are smaller than `error` and
/// reach no face of the cell are dropped.
pub(super) fn simplified(mesh: &LatticeMesh, groups: &[Group<'_>], lattice: &Lattice, error: f64) -> Simplified {
    let step = f64::from(lattice.step);
    let corners: Vec<_> = mesh.triangles.iter().map(|&t| mesh.places(t)).collect();
    let mut dropped = 0.0_f64;
    let parts = parts(&corners, lattice);
    let kept = mesh.triangles.iter().zip(&parts).filter(|(_, part)| {
        let keeps = part.is_on_face || part.diameter > error;
        if !keeps {
            dropped = dropped.max(part.diameter);
        }
        keeps
    });
    let kept = mesh.with(kept.map(|(&triangle, _)| triangle));
    if kept.triangles.is_empty() {
        return Simplified { mesh: kept, claimed: dropped };
    }
    // In steps, which 32 bits hold exactly.
    let positions: Vec<[f32; 3]> = kept.vertices.iter().map(|v| v.at.map(f32::from)).collect();
    let indices: Vec<u32> = kept.triangles.iter().flatten().copied().collect();
    let lock = |is_locked: bool| if is_locked { SimplifyVertex::Lock } else { SimplifyVertex::None };
    let locks: Vec<SimplifyVertex> = kept.vertices.iter().map(|v| lock(lattice.is_on_face(v.at))).collect();
    #[expect(clippy::cast_possible_truncation, reason = "steps")]
    let limit = (error / step) as f32;
    let mut claimed = 0.0_f32;
    let extent = simplify_scale_decoder(&positions).max(1.0);
    let mut valences = vec![0_u64; kept.vertices.len()];
    indices.iter().for_each(|&vertex| valences[vertex as usize] += 1);
    let found = if valences.iter().map(|v| v * v).sum::<u64>() > VALENCES_MAX {
        let found =
            simplify_sloppy_with_locks_decoder(&indices, &positions, &locks, 0, limit / extent, Some(&mut claimed));
        claimed *= extent;
        found
    } else {
        // Where a vertex lies in its texture, in steps of the surface that it is drawn onto.
        let shift = |vertex: &super::lattice::Vertex| -> [f32; 2] {
            let group = &groups[vertex.group as usize];
            let Some((texture, frame)) = group.texture.filter(|_| group.texel.is_finite()) else { return [0.0; 2] };
            let (width, height) = texture.size();
            let steps = [frame.scale.x * width as f64, frame.scale.y * height as f64].map(|t| t * group.texel / step);
            #[expect(clippy::cast_possible_truncation, reason = "steps")]
            std::array::from_fn(|i| (f64::from(vertex.uv[i]) / 65535.0 * steps[i]) as f32)
        };
        let attributes: Vec<[f32; 5]> = kept
            .vertices
            .iter()
            .map(|vertex| {
                let ([u, v], [r, g, b]) = (shift(vertex), vertex.tint.map(|byte| f32::from(byte) / 255.0));
                [u, v, r, g, b]
            })
            .collect();
        let (texture, tint) = (TEXTURE_WEIGHT / extent, limit / (TINT_ALLOWED * extent));
        let weights = [texture, texture, tint, tint, tint];
        let Ok(vertices) = VertexDataAdapter::new(typed_to_bytes(&positions), 12, 0) else {
            return Simplified { mesh: kept, claimed: dropped };
        };
        simplify_with_attributes_and_locks(
            &indices,
            &vertices,
            attributes.as_flattened(),
            &weights,
            20,
            &locks,
            0,
            limit,
            SimplifyOptions::ErrorAbsolute,
            Some(&mut claimed),
        )
    };
    let is_whole = |t: &[u32; 3]| {
        let group = |vertex: u32| kept.vertices[vertex as usize].group;
        group(t[0]) == group(t[1]) && group(t[1]) == group(t[2])
    };
    let triangles = found.chunks_exact(3).map(|t| [t[0], t[1], t[2]]);
    let out = kept.with(triangles.filter(is_whole));
    Simplified { mesh: out, claimed: (f64::from(claimed) * step).max(dropped) }
}
