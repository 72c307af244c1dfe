//! What is around the camera, as far as moving it needs to know.

use foresight_index::world::World;
use foresight_scheduler::lod_tree::{Aabb, LodTree, NodeId};
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Where there is content: its boxes, the ground, up.
pub trait Surroundings {
    /// Unit vector away from the ground.
    fn up(&self) -> DVec3;
    /// The ground's coordinate along up under a place, metres; `None` where there is no ground.
    fn ground(&self, at: DVec3) -> Option<f64>;
    /// Metres from a place to the nearest thing, or within a thing's box the size of what is in it.
    fn nearest(&self, at: DVec3) -> f64;
    /// Metres along a ray of unit direction to the first box of a thing; `None` if it meets none.
    fn ahead(&self, from: DVec3, along: DVec3) -> Option<f64>;
    /// Box around everything.
    fn bounds(&self) -> Aabb;
}

/// Nodes that a search looks at; beyond that it answers with what it has.
const VISITS_MAX: usize = 100_000;

/// A node in a search, the least distance first, then the least id.
#[derive(PartialEq)]
struct Next(f64, NodeId);

impl Eq for Next {}

impl Ord for Next {
    fn cmp(&self, other: &Next) -> Ordering {
        other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
    }
}

impl PartialOrd for Next {
    fn partial_cmp(&self, other: &Next) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The leaf with the least `distance` of its box, and that. `distance` of a box must be at least that of one around it;
/// `None` leaves a box out.
fn first_leaf(tree: &LodTree, distance: impl Fn(Aabb) -> Option<f64>) -> Option<(NodeId, f64)> {
    let mut queue = BinaryHeap::new();
    let put = |queue: &mut BinaryHeap<Next>, node| {
        if let Some(distance) = distance(tree.bounds(node)) {
            queue.push(Next(distance, node));
        }
    };
    put(&mut queue, tree.root());
    for _ in 0..VISITS_MAX {
        let Next(distance, node) = queue.pop()?;
        if tree.is_leaf(node) {
            return Some((node, distance));
        }
        tree.children(node).for_each(|child| put(&mut queue, child));
    }
    queue.pop().map(|Next(distance, node)| (node, distance))
}

/// Metres from a place to a box, 0 inside.
pub fn distance_to(bounds: Aabb, at: DVec3) -> f64 {
    (at.clamp(bounds.min, bounds.max) - at).length()
}

/// Metres along a ray to a box, 0 from inside; `None` if it misses it.
pub fn along_ray(bounds: Aabb, from: DVec3, along: DVec3) -> Option<f64> {
    let (mut enters, mut leaves) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - from[axis], bounds.max[axis] - from[axis]);
        if along[axis].abs() < 1e-12 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (low / along[axis], high / along[axis]);
        enters = enters.max(a.min(b));
        leaves = leaves.min(a.max(b));
    }
    (enters <= leaves).then_some(enters)
}

impl Surroundings for World {
    fn up(&self) -> DVec3 {
        self.up
    }

    fn ground(&self, at: DVec3) -> Option<f64> {
        self.ground_height(at)
    }

    /// Never less than a quarter of the nearest leaf's shortest side, nor than half a metre.
    fn nearest(&self, at: DVec3) -> f64 {
        let tree = &self.tree;
        let Some((leaf, distance)) = first_leaf(tree, |bounds| Some(distance_to(bounds, at))) else { return 1.0 };
        distance.max((0.5 * tree.half(leaf).min_element()).max(0.5))
    }

    fn ahead(&self, from: DVec3, along: DVec3) -> Option<f64> {
        first_leaf(&self.tree, |bounds| along_ray(bounds, from, along)).map(|(_, distance)| distance)
    }

    fn bounds(&self) -> Aabb {
        self.tree.bounds(self.tree.root())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_index::specification;
    use std::sync::Arc;

    #[test]
    fn searches_find_what_trying_every_leaf_finds() {
        let world = specification::open("city:blocks=3", &(Arc::new(|_, _| {}) as specification::Progress)).unwrap();
        let leaves: Vec<NodeId> =
            (0..world.tree.nodes() as u32).map(NodeId).filter(|&node| world.tree.is_leaf(node)).collect();
        for i in 0..200 {
            let turn = f64::from(i);
            let at = DVec3::new(300.0 * libm::sin(turn), 250.0 * libm::cos(3.0 * turn), 60.0 * libm::sin(7.0 * turn));
            let along = DVec3::new(libm::cos(turn), libm::sin(turn), 0.3 * libm::sin(5.0 * turn)).normalize();
            let boxes = || leaves.iter().map(|&leaf| world.tree.bounds(leaf));
            let near = boxes().map(|bounds| distance_to(bounds, at)).fold(f64::INFINITY, f64::min);
            let (_, found) = first_leaf(&world.tree, |bounds| Some(distance_to(bounds, at))).unwrap();
            assert_eq!(found, near);
            assert!(world.nearest(at) >= near);
            let hit = boxes().filter_map(|bounds| along_ray(bounds, at, along)).min_by(f64::total_cmp);
            assert_eq!(world.ahead(at, along), hit);
        }
    }
}
