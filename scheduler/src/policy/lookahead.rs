//! `lookahead`: the prefetching queue of \[HIBR\] §6.2.
//!
//! Seven positions: the viewer's, and six around it along the axes at the size L of the smallest cell in use. Each
//! requires a set, whatever the direction of view: the coarsest cut with g · pixels per radian / d ≤ target, d (m) from
//! the position to the node's box; the finest there is where nothing meets the target. The queue is the union of the
//! seven sets, ordered by distance from the viewer, then by level, coarse first. It is made anew when the viewer is more
//! than L/10 away from where it was last made, and is worked off in order, a few requests at a time; what is there
//! already is not fetched.
//!
//! Settled here:
//! - "Size of the lowest-level octree cell currently in use": the longest side of the smallest box, not of size 0, among
//!   the nodes that the viewer's own position requires. Boxes are content boxes.
//! - "Distance from the current position" is that of the node's box from the viewer's position, not that of the look-ahead position.
//! - The paper's unit is the orthoview, three to a cell, those at the smallest angles with the direction in which the
//!   cell is seen. So it is here where representations have directions; others show every side, and one is enough.
//! - "Background threads" have no number: 4.
//! - Requests in flight are not aborted when the queue changes; the paper aborts nothing.
//! - The paper retains what was drawn before until new data comes, which covers for what is late, except at the
//!   start, where nothing was drawn. There the coarsest representation of everything in the first view comes
//!   first, nearest first; without it the screen would stay empty until the finest has come.
//! - The paper's local cache has no limit. Here the union ends, in the queue's order, where the memory budget does, so that
//!   the farthest gives way to the nearest. What is not in it goes when room is needed, least recently in it first. When
//!   that is not enough, the queue waits for what is on its way, and when nothing is, passes over what does not fit until
//!   it is made anew.
//! - Prerequisites belong to the set of whatever needs them and are requested before it.
//! - A failed request is made again when the queue is made anew. So is the queue when field of view or viewport change.

use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::policy::tileset::{FRAME, first_missing};
use crate::policy::{Policy, Rival};
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use core::cmp::Ordering;
use glam::DVec3;
use std::collections::VecDeque;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "lookahead",
    about: "required sets around the viewer at six look-ahead positions, by distance",
    error_target_px: Some(16.0),
    parallel: 4,
    tells_directions: true,
    build: |tree, settings| {
        let (error_target_px, max_requests) = (settings.error_target_px, settings.parallel);
        let settings = LookaheadSettings { error_target_px, max_requests, ..LookaheadSettings::default() };
        Box::new(Lookahead::new(tree, settings))
    },
};
/// Orthoviews drawn per cell.
const DIRECTIONS_PER_CELL: usize = 3;
/// How much of the queue is put in order at a time.
const CHUNK: usize = 64;

/// What can be set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LookaheadSettings {
    /// Error on screen that the required sets meet, pixels.
    pub error_target_px: f64,
    /// Requests in flight at once.
    pub max_requests: usize,
    /// The queue is made anew after this share of L.
    pub update_share: f64,
}

impl Default for LookaheadSettings {
    fn default() -> LookaheadSettings {
        LookaheadSettings { error_target_px: 16.0, max_requests: 4, update_share: 0.1 }
    }
}

/// A representation to fetch.
#[derive(Clone, Copy, Debug)]
struct Entry {
    /// Metres.
    distance: f64,
    level: u32,
    rep: RepId,
}

fn in_order(a: &Entry, b: &Entry) -> Ordering {
    a.distance.total_cmp(&b.distance).then(a.level.cmp(&b.level)).then(a.rep.cmp(&b.rep))
}

/// Entries, of which only the front is kept in order.
#[derive(Debug, Default)]
struct Queue {
    entries: Vec<Entry>,
    next: usize,
    sorted: usize,
}

impl Queue {
    fn clear(&mut self) {
        self.entries.clear();
        (self.next, self.sorted) = (0, 0);
    }

    fn first(&mut self) -> Option<Entry> {
        if self.next == self.sorted && self.sorted < self.entries.len() {
            let rest = &mut self.entries[self.sorted..];
            let chunk = CHUNK.min(rest.len());
            if chunk < rest.len() {
                rest.select_nth_unstable_by(chunk, in_order);
            }
            rest[..chunk].sort_unstable_by(in_order);
            self.sorted += chunk;
        }
        self.entries.get(self.next).copied()
    }

    fn pass(&mut self) {
        self.next += 1;
    }

    /// Drops what was passed, and of the rest what does not fulfil the condition.
    fn keep(&mut self, condition: impl Fn(&Entry) -> bool) {
        self.entries.drain(..self.next);
        self.entries.retain(condition);
        (self.next, self.sorted) = (0, 0);
    }
}

/// Where the queue was last made.
#[derive(Clone, Copy, Debug)]
struct Made {
    position: DVec3,
    /// L, metres.
    length: f64,
    fov_y: f64,
    viewport: [u32; 2],
}

/// The policy.
#[derive(Debug)]
pub struct Lookahead {
    settings: LookaheadSettings,
    /// Each node's representations, coarsest first.
    own: Vec<RepId>,
    /// Per node, where in `own` they begin; one more at the end.
    first_own: Vec<u32>,
    level: Vec<u32>,
    /// Per node: every leaf beneath has something of its own, strictly below the node.
    shown_below: Vec<bool>,
    made: Option<Made>,
    /// Number of times that the queue has been made.
    update: u32,
    /// Per representation, the update whose union it was last in.
    last_in_union: Vec<u32>,
    cover: Queue,
    queue: Queue,
    /// Present or on its way.
    held: Vec<RepId>,
    /// On its way or being decoded.
    pending: Vec<RepId>,
    evictable: Vec<RepId>,
    discards: VecDeque<RepId>,
    /// Subtrees being traversed: where each ends, and which positions need more than is above it.
    open: Vec<(u32, u8)>,
    next_frame: Time,
}

impl Lookahead {
    /// A client of `tree`.
    pub fn new(tree: &LodTree, settings: LookaheadSettings) -> Lookahead {
        let mut own: Vec<RepId> = Vec::with_capacity(tree.representations());
        let mut first_own = Vec::with_capacity(tree.nodes() + 1);
        let mut level = vec![0; tree.nodes()];
        for node in (0..tree.nodes() as u32).map(NodeId) {
            first_own.push(own.len() as u32);
            let start = own.len();
            own.extend(tree.own(node));
            own[start..].sort_by(|&a, &b| tree.error(b).total_cmp(&tree.error(a)).then(a.cmp(&b)));
            if let Some(parent) = tree.parent(node) {
                level[node.index()] = level[parent.index()] + 1;
            }
        }
        first_own.push(own.len() as u32);
        let mut shown_below = vec![true; tree.nodes()];
        for node in (0..tree.nodes() as u32).rev().map(NodeId) {
            let children_shown = !tree.is_leaf(node) && shown_below[node.index()];
            shown_below[node.index()] = children_shown;
            if let (false, Some(parent)) = (children_shown || tree.own(node).len() > 0, tree.parent(node)) {
                shown_below[parent.index()] = false;
            }
        }
        Lookahead {
            settings,
            own,
            first_own,
            level,
            shown_below,
            made: None,
            update: 0,
            last_in_union: vec![0; tree.representations()],
            cover: Queue::default(),
            queue: Queue::default(),
            held: Vec::new(),
            pending: Vec::new(),
            evictable: Vec::new(),
            discards: VecDeque::new(),
            open: Vec::new(),
            next_frame: Time::ZERO,
        }
    }

    fn own(&self, node: NodeId) -> &[RepId] {
        &self.own[self.first_own[node.index()] as usize..self.first_own[node.index() + 1] as usize]
    }

    /// What a position `distance` (m) away is shown of the node, as an interval of `own`: the representations of the
    /// coarsest error that meets the target, else of the finest. `true` if it meets the target. `None`: owns nothing.
    fn choose(&self, tree: &LodTree, node: NodeId, allowed_error: f64) -> Option<(usize, usize, bool)> {
        let first = self.first_own[node.index()] as usize;
        let own = self.own(node);
        let finest = tree.error(*own.last()?);
        let meets = finest <= allowed_error;
        let error = if meets {
            own.iter().map(|&r| tree.error(r)).find(|&e| e <= allowed_error).unwrap_or(finest)
        } else {
            finest
        };
        let start = own.partition_point(|&r| tree.error(r) > error);
        let end = if tree.has_directions() { own.partition_point(|&r| tree.error(r) >= error) } else { start + 1 };
        Some((first + start, first + end, meets))
    }

    /// Calls `required(self, node, start, end, positions)` for the part of `own` that the positions in the mask
    /// require. `offsets` are relative to `eye`, none further than `reach`. In preorder; without recursion.
    fn traverse(
        &mut self,
        tree: &LodTree,
        eye: DVec3,
        offsets: &[DVec3],
        reach: f64,
        metres_per_radian: f64,
        mut required: impl FnMut(&mut Lookahead, NodeId, usize, usize, u8),
    ) {
        let everyone = ((1u16 << offsets.len()) - 1) as u8;
        self.open.clear();
        let mut next = 0u32;
        while next < tree.nodes() as u32 {
            while self.open.last().is_some_and(|&(end, _)| end <= next) {
                self.open.pop();
            }
            let asking = self.open.last().map_or(everyone, |&(_, mask)| mask);
            let node = NodeId(next);
            let end = tree.subtree_end(node).0;
            let leaf = end == next + 1;
            let mut descending = asking;
            if !self.own(node).is_empty() {
                descending = 0;
                let to_centre = (tree.centre(node) - eye).abs();
                let half = tree.half(node);
                let distance = (to_centre - half).max(DVec3::ZERO).length();
                // All positions agree wherever the nearest and the farthest that they could be do.
                let near = self.choose(tree, node, (distance - reach).max(0.0) * metres_per_radian);
                let far = self.choose(tree, node, (distance + reach) * metres_per_radian);
                let all_agree = near == far;
                for (i, &offset) in offsets.iter().enumerate() {
                    let bit = 1u8 << i;
                    if asking & bit == 0 {
                        continue;
                    }
                    let (choice, bits) = if all_agree {
                        (near, asking)
                    } else {
                        let to_box = (tree.centre(node) - (eye + offset)).abs() - half;
                        let allowed = to_box.max(DVec3::ZERO).length() * metres_per_radian;
                        (self.choose(tree, node, allowed), bit)
                    };
                    if let Some((start, end, meets)) = choice {
                        if meets || leaf || !self.shown_below[node.index()] {
                            required(self, node, start, end, bits);
                        }
                        if !meets {
                            descending |= bits;
                        }
                    }
                    if all_agree {
                        break;
                    }
                }
            }
            if descending == 0 {
                next = end;
            } else {
                if !leaf && descending != asking {
                    self.open.push((end, descending));
                }
                next += 1;
            }
        }
    }

    fn make_queue(&mut self, state: &ClientState, view: &View) {
        let tree = state.tree;
        let eye = view.position;
        // Error in metres that meets the target at one metre.
        let allowed = self.settings.error_target_px / view.pixels_per_radian();
        let mut length = f64::INFINITY;
        self.traverse(tree, eye, &[DVec3::ZERO], 0.0, allowed, |_, node, _, _, _| {
            let side = 2.0 * tree.half(node).max_element();
            if side > 0.0 {
                length = length.min(side);
            }
        });
        let length = if length.is_finite() { length } else { 0.0 };
        self.update += 1;
        self.made = Some(Made { position: eye, length, fov_y: view.fov_y, viewport: view.viewport });
        self.queue.clear();
        let offsets = [
            DVec3::ZERO,
            DVec3::X * length,
            DVec3::NEG_X * length,
            DVec3::Y * length,
            DVec3::NEG_Y * length,
            DVec3::Z * length,
            DVec3::NEG_Z * length,
        ];
        self.traverse(tree, eye, &offsets, length, allowed, |policy, node, start, end, positions| {
            let many = end - start > DIRECTIONS_PER_CELL;
            if !many {
                for at in start..end {
                    policy.require(state, eye, node, policy.own[at]);
                }
                return;
            }
            for (i, &offset) in offsets.iter().enumerate() {
                if positions & 1 << i != 0 {
                    let towards = tree.centre(node) - (eye + offset);
                    for rep in facing(tree, &policy.own[start..end], towards) {
                        policy.require(state, eye, node, rep);
                    }
                }
            }
        });
        self.end_where_memory_ends(state);
    }

    /// Ends the union where the memory budget does, and the queue with it.
    fn end_where_memory_ends(&mut self, state: &ClientState) {
        let decoded = |entry: &Entry| state.tree.decoded_bytes(entry.rep);
        let entries = &mut self.queue.entries;
        if entries.iter().map(decoded).sum::<u64>() > state.budget {
            entries.sort_unstable_by(in_order);
            let mut bytes = 0;
            let fitting = entries.iter().take_while(|entry| {
                bytes += decoded(entry);
                bytes <= state.budget
            });
            for beyond in entries.drain(fitting.count().max(1)..) {
                self.last_in_union[beyond.rep.index()] = self.update - 1;
            }
            // What is kept keeps what it needs, though that was first required from farther away.
            for entry in entries.iter() {
                let mut needed = state.tree.prerequisite(entry.rep);
                while let Some(prerequisite) = needed {
                    self.last_in_union[prerequisite.index()] = self.update;
                    needed = state.tree.prerequisite(prerequisite);
                }
            }
        }
        entries.retain(|entry| state.status(entry.rep) == Status::Absent);
    }

    /// Puts `rep` into the union, with what it needs first.
    fn require(&mut self, state: &ClientState, eye: DVec3, node: NodeId, rep: RepId) {
        let tree = state.tree;
        if self.last_in_union[rep.index()] == self.update {
            return;
        }
        let mut needed = Some(rep);
        while let Some(r) = needed.filter(|r| self.last_in_union[r.index()] != self.update) {
            self.last_in_union[r.index()] = self.update;
            let distance = distance_to(tree, node, eye);
            self.queue.entries.push(Entry { distance, level: self.level[node.index()], rep: r });
            needed = tree.prerequisite(r);
        }
    }

    /// The coarsest of everything in the first view.
    fn make_cover(&mut self, state: &ClientState, view: &View) {
        let tree = state.tree;
        let frustum = Frustum::new(view);
        let mut next = 0u32;
        while next < tree.nodes() as u32 {
            let node = NodeId(next);
            let to_centre = tree.centre(node) - view.position;
            if frustum.side(to_centre, tree.half(node)) == Side::Outside {
                next = tree.subtree_end(node).0;
            } else if let Some(&coarsest) = self.own(node).first() {
                let end = self.own(node).partition_point(|&r| tree.error(r) >= tree.error(coarsest));
                let rep = facing(tree, &self.own(node)[..end], to_centre).next().unwrap_or(coarsest);
                let distance = distance_to(tree, node, view.position);
                self.cover.entries.push(Entry { distance, level: self.level[node.index()], rep });
                next = tree.subtree_end(node).0;
            } else {
                next += 1;
            }
        }
    }

    /// Lists what may be discarded in favour of `wanted`; returns its bytes.
    fn find_evictable(&mut self, state: &ClientState, wanted: RepId) -> u64 {
        // What is wanted or on its way keeps what it needs.
        self.pending.retain(|&r| matches!(state.status(r), Status::InFlight | Status::Arrived));
        for &rep in self.pending.iter().chain(&[wanted]) {
            let mut needed = state.tree.prerequisite(rep);
            while let Some(prerequisite) = needed {
                self.last_in_union[prerequisite.index()] = self.update;
                needed = state.tree.prerequisite(prerequisite);
            }
        }
        let (update, last) = (self.update, &self.last_in_union);
        self.held.retain(|&r| state.status(r) != Status::Absent);
        self.evictable.clear();
        // What is still on its way has left the union, perhaps, but keeps what it needs first.
        let on_the_way = self.held.iter().filter(|&&r| state.status(r) != Status::Resident);
        let needs = |&r: &RepId| core::iter::successors(state.tree.prerequisite(r), |&p| state.tree.prerequisite(p));
        let mut needed: Vec<RepId> = on_the_way.flat_map(needs).collect();
        needed.sort_unstable();
        let outside = |r: &&RepId| {
            last[r.index()] != update && state.status(**r) == Status::Resident && needed.binary_search(r).is_err()
        };
        self.evictable.extend(self.held.iter().filter(outside));
        self.evictable.iter().map(|&r| state.tree.decoded_bytes(r)).sum()
    }

    /// Plans discards until `bytes` fit.
    fn make_room(&mut self, state: &ClientState, bytes: u64) {
        // A prerequisite was in every union that what needs it was in, and has the lower id: it goes later.
        let last = &self.last_in_union;
        self.evictable.sort_unstable_by_key(|&r| (last[r.index()], core::cmp::Reverse(r)));
        let mut free = state.free_bytes();
        for &rep in &self.evictable {
            if free >= bytes {
                break;
            }
            free += state.tree.decoded_bytes(rep);
            self.discards.push_back(rep);
        }
    }

    /// The next request, if there is one and room for it.
    fn fetch(&mut self, state: &ClientState) -> Option<Action> {
        loop {
            let from_cover = self.cover.first();
            let entry = from_cover.or_else(|| self.queue.first())?;
            let queue = if from_cover.is_some() { &mut self.cover } else { &mut self.queue };
            if state.status(entry.rep) != Status::Absent {
                queue.pass();
                continue;
            }
            let rep = first_missing(state, entry.rep);
            let bytes = state.request_bytes(rep);
            if bytes <= state.free_bytes() {
                if rep == entry.rep {
                    queue.pass();
                }
                self.held.push(rep);
                self.pending.push(rep);
                return Some(Action::Fetch { rep, discard_on_arrival: Vec::new() });
            }
            let possible = state.free_bytes() + self.find_evictable(state, entry.rep);
            if bytes <= possible {
                self.make_room(state, bytes);
                return self.discards.pop_front().map(Action::Discard);
            }
            if bytes <= state.budget && !self.pending.is_empty() {
                return None;
            }
            // Waiting will not help: what is too large now is passed over.
            let limit = if self.pending.is_empty() { possible } else { state.budget };
            let queue = if from_cover.is_some() { &mut self.cover } else { &mut self.queue };
            queue.keep(|e| state.request_bytes(first_missing(state, e.rep)) <= limit);
        }
    }
}

fn distance_to(tree: &LodTree, node: NodeId, eye: DVec3) -> f64 {
    ((tree.centre(node) - eye).abs() - tree.half(node)).max(DVec3::ZERO).length()
}

/// The representations that look most along `towards` (against their direction), best first, then by id; those that
/// show every side come first.
fn facing(tree: &LodTree, reps: &[RepId], towards: DVec3) -> impl Iterator<Item = RepId> + use<> {
    let cosine = |rep: RepId| match tree.direction(rep) {
        Some(code) => {
            let code = f64::from(code);
            let axis = |place: f64| libm::floor(code / place) - 3.0 * libm::floor(code / (3.0 * place)) - 1.0;
            -DVec3::new(axis(9.0), axis(3.0), axis(1.0)).normalize().dot(towards)
        }
        None => f64::INFINITY,
    };
    let mut best = [(f64::NEG_INFINITY, None); DIRECTIONS_PER_CELL];
    for &rep in reps {
        let mut candidate = (cosine(rep), Some(rep));
        for place in &mut best {
            if place.1.is_none() || candidate.0 > place.0 || (candidate.0 == place.0 && candidate.1 < place.1) {
                core::mem::swap(place, &mut candidate);
            }
        }
    }
    best.into_iter().filter_map(|(_, rep)| rep)
}

impl Policy for Lookahead {
    fn name(&self) -> &str {
        "lookahead"
    }

    fn observe(&mut self, state: &ClientState, view: &View, now: Time) {
        self.next_frame = now + FRAME;
        if self.made.is_none() {
            let present = |r: &RepId| state.status(*r) != Status::Absent;
            self.held.extend((0..state.tree.representations() as u32).map(RepId).filter(present));
            if self.held.is_empty() {
                self.make_cover(state, view);
            }
        }
        let valid = self.made.is_some_and(|made| {
            view.position.distance(made.position) <= self.settings.update_share * made.length
                && (view.fov_y, view.viewport) == (made.fov_y, made.viewport)
        });
        if !valid {
            self.make_queue(state, view);
        }
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        while let Some(rep) = self.discards.pop_front() {
            if state.status(rep) == Status::Resident && self.last_in_union[rep.index()] != self.update {
                return Action::Discard(rep);
            }
        }
        let action = if state.requests().len() < self.settings.max_requests { self.fetch(state) } else { None };
        action.unwrap_or(Action::WaitUntil(if self.next_frame > now { self.next_frame } else { now + FRAME }))
    }
}
