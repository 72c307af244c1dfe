//! The tree as a tileset: a tile per level of detail of a node.

use crate::lod_tree::{LodTree, NodeId, RepId};

/// No tile.
pub(in crate::policy) const NONE: u32 = u32::MAX;

/// A tile, by its place in preorder.
#[derive(Clone, Copy, Debug)]
pub(in crate::policy) struct Tile {
    pub(in crate::policy) node: NodeId,
    pub(in crate::policy) parent: u32,
    pub(in crate::policy) subtree_end: u32,
    /// Number of tiles above, with content or without.
    pub(in crate::policy) level: u32,
    /// Its contents are `contents[first_content..end_content]`.
    pub(in crate::policy) first_content: u32,
    pub(in crate::policy) end_content: u32,
    /// Number of tiles with content from the root to here.
    pub(in crate::policy) depth: u32,
    /// Geometric error, metres; ∞ without content.
    pub(in crate::policy) error: f64,
    /// Its error is not below that of the nearest tile above that has content and is not itself such a tile.
    pub(in crate::policy) unconditional: bool,
}

impl Tile {
    /// Nothing to load.
    pub(in crate::policy) fn is_empty(&self) -> bool {
        self.first_content == self.end_content
    }
}

/// The tiles in preorder, their contents in the order of the tiles, and each representation's tile.
pub(in crate::policy) fn tiles_of(tree: &LodTree) -> (Vec<Tile>, Vec<RepId>, Vec<u32>) {
    let mut tiles: Vec<Tile> = Vec::with_capacity(tree.nodes());
    let mut contents: Vec<RepId> = Vec::with_capacity(tree.representations());
    let mut tile_of = vec![NONE; tree.representations()];
    let mut last_tile = vec![NONE; tree.nodes()];
    // Per tile, the error of the nearest tile from it upwards that can be stopped at; ∞ above the first.
    let mut bound: Vec<f64> = Vec::with_capacity(tree.nodes());
    let mut first_tile = Vec::with_capacity(tree.nodes() + 1);
    for node in (0..tree.nodes() as u32).map(NodeId) {
        first_tile.push(tiles.len() as u32);
        let mut next = contents.len();
        contents.extend(tree.own(node));
        contents[next..].sort_by(|&a, &b| tree.error(b).total_cmp(&tree.error(a)).then(a.cmp(&b)));
        let mut parent = tree.parent(node).map_or(NONE, |p| last_tile[p.index()]);
        loop {
            let error = contents.get(next).map_or(f64::INFINITY, |&r| tree.error(r));
            let count = contents[next..].iter().take_while(|&&r| tree.error(r) == error).count();
            let above = tiles.get(parent as usize).map(|p| (p.depth, p.level + 1));
            let limit = bound.get(parent as usize).copied().unwrap_or(f64::INFINITY);
            let unconditional = count > 0 && error >= limit;
            let id = tiles.len() as u32;
            for &rep in &contents[next..next + count] {
                tile_of[rep.index()] = id;
            }
            tiles.push(Tile {
                node,
                parent,
                subtree_end: 0,
                first_content: next as u32,
                end_content: (next + count) as u32,
                level: above.map_or(0, |(_, level)| level),
                depth: above.map_or(0, |(depth, _)| depth) + u32::from(count > 0),
                error,
                unconditional,
            });
            bound.push(if count > 0 && !unconditional { error } else { limit });
            parent = id;
            next += count;
            if next == contents.len() {
                break;
            }
        }
        last_tile[node.index()] = parent;
    }
    first_tile.push(tiles.len() as u32);
    for tile in &mut tiles {
        tile.subtree_end = first_tile[tree.subtree_end(tile.node).index()];
    }
    (tiles, contents, tile_of)
}

/// Per tile, whether all that lies beneath it is beneath a descendant for which `shows` holds.
pub(in crate::policy) fn shown_beneath(tiles: &[Tile], shows: impl Fn(&Tile) -> bool) -> Vec<bool> {
    let mut shown: Vec<bool> = (0u32..).zip(tiles).map(|(id, tile)| tile.subtree_end > id + 1).collect();
    for id in (0..tiles.len()).rev() {
        let parent = tiles[id].parent as usize;
        if parent < id && !shown[id] && !shows(&tiles[id]) {
            shown[parent] = false;
        }
    }
    shown
}
