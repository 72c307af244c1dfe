//! What the cache drops: `LRUCache.js` and `lruPriorityCallback`.

use super::{TilesRenderer, by_priority};
use crate::policy::tileset::first_missing;
use crate::scheduler::Action;
use crate::state::{ClientState, Status};

impl TilesRenderer {
    /// `unloadUnusedContent`; returns the bytes that the discards and cancellations will free.
    pub(super) fn unload(&mut self, state: &ClientState) -> u64 {
        if core::mem::take(&mut self.may_have_gone) {
            self.forget_absent(state);
        }
        let sent = self.pending.iter().filter(|r| !self.waiting.contains(r));
        let on_the_way: u64 = sent.map(|&r| state.request_bytes(r)).sum();
        let cached_bytes = state.used_bytes().saturating_sub(on_the_way) as f64;
        let min_bytes = self.settings.min_bytes_share * state.budget as f64;
        let items = self.cached.len() + self.queue.len();
        let head_bytes = match self.queue.iter().min_by(|a, b| by_priority(a, b)) {
            Some(head) if self.free_slots(state) > 0 => state.request_bytes(first_missing(state, head.rep)),
            _ => 0,
        };
        let shortage = head_bytes.saturating_sub(self.free_bytes(state));
        if cached_bytes <= min_bytes && items <= self.settings.min_items && shortage == 0 {
            return 0;
        }
        let frame = self.frame;
        let mut unused = core::mem::take(&mut self.unused);
        unused.clear();
        unused.extend(self.cached.iter().filter(|&&id| self.visits[id as usize].kept != frame));
        if !unused.is_empty() {
            unused.sort_by_cached_key(|&id| self.unload_key(state, id));
        }
        let waiting_bytes = self.waiting_bytes(state);
        let freed = self.unload_in_order(state, &unused, cached_bytes, min_bytes, items, shortage);
        self.unused = unused;
        // What no longer waits is free already.
        freed - (waiting_bytes - self.waiting_bytes(state))
    }

    fn unload_in_order(
        &mut self,
        state: &ClientState,
        unused: &[u32],
        cached_bytes: f64,
        min_bytes: f64,
        items: usize,
        shortage: u64,
    ) -> u64 {
        self.count_dependants(state, true);
        let freeable: u64 = unused.iter().map(|&id| self.bytes_freed(state, id)).sum();
        // Where even all of it is too little, nothing is unloaded for the request's sake.
        let shortage = if freeable >= shortage { shortage } else { 0 };
        let excess_items = items.saturating_sub(self.settings.min_items).min(unused.len()) as f64;
        let step = self.settings.unload_share;
        let items_to_unload =
            libm::ceil((step * self.settings.min_items as f64).max(step * excess_items)).min(excess_items);
        let excess_bytes = (cached_bytes - min_bytes).max(0.0);
        let bytes_to_unload = (step * excess_bytes).max(step * min_bytes).min(excess_bytes);
        let (mut freed, mut removed_bytes, mut removed_items) = (0u64, 0.0, 0.0);
        for &id in unused {
            if freed >= shortage && removed_bytes >= bytes_to_unload && removed_items >= items_to_unload {
                break;
            }
            let bytes = self.loaded_bytes(state, id) as f64;
            let undershoots = cached_bytes - removed_bytes - bytes < min_bytes;
            if freed >= shortage && undershoots && removed_items >= items_to_unload {
                break;
            }
            if !self.can_be_unloaded(state, id) {
                continue;
            }
            freed += self.bytes_freed(state, id);
            removed_bytes += bytes;
            removed_items += 1.0;
            self.visits[id as usize].failed = false;
            let tile = self.tiles[id as usize];
            // Of equal error, the later may need the earlier.
            for at in (tile.first_content..tile.end_content).rev() {
                let rep = self.contents[at as usize];
                let status = state.status(rep);
                match status {
                    Status::Resident => self.actions.push_back(Action::Discard(rep)),
                    Status::InFlight => self.actions.push_back(Action::Cancel(rep)),
                    _ => {
                        self.waiting.retain(|&waits| waits != rep);
                        self.may_have_gone = true;
                    }
                }
                let needed = state.tree.prerequisite(rep).filter(|p| self.tile_of[p.index()] != id);
                if let (Status::Resident | Status::InFlight, Some(p)) = (status, needed) {
                    self.dependants[p.index()] = self.dependants[p.index()].saturating_sub(1);
                }
            }
        }
        self.count_dependants(state, false);
        freed
    }

    /// Sorts what is unloaded first to the front: `lruPriorityCallback` after "unfinished first". Among equals, what was
    /// cached first goes first.
    fn unload_key(&self, state: &ClientState, id: u32) -> (bool, u32, u32, u8, u64) {
        let visit = &self.visits[id as usize];
        let progress = self.contents(id).iter().map(|&r| match state.status(r) {
            Status::Absent if !self.waiting.contains(&r) => 0,
            Status::Absent | Status::InFlight => 1,
            Status::Arrived => 2,
            Status::Resident | Status::Doomed => 3,
        });
        // Errors are not negative: their bits are in their order. Deeper first, so depth is reversed.
        let error = visit.error.to_bits();
        let finished = self.is_finished(state, id);
        let depth = u32::MAX - self.tiles[id as usize].depth;
        (finished, visit.visited, depth, progress.min().unwrap_or(0), error)
    }

    /// Counts, or with `counting` false sets back, which representations others in the cache need.
    fn count_dependants(&mut self, state: &ClientState, counting: bool) {
        if self.dependants.is_empty() {
            return;
        }
        for &id in &self.cached {
            let tile = &self.tiles[id as usize];
            for &rep in &self.contents[tile.first_content as usize..tile.end_content as usize] {
                let needed = state.tree.prerequisite(rep).filter(|p| self.tile_of[p.index()] != id);
                if let (true, Some(p)) = (state.status(rep) != Status::Absent, needed) {
                    self.dependants[p.index()] = if counting { self.dependants[p.index()] + 1 } else { 0 };
                }
            }
        }
    }

    /// False while a content is being decoded, or another one needs it.
    fn can_be_unloaded(&self, state: &ClientState, id: u32) -> bool {
        self.contents(id).iter().all(|&r| {
            let needed = self.dependants.get(r.index()).is_some_and(|&n| n > 0);
            !needed && !matches!(state.status(r), Status::Arrived | Status::Doomed)
        })
    }

    fn loaded_bytes(&self, state: &ClientState, id: u32) -> u64 {
        let resident = self.contents(id).iter().filter(|&&r| state.status(r) == Status::Resident);
        resident.map(|&r| state.tree.decoded_bytes(r)).sum()
    }

    fn bytes_freed(&self, state: &ClientState, id: u32) -> u64 {
        let asked = |r| state.status(r) == Status::InFlight || self.waiting.contains(&r);
        let in_flight = self.contents(id).iter().filter(|&&r| asked(r));
        self.loaded_bytes(state, id) + in_flight.map(|&r| state.request_bytes(r)).sum::<u64>()
    }

    /// Takes tiles out of the cache of which nothing is left.
    fn forget_absent(&mut self, state: &ClientState) {
        let mut cached = core::mem::take(&mut self.cached);
        cached.retain(|&id| {
            let is_here = |&r: &_| state.status(r) != Status::Absent || self.waiting.contains(&r);
            let present = self.visits[id as usize].failed || self.contents(id).iter().any(is_here);
            self.visits[id as usize].cached = present;
            present
        });
        self.cached = cached;
    }
}
