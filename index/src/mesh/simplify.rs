//! Fewer triangles for the same surface, by meshoptimizer.

use meshopt::{SimplifyOptions, simplify_decoder, simplify_sloppy_decoder};

use super::Mesh;

/// No limit on the library's own error, relative to the mesh: the error is measured afterwards.
const ANY_ERROR: f32 = 10.0;

/// The mesh with about `target` and at most `most` triangles. By collapsing edges and dropping the smallest components,
/// whichever costs less; if that is enough with every border kept, as of a piece of terrain, with every border kept. Where
/// topology does not allow so few, by clustering vertices. `None` if that fails too.
pub(crate) fn simplified(mesh: &Mesh, target: usize, most: usize) -> Option<Mesh> {
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let wanted = 3 * target.min(mesh.triangles.len());
    let is_accepted = |found: &[u32]| !found.is_empty() && found.len() < indices.len() && found.len() <= 3 * most;
    let collapsed = |options| simplify_decoder(&indices, &mesh.positions, wanted, ANY_ERROR, options, None);
    let mut found = collapsed(SimplifyOptions::Prune | SimplifyOptions::LockBorder);
    if !is_accepted(&found) {
        found = collapsed(SimplifyOptions::Prune);
    }
    if !is_accepted(&found) {
        found = simplify_sloppy_decoder(&indices, &mesh.positions, wanted, ANY_ERROR, None);
    }
    is_accepted(&found).then(|| compacted(mesh, &found))
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
