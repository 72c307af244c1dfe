//! Items to tiles: an R-tree over the plane, packed from the top by halving the triangles along x, then along y. A
//! tile at the bottom holds its items at each of their levels; one above holds what is beneath it, simplified.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use rayon::prelude::*;

use super::items::{COARSEST, FINEST, Item};
use crate::mesh::distance::{self, Bracket};
use crate::mesh::simplify::simplified;
use crate::mesh::{Mesh, Triangle};

/// Most triangles of a tile at its finest level: some 30 kB as GLB.
pub(super) const MAX_TILE_TRIANGLES: usize = 2048;
/// Least triangles that a simplified tile is asked for.
const LEAST_TRIANGLES: usize = 128;
/// Share of the triangles beneath it that a simplified tile is asked for.
const KEPT: usize = 4;
/// A simplified representation is used if it has at most this share of the bytes that it stands for.
const WORTHWHILE: f64 = 0.7;
/// Items that fill less than this share of their tile on the plane are told apart, however few their triangles.
const DENSE: f64 = 1.0 / 16.0;

/// A representation's sizes and error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    pub(super) wire_bytes: u32,
    pub(super) decoded_bytes: u32,
    /// Metres, an upper bound of the distance between this surface and the finest.
    pub(super) error: f64,
    /// True if the bound is wider than the tolerance of the measurement.
    pub(super) is_loose: bool,
}

/// A tile with what is beneath it.
#[derive(Debug)]
pub(super) struct Tile {
    pub(super) bounds: Aabb,
    /// Coarse to fine; at most one above other tiles.
    pub(super) levels: Vec<Level>,
    pub(super) children: Vec<Tile>,
}

/// A tile on the way up: what it stands for, and what the tile above is simplified from.
struct Packed {
    tile: Tile,
    finest: Vec<Triangle>,
    source: Vec<Triangle>,
    /// Bytes on the wire of the source.
    source_bytes: u64,
    /// No representation above may have a smaller error.
    least_error: f64,
}

/// Packs items. `None` if no triangle is left once positions are narrowed.
pub(super) fn pack(items: &[Item], vertices: &[DVec3]) -> Option<Tile> {
    let mut order: Vec<usize> = (0..items.len()).collect();
    Some(Packer { items, vertices }.pack(&mut order)?.tile)
}

struct Packer<'a> {
    items: &'a [Item],
    vertices: &'a [DVec3],
}

impl Packer<'_> {
    fn pack(&self, order: &mut [usize]) -> Option<Packed> {
        let bounds = order.iter().fold(Aabb::EMPTY, |sum, &at| sum.union(self.items[at].bounds));
        let weight: usize = order.iter().map(|&at| self.items[at].weight).sum();
        let filled: f64 = order.iter().map(|&at| self.items[at].footprint).sum();
        let size = bounds.max - bounds.min;
        if order.len() <= 1 || (weight <= MAX_TILE_TRIANGLES && filled >= DENSE * size.x * size.y) {
            return self.leaf(order, bounds);
        }
        let (west, east) = self.halve(order, |item| item.anchor.x);
        let quarters = [west, east].into_iter().flat_map(|half| {
            let (south, north) = self.halve(half, |item| item.anchor.y);
            [south, north]
        });
        let quarters: Vec<&mut [usize]> = quarters.filter(|quarter| !quarter.is_empty()).collect();
        let children: Vec<Packed> = quarters
            .into_par_iter()
            .map(|quarter| self.pack(quarter))
            .collect::<Vec<_>>()
            .into_iter()
            .flatten()
            .collect();
        inner(bounds, children)
    }

    /// Sorts by `key` and cuts where half of the weight is on either side; one item alone stays whole.
    fn halve<'o>(&self, order: &'o mut [usize], key: impl Fn(&Item) -> f64) -> (&'o mut [usize], &'o mut [usize]) {
        if order.len() < 2 {
            return order.split_at_mut(order.len());
        }
        order.sort_unstable_by(|&a, &b| key(&self.items[a]).total_cmp(&key(&self.items[b])).then(a.cmp(&b)));
        let weight = |&at: &usize| self.items[at].weight.max(1);
        let whole: usize = order.iter().map(weight).sum();
        let mut below = 0;
        let cut = order.iter().position(|at| {
            below += weight(at);
            2 * below >= whole
        });
        let cut = cut.map_or(1, |at| at + 1).clamp(1, order.len() - 1);
        order.split_at_mut(cut)
    }

    /// A tile at the bottom: a representation for each level that differs in it; with one level only, a simplified one.
    fn leaf(&self, order: &mut [usize], bounds: Aabb) -> Option<Packed> {
        order.sort_unstable();
        let patches = || order.iter().flat_map(|&at| &self.items[at].patches);
        let mut changes: Vec<i32> = patches().flat_map(|patch| [patch.from, patch.until]).collect();
        changes.push(COARSEST);
        changes.sort_unstable();
        changes.dedup();
        changes.retain(|&level| level != FINEST);
        let triangles = |level: i32| -> Vec<Triangle> {
            let shown = patches().filter(|patch| patch.from <= level && level < patch.until);
            shown.flat_map(|patch| &patch.triangles).map(|corners| corners.map(|c| self.vertices[c as usize])).collect()
        };
        let origin = bounds.centre().round();
        let finest_level = changes.pop().unwrap_or(COARSEST);
        let finest = triangles(finest_level);
        let mesh = Mesh::weld(origin, finest.iter().copied());
        let (wire_bytes, decoded_bytes) = mesh.sizes()?;
        let least_error = mesh.narrowing;
        let mut levels = vec![Level { wire_bytes, decoded_bytes, error: least_error, is_loose: false }];
        let mut add = |mesh: &Mesh, share: f64| {
            let finer = levels[levels.len() - 1];
            let sizes = mesh.sizes().filter(|&(wire, _)| f64::from(wire) < share * f64::from(finer.wire_bytes));
            if let Some((sizes, bracket)) = sizes.zip(distance::between(&mesh.corners(), &finest)) {
                levels.push(level(sizes, bracket, finer.error));
            }
        };
        if changes.is_empty() {
            let target = (mesh.triangles.len() / KEPT).max(LEAST_TRIANGLES);
            if let Some(coarse) = simplified(&mesh, target) {
                add(&coarse, WORTHWHILE);
            }
        }
        for &change in changes.iter().rev() {
            add(&Mesh::weld(origin, triangles(change)), 1.0);
        }
        levels.reverse();
        let tile = Tile { bounds, levels, children: Vec::new() };
        Some(Packed { tile, source: finest.clone(), finest, source_bytes: u64::from(wire_bytes), least_error })
    }
}

fn level((wire_bytes, decoded_bytes): (u32, u32), bracket: Bracket, least: f64) -> Level {
    Level { wire_bytes, decoded_bytes, error: bracket.upper.max(least), is_loose: !bracket.is_tight() }
}

/// A tile above others: what is beneath it, simplified and compared with the finest there is beneath it. Without a
/// representation of its own where simplifying saves too little.
fn inner(bounds: Aabb, mut children: Vec<Packed>) -> Option<Packed> {
    if children.len() < 2 {
        return children.pop();
    }
    let gather =
        |of: fn(&Packed) -> &Vec<Triangle>| -> Vec<Triangle> { children.iter().flat_map(of).copied().collect() };
    let finest = gather(|child| &child.finest);
    let below = gather(|child| &child.source);
    let below_bytes: u64 = children.iter().map(|child| child.source_bytes).sum();
    let least_error = children.iter().map(|child| child.least_error).fold(0.0, f64::max);
    let mesh = Mesh::weld(bounds.centre().round(), below.iter().copied());
    let target = (mesh.triangles.len() / KEPT).clamp(LEAST_TRIANGLES, MAX_TILE_TRIANGLES);
    let found = simplified(&mesh, target).and_then(|mesh| {
        let sizes = mesh.sizes().filter(|&(wire, _)| f64::from(wire) <= WORTHWHILE * below_bytes as f64)?;
        let corners = mesh.corners();
        let own = level(sizes, distance::between(&corners, &finest)?, least_error);
        Some((own, corners))
    });
    let children: Vec<Tile> = children.into_iter().map(|child| child.tile).collect();
    Some(match found {
        Some((own, source)) => Packed {
            tile: Tile { bounds, levels: vec![own], children },
            finest,
            source,
            source_bytes: u64::from(own.wire_bytes),
            least_error: own.error,
        },
        None => {
            let tile = Tile { bounds, levels: Vec::new(), children };
            Packed { tile, finest, source: below, source_bytes: below_bytes, least_error }
        }
    })
}
