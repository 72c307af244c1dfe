//! Fewer triangles for the same surface, by meshoptimizer.

use meshopt::{SimplifyOptions, simplify_decoder, simplify_sloppy_decoder};

use super::Mesh;

/// A result of at most this many times the triangles asked for is taken.
const SLACK: f64 = 1.5;
/// No limit on the library's own error, relative to the mesh: the error is measured afterwards.
const ANY_ERROR: f32 = 10.0;

/// The mesh with about `target` triangles. Of three ways the first that comes near that: collapsing edges, which keeps
/// every component; the same while dropping small components; vertex clustering, which keeps no topology. `None` if
/// nothing with fewer triangles came out.
pub(crate) fn simplified(mesh: &Mesh, target: usize) -> Option<Mesh> {
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    let wanted = 3 * target.min(mesh.triangles.len());
    let most = (SLACK * wanted as f64) as usize;
    let collapse = |options| simplify_decoder(&indices, &mesh.positions, wanted, ANY_ERROR, options, None);
    let mut found = collapse(SimplifyOptions::None);
    if found.len() > most {
        found = collapse(SimplifyOptions::Prune);
    }
    if found.len() > most || found.is_empty() {
        found = simplify_sloppy_decoder(&indices, &mesh.positions, wanted, ANY_ERROR, None);
    }
    (!found.is_empty() && found.len() < indices.len()).then(|| compacted(mesh, &found))
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
