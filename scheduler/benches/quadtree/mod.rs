//! The world of the benchmarks: boxes on a square, under a quadtree.

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, Representation};
use glam::DVec3;

/// Side of a leaf's footprint, metres.
pub(crate) const LOT: f64 = 15.0;

/// 4^levels leaves around the origin, one representation a node.
pub(crate) fn quadtree(levels: u32) -> Result<LodTree, LodTreeError> {
    fn node(b: &mut LodTreeBuilder, level: u32, x: f64, z: f64) -> Result<(), LodTreeError> {
        let side = LOT * libm::exp2(f64::from(level));
        b.open()?;
        let (wire_bytes, error) = (6000 + 500 * level, (side / 12.0) as f32);
        let decoded_bytes = 3 * wire_bytes;
        b.add(Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: None })?;
        if level == 0 {
            let height = 4.0 + libm::fmod(libm::fabs(7.0 * x + 3.0 * z), 31.0);
            let min = DVec3::new(x, 0.0, z);
            return b.close(Some(Aabb { min, max: min + DVec3::new(0.8 * LOT, height, 0.8 * LOT) }), 1.0);
        }
        let half = 0.5 * side;
        for (dx, dz) in [(0.0, 0.0), (half, 0.0), (0.0, half), (half, half)] {
            node(b, level - 1, x + dx, z + dz)?;
        }
        b.close(None, 1.0)
    }
    let mut builder = LodTreeBuilder::default();
    let corner = -0.5 * LOT * libm::exp2(f64::from(levels));
    node(&mut builder, levels, corner, corner)?;
    builder.finish()
}
