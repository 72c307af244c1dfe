//! `potree`: the loading of Potree 1.8 with its shipped settings, read from `Potree_update_visibility.js`, `LRU.js`,
//! `Potree.js`, `modules/loader/2.0/OctreeGeometry.js` and `viewer/viewer.js`.
//!
//! Once per frame:
//! 1. *Visit* nodes from the root, greatest weight first: w = r · ½H / (tan(fov/2) · d), in pixels, with r the radius
//!    of the sphere about the node's box and d the distance to its centre; without limit where d < r, and at the root.
//!    Nodes of w < `minNodeSize` = 30 px are not visited. The visit ends at the first node whose points would make
//!    more than the point budget together with those visited so far. Nodes outside the frustum are passed over with
//!    what is beneath them, except those of level 0 to 2. Children are visited whether their parent is loaded or not.
//! 2. *Load* the first 4 of those visited that are not loaded while their parent is; at most 4 at once
//!    (`maxNodesLoading`; one that is already loading counts as one of the first 4).
//! 3. *Free memory* while more than twice the point budget is loaded (`pointLoadLimit`): the least recently used node
//!    goes with all that is loaded beneath it. Used are the loaded nodes visited, in that order.
//!
//! A failed node is asked for again in the next frame. Nothing on its way is aborted.
//!
//! Settled here:
//! - Points ↔ decoded bytes, so that the memory budget is the load limit and half of it the point budget.
//! - A node ↔ a level of detail of a node: levels of one box are a chain, coarse first. Potree adds a node's points to
//!   its ancestors'; here a node is loaded after its parent, and both count, as in Potree they do. A node without
//!   content is loaded as soon as its parent is.
//! - Spacing, Potree's error, has no part in the decision, and so neither has the error here; detail ends with the
//!   point budget, or at boxes of less than 30 px.
//! - Levels are those of the octree that the root's sphere begins: levels 0 to 2 are those of at least a quarter of its
//!   radius. Where nodes have many more than eight children, counted levels would be loaded all around.
//! - The first node is taken even if it exceeds the point budget: a viewer of files made for it never meets one.
//! - Memory cannot be overdrawn: what is least recently used goes before the request, if that makes room (shipped:
//!   after the download has overdrawn it). If not, loading waits for what is on its way, and when nothing is, what does
//!   not fit is not counted among the first 4.
//! - Two nodes per frame are uploaded as shipped; here uploads are limited by the client's bytes per frame alone.
//! - Of equal weights, the node first in preorder is visited first (shipped: as the heap has it). The hierarchy is
//!   known from the start. The frustum has no near or far plane.

use super::downloads::{Asked, Downloads};
use super::tileset::tile::{Tile, tiles_of};
use super::{Policy, Rival};
use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::{LodTree, RepId};
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use core::cmp::Ordering;
use std::collections::BinaryHeap;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "potree",
    about: "nodes by projected size within a point budget, first unloaded first, least recently used subtrees go",
    // The least size of a node stands for a target: both end the detail.
    error_target_px: Some(30.0),
    parallel: 4,
    tells_directions: false,
    build: |tree, settings| {
        let (min_node_px, max_nodes_loading) = (settings.error_target_px, settings.parallel);
        Box::new(Potree::new(tree, PotreeSettings { max_nodes_loading, min_node_px, ..Default::default() }))
    },
};

/// What a user of the viewer can set; the default is what it ships with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PotreeSettings {
    /// `maxNodesLoading`: nodes loading at once, and how many of the unloaded are looked at in a frame.
    pub max_nodes_loading: usize,
    /// `viewer.minNodeSize`: projected radius below which a node is left out, pixels.
    pub min_node_px: f64,
    /// `pointBudget / pointLoadLimit`: the share of memory that may be visible at once.
    pub visible_share: f64,
}

impl Default for PotreeSettings {
    fn default() -> PotreeSettings {
        PotreeSettings { max_nodes_loading: 4, min_node_px: 30.0, visible_share: 0.5 }
    }
}

/// A node to visit.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    /// Pixels.
    weight: f64,
    tile: u32,
}

impl Ord for Candidate {
    fn cmp(&self, other: &Candidate) -> Ordering {
        self.weight.total_cmp(&other.weight).then(other.tile.cmp(&self.tile))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Candidate) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Candidate) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}

/// The policy.
#[derive(Debug)]
pub struct Potree {
    settings: PotreeSettings,
    tiles: Vec<Tile>,
    contents: Vec<RepId>,
    tile_of: Vec<u32>,
    /// Per tile, decoded bytes of its contents.
    points: Vec<u64>,
    /// Per tile, the frame in which it was last visited and found loaded.
    loaded_in: Vec<u32>,
    heap: BinaryHeap<Candidate>,
    /// Visited, not loaded, and their parents are.
    unloaded: Vec<u32>,
    downloads: Downloads,
}

impl Potree {
    /// A viewer of `tree`.
    pub fn new(tree: &LodTree, settings: PotreeSettings) -> Potree {
        let (tiles, contents, tile_of) = tiles_of(tree);
        let bytes = |tile: &Tile| {
            let own = &contents[tile.first_content as usize..tile.end_content as usize];
            own.iter().map(|&r| tree.decoded_bytes(r)).sum()
        };
        Potree {
            settings,
            points: tiles.iter().map(bytes).collect(),
            loaded_in: vec![0; tiles.len()],
            tiles,
            contents,
            tile_of,
            heap: BinaryHeap::new(),
            unloaded: Vec::new(),
            downloads: Downloads::new(tree),
        }
    }

    fn visit(&mut self, state: &ClientState, view: &View) {
        let (tree, frustum, frame) = (state.tree, Frustum::new(view), self.downloads.frame());
        let budget = (self.settings.visible_share * state.budget as f64) as u64;
        let radius = |tile: &Tile| tree.half(tile.node).length();
        let always_visible = 0.25 * radius(&self.tiles[0]);
        let mut visible_points = 0u64;
        self.unloaded.clear();
        self.heap.clear();
        self.heap.push(Candidate { weight: f64::MAX, tile: 0 });
        while let Some(Candidate { tile: id, .. }) = self.heap.pop() {
            let tile = self.tiles[id as usize];
            let points = self.points[id as usize];
            if visible_points > 0 && visible_points + points > budget {
                break;
            }
            let to_centre = tree.centre(tile.node) - frustum.eye;
            let inside = frustum.side(to_centre, tree.half(tile.node)) != Side::Outside;
            if !inside && radius(&tile) < always_visible {
                continue;
            }
            visible_points += points;
            let contents = &self.contents[tile.first_content as usize..tile.end_content as usize];
            let parent_loaded = self.loaded_in.get(tile.parent as usize).is_none_or(|&f| f == frame);
            if !contents.iter().all(|&r| state.status(r) == Status::Resident) {
                if parent_loaded {
                    self.unloaded.push(id);
                }
            } else if parent_loaded || !tile.is_empty() {
                self.loaded_in[id as usize] = frame;
                for &rep in contents {
                    self.downloads.touch(state, rep);
                }
            }
            let mut next = id + 1;
            while next < tile.subtree_end {
                let child = &self.tiles[next as usize];
                let distance = (tree.centre(child.node) - frustum.eye).length();
                let r = radius(child);
                let projected = if distance < r { f64::MAX } else { r * frustum.pixels_per_radian / distance };
                // A point-like box at the eye has no size: NaN is not below the limit, nor is it a weight.
                if projected >= self.settings.min_node_px {
                    self.heap.push(Candidate { weight: projected, tile: next });
                }
                next = child.subtree_end;
            }
        }
    }

    fn load(&mut self, state: &ClientState) {
        let (tiles, tile_of) = (&self.tiles, &self.tile_of);
        let beneath = |victim: RepId, other: RepId| {
            let top = tile_of[victim.index()];
            (top..tiles[top as usize].subtree_end).contains(&tile_of[other.index()])
        };
        let mut looked_at = 0;
        for &id in &self.unloaded {
            if looked_at == self.settings.max_nodes_loading {
                return;
            }
            let tile = tiles[id as usize];
            let mut fits = true;
            for &rep in &self.contents[tile.first_content as usize..tile.end_content as usize] {
                match self.downloads.request_with(state, rep, Some(&beneath)) {
                    Asked::Yes => {}
                    Asked::TooLarge => fits = false,
                    Asked::NoSlot | Asked::Waits => return,
                }
            }
            looked_at += usize::from(fits);
        }
    }
}

impl Policy for Potree {
    fn name(&self) -> &str {
        RIVAL.name
    }

    fn observe(&mut self, _state: &ClientState, _view: &View, now: Time) {
        self.downloads.frame_seen(now);
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        if self.downloads.begin(state, self.settings.max_nodes_loading)
            && let Some(view) = &state.view
        {
            self.visit(state, view);
            self.load(state);
        }
        self.downloads.next(state, now)
    }
}
