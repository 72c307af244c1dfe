//! The downloads of a viewer that decides once per frame: what is there or on its way, when each was last used, and
//! the discards and requests of this frame, in order.
//!
//! A request that does not fit makes room first. Least recently used goes first, in the order of [`Downloads::touch`];
//! what is kept stays, and so does what something on its way needs. Where even all of the rest is too little, nothing
//! goes.

use crate::lod_tree::{LodTree, RepId};
use crate::policy::tileset::FRAME;
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use core::cmp::Reverse;
use std::collections::VecDeque;

/// What became of a wish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Asked {
    /// It is there, on its way or requested now.
    Yes,
    /// As much is in flight as may be.
    NoSlot,
    /// It will fit once what is on its way has come, perhaps.
    Waits,
    /// It does not fit, and nothing is on its way that could change that.
    TooLarge,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Downloads {
    frame: u32,
    /// Uses in this frame.
    uses: u32,
    /// What was used in this frame or later is kept.
    kept_since: u32,
    due: bool,
    next_frame: Time,
    /// Per representation, the frame of its last use and its place among that frame's uses; 0 before the first.
    last_use: Vec<(u32, u32)>,
    /// Per representation, the frame in which it was last requested.
    requested: Vec<u32>,
    /// Per representation, the frame in which it was last discarded.
    discarded: Vec<u32>,
    /// Present or on its way.
    held: Vec<RepId>,
    /// On its way or being decoded.
    pending: Vec<RepId>,
    /// Requests that can still be made in this frame.
    slots: usize,
    /// Bytes free when this frame's actions are done.
    free: u64,
    /// What can go in this frame, first to go last; `None` until it is asked for.
    victims: Option<Vec<RepId>>,
    victim_bytes: u64,
    actions: VecDeque<Action>,
}

impl Downloads {
    pub(super) fn new(tree: &LodTree) -> Downloads {
        Downloads {
            frame: 0,
            uses: 0,
            kept_since: 0,
            due: false,
            next_frame: Time::ZERO,
            last_use: vec![(0, 0); tree.representations()],
            requested: vec![0; tree.representations()],
            discarded: vec![0; tree.representations()],
            held: Vec::new(),
            pending: Vec::new(),
            slots: 0,
            free: 0,
            victims: None,
            victim_bytes: 0,
            actions: VecDeque::new(),
        }
    }

    /// A frame was seen: it has to be planned.
    pub(super) fn frame_seen(&mut self, now: Time) {
        self.due = true;
        self.next_frame = now + FRAME;
    }

    /// Begins to plan the frame seen last, with at most `parallel` requests in flight; false if that has been done.
    pub(super) fn begin(&mut self, state: &ClientState, parallel: usize) -> bool {
        if !core::mem::take(&mut self.due) {
            return false;
        }
        self.frame += 1;
        self.uses = 0;
        self.kept_since = self.frame;
        if self.frame == 1 {
            self.held.extend((0..state.tree.representations() as u32).map(RepId));
        }
        self.held.retain(|&r| state.status(r) != Status::Absent);
        self.pending.clear();
        self.pending
            .extend(self.held.iter().filter(|&&r| matches!(state.status(r), Status::InFlight | Status::Arrived)));
        self.slots = parallel.saturating_sub(state.requests().len());
        self.free = state.free_bytes();
        (self.victims, self.victim_bytes) = (None, 0);
        self.actions.clear();
        true
    }

    /// The number of this frame, from 1.
    pub(super) fn frame(&self) -> u32 {
        self.frame
    }

    /// Present or on its way, in order of request.
    pub(super) fn held(&self) -> &[RepId] {
        &self.held
    }

    /// Requests that can still be made in this frame.
    pub(super) fn slots(&self) -> usize {
        self.slots
    }

    /// Nothing is on its way or being decoded.
    pub(super) fn is_idle(&self) -> bool {
        self.pending.is_empty()
    }

    /// Everything used in `frame` or later is kept, not only what is used in the present one.
    pub(super) fn keep_since(&mut self, frame: u32) {
        self.kept_since = frame;
    }

    fn is_kept(&self, rep: RepId) -> bool {
        self.last_use[rep.index()].0 >= self.kept_since
    }

    fn can_go(&self, state: &ClientState, rep: RepId) -> bool {
        state.status(rep) == Status::Resident && !self.is_kept(rep) && self.discarded[rep.index()] != self.frame
    }

    /// `rep` is used in this frame, and with it whatever it needs first.
    pub(super) fn touch(&mut self, state: &ClientState, rep: RepId) {
        let mut next = Some(rep);
        while let Some(used) = next {
            if self.victims.is_some() && self.can_go(state, used) {
                self.victim_bytes -= state.tree.decoded_bytes(used);
            }
            self.uses += 1;
            self.last_use[used.index()] = (self.frame, self.uses);
            next = state.tree.prerequisite(used);
        }
    }

    /// Whether `rep` is there, on its way or requested in this frame.
    pub(super) fn is_asked(&self, state: &ClientState, rep: RepId) -> bool {
        state.status(rep) != Status::Absent || self.requested[rep.index()] == self.frame
    }

    /// Requests `rep` and whatever it needs first.
    pub(super) fn request(&mut self, state: &ClientState, rep: RepId) -> Asked {
        self.request_with(state, rep, None)
    }

    /// As [`Downloads::request`]; what is held and fulfils `along(victim, held)` goes together with a victim.
    pub(super) fn request_with(
        &mut self,
        state: &ClientState,
        rep: RepId,
        along: Option<&dyn Fn(RepId, RepId) -> bool>,
    ) -> Asked {
        self.touch(state, rep);
        while !self.is_asked(state, rep) {
            if self.slots == 0 {
                return Asked::NoSlot;
            }
            let mut first = rep;
            while let Some(missing) = state.tree.prerequisite(first).filter(|&p| !self.is_asked(state, p)) {
                first = missing;
            }
            let bytes = state.request_bytes(first);
            if bytes > self.free && !self.make_room(state, bytes, along) {
                let may_fit = bytes <= state.budget && !self.pending.is_empty();
                return if may_fit { Asked::Waits } else { Asked::TooLarge };
            }
            self.free -= bytes;
            self.slots -= 1;
            self.requested[first.index()] = self.frame;
            self.held.push(first);
            self.pending.push(first);
            self.actions.push_back(Action::Fetch { rep: first, discard_on_arrival: Vec::new() });
        }
        Asked::Yes
    }

    /// Discards what has not been used for `frames` frames.
    pub(super) fn discard_unused(&mut self, state: &ClientState, frames: u32) {
        let expired = |uses: &[(u32, u32)], rep: RepId, now: u32| uses[rep.index()].0.saturating_add(frames) <= now;
        if !self.held.iter().any(|&r| expired(&self.last_use, r, self.frame)) {
            return;
        }
        self.find_victims(state);
        let mut victims = self.victims.take().unwrap_or_default();
        while let Some(&rep) = victims.last() {
            if !expired(&self.last_use, rep, self.frame) {
                break;
            }
            victims.pop();
            if self.can_go(state, rep) {
                self.discard(state, rep);
            }
        }
        self.victims = Some(victims);
    }

    fn find_victims(&mut self, state: &ClientState) {
        if self.victims.is_some() {
            return;
        }
        for place in 0..self.pending.len() {
            if let Some(needed) = state.tree.prerequisite(self.pending[place]) {
                self.touch(state, needed);
            }
        }
        let mut victims: Vec<RepId> = self.held.iter().copied().filter(|&r| self.can_go(state, r)).collect();
        // What needs another was never used after it, and has the higher id: it goes first.
        victims.sort_unstable_by_key(|&r| Reverse((self.last_use[r.index()], Reverse(r))));
        self.victim_bytes = victims.iter().map(|&r| state.tree.decoded_bytes(r)).sum();
        self.victims = Some(victims);
    }

    fn make_room(&mut self, state: &ClientState, bytes: u64, along: Option<&dyn Fn(RepId, RepId) -> bool>) -> bool {
        self.find_victims(state);
        if bytes > self.free + self.victim_bytes {
            return false;
        }
        let mut victims = self.victims.take().unwrap_or_default();
        let mut group = Vec::new();
        while self.free < bytes {
            let Some(victim) = victims.pop() else { break };
            group.clear();
            group.push(victim);
            if let Some(along) = along {
                group.extend(self.held.iter().filter(|&&r| r != victim && along(victim, r)));
            }
            group.sort_unstable_by_key(|&r| Reverse(r));
            for &rep in &group {
                if self.can_go(state, rep) {
                    self.discard(state, rep);
                }
            }
        }
        self.victims = Some(victims);
        self.free >= bytes
    }

    fn discard(&mut self, state: &ClientState, rep: RepId) {
        let bytes = state.tree.decoded_bytes(rep);
        self.free += bytes;
        self.victim_bytes = self.victim_bytes.saturating_sub(bytes);
        self.discarded[rep.index()] = self.frame;
        self.actions.push_back(Action::Discard(rep));
    }

    /// The next planned action that is still possible, or until when to wait.
    pub(super) fn next(&mut self, state: &ClientState, now: Time) -> Action {
        while let Some(action) = self.actions.pop_front() {
            let possible = match &action {
                Action::Fetch { rep, .. } => {
                    state.status(*rep) == Status::Absent
                        && state.has_prerequisite(*rep)
                        && state.request_bytes(*rep) <= state.free_bytes()
                }
                Action::Discard(rep) => state.status(*rep) == Status::Resident && !state.is_needed(*rep),
                Action::Cancel(_) | Action::WaitUntil(_) => false,
            };
            if possible {
                return action;
            }
        }
        Action::WaitUntil(if self.next_frame > now { self.next_frame } else { now + FRAME })
    }
}
