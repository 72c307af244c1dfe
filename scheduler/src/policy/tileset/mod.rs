//! A world as a tileset: what the ports of 3D Tiles viewers share. The tiles, what of them a client holds, and what one
//! frame decides to cancel, discard and request.
//!
//! Settled here for all that use [`Tileset`]:
//! - Bounding volumes are the nodes' content boxes. The frustum has no near and no far plane.
//! - Every tile refines by `REPLACE`. A node's representations are a chain of tiles with decreasing error; those of
//!   equal error (the directions of an orthoview) are the contents of one tile.
//! - The tree is known from the start: no `tileset.json` and no subtree is waited for.
//! - The error of an empty tile is not known. It never meets the target: stopping at it shows nothing.
//! - Contents have their prerequisites requested first, and kept as long as something used needs them.
//! - Memory is a hard maximum; a request takes its wire and its decoded bytes from the moment when it is made. One that
//!   does not fit has unused tiles unloaded if that makes room. If not, the queue waits for what is on its way, and when
//!   nothing is, later requests that fit go ahead.

pub(super) mod fog;
pub(super) mod tile;

use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use glam::DVec3;
use std::collections::VecDeque;
use tile::{Tile, tiles_of};

/// One frame at 60 Hz.
pub(super) const FRAME: Time = Time(16_666_667);

/// A content to request. What comes first in the order of these is requested first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Queued {
    /// Lower first: the group, the priority in it as the bits of a number ≥ 0, and what decides among equals.
    pub(super) priority: (u32, u64, u32),
    pub(super) rep: RepId,
}

/// Where a box lies as seen from the eye.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    /// From the eye to the middle, metres.
    pub(super) to_centre: DVec3,
    /// Half the sides, metres.
    pub(super) half: DVec3,
    /// From the eye to the nearest point, metres.
    pub(super) distance: f64,
    pub(super) side: Side,
}

impl Sight {
    /// Of the node's content box. `inside`: a box around it is known to lie inside the frustum.
    pub(super) fn of(tree: &LodTree, frustum: &Frustum, node: NodeId, inside: bool) -> Sight {
        let to_centre = tree.centre(node) - frustum.eye;
        let half = tree.half(node);
        let distance = (to_centre.abs() - half).max(DVec3::ZERO).length();
        let side = if inside { Side::Inside } else { frustum.side(to_centre, half) };
        Sight { to_centre, half, distance, side }
    }
}

/// The prerequisite of `rep` that has to be requested first, or `rep` itself.
pub(super) fn first_missing(state: &ClientState, rep: RepId) -> RepId {
    let mut first = rep;
    while let Some(missing) = state.tree.prerequisite(first).filter(|&p| state.status(p) == Status::Absent) {
        first = missing;
    }
    first
}

/// Everything that `rep` needs first, nearest first.
fn prerequisites(tree: &LodTree, rep: RepId) -> impl Iterator<Item = RepId> + '_ {
    core::iter::successors(tree.prerequisite(rep), |&p| tree.prerequisite(p))
}

/// The tiles, and what is held of them.
#[derive(Debug)]
pub(super) struct Tileset {
    tiles: Vec<Tile>,
    contents: Vec<RepId>,
    tile_of: Vec<u32>,
    /// Number of this frame. The first is 2, so that 0 is never the frame before it.
    frame: u32,
    failed: Vec<bool>,
    /// Tiles that may have a content requested or loaded.
    held: Vec<u32>,
    is_held: Vec<bool>,
    /// A discard or a cancellation may have left a held tile without content.
    may_have_gone: bool,
    /// Contents on their way or being decoded.
    pending: Vec<RepId>,
    /// Per tile, the frame in which something used last needed it first; empty if nothing needs another.
    needed: Vec<u32>,
    /// Per representation, how many held ones need it; empty if nothing needs another.
    dependants: Vec<u32>,
    dependants_counted: bool,
    /// Bytes that are free when what this frame has decided so far is done.
    free: u64,
    /// Decoded bytes that are then loaded.
    loaded: u64,
    /// Per tile, the frame in which it was last unloaded.
    unloaded: Vec<u32>,
    unloadable: Vec<((u32, i64), u32)>,
    /// The frame observed last has not been planned yet.
    due: bool,
    next_frame: Time,
    actions: VecDeque<Action>,
}

impl Tileset {
    pub(super) fn new(tree: &LodTree) -> Tileset {
        let (tiles, contents, tile_of) = tiles_of(tree);
        let linked = tree.has_prerequisites();
        Tileset {
            frame: 1,
            failed: vec![false; tiles.len()],
            held: Vec::new(),
            is_held: vec![false; tiles.len()],
            may_have_gone: false,
            pending: Vec::new(),
            needed: vec![0; if linked { tiles.len() } else { 0 }],
            dependants: vec![0; if linked { tree.representations() } else { 0 }],
            dependants_counted: false,
            free: 0,
            loaded: 0,
            unloaded: vec![0; tiles.len()],
            unloadable: Vec::new(),
            due: false,
            next_frame: Time::ZERO,
            actions: VecDeque::new(),
            tiles,
            contents,
            tile_of,
        }
    }

    /// In preorder.
    pub(super) fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    pub(super) fn tile(&self, id: u32) -> &Tile {
        &self.tiles[id as usize]
    }

    pub(super) fn has_children(&self, id: u32) -> bool {
        self.tiles[id as usize].subtree_end > id + 1
    }

    /// In order.
    pub(super) fn children(&self, id: u32) -> impl Iterator<Item = u32> + '_ {
        let end = self.tiles[id as usize].subtree_end;
        let first = Some(id + 1).filter(|&child| child < end);
        core::iter::successors(first, move |&child| {
            Some(self.tiles[child as usize].subtree_end).filter(|&next| next < end)
        })
    }

    fn contents(&self, id: u32) -> &[RepId] {
        let tile = &self.tiles[id as usize];
        &self.contents[tile.first_content as usize..tile.end_content as usize]
    }

    pub(super) fn tile_of(&self, rep: RepId) -> u32 {
        self.tile_of[rep.index()]
    }

    pub(super) fn frame(&self) -> u32 {
        self.frame
    }

    pub(super) fn has_failed(&self, id: u32) -> bool {
        self.failed[id as usize]
    }

    /// Everything that the tile shows can be drawn.
    pub(super) fn is_loaded(&self, state: &ClientState, id: u32) -> bool {
        self.contents(id).iter().all(|&r| matches!(state.status(r), Status::Resident | Status::Doomed))
    }

    /// Some content is neither here nor on its way, and none has failed.
    pub(super) fn is_missing(&self, state: &ClientState, id: u32) -> bool {
        !self.has_failed(id) && self.contents(id).iter().any(|&r| state.status(r) == Status::Absent)
    }

    /// Contents on their way or being decoded.
    pub(super) fn pending(&self) -> &[RepId] {
        &self.pending
    }

    /// Decoded bytes that are loaded when what this frame has decided so far is done.
    pub(super) fn loaded_bytes(&self) -> u64 {
        self.loaded
    }

    /// Decoded bytes that are loaded now.
    pub(super) fn loaded_now(&self, state: &ClientState) -> u64 {
        let coming = |r: &&RepId| matches!(state.status(**r), Status::InFlight | Status::Arrived);
        let on_the_way: u64 = self.pending.iter().filter(coming).map(|&r| state.request_bytes(r)).sum();
        state.used_bytes().saturating_sub(on_the_way)
    }

    fn hold(&mut self, id: u32) {
        if !core::mem::replace(&mut self.is_held[id as usize], true) {
            self.held.push(id);
        }
    }

    /// The camera was observed.
    pub(super) fn observe(&mut self, now: Time) {
        self.due = true;
        self.next_frame = now + FRAME;
    }

    /// Begins the frame observed last; `None` if it has been planned already.
    pub(super) fn begin_frame(&mut self, state: &ClientState) -> Option<View> {
        if !core::mem::take(&mut self.due) {
            return None;
        }
        let view = state.view?;
        self.frame += 1;
        self.actions.clear();
        if self.frame == 2 {
            // What was there before the first frame.
            for rep in (0..state.tree.representations() as u32).map(RepId) {
                if state.status(rep) != Status::Absent {
                    self.hold(self.tile_of[rep.index()]);
                }
            }
        }
        self.pending.retain(|&r| matches!(state.status(r), Status::InFlight | Status::Arrived));
        if core::mem::take(&mut self.may_have_gone) {
            let mut held = core::mem::take(&mut self.held);
            held.retain(|&id| {
                let present = self.contents(id).iter().any(|&r| state.status(r) != Status::Absent);
                self.is_held[id as usize] = present;
                present
            });
            self.held = held;
        }
        if core::mem::take(&mut self.dependants_counted) {
            self.dependants.fill(0);
        }
        self.loaded = self.loaded_now(state);
        self.free = state.free_bytes();
        Some(view)
    }

    /// What a used tile needs first stays.
    pub(super) fn keep_prerequisites(&mut self, tree: &LodTree, id: u32) {
        if self.needed.is_empty() {
            return;
        }
        let tile = self.tiles[id as usize];
        for at in tile.first_content..tile.end_content {
            for needed in prerequisites(tree, self.contents[at as usize]) {
                self.needed[self.tile_of[needed.index()] as usize] = self.frame;
            }
        }
    }

    /// Puts what is missing of the tile into the queue.
    pub(super) fn enqueue(&self, state: &ClientState, id: u32, priority: (u32, u64, u32), queue: &mut Vec<Queued>) {
        if !self.has_failed(id) {
            let missing = self.contents(id).iter().filter(|&&r| state.status(r) == Status::Absent);
            queue.extend(missing.map(|&rep| Queued { priority, rep }));
        }
    }

    /// Aborts the requests of tiles that are not `used`; returns how many.
    pub(super) fn cancel_unused(&mut self, state: &ClientState, used: impl Fn(u32) -> bool) -> usize {
        let before = self.pending.len();
        let (tile_of, needed, frame) = (&self.tile_of, &self.needed, self.frame);
        let (actions, free) = (&mut self.actions, &mut self.free);
        // What needs another was requested later: it is aborted first.
        let mut index = self.pending.len();
        while index > 0 {
            index -= 1;
            let rep = self.pending[index];
            let tile = tile_of[rep.index()];
            let kept = used(tile) || needed.get(tile as usize) == Some(&frame);
            if !kept && state.status(rep) == Status::InFlight {
                self.pending.remove(index);
                actions.push_back(Action::Cancel(rep));
                *free += state.request_bytes(rep);
            }
        }
        before - self.pending.len()
    }

    fn count_dependants(&mut self, state: &ClientState) {
        if self.dependants.is_empty() || core::mem::replace(&mut self.dependants_counted, true) {
            return;
        }
        for &id in &self.held {
            let tile = &self.tiles[id as usize];
            for &rep in &self.contents[tile.first_content as usize..tile.end_content as usize] {
                let loaded = matches!(state.status(rep), Status::Resident | Status::Doomed);
                if let (true, Some(p)) = (loaded, state.tree.prerequisite(rep)) {
                    self.dependants[p.index()] += 1;
                }
            }
        }
        for &rep in &self.pending {
            if let Some(p) = state.tree.prerequisite(rep) {
                self.dependants[p.index()] += 1;
            }
        }
    }

    fn resident_bytes(&self, state: &ClientState, id: u32) -> u64 {
        let resident = self.contents(id).iter().filter(|&&r| state.status(r) == Status::Resident);
        resident.map(|&r| state.tree.decoded_bytes(r)).sum()
    }

    /// Lists the held tiles to which `rank` gives a place, and returns the bytes that they take.
    fn list_unloadable(&mut self, state: &ClientState, rank: impl Fn(u32) -> Option<(u32, i64)>) -> u64 {
        let mut list = core::mem::take(&mut self.unloadable);
        list.clear();
        let there =
            |&&id: &&u32| self.unloaded[id as usize] != self.frame && self.needed.get(id as usize) != Some(&self.frame);
        list.extend(self.held.iter().filter(there).filter_map(|&id| Some((rank(id)?, id))));
        let bytes = list.iter().map(|&(_, id)| self.resident_bytes(state, id)).sum();
        self.unloadable = list;
        bytes
    }

    /// Unloads what was listed, least place first, until `done`.
    fn unload_listed(&mut self, state: &ClientState, done: impl Fn(&Tileset) -> bool) {
        self.count_dependants(state);
        let mut list = core::mem::take(&mut self.unloadable);
        list.sort_unstable();
        for &(_, id) in &list {
            if done(self) {
                break;
            }
            self.unloaded[id as usize] = self.frame;
            let tile = self.tiles[id as usize];
            // Of equal error, the later may need the earlier.
            for at in (tile.first_content..tile.end_content).rev() {
                let rep = self.contents[at as usize];
                let unneeded = self.dependants.get(rep.index()).is_none_or(|&n| n == 0);
                if state.status(rep) != Status::Resident || !unneeded {
                    continue;
                }
                self.actions.push_back(Action::Discard(rep));
                self.free += state.tree.decoded_bytes(rep);
                self.loaded = self.loaded.saturating_sub(state.tree.decoded_bytes(rep));
                if let (false, Some(p)) = (self.dependants.is_empty(), state.tree.prerequisite(rep)) {
                    self.dependants[p.index()] = self.dependants[p.index()].saturating_sub(1);
                }
            }
        }
        self.unloadable = list;
    }

    /// Unloads tiles in the order of `rank` until what is loaded takes at most `cap` bytes.
    pub(super) fn unload_down_to(&mut self, state: &ClientState, cap: u64, rank: impl Fn(u32) -> Option<(u32, i64)>) {
        if self.loaded > cap && self.list_unloadable(state, rank) > 0 {
            self.unload_listed(state, |tileset| tileset.loaded <= cap);
        }
    }

    /// Requests what is queued, in order, while `slots` and memory last; room is made by unloading in the order of
    /// `rank`. Returns the first that did not fit.
    pub(super) fn request(
        &mut self,
        state: &ClientState,
        queue: &mut Vec<Queued>,
        slots: &mut usize,
        rank: impl Fn(u32) -> Option<(u32, i64)>,
    ) -> Option<RepId> {
        let mut blocked = None;
        let (mut next, mut sorted) = (0, 0);
        while *slots > 0 && next < queue.len() {
            if next == sorted {
                // Only as much is put in order as can be requested.
                let rest = &mut queue[sorted..];
                let chunk = (*slots).min(rest.len());
                if chunk < rest.len() {
                    rest.select_nth_unstable(chunk);
                }
                rest[..chunk].sort_unstable();
                sorted += chunk;
            }
            let wanted = queue[next].rep;
            let asked = |rep| state.status(rep) != Status::Absent || self.pending.contains(&rep);
            let mut rep = wanted;
            while let Some(missing) = state.tree.prerequisite(rep).filter(|&p| !asked(p)) {
                rep = missing;
            }
            if asked(rep) || self.has_failed(self.tile_of[rep.index()]) {
                next += 1;
                continue;
            }
            let bytes = state.request_bytes(rep);
            if bytes > self.free && blocked.is_none() {
                let shortage = bytes - self.free;
                if self.list_unloadable(state, &rank) >= shortage {
                    self.unload_listed(state, |tileset| tileset.free >= bytes);
                }
            }
            if bytes <= self.free {
                (self.free, *slots) = (self.free - bytes, *slots - 1);
                self.actions.push_back(Action::Fetch { rep, discard_on_arrival: Vec::new() });
                self.pending.push(rep);
                self.hold(self.tile_of[rep.index()]);
                continue;
            }
            blocked = blocked.or(Some(rep));
            if !self.pending.is_empty() {
                break;
            }
            // Nothing will change by waiting: let those go ahead that fit.
            queue.drain(..=next);
            queue.retain(|q| state.request_bytes(first_missing(state, q.rep)) <= self.free);
            (next, sorted) = (0, 0);
        }
        blocked
    }

    /// Bytes that `rep` would bring to what is on its way and what stays loaded when all that has a place in `rank` has
    /// been unloaded, once everything is decoded.
    pub(super) fn bytes_with(
        &mut self,
        state: &ClientState,
        rep: RepId,
        rank: impl Fn(u32) -> Option<(u32, i64)>,
    ) -> u64 {
        let gone = self.list_unloadable(state, rank);
        let coming: u64 = self.pending.iter().chain(&[rep]).map(|&r| state.tree.decoded_bytes(r)).sum();
        self.loaded.saturating_sub(gone) + coming
    }

    /// A request or its decoding failed.
    pub(super) fn fail(&mut self, rep: RepId) {
        self.failed[self.tile_of[rep.index()] as usize] = true;
        self.may_have_gone = true;
    }

    /// The next thing that this frame has decided.
    pub(super) fn next_action(&mut self, state: &ClientState, now: Time) -> Action {
        while let Some(action) = self.actions.pop_front() {
            let possible = match &action {
                Action::Fetch { rep, .. } => {
                    state.status(*rep) == Status::Absent
                        && state.has_prerequisite(*rep)
                        && state.request_bytes(*rep) <= state.free_bytes()
                }
                Action::Cancel(rep) => state.status(*rep) == Status::InFlight && !state.is_needed(*rep),
                Action::Discard(rep) => state.status(*rep) == Status::Resident && !state.is_needed(*rep),
                Action::WaitUntil(_) => false,
            };
            self.may_have_gone |= !possible || !matches!(action, Action::Fetch { .. });
            if possible {
                return action;
            }
        }
        Action::WaitUntil(if self.next_frame > now { self.next_frame } else { now + FRAME })
    }
}
