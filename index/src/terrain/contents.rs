//! Contents of terrain by representation: a square of the ground's own surface, sampled as finely as the tile is.

use foresight_scheduler::lod_tree::RepId;
use glam::DVec3;

use super::TILE_CELLS;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::surface::Piece;
use crate::world::World;

/// Linear light of level ground, and of walls of rock.
const LEVEL: [f32; 3] = [0.16, 0.17, 0.08];
const STEEP: [f32; 3] = [0.2, 0.18, 0.16];

/// What a representation of a terrain shows: 64 × 64 cells over its bounds, darker where steep, with a skirt as deep as
/// the tile above may be off. `None` if the ground has no surface there.
pub fn tile_surface(world: &World, rep: RepId) -> Option<Piece> {
    let tree = &world.tree;
    let node = tree.node_of(rep);
    let bounds = tree.bounds(node);
    let side = TILE_CELLS as usize + 1;
    let place = |i: i64, j: i64| -> Option<DVec3> {
        let share = DVec3::new(i as f64, j as f64, 0.0) / f64::from(TILE_CELLS);
        let at = bounds.min + share * (bounds.max - bounds.min);
        Some(at.with_z(world.ground_height(at)?))
    };
    // A ring of samples around the tile gives the slopes at its edges.
    let ring = side as i64 + 1;
    let places: Vec<DVec3> =
        (-1..ring).flat_map(|j| (-1..ring).map(move |i| (i, j))).map(|(i, j)| place(i, j)).collect::<Option<_>>()?;
    let wide = side + 2;
    let at = |i: usize, j: usize| places[(j + 1) * wide + i + 1];
    let normal = |i: usize, j: usize| {
        let [west, east] = [i, i + 2].map(|i| places[(j + 1) * wide + i]);
        let [south, north] = [j, j + 2].map(|j| places[j * wide + i + 1]);
        (east - west).cross(north - south).normalize_or(DVec3::Z)
    };
    let mut out = Piece {
        materials: [LEVEL, STEEP].map(|base| Material { base, ..Material::default() }).to_vec(),
        ..Piece::default()
    };
    let mut add = |corners: [(usize, usize); 3], down: [f64; 3], two_sided: bool| {
        #[expect(clippy::cast_possible_truncation, reason = "unit vectors")]
        let normals = corners.map(|(i, j)| normal(i, j).to_array().map(|v| v as f32));
        let level = normals.iter().map(|normal| normal[2]).sum::<f32>() / 3.0;
        let places = [0, 1, 2].map(|c| at(corners[c].0, corners[c].1) - DVec3::new(0.0, 0.0, down[c]));
        let material = u32::from(level < 0.85);
        out.triangles.push(Triangle { corners: places, material, two_sided, ..Triangle::default() });
        out.normals.push(normals);
    };
    for j in 0..side - 1 {
        for i in 0..side - 1 {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
            add([a, b, d], [0.0; 3], false);
            add([a, d, c], [0.0; 3], false);
        }
    }
    let coarser = tree.parent(node).and_then(|above| tree.own(above).next());
    let skirt = tree.error(coarser.unwrap_or(rep));
    if skirt > 0.0 {
        let last = side - 1;
        let edge = |from: usize, to: usize| (from.min(to)..from.max(to)).map(|at| (at, at + 1));
        let sides = edge(0, last)
            .flat_map(|(a, b)| [[(a, 0), (b, 0)], [(last, a), (last, b)], [(b, last), (a, last)], [(0, b), (0, a)]]);
        for [a, b] in sides.collect::<Vec<_>>() {
            add([a, a, b], [0.0, skirt, 0.0], true);
            add([b, a, b], [0.0, skirt, skirt], true);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::terrain::{TerrainParams, TerrainSurfaces, terrain};
    use crate::surface::SurfaceSource;

    #[test]
    fn the_finest_tiles_are_the_surface_itself() {
        let params = TerrainParams { size: 2500.0, resolution: 10.0, relief: 500.0, ..TerrainParams::default() };
        let world = terrain(&params).expect("in range");
        let source = TerrainSurfaces::new(&params).expect("in range");
        let mut expected: Vec<[i64; 3]> = Vec::new();
        for piece in 0..source.pieces() {
            let triangles = source.triangles(piece).expect("made");
            expected.extend(
                triangles.iter().flat_map(|t| t.corners).map(|at| (at * 1e3).round().to_array().map(|v| v as i64)),
            );
        }
        expected.sort_unstable();
        expected.dedup();
        let mut leaves = 0;
        for rep in (0..world.tree.representations() as u32).map(RepId) {
            let piece = tile_surface(&world, rep).expect("a tile");
            assert_eq!(piece.triangles.len(), piece.normals.len());
            if !world.tree.is_leaf(world.tree.node_of(rep)) {
                continue;
            }
            leaves += 1;
            for at in piece.triangles[..8192].iter().flat_map(|t| t.corners) {
                let key = (at * 1e3).round().to_array().map(|v| v as i64);
                let near = expected.partition_point(|other| *other < [key[0] - 1, key[1] - 1, i64::MIN]);
                let found = expected[near..]
                    .iter()
                    .take(4)
                    .any(|other| other.iter().zip(&key).all(|(a, b)| (a - b).abs() <= 1));
                assert!(found, "{at}");
            }
        }
        assert_eq!(leaves, 16);
    }
}
