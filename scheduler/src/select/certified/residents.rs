//! What to give up when memory is full: least loss per byte first, without weighing thousands of residents at once.
//!
//! Every resident keeps the loss last seen for it. A few are estimated anew at each tick, in turn; when room is made, the
//! first is evaluated exactly, and goes only if it then still comes first.

use super::lanes::Lanes;
use super::search::{Ask, Search};
use super::standing::Standing;
use crate::benefit::element::Errors;
use crate::lod_tree::RepId;
use crate::select::discard::Victim;
use crate::sparse::IdMap;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Residents looked at to make room once.
const LOOKS_MAX: usize = 48;
/// Residents that go together at most when memory shrinks.
const BATCH: usize = 4096;
/// Estimates at one tick: the share of the residents, and their least and largest number.
const TURN: (usize, usize, usize) = (8, 16, 160);

/// Whether a resident may be discarded.
pub type MayGo<'a> = &'a dyn Fn(RepId) -> bool;

#[derive(Clone, Copy, Debug)]
struct Slot {
    rep: RepId,
    /// ΔJ per decoded byte, as last seen.
    loss_per_byte: f64,
    /// When it was last seen to show something in the nearest predicted view, counted in samplings.
    last_used: u32,
    /// The sampling that the loss is from; 0 before the first.
    of: u32,
    /// How many changes of the plan an exact loss of this sampling knew.
    exact: Option<u32>,
}

/// Discards that make room, and what they cost.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sacrifice {
    /// In the order chosen.
    pub reps: Vec<RepId>,
    /// ΔJ lost with all of them together.
    pub loss: f64,
}

/// Room to be made.
#[derive(Clone, Copy, Debug)]
struct Room {
    bytes: u64,
    /// Losses are counted from then on, seconds.
    offset: f64,
    loss_max: f64,
    /// Residents looked at, and taken, at most.
    looks_max: usize,
    reps_max: usize,
    /// By loss per byte; otherwise by least recent use.
    planned: bool,
}

/// The planned representations with their losses.
#[derive(Clone, Debug, Default)]
pub struct Residents {
    slots: Vec<Slot>,
    place: IdMap<u32>,
    /// Whose turn it is.
    cursor: usize,
    sampling: u32,
    heap: BinaryHeap<Reverse<Victim>>,
    /// Whether the heap has been filled since the last sampling.
    filled: bool,
    weights: Vec<f64>,
}

impl Residents {
    /// Forgets all.
    pub fn clear(&mut self) {
        *self = Residents::default();
    }

    /// Whether nothing is planned.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Bytes that they occupy.
    pub fn heap_bytes(&self) -> usize {
        self.slots.capacity() * size_of::<Slot>()
            + self.place.allocation_size()
            + self.heap.capacity() * size_of::<Reverse<Victim>>()
    }

    /// `rep` is planned.
    pub fn added(&mut self, rep: RepId) {
        if self.place.contains_key(&rep.0) {
            return;
        }
        self.place.insert(rep.0, self.slots.len() as u32);
        let slot = Slot { rep, loss_per_byte: 0.0, last_used: self.sampling, of: 0, exact: None };
        self.slots.push(slot);
        if self.filled {
            self.enter(slot);
        }
    }

    /// `rep` is planned no more.
    pub fn removed(&mut self, rep: RepId) {
        let Some(place) = self.place.remove(&rep.0) else { return };
        self.slots.swap_remove(place as usize);
        if let Some(moved) = self.slots.get(place as usize) {
            self.place.insert(moved.rep.0, place);
        }
    }

    /// The objective has been sampled anew: what is known are guesses again.
    pub fn sampled(&mut self) {
        self.sampling += 1;
        self.filled = false;
    }

    fn enter(&mut self, slot: Slot) {
        let Slot { rep, loss_per_byte, last_used, .. } = slot;
        self.heap.push(Reverse(Victim { loss_per_byte, last_used, rep }));
    }

    /// Estimates the losses of those whose turn it is.
    pub fn turn(&mut self, ask: &Ask, standing: &Standing, offset: f64) {
        if self.slots.is_empty() {
            return;
        }
        let (share, least, most) = TURN;
        let count = (self.slots.len() / share).clamp(least, most).min(self.slots.len());
        ask.objective.weights(offset, &mut self.weights);
        for _ in 0..count {
            self.cursor = if self.cursor + 1 < self.slots.len() { self.cursor + 1 } else { 0 };
            // What is known exactly is not worth a guess.
            if self.slots[self.cursor].of != self.sampling {
                self.estimate(ask, standing, self.cursor);
            }
        }
    }

    /// Guesses a loss: the area that nothing beneath shows, at the middle of the box, in the views that it meets.
    fn estimate(&mut self, ask: &Ask, standing: &Standing, place: usize) {
        if ask.tree.has_directions() {
            self.estimate_by::<Errors>(ask, standing, place);
        } else {
            self.estimate_by::<f32>(ask, standing, place);
        }
    }

    fn estimate_by<L: Lanes>(&mut self, ask: &Ask, standing: &Standing, place: usize) {
        let Some(slot) = self.slots.get_mut(place) else { return };
        let (tree, rep) = (ask.tree, slot.rep);
        let node = tree.node_of(rep);
        let summary = standing.beneath(tree, node);
        let areas = tree.face_areas(node);
        let whole = areas.element_sum();
        let errors = L::of(tree, rep);
        let bare = if !errors.improves(&L::beneath(tree, standing, node)) || whole <= 0.0 {
            0.0
        } else {
            (1.0 - f64::from(summary.covered) / whole).clamp(0.0, 1.0)
        };
        let others = L::without(tree, standing.plan(), rep);
        let (mut loss, mut in_view) = (0.0, false);
        if bare > 0.0 && errors.improves(&others) {
            (loss, in_view) = ask.objective.guess(tree, &self.weights, node, &errors, &others);
        }
        slot.loss_per_byte = bare * loss / tree.decoded_bytes(rep).max(1) as f64;
        slot.of = self.sampling;
        slot.exact = None;
        if in_view {
            slot.last_used = self.sampling;
        }
    }

    /// Takes residents out of `standing` until `bytes` are freed, losses counted from `offset` on. `near` are residents
    /// whose loss has just fallen (those that a new representation replaces). Stops with `None`, and `standing` as before,
    /// when the loss exceeds `loss_max`, nothing is left, or too many had to be looked at. Without `planned` nothing is
    /// weighed: least recent use decides.
    #[expect(clippy::too_many_arguments, reason = "inputs of one greedy step; grouping them would only rename them")]
    pub fn choose(
        &mut self,
        ask: &Ask,
        search: &mut Search,
        standing: &mut Standing,
        near: &[RepId],
        bytes: u64,
        offset: f64,
        loss_max: f64,
        planned: bool,
        may_go: MayGo,
        members: &[RepId],
    ) -> Option<Sacrifice> {
        let room = Room { bytes, offset, loss_max, looks_max: LOOKS_MAX, reps_max: usize::MAX, planned };
        let (sacrifice, freed) = self.gather(ask, search, standing, near, room, may_go, members);
        (freed >= bytes && sacrifice.loss <= loss_max).then_some(sacrifice)
    }

    /// As [`Residents::choose`], whatever it loses: what has to go when memory shrinks. Fewer than `bytes` are freed where
    /// nothing else may go, or too much had to be looked at; what is left is asked for again.
    #[expect(clippy::too_many_arguments, reason = "inputs of one greedy step; grouping them would only rename them")]
    pub fn make_room(
        &mut self,
        ask: &Ask,
        search: &mut Search,
        standing: &mut Standing,
        bytes: u64,
        offset: f64,
        planned: bool,
        may_go: MayGo,
    ) -> Sacrifice {
        let looks_max = 4 * self.slots.len() + BATCH;
        let room = Room { bytes, offset, loss_max: f64::INFINITY, looks_max, reps_max: BATCH, planned };
        self.gather(ask, search, standing, &[], room, may_go, &[]).0
    }

    #[expect(clippy::too_many_arguments, reason = "inputs of one greedy step; grouping them would only rename them")]
    fn gather(
        &mut self,
        ask: &Ask,
        search: &mut Search,
        standing: &mut Standing,
        near: &[RepId],
        room: Room,
        may_go: MayGo,
        members: &[RepId],
    ) -> (Sacrifice, u64) {
        let Room { bytes, offset, loss_max, looks_max, reps_max, planned } = room;
        let tree = ask.tree;
        if !self.filled {
            self.filled = true;
            let mut victims = core::mem::take(&mut self.heap).into_vec();
            victims.clear();
            victims.extend(self.slots.iter().map(|slot| {
                let loss_per_byte = if planned { slot.loss_per_byte } else { 0.0 };
                Reverse(Victim { loss_per_byte, last_used: slot.last_used, rep: slot.rep })
            }));
            self.heap = BinaryHeap::from(victims);
        }
        ask.objective.weights(offset, &mut self.weights);
        let mut sacrifice = Sacrifice::default();
        let mut freed = 0;
        // With the loss last weighed, which holds until something above or beneath goes.
        let near = near.iter().copied().filter(|&r| planned && may_go(r));
        let mut near: Vec<(RepId, Option<Victim>)> = near.map(|rep| (rep, None)).collect();
        let mut aside = Vec::new();
        let related = |a: RepId, b: RepId| {
            let (a, b) = (tree.node_of(a), tree.node_of(b));
            tree.is_beneath(a, b) || tree.is_beneath(b, a)
        };
        let mut looks = 0;
        let weigh = |search: &mut Search, standing: &Standing, rep: RepId, last_used: u32| Victim {
            loss_per_byte: search.marginal(ask, standing, rep, offset) / tree.decoded_bytes(rep).max(1) as f64,
            last_used,
            rep,
        };
        while freed < bytes && looks < looks_max && sacrifice.reps.len() < reps_max {
            let mut first: Option<Victim> = None;
            while let Some(Reverse(victim)) = self.heap.pop() {
                let Some(&place) = self.place.get(&victim.rep.0) else { continue };
                if !standing.plan().contains(victim.rep) {
                    continue;
                }
                if !may_go(victim.rep) {
                    aside.push(victim);
                    continue;
                }
                looks += 1;
                let slot = self.slots[place as usize];
                // Exact as long as nothing above or beneath has come or gone since, nor is about to.
                let is_exact = slot.exact.is_some_and(|seen| !search.is_touched(tree, &[victim.rep], seen as usize))
                    && !members.iter().chain(&sacrifice.reps).any(|&r| related(r, victim.rep));
                if !planned || is_exact && slot.loss_per_byte == victim.loss_per_byte {
                    first = Some(victim);
                    break;
                }
                // First a fresh guess, then the exact loss, each only while it stays in front.
                let is_guess = slot.of != self.sampling;
                let fresh = if is_guess {
                    self.estimate(ask, standing, place as usize);
                    let slot = self.slots[place as usize];
                    Victim { loss_per_byte: slot.loss_per_byte, last_used: slot.last_used, rep: slot.rep }
                } else {
                    let fresh = weigh(search, standing, victim.rep, slot.last_used);
                    let slot = &mut self.slots[place as usize];
                    slot.loss_per_byte = fresh.loss_per_byte;
                    let apart = !members.iter().chain(&sacrifice.reps).any(|&r| related(r, victim.rep));
                    slot.exact = u32::try_from(search.changes()).ok().filter(|_| apart);
                    fresh
                };
                if !is_guess && self.heap.peek().is_none_or(|Reverse(next)| fresh <= *next) {
                    first = Some(fresh);
                    break;
                }
                self.heap.push(Reverse(fresh));
                if looks >= looks_max {
                    break;
                }
            }
            let mut nearest: Option<Victim> = None;
            // Nothing loses less than nothing.
            let is_free = first.is_some_and(|first| first.loss_per_byte <= 0.0);
            for (rep, known) in near.iter_mut().filter(|(r, _)| !is_free && standing.plan().contains(*r)) {
                let known = known.get_or_insert_with(|| {
                    looks += 1;
                    weigh(search, standing, *rep, 0)
                });
                nearest = Some(nearest.map_or(*known, |n: Victim| n.min(*known)));
            }
            let victim = match (first, nearest) {
                (Some(a), Some(b)) if b.loss_per_byte < a.loss_per_byte => {
                    self.heap.push(Reverse(a));
                    b
                }
                (Some(a), _) => a,
                (None, Some(b)) => b,
                (None, None) => break,
            };
            near.retain(|(rep, _)| *rep != victim.rep);
            for (_, known) in near.iter_mut().filter(|(rep, _)| related(*rep, victim.rep)) {
                *known = None;
            }
            sacrifice.loss += victim.loss_per_byte * tree.decoded_bytes(victim.rep).max(1) as f64;
            freed += tree.decoded_bytes(victim.rep);
            sacrifice.reps.push(victim.rep);
            standing.remove(tree, victim.rep);
            if sacrifice.loss > loss_max {
                break;
            }
        }
        self.heap.extend(aside.into_iter().map(Reverse));
        // What was taken out is only meant to go: whoever acts on it removes it for good.
        for &rep in &sacrifice.reps {
            standing.insert(tree, rep);
            if let Some(&place) = self.place.get(&rep.0) {
                self.enter(self.slots[place as usize]);
            }
        }
        (sacrifice, freed)
    }
}
