//! What a viewer needs to see everything around: \[HIBR\]'s cut, whatever the direction of view.

use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;

/// Orthoviews drawn per cell (\[HIBR\] §4.2).
const DIRECTIONS_PER_CELL: usize = 3;

/// A cell that is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Shown {
    /// Which.
    pub node: NodeId,
    /// Metres from the eye to its box.
    pub distance: f64,
    /// What it is shown by: three orthoviews, or its geometry.
    pub by: Vec<RepId>,
}

/// The coarsest cut whose orthoviews have pixels of at most `allowed` × distance (metres); geometry where the leaves' are not
/// fine enough. In preorder.
pub fn required(tree: &LodTree, eye: DVec3, allowed: f64) -> Vec<Shown> {
    let mut shown = Vec::new();
    let end = tree.nodes() as u32;
    let mut next = 0;
    while next < end {
        let node = NodeId(next);
        let from = tree.centre(node) - eye;
        let distance = (from.abs() - tree.half(node)).max(DVec3::ZERO).length();
        let images = tree.own(node).filter(|&rep| tree.direction(rep).is_some());
        let fine = |rep: &RepId| tree.error(*rep) <= allowed * distance;
        let fitting: Vec<RepId> = images.filter(fine).collect();
        let by = if !fitting.is_empty() {
            nearest(tree, fitting, -from)
        } else if tree.is_leaf(node) {
            let finest = tree.own(node).min_by(|&a, &b| tree.error(a).total_cmp(&tree.error(b)).then(a.cmp(&b)));
            finest.into_iter().collect()
        } else {
            next += 1;
            continue;
        };
        if !by.is_empty() {
            shown.push(Shown { node, distance, by });
        }
        next = tree.subtree_end(node).0;
    }
    shown
}

/// Those at the smallest angles with `towards`.
fn nearest(tree: &LodTree, mut images: Vec<RepId>, towards: DVec3) -> Vec<RepId> {
    let cosine = |rep: RepId| {
        let direction = tree.direction(rep).and_then(Direction::from_code);
        direction.map_or(f64::NEG_INFINITY, |d| d.towards_eye().dot(towards))
    };
    images.sort_by(|&a, &b| cosine(b).total_cmp(&cosine(a)).then(a.cmp(&b)));
    images.truncate(DIRECTIONS_PER_CELL);
    images
}
