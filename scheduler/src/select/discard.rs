//! What to give up when memory is full: least loss per byte first, losses re-evaluated after each (\[ZK\] §4).

use super::horizon::Horizon;
use crate::benefit::coverage::Coverage;
use crate::lod_tree::{LodTree, RepId};
use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// A resident with the loss per byte last computed for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Victim {
    /// ΔJ per decoded byte that is lost with it.
    pub loss_per_byte: f64,
    /// Least recent use goes first among equals.
    pub last_used: u32,
    /// What would go.
    pub rep: RepId,
}

impl Eq for Victim {}

impl Ord for Victim {
    fn cmp(&self, other: &Victim) -> Ordering {
        self.loss_per_byte
            .total_cmp(&other.loss_per_byte)
            .then(self.last_used.cmp(&other.last_used))
            .then(self.rep.cmp(&other.rep))
    }
}

impl PartialOrd for Victim {
    fn partial_cmp(&self, other: &Victim) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// Residents by loss per byte. While things are only discarded, losses only grow (B is submodular), so a stale entry
/// is too low and re-evaluating the first until it stays first is exact.
#[derive(Clone, Debug, Default)]
pub struct Victims {
    heap: BinaryHeap<Reverse<Victim>>,
}

/// Discards that make room, and what they cost.
#[derive(Clone, Debug, Default)]
pub struct Sacrifice {
    /// In the order chosen.
    pub reps: Vec<RepId>,
    /// ΔJ lost with all of them together.
    pub loss: f64,
    /// Decoded bytes that they free.
    pub bytes: u64,
}

impl Victims {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.heap.clear();
    }

    /// Enters a resident.
    pub fn push(&mut self, victim: Victim) {
        self.heap.push(Reverse(victim));
    }

    /// Takes residents out of `planned` until `bytes` are freed, losses counted from `offset` on. `extra` are residents
    /// whose loss has just fallen (those that a new representation replaces). Stops with `None`, and `planned` as
    /// before, when the loss exceeds `loss_max` or nothing is left. `may_go` says what may be discarded.
    #[expect(clippy::too_many_arguments, reason = "inputs of one greedy step; grouping them would only rename them")]
    pub fn choose(
        &mut self,
        tree: &LodTree,
        horizon: &Horizon,
        planned: &mut Coverage,
        extra: &[RepId],
        bytes: u64,
        offset: f64,
        loss_max: f64,
        last_used: impl Fn(RepId) -> u32 + Copy,
        may_go: impl Fn(RepId) -> bool,
    ) -> Option<Sacrifice> {
        let mut sacrifice = Sacrifice::default();
        let weigh = |planned: &mut Coverage, rep: RepId| Victim {
            loss_per_byte: horizon.marginal(tree, planned, rep, offset) / tree.decoded_bytes(rep).max(1) as f64,
            last_used: last_used(rep),
            rep,
        };
        let mut near: Vec<RepId> = extra.iter().copied().filter(|&r| may_go(r)).collect();
        let mut fits = true;
        while sacrifice.bytes < bytes {
            // The first of the heap, re-evaluated until it stays first.
            let mut first = None;
            while let Some(Reverse(stale)) = self.heap.pop() {
                if !may_go(stale.rep) || !planned.contains(stale.rep) {
                    continue;
                }
                let fresh = weigh(planned, stale.rep);
                if self.heap.peek().is_none_or(|Reverse(next)| fresh <= *next) {
                    first = Some(fresh);
                    break;
                }
                self.heap.push(Reverse(fresh));
            }
            let mut nearest = None;
            for &rep in near.iter() {
                if planned.contains(rep) {
                    let fresh = weigh(planned, rep);
                    nearest = Some(nearest.map_or(fresh, |n: Victim| n.min(fresh)));
                }
            }
            let victim = match (first, nearest) {
                (Some(a), Some(b)) if b < a => {
                    self.heap.push(Reverse(a));
                    b
                }
                (Some(a), _) => a,
                (None, Some(b)) => b,
                (None, None) => {
                    fits = false;
                    break;
                }
            };
            near.retain(|&r| r != victim.rep);
            sacrifice.loss += victim.loss_per_byte * tree.decoded_bytes(victim.rep).max(1) as f64;
            sacrifice.bytes += tree.decoded_bytes(victim.rep);
            sacrifice.reps.push(victim.rep);
            planned.remove(tree, victim.rep);
            if sacrifice.loss > loss_max {
                fits = false;
                break;
            }
        }
        if fits {
            return Some(sacrifice);
        }
        self.restore(tree, horizon, planned, &sacrifice.reps, offset, last_used);
        None
    }

    /// Undoes a choice: the discards are planned to stay again, with their losses as they are now.
    pub fn restore(
        &mut self,
        tree: &LodTree,
        horizon: &Horizon,
        planned: &mut Coverage,
        reps: &[RepId],
        offset: f64,
        last_used: impl Fn(RepId) -> u32,
    ) {
        for &rep in reps {
            planned.insert(tree, rep);
        }
        for &rep in reps {
            let loss = horizon.marginal(tree, planned, rep, offset);
            let loss_per_byte = loss / tree.decoded_bytes(rep).max(1) as f64;
            self.push(Victim { loss_per_byte, last_used: last_used(rep), rep });
        }
    }
}
