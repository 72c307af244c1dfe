//! What the client was told to let go, and of which events may still be on their way.

use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use std::collections::{BTreeMap, VecDeque};

/// How long events may be on their way, ns.
const KEPT_NS: u64 = 60_000_000_000;
/// How many are remembered; the oldest are forgotten first.
const KEPT_MAX: usize = 4096;

/// What was cancelled or discarded in the last minute.
#[derive(Clone, Debug, Default)]
pub(super) struct LetGo {
    reps: BTreeMap<u32, Entry>,
    /// In order of time; entries that were let go again since are stale.
    order: VecDeque<(Time, u32)>,
}

#[derive(Clone, Debug)]
struct Entry {
    at: Time,
    /// What the request was to free on its arrival.
    doomed: Vec<RepId>,
}

impl LetGo {
    pub(super) fn insert(&mut self, rep: RepId, at: Time, doomed: Vec<RepId>) {
        self.reps.insert(rep.0, Entry { at, doomed });
        self.order.push_back((at, rep.0));
        while self.order.len() > KEPT_MAX {
            self.forget_oldest();
        }
    }

    pub(super) fn contains(&self, rep: RepId) -> bool {
        self.reps.contains_key(&rep.0)
    }

    /// What is gone at the client because the cancelled request had arrived there; once.
    pub(super) fn take_doomed(&mut self, rep: RepId) -> Vec<RepId> {
        self.reps.get_mut(&rep.0).map(|entry| core::mem::take(&mut entry.doomed)).unwrap_or_default()
    }

    /// Forgets what was let go too long before `now`.
    pub(super) fn forget_before(&mut self, now: Time) {
        while self.order.front().is_some_and(|(at, _)| now.since(*at).0 > KEPT_NS) {
            self.forget_oldest();
        }
    }

    fn forget_oldest(&mut self) {
        if let Some((at, rep)) = self.order.pop_front()
            && self.reps.get(&rep).is_some_and(|entry| entry.at == at)
        {
            self.reps.remove(&rep);
        }
    }

    /// Keeps what was let go, for its word may have been lost with the connection; not what was to be freed, for the client
    /// has said anew what it holds.
    pub(super) fn forget_doomed(&mut self) {
        self.reps.values_mut().for_each(|entry| entry.doomed = Vec::new());
    }

    pub(super) fn heap_bytes(&self) -> usize {
        let lists: usize = self.reps.values().map(|entry| entry.doomed.capacity() * size_of::<RepId>()).sum();
        lists + map_bytes::<u32, Entry>(self.reps.len()) + self.order.capacity() * size_of::<(Time, u32)>()
    }
}

/// Bytes that a `BTreeMap` of so many entries occupies at most: its nodes hold 11 entries and are at least half full, but
/// for the root.
pub(super) fn map_bytes<K, V>(entries: usize) -> usize {
    const NODE: usize = 11;
    if entries == 0 {
        return 0;
    }
    // Keys, values, links; an inner node has 12 edges more, and there is at most one for every 6 others.
    let node = NODE * (size_of::<K>() + size_of::<V>()) + 32 + 12 * size_of::<usize>();
    (entries / 5 + 2) * node
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_forgets_after_a_minute_and_beyond_its_bound() {
        let mut let_go = LetGo::default();
        let_go.insert(RepId(1), Time(0), vec![RepId(7)]);
        let_go.insert(RepId(2), Time(KEPT_NS / 2), Vec::new());
        let_go.insert(RepId(1), Time(KEPT_NS / 2), Vec::new());
        let_go.forget_before(Time(KEPT_NS + 1));
        assert!(let_go.contains(RepId(1)) && let_go.contains(RepId(2)));
        let_go.forget_before(Time(2 * KEPT_NS));
        assert!(!let_go.contains(RepId(1)) && !let_go.contains(RepId(2)));
        for rep in 0..3 * KEPT_MAX as u32 {
            let_go.insert(RepId(rep), Time(3 * KEPT_NS), Vec::new());
        }
        assert_eq!((let_go.reps.len(), let_go.order.len()), (KEPT_MAX, KEPT_MAX));
        assert!(!let_go.contains(RepId(0)));
    }
}
