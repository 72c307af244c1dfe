//! The benefit by element as its definition has it, written out.

use foresight_scheduler::benefit::element::{self, ELEMENTS};
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;

/// Share of each element in what a leaf weighs from an eye that may move by `reach`, written out: surface times the
/// eye's height over it.
pub(crate) fn shares_of(tree: &LodTree, node: NodeId, eye: DVec3, reach: f64) -> Vec<f64> {
    let (centre, half) = (tree.centre(node), tree.half(node));
    let corners = (0..8).map(|i| {
        let sign = |bit: u32| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
        centre + half * DVec3::new(sign(0), sign(1), sign(2))
    });
    let highest = |n: DVec3| corners.clone().map(|c| n.dot(eye - c)).fold(f64::NEG_INFINITY, f64::max);
    let areas = tree.surface(node);
    let seen: Vec<f64> = (0..ELEMENTS).map(|s| areas[s] * (highest(element::normals()[s]) + reach).max(0.0)).collect();
    let whole: f64 = seen.iter().sum();
    seen.iter().map(|seen| if whole > 0.0 { seen / whole } else { 0.0 }).collect()
}

/// Least error of each element among some representations, written out: g / (n·u) where that is more than the least.
pub(crate) fn errors_of(tree: &LodTree, held: impl Iterator<Item = RepId>) -> Vec<f64> {
    let mut least = vec![f64::INFINITY; ELEMENTS];
    for rep in held {
        for (s, least) in least.iter_mut().enumerate() {
            let cosine = match tree.direction(rep) {
                None => 1.0,
                Some(code) => {
                    let digit = |place: u8| f64::from(code / place % 3) - 1.0;
                    element::normals()[s].dot(DVec3::new(digit(9), digit(3), digit(1)).normalize())
                }
            };
            if cosine > element::SHOWN_MIN {
                *least = least.min(tree.error(rep) / cosine);
            }
        }
    }
    least
}
