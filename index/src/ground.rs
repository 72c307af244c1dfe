//! The height of the ground under a position, as far as a world's leaves tell it.

mod surface;

use std::fmt::Debug;
use std::sync::{Arc, OnceLock};

use foresight_scheduler::lod_tree::{LodTree, NodeId};
use glam::{DVec2, DVec3};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

pub use surface::GroundSurface;

/// A leaf's bounds seen along `up`, with its height above the datum.
type Footprint = GeomWithData<Rectangle<[f64; 2]>, f32>;

/// What is known about the height of the ground. Heights are coordinates along the world's up axis, metres.
#[derive(Clone, Debug)]
pub enum Ground {
    /// The same height everywhere.
    Flat(f64),
    /// A height per leaf.
    Leaves(LeafHeights),
    /// Triangles.
    Triangles(GroundSurface),
    /// A height at every place, in a world where z is up.
    Surface(Arc<dyn Surface>),
    /// None: a world in space.
    Absent,
}

/// A surface over the plane z = 0.
pub trait Surface: Debug + Send + Sync {
    /// The height over a place that is finite, metres.
    fn height(&self, at: DVec2) -> f64;
}

/// The mean height of each leaf's vertices, and an R-tree over the leaves' footprints that is built at the first use.
#[derive(Clone, Debug)]
pub struct LeafHeights {
    datum: f64,
    above_datum: Vec<f32>,
    index: OnceLock<RTree<Footprint>>,
}

impl LeafHeights {
    /// `heights` holds one height for each leaf of the tree, in preorder, metres along up; `datum` is a height amid
    /// them, so that what is stored keeps its precision far from the origin.
    pub fn new(datum: f64, heights: impl IntoIterator<Item = f64>) -> LeafHeights {
        #[expect(clippy::cast_possible_truncation, reason = "a difference from the datum, kept to 7 digits")]
        let above_datum = heights.into_iter().map(|height| (height - datum) as f32).collect();
        LeafHeights { datum, above_datum, index: OnceLock::new() }
    }
}

impl Ground {
    /// The height of the ground under or over `at`, metres along the unit vector `up`. Of the leaves whose footprint
    /// holds the position the lowest counts; where there is none, the one with the nearest footprint. The footprint is
    /// that of the leaf's bounds on the plane across `up`, so on a planet it holds near the place where `up` was taken.
    /// Of triangles, see [`GroundSurface`]. `None` without leaves or ground, or if `at` is not finite.
    pub fn height(&self, tree: &LodTree, up: DVec3, at: DVec3) -> Option<f64> {
        if !at.is_finite() {
            return None;
        }
        let leaves = match self {
            Ground::Flat(height) => return Some(*height),
            Ground::Surface(surface) => return Some(surface.height(at.truncate())),
            Ground::Absent => return None,
            Ground::Leaves(leaves) => leaves,
            Ground::Triangles(surface) => return surface.height(up, at),
        };
        let index = leaves.index.get_or_init(|| footprints(tree, up, &leaves.above_datum));
        let point = across(up, at).to_array();
        let below = index.locate_all_at_point(point).map(|leaf| leaf.data).min_by(f32::total_cmp);
        let height = below.or_else(|| index.nearest_neighbor(point).map(|leaf| leaf.data))?;
        Some(leaves.datum + f64::from(height))
    }
}

/// Coordinates on the plane across `up`.
fn across(up: DVec3, at: DVec3) -> DVec2 {
    let (right, forward) = up.any_orthonormal_pair();
    DVec2::new(at.dot(right), at.dot(forward))
}

fn footprints(tree: &LodTree, up: DVec3, heights: &[f32]) -> RTree<Footprint> {
    let (right, forward) = up.any_orthonormal_pair();
    let leaves = (0..tree.nodes() as u32).map(NodeId).filter(|&node| tree.is_leaf(node));
    let boxes = leaves.zip(heights).map(|(leaf, &height)| {
        let middle = across(up, tree.centre(leaf));
        let half = tree.half(leaf);
        let reach = DVec2::new(half.dot(right.abs()), half.dot(forward.abs()));
        let rectangle = AABB::from_corners((middle - reach).to_array(), (middle + reach).to_array());
        Footprint::new(Rectangle::from_aabb(rectangle), height)
    });
    RTree::bulk_load(boxes.collect())
}

#[cfg(test)]
mod tests {
    use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, Representation};

    use super::*;

    #[test]
    fn the_leaf_below_else_the_nearest() -> Result<(), LodTreeError> {
        let mut builder = LodTreeBuilder::default();
        builder.open()?;
        for x in [0.0, 10.0] {
            builder.open()?;
            let rep =
                Representation { wire_bytes: 1, decoded_bytes: 1, error: 0.0, prerequisite: None, direction: None };
            builder.add(rep)?;
            builder.close(Some(Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 4.0, 1.0, 4.0) }), 1.0)?;
        }
        builder.close(None, 1.0)?;
        let tree = builder.finish()?;
        let ground = Ground::Leaves(LeafHeights::new(6.4e6, [6.4e6 + 1.5, 6.4e6 + 2.5]));
        let height = |x, z| ground.height(&tree, DVec3::Y, DVec3::new(x, 50.0, z));
        assert_eq!(height(2.0, 2.0), Some(6.4e6 + 1.5));
        assert_eq!(height(11.0, 2.0), Some(6.4e6 + 2.5));
        assert_eq!(height(9.0, 2.0), Some(6.4e6 + 2.5));
        assert_eq!(height(-900.0, 2.0), Some(6.4e6 + 1.5));
        assert_eq!(height(f64::NAN, 2.0), None);
        Ok(())
    }
}
