//! Fewer triangles for the same surface, by meshoptimizer.

use meshopt::{SimplifyOptions, simplify_decoder, simplify_sloppy_decoder};

use super::distance::{self, Bracket};
use super::{Mesh, Original};

/// Limits on the library's own error that are tried in turn, relative to the mesh's extent: 2⁻¹² to 2.
const LIMITS: i32 = 14;

/// The mesh with at most `most` triangles, and its error against the originals. Edges are collapsed and the smallest
/// components dropped within the least limit that suffices, with borders kept, as suits pieces of terrain, and with
/// borders free, as suits single faces; where neither does, vertices are clustered. Of what comes out the one with the least
/// measured error is taken; `None` if nothing does.
pub(crate) fn simplified(mesh: &Mesh, most: usize, originals: &[Original]) -> Option<(Mesh, Bracket)> {
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let wanted = 3 * most.min(mesh.triangles.len());
    let is_accepted = |found: &Vec<u32>| !found.is_empty() && found.len() < indices.len() && found.len() <= wanted;
    let collapsed = |options| {
        let limits = (0..LIMITS).map(|step| f32::from_bits(((127 - 12 + step) as u32) << 23));
        limits.map(|limit| simplify_decoder(&indices, &mesh.positions, wanted, limit, options, None)).find(is_accepted)
    };
    let measured = |found: Vec<u32>| {
        let mesh = compacted(mesh, &found);
        let error = distance::error(&mesh.corners(), originals)?;
        Some((mesh, error))
    };
    let ways = [SimplifyOptions::Prune | SimplifyOptions::LockBorder, SimplifyOptions::Prune];
    let found = ways.into_iter().filter_map(collapsed).filter_map(measured);
    found.reduce(|one, other| if other.1.upper < one.1.upper { other } else { one }).or_else(|| {
        let clustered = simplify_sloppy_decoder(&indices, &mesh.positions, wanted, 1.0, None);
        Some(clustered).filter(is_accepted).and_then(measured)
    })
}

/// The triangles that `indices` names, with the vertices that they need in order of first use.
fn compacted(mesh: &Mesh, indices: &[u32]) -> Mesh {
    const UNUSED: u32 = u32::MAX;
    let mut number = vec![UNUSED; mesh.positions.len()];
    let mut out = Mesh { origin: mesh.origin, narrowing: mesh.narrowing, ..Mesh::default() };
    for triangle in indices.chunks_exact(3) {
        out.triangles.push([triangle[0], triangle[1], triangle[2]].map(|vertex| {
            let number = &mut number[vertex as usize];
            if *number == UNUSED {
                *number = out.positions.len() as u32;
                out.positions.push(mesh.positions[vertex as usize]);
            }
            *number
        }));
    }
    out
}
