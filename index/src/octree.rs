//! The octree of cells over a world, split as often per axis as the world's extent along it needs.
//!
//! Leaves are cubes of side s on a regular grid. A cell of level ℓ is 2^min(ℓ, n) leaves long along an axis that needs
//! 2^n of them: a flat world is split like a quadtree, and its cells are flat boxes from the level on at which one
//! covers its height.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

/// Most levels above the leaves: 2⁴⁰ leaves of a millimetre span a million kilometres.
pub const LEVELS_MAX: u32 = 40;

/// Share of a leaf's side by which a world may be longer than its leaves: what rounding adds makes no further leaf. It is
/// less than a pixel of an orthoview.
const SLACK: f64 = 1e-4;

/// A grid of leaves with everything above it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Octree {
    /// Least corner of the leaf (0, 0, 0), metres.
    origin: DVec3,
    /// s: side of a leaf, metres.
    leaf_side: f64,
    /// n: doublings until one cell covers the world, per axis.
    splits: [u32; 3],
}

/// A cell by its level above the leaves and its place among the cells of that level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cell {
    /// 0 for leaves.
    pub level: u32,
    /// Place along x, y and z.
    pub place: [u64; 3],
}

/// Why there is no octree.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum OctreeError {
    /// The box is empty or not finite.
    #[error("bounds from {min} to {max}; expected finite corners in order")]
    Bounds {
        /// Least corner.
        min: DVec3,
        /// Largest corner.
        max: DVec3,
    },
    /// The side is not a length, or far too small for the box.
    #[error("a leaf of {side} m; expected at least {least} m for a world of {extent} m")]
    Side {
        /// As given.
        side: f64,
        /// What the levels allow.
        least: f64,
        /// Largest extent of the box, metres.
        extent: f64,
    },
}

impl Octree {
    /// The octree over `bounds` with leaves of side `leaf_side`, metres. Content on the upper faces of the box belongs to
    /// the last cells.
    ///
    /// # Errors
    /// Bounds that are not finite or not in order; a side that needs more than [`LEVELS_MAX`] levels.
    pub fn over(bounds: Aabb, leaf_side: f64) -> Result<Octree, OctreeError> {
        let Aabb { min, max } = bounds;
        if !(min.is_finite() && max.is_finite() && min.cmple(max).all()) {
            return Err(OctreeError::Bounds { min, max });
        }
        let extent = (max - min).max_element();
        let least = extent / (1u64 << LEVELS_MAX) as f64;
        if !(leaf_side.is_finite() && leaf_side > least) {
            return Err(OctreeError::Side { side: leaf_side, least, extent });
        }
        let splits = (max - min)
            .to_array()
            .map(|length| length - SLACK * leaf_side)
            .map(|length| (0..=LEVELS_MAX).find(|&n| (1u64 << n) as f64 * leaf_side >= length).unwrap_or(LEVELS_MAX));
        Ok(Octree { origin: min, leaf_side, splits })
    }

    /// The octree of these parts, as [`Octree::origin`], [`Octree::leaf_side`] and [`Octree::splits`] give them; `None` if
    /// they make none.
    pub fn of(origin: DVec3, leaf_side: f64, splits: [u32; 3]) -> Option<Octree> {
        let fits = splits.into_iter().all(|n| n <= LEVELS_MAX) && leaf_side.is_finite() && leaf_side > 0.0;
        let octree = Octree { origin, leaf_side, splits };
        (fits && origin.is_finite() && octree.bounds(octree.root()).max.is_finite()).then_some(octree)
    }

    /// The child of a cell, by which half it takes along each axis: bits 0 to 2 for x, y and z. `None` where the cell is a
    /// leaf, or is not split along an axis whose bit is set.
    pub fn child(&self, cell: Cell, halves: u8) -> Option<Cell> {
        let level = cell.level.checked_sub(1)?;
        let split = self.splits.map(|n| n > level);
        let half = |axis: usize| u64::from(halves >> axis & 1);
        let fits = halves < 8 && (0..3).all(|axis| split[axis] || half(axis) == 0);
        fits.then(|| Cell {
            level,
            place: std::array::from_fn(|axis| (cell.place[axis] << u32::from(split[axis])) + half(axis)),
        })
    }

    /// Which half of its parent a cell takes along each axis, as [`Octree::child`] has it; 0 for the root.
    pub fn halves(&self, cell: Cell) -> u8 {
        let split = self.splits.map(|n| n > cell.level);
        (0..3).filter(|&axis| split[axis] && cell.place[axis] & 1 == 1).fold(0, |halves, axis| halves | 1 << axis)
    }

    /// Least corner of the first leaf, metres.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Side of a leaf, metres.
    pub fn leaf_side(&self) -> f64 {
        self.leaf_side
    }

    /// Doublings along each axis.
    pub fn splits(&self) -> [u32; 3] {
        self.splits
    }

    /// The cell over everything.
    pub fn root(&self) -> Cell {
        Cell { level: self.splits.into_iter().max().unwrap_or(0), place: [0; 3] }
    }

    /// How often each axis has doubled at a level.
    fn doublings(&self, level: u32) -> [u32; 3] {
        self.splits.map(|n| n.min(level))
    }

    /// Number of cells along each axis at a level.
    pub fn cells_at(&self, level: u32) -> [u64; 3] {
        let doublings = self.doublings(level);
        std::array::from_fn(|axis| 1u64 << (self.splits[axis] - doublings[axis]))
    }

    /// The box of a cell, metres. Corners of neighbours are equal to the bit.
    pub fn bounds(&self, cell: Cell) -> Aabb {
        let doublings = self.doublings(cell.level);
        let corner = |step: u64| {
            DVec3::from_array(std::array::from_fn(|axis| {
                let leaves = (cell.place[axis] + step) << doublings[axis];
                self.origin[axis] + leaves as f64 * self.leaf_side
            }))
        };
        Aabb { min: corner(0), max: corner(1) }
    }

    /// The cell above; `None` for the root.
    pub fn parent(&self, cell: Cell) -> Option<Cell> {
        if cell.level >= self.root().level {
            return None;
        }
        let (here, above) = (self.doublings(cell.level), self.doublings(cell.level + 1));
        let place = std::array::from_fn(|axis| cell.place[axis] >> (above[axis] - here[axis]));
        Some(Cell { level: cell.level + 1, place })
    }

    /// The cells beneath, x fastest: up to eight; none beneath a leaf.
    pub fn children(&self, cell: Cell) -> impl Iterator<Item = Cell> + use<> {
        let level = cell.level.checked_sub(1);
        let splits = self.splits;
        let steps: [u64; 3] = match level {
            Some(level) => splits.map(|n| u64::from(n > level) + 1),
            None => [0; 3],
        };
        (0..steps[2]).flat_map(move |z| (0..steps[1]).flat_map(move |y| (0..steps[0]).map(move |x| [x, y, z]))).map(
            move |step| Cell {
                level: level.unwrap_or_default(),
                place: std::array::from_fn(|axis| cell.place[axis] * steps[axis] + step[axis]),
            },
        )
    }

    /// The leaves that a box meets, as ranges of places with both ends in them; what lies outside is moved to the border.
    /// NaN is at the first.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid before")]
    pub fn leaves(&self, bounds: &Aabb) -> [[u64; 2]; 3] {
        std::array::from_fn(|axis| {
            let last = (1u64 << self.splits[axis]) - 1;
            [bounds.min[axis], bounds.max[axis]].map(|at| {
                let leaf = ((at - self.origin[axis]) / self.leaf_side).floor();
                leaf.clamp(0.0, last as f64) as u64
            })
        })
    }

    /// The box of what belongs to a cell: its own, `slack` metres larger, and without end where the grid ends. What lies on
    /// a face belongs to both neighbours: a point that rounding has moved is lost to neither.
    pub fn holds(&self, cell: Cell, slack: f64) -> Aabb {
        let Aabb { min, max } = self.bounds(cell);
        let last = self.cells_at(cell.level);
        let low = |axis: usize| if cell.place[axis] == 0 { f64::NEG_INFINITY } else { min[axis] - slack };
        let high = |axis: usize| if cell.place[axis] + 1 == last[axis] { f64::INFINITY } else { max[axis] + slack };
        Aabb { min: DVec3::new(low(0), low(1), low(2)), max: DVec3::new(high(0), high(1), high(2)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn octree(extent: DVec3, side: f64) -> Octree {
        Octree::over(Aabb { min: DVec3::ZERO, max: extent }, side).expect("a box")
    }

    #[test]
    fn a_flat_world_is_split_like_a_quadtree() {
        let flat = octree(DVec3::new(1000.0, 900.0, 60.0), 64.0);
        assert_eq!((flat.splits(), flat.root().level), ([4, 4, 0], 4));
        assert_eq!(flat.children(flat.root()).count(), 4);
        assert_eq!(flat.bounds(flat.root()).max, DVec3::new(1024.0, 1024.0, 64.0));
        let long = octree(DVec3::new(1000.0, 100.0, 60.0), 64.0);
        assert_eq!((long.splits(), long.cells_at(1)), ([4, 1, 0], [8, 1, 1]));
        assert_eq!(long.children(long.root()).count(), 2);
        let last = Cell { level: 1, place: [0, 0, 0] };
        assert_eq!(
            long.children(last).map(|c| c.place).collect::<Vec<_>>(),
            [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
        );
    }

    #[test]
    fn what_makes_no_octree_is_refused() {
        let bounds = |min: f64, max: f64| Aabb { min: DVec3::splat(min), max: DVec3::splat(max) };
        for (bounds, side) in [
            (bounds(1.0, 0.0), 1.0),
            (bounds(f64::NAN, 1.0), 1.0),
            (bounds(0.0, f64::INFINITY), 1.0),
            (bounds(0.0, 1.0), 0.0),
        ] {
            assert!(Octree::over(bounds, side).is_err(), "{bounds:?} {side}");
        }
        assert!(Octree::over(bounds(0.0, 1e13), 1.0).is_err());
        assert!(Octree::over(bounds(0.0, 1.0), f64::NAN).is_err());
        // What rounding adds makes no leaf.
        assert_eq!(octree(DVec3::new(400.000_03, 400.0, 99.0), 100.0).splits(), [2, 2, 0]);
        assert_eq!(octree(DVec3::new(400.1, 400.0, 99.0), 100.0).splits(), [3, 2, 0]);
        // A point is a world of one leaf.
        assert_eq!(Octree::over(bounds(5.0, 5.0), 1.0).expect("a point").root().level, 0);
    }

    proptest! {
        #[test]
        fn children_tile_their_parent_and_know_it(
            extent in prop::array::uniform3(0.0..1e4f64), side in 1.0..300.0f64, walk in prop::collection::vec(0..8usize, 0..14),
        ) {
            let tree = octree(DVec3::from_array(extent), side);
            let mut cell = tree.root();
            for step in walk {
                let children: Vec<_> = tree.children(cell).collect();
                prop_assert_eq!((0..=u8::MAX).filter_map(|h| tree.child(cell, h)).collect::<Vec<_>>(), children.clone());
                if cell.level == 0 {
                    prop_assert!(children.is_empty());
                    break;
                }
                let whole = tree.bounds(cell);
                let volume = |b: Aabb| (b.max - b.min).element_product();
                let sum: f64 = children.iter().map(|&c| volume(tree.bounds(c))).sum();
                prop_assert!((sum / volume(whole) - 1.0).abs() < 1e-9);
                for &child in &children {
                    prop_assert_eq!(tree.parent(child), Some(cell));
                    prop_assert_eq!(tree.child(cell, tree.halves(child)), Some(child));
                    let b = tree.bounds(child);
                    prop_assert!(b.min.cmpge(whole.min).all() && b.max.cmple(whole.max).all());
                }
                cell = children[step % children.len()];
            }
        }

        #[test]
        fn every_point_has_one_leaf_or_lies_between(
            extent in prop::array::uniform3(0.0..500.0f64), share in prop::array::uniform3(0.0..=1.0f64),
        ) {
            let tree = octree(DVec3::from_array(extent), 50.0);
            let point = DVec3::from_array(extent) * DVec3::from_array(share);
            let at = tree.leaves(&Aabb { min: point, max: point }).map(|[first, last]| { assert_eq!(first, last); first });
            let cells = tree.cells_at(0);
            let holds = |place| {
                let Aabb { min, max } = tree.holds(Cell { level: 0, place }, 1e-9);
                point.cmpge(min).all() && point.cmple(max).all()
            };
            prop_assert!(holds(at));
            let all = (0..cells[2]).flat_map(|z| (0..cells[1]).flat_map(move |y| (0..cells[0]).map(move |x| [x, y, z])));
            let between = (point / 50.0).to_array().into_iter().any(|v| (v - v.round()).abs() < 1e-6);
            prop_assert!(between || all.filter(|&place| holds(place)).count() == 1);
        }
    }
}
