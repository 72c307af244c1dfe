//! Items to tiles: an R-tree over the plane, packed from the top by halving the triangles along x, then along y. A
//! tile at the bottom holds its items at each of their levels; one above holds what is beneath it, simplified.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use rayon::prelude::*;

use super::items::{COARSEST, FINEST, Item};
use crate::mesh::distance::{self, Bracket};
use crate::mesh::simplify::simplified;
use crate::mesh::{Mesh, Original, Triangle};

/// Most triangles of a tile at its finest level: some 40 kB as GLB.
pub(super) const MAX_TILE_TRIANGLES: usize = 3072;
/// A simplified tile has at most one in this many triangles of the coarsest levels beneath it.
const KEPT: usize = 3;
/// A simplified representation is used if it has at most this share of the bytes that it stands for.
const WORTHWHILE: f64 = 0.7;
/// Items that fill less than this share of their tile on the plane are told apart, however few their triangles,
const DENSE: f64 = 1.0 / 16.0;
/// unless the tile is no longer than this, metres.
const COMPACT: f64 = 100.0;

/// A representation's mesh, its sizes and its error.
#[derive(Clone, Debug)]
pub(super) struct Level {
    pub(super) mesh: Mesh,
    pub(super) wire_bytes: u32,
    pub(super) decoded_bytes: u32,
    /// Metres, an upper bound of the distance from the finest surface ([`distance`]).
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
    finest: Vec<Original>,
    source: Vec<Triangle>,
    /// Bytes on the wire of the source.
    source_bytes: u64,
    /// Triangles at the coarsest level, taken as no less than one in [`KEPT`] of the finest.
    coarsest: usize,
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
        let is_dense = filled >= DENSE * size.x * size.y || size.x.max(size.y) <= COMPACT;
        if order.len() <= 1 || (weight <= MAX_TILE_TRIANGLES && is_dense) {
            return self.leaf(order, bounds);
        }
        let is_wide = size.x >= size.y;
        let (along, across) = (|item: &Item| item.anchor.x, |item: &Item| item.anchor.y);
        let (low, high) = if is_wide { self.halve(order, along) } else { self.halve(order, across) };
        let parts: Vec<&mut [usize]> = if is_dense && weight <= 2 * MAX_TILE_TRIANGLES {
            vec![low, high]
        } else {
            let quarters = [low, high].into_iter().flat_map(|half| {
                let (low, high) = if is_wide { self.halve(half, across) } else { self.halve(half, along) };
                [low, high]
            });
            quarters.filter(|quarter| !quarter.is_empty()).collect()
        };
        let children: Vec<Option<Packed>> = parts.into_par_iter().map(|part| self.pack(part)).collect();
        inner(bounds, children.into_iter().flatten().collect())
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
        let patches = || {
            let items = order.iter().map(|&at| &self.items[at]);
            items.flat_map(|item| item.patches.iter().map(|patch| (patch, item.whole)))
        };
        let mut changes: Vec<i32> = patches().flat_map(|(patch, _)| [patch.from, patch.until]).collect();
        changes.push(COARSEST);
        changes.sort_unstable();
        changes.dedup();
        changes.retain(|&level| level != FINEST);
        let shown = |level: i32| -> Vec<Original> {
            let shown = patches().filter(|(patch, _)| patch.from <= level && level < patch.until);
            let place = |corners: &[u32; 3]| corners.map(|corner| self.vertices[corner as usize]);
            let originals = shown.flat_map(|(patch, whole)| {
                patch.triangles.iter().map(move |corners| Original { corners: place(corners), whole })
            });
            originals.collect()
        };
        let corners = |shown: &[Original]| -> Vec<Triangle> { shown.iter().map(|original| original.corners).collect() };
        let origin = bounds.centre().round();
        let finest_level = changes.pop().unwrap_or(COARSEST);
        let finest = shown(finest_level);
        let source = corners(&finest);
        let mesh = Mesh::weld(origin, source.iter().copied());
        let (wire_bytes, decoded_bytes) = mesh.sizes()?;
        let least_error = mesh.narrowing;
        let mut levels =
            vec![Level { mesh: mesh.clone(), wire_bytes, decoded_bytes, error: least_error, is_loose: false }];
        let mut coarsest = mesh.triangles.len();
        let mut add = |mesh: &Mesh, share: f64, error: Option<Bracket>| {
            let Some((finer_bytes, finer_error)) = levels.last().map(|finer| (finer.wire_bytes, finer.error)) else {
                return;
            };
            let sizes = mesh.sizes().filter(|&(wire, _)| f64::from(wire) < share * f64::from(finer_bytes));
            let Some(sizes) = sizes else { return };
            if let Some(error) = error.or_else(|| distance::error(&mesh.corners(), &finest)) {
                levels.push(level(mesh.clone(), sizes, error, finer_error));
                coarsest = coarsest.min(mesh.triangles.len());
            }
        };
        if changes.is_empty()
            && let Some((coarse, error)) = fewer(&mesh, mesh.triangles.len(), &finest)
        {
            add(&coarse, WORTHWHILE, Some(error));
        }
        for &change in changes.iter().rev() {
            add(&Mesh::weld(origin, corners(&shown(change))), 1.0, None);
        }
        levels.reverse();
        coarsest = coarsest.max(mesh.triangles.len() / KEPT);
        let tile = Tile { bounds, levels, children: Vec::new() };
        Some(Packed { tile, finest, source, source_bytes: u64::from(wire_bytes), coarsest, least_error })
    }
}

/// The mesh with one in [`KEPT`] of `coarsest` triangles.
fn fewer(mesh: &Mesh, coarsest: usize, finest: &[Original]) -> Option<(Mesh, Bracket)> {
    simplified(mesh, (coarsest / KEPT).min(MAX_TILE_TRIANGLES), finest)
}

fn level(mesh: Mesh, (wire_bytes, decoded_bytes): (u32, u32), bracket: Bracket, least: f64) -> Level {
    Level { mesh, wire_bytes, decoded_bytes, error: bracket.upper.max(least), is_loose: !bracket.is_tight }
}

/// A tile above others: what is beneath it, simplified and compared with the finest there is beneath it. Without a
/// representation of its own where simplifying saves too little.
fn inner(bounds: Aabb, mut children: Vec<Packed>) -> Option<Packed> {
    if children.len() < 2 {
        return children.pop();
    }
    let finest: Vec<Original> = children.iter().flat_map(|child| &child.finest).copied().collect();
    let below: Vec<Triangle> = children.iter().flat_map(|child| &child.source).copied().collect();
    let coarsest: usize = children.iter().map(|child| child.coarsest).sum();
    let below_bytes: u64 = children.iter().map(|child| child.source_bytes).sum();
    let least_error = children.iter().map(|child| child.least_error).fold(0.0, f64::max);
    let mesh = Mesh::weld(bounds.centre().round(), below.iter().copied());
    let found = fewer(&mesh, coarsest, &finest).and_then(|(mesh, error)| {
        let sizes = mesh.sizes().filter(|&(wire, _)| f64::from(wire) <= WORTHWHILE * below_bytes as f64)?;
        let corners = mesh.corners();
        let own = level(mesh, sizes, error, least_error);
        Some((own, corners))
    });
    let children: Vec<Tile> = children.into_iter().map(|child| child.tile).collect();
    Some(match found {
        Some((own, source)) => Packed {
            source_bytes: u64::from(own.wire_bytes),
            least_error: own.error,
            tile: Tile { bounds, levels: vec![own], children },
            finest,
            coarsest: source.len(),
            source,
        },
        None => {
            let tile = Tile { bounds, levels: Vec::new(), children };
            Packed { tile, finest, source: below, source_bytes: below_bytes, coarsest, least_error }
        }
    })
}
