//! Which tiles a frame uses: the passes of `traverseFunctions.js`, over flat arrays and without recursion.

use super::{TilesRenderer, Visit};
use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::LodTree;
use crate::policy::tileset::tile::Tile;
use crate::state::ClientState;
use glam::DVec3;

/// A tile whose children are being traversed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Descent {
    pub(super) tile: u32,
    pub(super) next_child: u32,
    pub(super) any_child_in_frustum: bool,
    pub(super) any_child_used: bool,
}

/// What one frame's traversals go by.
pub(super) struct Traversal<'t> {
    pub(super) tree: &'t LodTree,
    pub(super) frustum: Frustum,
    /// Pixels.
    pub(super) target: f64,
    /// Children replace their parent together.
    pub(super) atomic: bool,
}

impl Traversal<'_> {
    /// Whether marking and refinement go on to the children whatever the tile's error.
    fn passes_through(&self, tile: &Tile) -> bool {
        tile.unconditional || (self.atomic && tile.is_empty())
    }
}

impl TilesRenderer {
    /// `markUsedTiles`: which tiles the view needs.
    pub(super) fn mark_used(&mut self, traversal: &Traversal) {
        self.descents.clear();
        let mut entering = Some(0u32);
        loop {
            if let Some(id) = entering.take() {
                self.visit(traversal, id);
                let (tile, visit) = (&self.tiles[id as usize], &mut self.visits[id as usize]);
                if visit.in_frustum && (visit.error > traversal.target || traversal.passes_through(tile)) {
                    self.descents.push(Descent {
                        tile: id,
                        next_child: id + 1,
                        any_child_in_frustum: false,
                        any_child_used: false,
                    });
                } else {
                    if visit.in_frustum {
                        visit.used = self.frame;
                    }
                    self.tell_parent(id);
                }
            }
            let Some(descent) = self.descents.last_mut() else { return };
            let end = self.tiles[descent.tile as usize].subtree_end;
            if descent.next_child < end {
                entering = Some(descent.next_child);
                descent.next_child = self.tiles[descent.next_child as usize].subtree_end;
                continue;
            }
            let Descent { tile: id, any_child_in_frustum, any_child_used, .. } = *descent;
            self.descents.pop();
            // The children are done: some of them, or the tile itself if it has none, decide whether it is used.
            let has_children = end > id + 1;
            if has_children && !any_child_in_frustum {
                self.visits[id as usize].in_frustum = false;
                self.visits[id as usize].kept = self.frame;
                self.mark_children(traversal, id, |visit, frame| visit.kept = frame);
            } else {
                self.visits[id as usize].used = self.frame;
                if any_child_used {
                    self.mark_children(traversal, id, |visit, frame| visit.used = frame);
                }
            }
            self.tell_parent(id);
        }
    }

    /// Hands a finished tile's state on to its parent, which is being traversed.
    fn tell_parent(&mut self, id: u32) {
        let visit = &self.visits[id as usize];
        if let Some(parent) = self.descents.last_mut() {
            parent.any_child_in_frustum |= visit.in_frustum;
            parent.any_child_used |= visit.used == self.frame;
        }
    }

    /// `recursivelyMarkUsed` on every child.
    fn mark_children(&mut self, traversal: &Traversal, id: u32, mark: impl Fn(&mut Visit, u32)) {
        let end = self.tiles[id as usize].subtree_end;
        let mut next = id + 1;
        while next < end {
            self.visit(traversal, next);
            mark(&mut self.visits[next as usize], self.frame);
            let tile = &self.tiles[next as usize];
            next = if traversal.passes_through(tile) { next + 1 } else { tile.subtree_end };
        }
    }

    /// `resetFrameState`: error and distance as this frame's view has them.
    fn visit(&mut self, traversal: &Traversal, id: u32) {
        if self.visits[id as usize].visited == self.frame {
            return;
        }
        let tile = &self.tiles[id as usize];
        let above = self.visits.get(tile.parent as usize);
        let above_inside = above.is_some_and(|v| v.visited == self.frame && v.all_inside);
        let visit = &mut self.visits[id as usize];
        visit.visited = self.frame;
        let to_centre = traversal.tree.centre(tile.node) - traversal.frustum.eye;
        let half = traversal.tree.half(tile.node);
        let side = if above_inside { Side::Inside } else { traversal.frustum.side(to_centre, half) };
        (visit.in_frustum, visit.all_inside) = (side != Side::Outside, side == Side::Inside);
        visit.distance = (to_centre.abs() - half).max(DVec3::ZERO).length();
        visit.error = if visit.distance == 0.0 {
            f64::INFINITY
        } else {
            tile.error * traversal.frustum.pixels_per_radian / visit.distance
        };
    }

    /// Lists the used tiles in preorder, refreshes the cached ones among their children, and finds bottom-up where
    /// something below is still missing (`markUsedSetLeaves`).
    pub(super) fn list_used(&mut self, state: &ClientState, traversal: &Traversal) {
        self.used.clear();
        let mut next = 0;
        while next < self.tiles.len() as u32 {
            let index = next as usize;
            if self.visits[index].used == self.frame {
                let finished = self.is_finished(state, next);
                let visit = &mut self.visits[index];
                (visit.finished, visit.any_child_used, visit.children_loaded) = (finished, false, true);
                self.used.push(next);
                next += 1;
            } else {
                if self.visits[index].cached {
                    self.visit(traversal, next);
                }
                next = self.tiles[index].subtree_end;
            }
        }
        for &id in self.used.iter().rev() {
            let (tile, visit) = (self.tiles[id as usize], self.visits[id as usize]);
            let ready = !traversal.passes_through(&tile) && visit.finished;
            if let Some(parent) = self.visits.get_mut(tile.parent as usize) {
                parent.any_child_used = true;
                parent.children_loaded &= ready || (visit.any_child_used && visit.children_loaded);
            }
        }
    }

    /// `markVisibleTiles`: which tiles are drawn, and which of the last frame stay because those are not loaded.
    pub(super) fn keep_previously_used(&mut self, traversal: &Traversal) {
        let (frame, listed, mut skip_until, mut first) = (self.frame, self.used.len(), 0, 0);
        for place in 0..listed {
            let id = self.used[place];
            let tile = self.tiles[id as usize];
            let visit = self.visits[id as usize];
            let passes = traversal.passes_through(&tile);
            let is_leaf = !visit.any_child_used || (!visit.children_loaded && !passes);
            if id < skip_until || !is_leaf {
                continue;
            }
            skip_until = tile.subtree_end;
            if passes {
                continue;
            }
            if visit.finished {
                self.visits[id as usize].active = frame;
                continue;
            }
            let last = &self.used_last_frame;
            // Both lists are in preorder.
            while last.get(first).is_some_and(|&t| t <= id) {
                first += 1;
            }
            let mut drawn_until = 0;
            for at in first..last.len() {
                let below = self.used_last_frame[at];
                if below >= tile.subtree_end {
                    break;
                }
                if below < drawn_until {
                    continue;
                }
                self.visit(traversal, below);
                let tile = &self.tiles[below as usize];
                let visit = &mut self.visits[below as usize];
                if visit.used != frame {
                    visit.used = frame;
                    self.used.push(below);
                }
                if visit.active + 1 >= frame {
                    visit.active = frame;
                    if !traversal.passes_through(tile) {
                        drawn_until = tile.subtree_end;
                    }
                }
            }
        }
        if self.used.len() > listed {
            // Two runs in order: a merge.
            self.used.sort();
        }
        for at in 0..self.used_last_frame.len() {
            self.visit(traversal, self.used_last_frame[at]);
        }
    }
}
