//! Leaves in the order of a walk down the octree, so that those beneath a cell follow each other.

use crate::octree::{Cell, Octree};

/// The key of a leaf: a bit for each axis that is split at a level, from the root down; at most 120.
pub(super) fn key(octree: &Octree, place: [u64; 3]) -> u128 {
    let splits = octree.splits();
    let mut key = 0;
    for level in (0..octree.root().level).rev() {
        for axis in (0..3).filter(|&axis| splits[axis] > level) {
            key = key << 1 | u128::from(place[axis] >> level & 1);
        }
    }
    key
}

/// The leaf of a key.
pub(super) fn place(octree: &Octree, mut key: u128) -> [u64; 3] {
    let splits = octree.splits();
    let mut place = [0; 3];
    for level in 0..octree.root().level {
        for axis in (0..3).rev().filter(|&axis| splits[axis] > level) {
            place[axis] |= u64::from(key & 1 == 1) << level;
            key >>= 1;
        }
    }
    place
}

/// The keys of the leaves beneath a cell: from the first up to, not with, the second.
pub(super) fn beneath(octree: &Octree, cell: Cell) -> (u128, u128) {
    let doublings = octree.splits().map(|n| n.min(cell.level));
    let first = key(octree, std::array::from_fn(|axis| cell.place[axis] << doublings[axis]));
    (first, first + (1 << doublings.iter().sum::<u32>()))
}
