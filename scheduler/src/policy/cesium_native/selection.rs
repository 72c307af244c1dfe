//! Which tiles a frame renders, refines and loads: `selectTiles`, without recursion.

use super::CesiumNative;
use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::LodTree;
use crate::policy::tileset::Sight;
use crate::state::ClientState;
use crate::view::View;

/// Least distance that an error is divided by, metres.
const DISTANCE_MIN: f64 = 1e-7;
/// A middle nearer than this has no direction, metres.
const DIRECTION_MIN: f64 = 1e-5;

/// What was done with a tile in a frame (`TileSelectionState::Result`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Outcome {
    #[default]
    None,
    Culled,
    Rendered,
    Refined,
    RenderedAndKicked,
    RefinedAndKicked,
}

impl Outcome {
    fn kicked(self) -> Outcome {
        match self {
            Outcome::Rendered => Outcome::RenderedAndKicked,
            Outcome::Refined => Outcome::RefinedAndKicked,
            other => other,
        }
    }
}

/// What was done with a tile in the last two frames that visited it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Selected {
    frame: u32,
    outcome: Outcome,
    frame_before: u32,
    outcome_before: Outcome,
}

impl Selected {
    /// The last frame that visited it.
    pub(super) fn last_visited(&self) -> u32 {
        self.frame
    }

    /// Visited in `frame`, and neither drawn nor meant to be.
    pub(super) fn is_only_preloaded(&self, frame: u32) -> bool {
        let waits = matches!(self.outcome, Outcome::Culled | Outcome::Refined | Outcome::RefinedAndKicked);
        self.frame == frame && waits
    }

    fn begin(&mut self, frame: u32) {
        (self.frame_before, self.outcome_before) = (self.frame, self.outcome);
        (self.frame, self.outcome) = (frame, Outcome::None);
    }

    /// In the frame before `frame`.
    fn last_outcome(&self, frame: u32) -> Outcome {
        if self.frame + 1 == frame {
            self.outcome
        } else if self.frame == frame && self.frame_before + 1 == frame {
            self.outcome_before
        } else {
            Outcome::None
        }
    }
}

/// `TileLoadPriorityGroup`, in the order of loading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    Urgent,
    Normal,
    Preload,
}

/// A tile to load.
#[derive(Clone, Copy, Debug)]
pub(super) struct Load {
    pub(super) tile: u32,
    group: Group,
    /// Group, priority, tile.
    pub(super) priority: (u32, u64, u32),
}

impl Load {
    pub(super) fn is_preload(&self) -> bool {
        self.group == Group::Preload
    }
}

/// What is known of everything rendered at or beneath a tile (`TraversalDetails`).
#[derive(Clone, Copy, Debug)]
struct Details {
    all_renderable: bool,
    any_rendered_before: bool,
    missing: usize,
}

const NOTHING: Details = Details { all_renderable: true, any_rendered_before: false, missing: 0 };

/// A refined tile whose children are being visited.
#[derive(Clone, Copy, Debug)]
pub(super) struct Branch {
    tile: u32,
    next_child: u32,
    /// Beneath it nothing is loaded for its own sake.
    ancestor_meets: bool,
    queued: bool,
    priority: f64,
    loads_before: usize,
    visited_before: usize,
    beneath: Details,
}

/// What one frame's selection goes by.
pub(super) struct Selection<'t> {
    tree: &'t LodTree,
    frustum: Frustum,
}

impl<'t> Selection<'t> {
    pub(super) fn new(tree: &'t LodTree, view: &View) -> Selection<'t> {
        Selection { tree, frustum: Frustum::new(view) }
    }
}

impl CesiumNative {
    /// `selectTiles`: fills the queue of loads.
    pub(super) fn select(&mut self, state: &ClientState, selection: &Selection) {
        core::mem::swap(&mut self.visited, &mut self.visited_before);
        self.visited.clear();
        self.loads.clear();
        self.branches.clear();
        let mut finished = self.enter(state, selection, 0, false);
        loop {
            if let Some(details) = finished {
                let Some(parent) = self.branches.last_mut() else { return };
                parent.beneath.all_renderable &= details.all_renderable;
                parent.beneath.any_rendered_before |= details.any_rendered_before;
                parent.beneath.missing += details.missing;
            }
            let Some(&Branch { tile, next_child, ancestor_meets, .. }) = self.branches.last() else { return };
            finished = if next_child < self.tileset.tile(tile).subtree_end {
                if let Some(branch) = self.branches.last_mut() {
                    branch.next_child = self.tileset.tile(next_child).subtree_end;
                }
                self.enter(state, selection, next_child, ancestor_meets)
            } else {
                self.branches.pop().map(|branch| self.leave(state, &branch))
            };
        }
    }

    /// Refined whatever its error.
    fn is_unconditional(&self, id: u32) -> bool {
        self.tileset.tile(id).is_empty() && self.tileset.has_children(id)
    }

    fn is_renderable(&self, state: &ClientState, id: u32) -> bool {
        self.tileset.has_failed(id) || (!self.is_unconditional(id) && self.tileset.is_loaded(state, id))
    }

    fn last_outcome(&self, id: u32) -> Outcome {
        self.selected[id as usize].last_outcome(self.tileset.frame())
    }

    fn set(&mut self, id: u32, outcome: Outcome) {
        self.selected[id as usize].outcome = outcome;
    }

    fn queue_load(&mut self, state: &ClientState, tile: u32, group: Group, priority: f64) {
        if self.tileset.is_missing(state, tile) {
            self.loads.push(Load { tile, group, priority: (group as u32, priority.to_bits(), tile) });
        }
    }

    fn is_culled(&self, selection: &Selection, id: u32, sight: &Sight) -> bool {
        let by_children =
            self.tileset.has_children(id) && !self.tileset.children(id).any(|child| self.is_unconditional(child));
        if !by_children {
            return sight.side == Side::Outside;
        }
        !self.tileset.children(id).any(|child| {
            let node = self.tileset.tile(child).node;
            let to_centre = selection.tree.centre(node) - selection.frustum.eye;
            selection.frustum.side(to_centre, selection.tree.half(node)) != Side::Outside
        })
    }

    /// What a tile without refinement contributes (`createTraversalDetailsForSingleTile`).
    fn single(&self, state: &ClientState, id: u32) -> Details {
        let renderable = self.is_renderable(state, id);
        let before = match self.last_outcome(id) {
            Outcome::Rendered => true,
            // Drawn in its place in the last frame.
            Outcome::Refined => {
                let first = self.visited_before.partition_point(|&t| t <= id);
                let end = self.tileset.tile(id).subtree_end;
                let beneath = self.visited_before[first..].iter().take_while(|&&t| t < end);
                beneath.into_iter().any(|&t| self.last_outcome(t) == Outcome::Rendered)
            }
            _ => false,
        };
        Details {
            all_renderable: renderable,
            any_rendered_before: renderable && before,
            missing: usize::from(!renderable),
        }
    }

    /// `visitTileIfNeeded` and `visitTile` up to the children: `None` if these are to be visited.
    fn enter(&mut self, state: &ClientState, selection: &Selection, id: u32, ancestor_meets: bool) -> Option<Details> {
        self.selected[id as usize].begin(self.tileset.frame());
        self.visited.push(id);
        let tile = *self.tileset.tile(id);
        let frustum = &selection.frustum;
        let sight = Sight::of(selection.tree, frustum, tile.node, false);
        let away = sight.to_centre.length();
        let priority = if away >= DIRECTION_MIN {
            ((1.0 - frustum.forward.dot(sight.to_centre / away)) * sight.distance).max(0.0)
        } else {
            f64::MAX
        };
        let unconditional = self.is_unconditional(id);
        if self.is_culled(selection, id, &sight) && !(unconditional && id == 0) {
            self.set(id, Outcome::Culled);
            if self.settings.preload_siblings {
                self.queue_load(state, id, Group::Preload, priority);
            }
            return Some(NOTHING);
        }
        if !self.tileset.has_children(id) {
            self.set(id, Outcome::Rendered);
            self.queue_load(state, id, Group::Normal, priority);
            return Some(self.single(state, id));
        }
        let error = tile.error * frustum.pixels_per_radian / sight.distance.max(DISTANCE_MIN);
        let meets = error < self.settings.error_target_px;
        let (mut beneath_one_that_meets, mut queued) = (ancestor_meets, false);
        if !unconditional && (meets || ancestor_meets) {
            let was_refined = matches!(self.last_outcome(id), Outcome::Refined | Outcome::RefinedAndKicked);
            if !was_refined || self.is_renderable(state, id) {
                if !ancestor_meets {
                    self.queue_load(state, id, Group::Normal, priority);
                }
                self.set(id, Outcome::Rendered);
                return Some(self.single(state, id));
            }
            if !ancestor_meets {
                self.queue_load(state, id, Group::Urgent, priority);
                queued = true;
            }
            beneath_one_that_meets = true;
        }
        self.branches.push(Branch {
            tile: id,
            next_child: id + 1,
            ancestor_meets: beneath_one_that_meets,
            queued,
            priority,
            loads_before: self.loads.len(),
            visited_before: self.visited.len(),
            beneath: NOTHING,
        });
        None
    }

    /// `visitTile` from the children on.
    fn leave(&mut self, state: &ClientState, branch: &Branch) -> Details {
        let (id, mut details, mut queued) = (branch.tile, branch.beneath, branch.queued);
        let renderable = self.is_renderable(state, id);
        let too_many = details.missing > self.settings.descendant_limit;
        if !details.all_renderable && !details.any_rendered_before && (too_many || renderable) {
            for at in branch.visited_before..self.visited.len() {
                let selected = &mut self.selected[self.visited[at] as usize];
                selected.outcome = selected.outcome.kicked();
            }
            let was_drawn = self.last_outcome(id) == Outcome::Rendered && renderable;
            self.set(id, Outcome::Rendered);
            if too_many && !was_drawn && !self.is_unconditional(id) {
                self.loads.truncate(branch.loads_before);
                if !queued {
                    self.queue_load(state, id, Group::Normal, branch.priority);
                }
                details.missing = usize::from(!renderable);
                queued = true;
            }
            (details.all_renderable, details.any_rendered_before) = (renderable, was_drawn);
        } else {
            self.set(id, Outcome::Refined);
        }
        if self.settings.preload_ancestors && !queued {
            self.queue_load(state, id, Group::Preload, branch.priority);
        }
        details
    }
}
