//! The choice by sampling: one pass over the patches of every predicted view gives every candidate's gain.
//!
//! Candidates wait in a heap; the first is re-evaluated only if the plan has changed above or beneath it since, which under
//! partial refinement is exact, because gains only fall while the planned set grows. It knows sibling groups (atomic
//! refinement), which branch and bound does not.

use super::closure::{closure, coarsest, coarsest_facing, common_ancestor, needed_by};
use super::context::{Choice, Choose, Context, Discarded, Lookahead, first_pointless, predicted_share};
use super::settings::Discards;
use crate::benefit::accuracy::accuracy;
use crate::benefit::coverage::{Coverage, Refinement};
use crate::benefit::element::{self, ELEMENTS};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::select::discard::{Victim, Victims};
use crate::select::horizon::{Horizon, HorizonSettings, Worst};
use crate::state::{ClientState, Status};
use rustc_hash::FxHashMap;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Least and greatest gain beneath a group, share of a steradian, at which it is not opened.
const TOLERANCES: (f64, f64) = (1e-7, 2e-3);

/// Candidates whose discards are worked out for one decision; the rest are worse even without any loss.
const SWAPS_WEIGHED: usize = 12;

/// A closure waiting for its turn. The ratio is an upper bound until it is evaluated for the present plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Candidate {
    ratio: f64,
    rep: RepId,
    /// ΔJ, as of `seen`.
    gain: f64,
    /// How many changes of the plan the evaluation knew; `None` before the first.
    seen: Option<usize>,
}

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Candidate) -> Ordering {
        self.ratio.total_cmp(&other.ratio).then(other.rep.cmp(&self.rep))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Candidate) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The sampled choice.
pub(super) struct Sampled {
    horizon: Horizon,
    /// Nodes at which the plan has changed since the objective was sampled.
    changes: Vec<NodeId>,
    candidates: BinaryHeap<Candidate>,
    victims: Victims,
    victims_known: bool,
    /// The planned set; `None` when it must be read from the state.
    plan: Option<Coverage>,
    /// When each representation was last the best of something in the nearest sampled view, counted in samplings.
    last_used: FxHashMap<RepId, u32>,
    uses: u32,
    gain: FxHashMap<RepId, f64>,
    /// The keys of `gain`, in the order in which they came.
    touched: Vec<RepId>,
    /// Running mean of the gains of what was chosen; halved when nothing was found to gain.
    typical_gain: f64,
}

impl Default for Sampled {
    fn default() -> Sampled {
        Sampled {
            horizon: Horizon::default(),
            changes: Vec::new(),
            candidates: BinaryHeap::new(),
            victims: Victims::default(),
            victims_known: false,
            plan: None,
            last_used: FxHashMap::default(),
            uses: 0,
            gain: FxHashMap::default(),
            touched: Vec::new(),
            typical_gain: 5e-3,
        }
    }
}

impl Sampled {
    fn sample_with(&mut self, cx: &Context, plan: &Coverage, ahead: &Lookahead) {
        let (tree, s) = (cx.state.tree, cx.settings);
        let horizon = HorizonSettings {
            alpha: ahead.alpha,
            attenuation: s.attenuation,
            tolerance: (s.grouping * self.typical_gain).clamp(TOLERANCES.0, TOLERANCES.1),
            cut: s.cut,
        };
        self.horizon.cameras = ahead.cameras;
        self.horizon.make(tree, plan, &ahead.paths, &ahead.bounds, Worst::Several(&ahead.worst), &horizon);
        self.changes.clear();
        self.uses += 1;
        self.victims.clear();
        self.victims_known = false;

        // One pass over all patches gives every candidate's gain, with the earliest arrival any could have.
        let earliest = cx.arrival(0);
        if tree.has_directions() {
            self.gather_by_element(tree, plan, earliest);
        } else {
            self.gather(tree, plan, earliest);
        }
        self.rank(cx, plan);
    }

    /// Gains of all candidates, and what is the best of something in a present view.
    fn gather(&mut self, tree: &LodTree, plan: &Coverage, earliest: f64) {
        let (gain, touched, last_used, uses) = (&mut self.gain, &mut self.touched, &mut self.last_used, self.uses);
        self.horizon.for_each(tree, plan, earliest, |patch, share, chain, present| {
            if let (true, Some(owner)) = (present, chain.owner) {
                for rep in tree.own(owner) {
                    if plan.contains(rep) {
                        last_used.insert(rep, uses);
                    }
                }
            }
            if share <= 0.0 {
                return;
            }
            let now_shown = accuracy(f64::from(chain.best), patch.sharpness);
            if now_shown >= 1.0 {
                return;
            }
            for node in tree.ancestors(patch.node) {
                if tree.errors_fall() && chain.owner.is_some_and(|owner| node < owner) {
                    break;
                }
                for rep in tree.own(node) {
                    let error = tree.error(rep);
                    if error < f64::from(chain.best) && !plan.contains(rep) {
                        let added = accuracy(error, patch.sharpness) - now_shown;
                        let sum = gain.entry(rep).or_insert_with(|| {
                            touched.push(rep);
                            0.0
                        });
                        *sum += share * patch.weight * added;
                    }
                }
            }
        });
    }

    /// As [`Sampled::gather`], by element.
    fn gather_by_element(&mut self, tree: &LodTree, plan: &Coverage, earliest: f64) {
        let (gain, touched, last_used, uses) = (&mut self.gain, &mut self.touched, &mut self.last_used, self.uses);
        self.horizon.for_each_by_element(tree, plan, earliest, |patch, share, chain, present| {
            if present {
                for s in (0..ELEMENTS).filter(|&s| chain.shares[s] > 0.0) {
                    last_used.extend(chain.shown.rep(s).map(|rep| (rep, uses)));
                }
            }
            if share <= 0.0 {
                return;
            }
            for rep in tree.ancestors(patch.node).flat_map(|node| tree.own(node)).filter(|&rep| !plan.contains(rep)) {
                let errors = element::errors(tree, rep);
                let added = element::mean_gain(&chain.shares, &errors, &chain.shown.errors, patch.sharpness);
                if added > 0.0 {
                    let sum = gain.entry(rep).or_insert_with(|| {
                        touched.push(rep);
                        0.0
                    });
                    *sum += share * patch.weight * added;
                }
            }
        });
    }

    /// Turns the gains into candidates.
    fn rank(&mut self, cx: &Context, plan: &Coverage) {
        let (state, tree) = (cx.state, cx.state.tree);
        let alone = !tree.has_prerequisites() && plan.refinement() == Refinement::Partial;
        let mut ranked = core::mem::take(&mut self.candidates).into_vec();
        ranked.clear();
        for &rep in &self.touched {
            if !cx.may_fetch(rep) {
                continue;
            }
            let ratio = if alone {
                self.gain[&rep] / cx.cost(&[rep])
            } else {
                let members = closure(state, plan, rep);
                members.iter().map(|m| self.gain.get(m).copied().unwrap_or(0.0)).sum::<f64>() / cx.cost(&members)
            };
            if ratio > 0.0 {
                ranked.push(Candidate { ratio, rep, gain: 0.0, seen: None });
            }
        }
        self.candidates = BinaryHeap::from(ranked);
        self.touched.clear();
        self.gain.clear();
    }

    /// ΔJ of the closure beside the plan, counted from `offset`.
    fn closure_gain(&self, state: &ClientState, plan: &mut Coverage, members: &[RepId], offset: f64) -> f64 {
        let tree = state.tree;
        if let [only] = members
            && plan.refinement() == Refinement::Partial
        {
            return self.horizon.marginal(tree, plan, *only, offset);
        }
        if plan.refinement() == Refinement::Partial {
            let mut sum = 0.0;
            for &member in members {
                sum += self.horizon.marginal(tree, plan, member, offset);
                plan.insert(tree, member);
            }
            for &member in members {
                plan.remove(tree, member);
            }
            return sum;
        }
        let top = common_ancestor(state, members);
        let before = self.horizon.benefit_beneath(tree, plan, top, offset);
        for &member in members {
            plan.insert(tree, member);
        }
        let after = self.horizon.benefit_beneath(tree, plan, top, offset);
        for &member in members {
            plan.remove(tree, member);
        }
        after - before
    }

    /// Ranks the residents by what discarding them would lose.
    fn know_victims(&mut self, cx: &Context, plan: &Coverage, offset: f64) {
        let state = cx.state;
        if self.victims_known {
            return;
        }
        self.victims_known = true;
        let tree = state.tree;
        let planned = cx.settings.discards == Discards::Planned;
        if planned && tree.has_directions() {
            self.losses_by_element(tree, plan, offset);
        }
        // Singly, only the best of each patch loses anything: the difference to the second best. One pass adds it up.
        let gain = &mut self.gain;
        let by_node = planned && !tree.has_directions();
        self.horizon.for_each(tree, plan, offset, |patch, share, chain, _| {
            let Some(owner) = chain.owner.filter(|_| by_node && share > 0.0) else { return };
            let mut second = if tree.errors_fall() {
                tree.parent(owner).map_or(f32::INFINITY, |p| plan.best_above(tree, p))
            } else {
                let others = tree.ancestors(patch.node).filter(|&n| n != owner);
                others.fold(f32::INFINITY, |second, n| second.min(plan.best_at(n)))
            };
            let mut first = None;
            for rep in tree.own(owner).filter(|&r| plan.contains(r)) {
                if first.is_none() && tree.error(rep) as f32 == chain.best {
                    first = Some(rep);
                } else {
                    second = second.min(tree.error(rep) as f32);
                }
            }
            let lost = accuracy(f64::from(chain.best), patch.sharpness) - accuracy(f64::from(second), patch.sharpness);
            if let Some(rep) = first.filter(|_| lost > 0.0) {
                *gain.entry(rep).or_insert(0.0) += share * patch.weight * lost;
            }
        });
        for rep in state.residents() {
            let lost = gain.get(&rep).copied().unwrap_or(0.0);
            let loss_per_byte = lost / tree.decoded_bytes(rep).max(1) as f64;
            let last_used = self.last_used.get(&rep).copied().unwrap_or(0);
            self.victims.push(Victim { loss_per_byte, last_used, rep });
        }
        gain.clear();
    }

    /// What discarding each planned representation would lose by itself: of each element only its best loses, down to the
    /// second best.
    fn losses_by_element(&mut self, tree: &LodTree, plan: &Coverage, offset: f64) {
        let gain = &mut self.gain;
        self.horizon.for_each_by_element(tree, plan, offset, |patch, share, chain, _| {
            if share <= 0.0 {
                return;
            }
            let mut second = element::NOTHING;
            let held = tree.ancestors(patch.node).flat_map(|node| tree.own(node)).filter(|&rep| plan.contains(rep));
            for rep in held {
                let errors = element::errors(tree, rep);
                for s in (0..ELEMENTS).filter(|&s| chain.shown.rep(s) != Some(rep)) {
                    second[s] = second[s].min(errors[s]);
                }
            }
            for s in (0..ELEMENTS).filter(|&s| chain.shares[s] > 0.0) {
                let at = |error: f32| accuracy(f64::from(error), patch.sharpness);
                let lost = at(chain.shown.errors[s]) - at(second[s]);
                if let Some(rep) = chain.shown.rep(s).filter(|_| lost > 0.0) {
                    *gain.entry(rep).or_insert(0.0) += share * patch.weight * chain.shares[s] * lost;
                }
            }
        });
    }

    /// The best closure that gains, with its discards; the plan is as before.
    fn choose_with(&mut self, cx: &Context, plan: &mut Coverage) -> Option<Choice> {
        let state = cx.state;
        let tree = state.tree;
        let mut best: Option<Choice> = None;
        let mut weighed = 0;
        let mut passed_over = Vec::new();
        while let Some(top) = self.candidates.pop() {
            if best.as_ref().is_some_and(|b| b.ratio >= top.ratio) || weighed >= SWAPS_WEIGHED {
                self.candidates.push(top);
                break;
            }
            if state.status(top.rep) != Status::Absent || plan.contains(top.rep) {
                continue;
            }
            let members = closure(state, plan, top.rep);
            if !members.iter().all(|&m| cx.may_fetch(m)) {
                continue;
            }
            let bytes: u64 = members.iter().map(|&m| tree.wire_bytes(m)).sum();
            let offset = cx.arrival(bytes);
            let gain = match top.seen {
                Some(seen) if !self.is_touched(state, &members, seen) => top.gain,
                _ => self.closure_gain(state, plan, &members, offset),
            };
            let seen = Some(self.changes.len());
            let cost = cx.cost(&members);
            let ratio = gain / cost;
            if ratio <= 0.0 {
                continue;
            }
            // Below the next one's bound? Then it has to wait for its turn again.
            // Of equals, the lower id goes first.
            let evaluated = Candidate { ratio, gain, seen, ..top };
            if ratio < top.ratio && self.candidates.peek().is_some_and(|next| *next > evaluated) {
                self.candidates.push(evaluated);
                continue;
            }
            let need: u64 = members.iter().map(|&m| state.request_bytes(m)).sum();
            let free = state.free_bytes();
            if need <= free {
                if best.as_ref().is_none_or(|b| ratio > b.ratio) {
                    best =
                        Some(Choice { ratio, gain, rep: top.rep, members, discards: Vec::new(), predicted_share: 0.0 });
                } else {
                    passed_over.push(Candidate { ratio, gain, seen, ..top });
                }
                break;
            }
            weighed += 1;
            self.know_victims(cx, plan, offset);
            match self.swap(cx, plan, &members, need - free, gain, offset) {
                Some((discards, loss)) => {
                    let net = (gain - loss) / cost;
                    let candidate = Candidate { ratio: net, gain, seen, ..top };
                    if best.as_ref().is_none_or(|b| net > b.ratio) {
                        if let Some(b) = best.replace(Choice {
                            ratio: net,
                            gain,
                            rep: top.rep,
                            members,
                            discards,
                            predicted_share: 0.0,
                        }) {
                            passed_over.push(Candidate { ratio: b.ratio, rep: b.rep, gain: b.gain, seen });
                        }
                    } else {
                        passed_over.push(candidate);
                    }
                }
                // It cannot gain before the next sampling; discards since then only make it worse.
                None => continue,
            }
        }
        self.candidates.extend(passed_over);
        if let Some(choice) = &mut best {
            // After all time, only the terms without an interval count.
            let worst = self.closure_gain(state, plan, &choice.members, f64::INFINITY);
            choice.predicted_share = predicted_share(choice.gain, worst);
        }
        best
    }

    /// Whether the plan has changed above or beneath one of `members` since the first `seen` changes. Under atomic
    /// refinement a change reaches across its siblings, so any counts.
    fn is_touched(&self, state: &ClientState, members: &[RepId], seen: usize) -> bool {
        let tree = state.tree;
        let changed = &self.changes[seen..];
        if state.planned().refinement() == Refinement::Atomic {
            return !changed.is_empty();
        }
        members
            .iter()
            .map(|&m| tree.node_of(m))
            .any(|node| changed.iter().any(|&other| tree.is_beneath(node, other) || tree.is_beneath(other, node)))
    }

    /// Discards for a closure and their joint loss, or `None` if the swap does not gain. The plan is as before.
    fn swap(
        &mut self,
        cx: &Context,
        plan: &mut Coverage,
        members: &[RepId],
        bytes: u64,
        gain: f64,
        offset: f64,
    ) -> Option<(Vec<RepId>, f64)> {
        let (state, tree) = (cx.state, cx.state.tree);
        for &member in members {
            plan.insert(tree, member);
        }
        let may_go = |rep: RepId| {
            state.status(rep) == Status::Resident && !state.is_needed(rep) && !needed_by(state, rep, members)
        };
        let last_used = &self.last_used;
        let used = |rep: RepId| last_used.get(&rep).copied().unwrap_or(0);
        let planned = cx.settings.discards == Discards::Planned;
        let mut replaced = Vec::new();
        if planned {
            // A new representation takes over from the nearest owner above it: that one's loss falls.
            for &member in members {
                let held = |n: &NodeId| tree.own(*n).any(|r| plan.contains(r) && !members.contains(&r));
                if let Some(owner) = tree.ancestors(tree.node_of(member)).find(held) {
                    replaced.extend(tree.own(owner).filter(|r| plan.contains(*r) && !members.contains(r)));
                }
            }
            replaced.sort_unstable();
            replaced.dedup();
        }
        let limit = if planned { gain / (1.0 + cx.settings.hysteresis) } else { f64::INFINITY };
        let empty = Horizon::default();
        // Without planning, nothing is lost as far as the policy knows: only recency orders the victims.
        let horizon = if planned { &self.horizon } else { &empty };
        let chosen = self.victims.choose(tree, horizon, plan, &replaced, bytes, offset, limit, used, may_go);
        let swap = chosen.filter(|s| !planned || gain > (1.0 + cx.settings.hysteresis) * s.loss).map(|s| {
            self.victims.restore(tree, horizon, plan, &s.reps, offset, used);
            (s.reps, s.loss)
        });
        for &member in members {
            plan.remove(tree, member);
        }
        swap
    }

    fn cover_with(&mut self, cx: &Context, plan: &Coverage) -> Option<RepId> {
        let (state, tree) = (cx.state, cx.state.tree);
        let (gain, touched) = (&mut self.gain, &mut self.touched);
        let mut add = |rep: Option<RepId>, weight: f64| {
            if let Some(rep) = rep {
                let sum = gain.entry(rep).or_insert_with(|| {
                    touched.push(rep);
                    0.0
                });
                *sum += weight;
            }
        };
        if tree.has_directions() {
            self.horizon.for_each_by_element(tree, plan, 0.0, |patch, _, chain, present| {
                let shown = (0..ELEMENTS).any(|s| chain.shares[s] > 0.0 && chain.shown.rep(s).is_some());
                if present && !shown {
                    add(coarsest_facing(tree, patch.node, &chain.shares), patch.weight);
                }
            });
        } else {
            self.horizon.for_each(tree, plan, 0.0, |patch, _, chain, present| {
                if present && chain.owner.is_none() {
                    add(coarsest(tree, patch.node), patch.weight);
                }
            });
        }
        let per_byte = |r: RepId| gain[&r] / tree.wire_bytes(r) as f64;
        let best = touched
            .iter()
            .copied()
            .filter(|&r| cx.may_fetch(r) && state.has_prerequisite(r))
            .filter(|&r| state.request_bytes(r) <= state.free_bytes())
            .max_by(|&a, &b| per_byte(a).total_cmp(&per_byte(b)).then(b.cmp(&a)));
        touched.clear();
        gain.clear();
        best
    }
}

impl Choose for Sampled {
    fn sample(&mut self, cx: &Context, ahead: &Lookahead) {
        let plan = self.plan.take().unwrap_or_else(|| cx.state.hypothetical());
        self.sample_with(cx, &plan, ahead);
        self.plan = Some(plan);
    }

    fn added(&mut self, cx: &Context, rep: RepId) {
        self.changes.push(cx.state.tree.node_of(rep));
        if let Some(plan) = &mut self.plan {
            plan.insert(cx.state.tree, rep);
        }
    }

    fn removed(&mut self, cx: &Context, rep: RepId) {
        self.changes.push(cx.state.tree.node_of(rep));
        if let Some(plan) = &mut self.plan {
            plan.remove(cx.state.tree, rep);
        }
    }

    fn forget(&mut self) {
        self.plan = None;
    }

    fn cover(&mut self, cx: &Context) -> Option<RepId> {
        let plan = self.plan.take()?;
        let rep = self.cover_with(cx, &plan);
        self.plan = Some(plan);
        rep
    }

    fn pointless_request(&mut self, cx: &Context) -> Option<RepId> {
        let mut plan = self.plan.take()?;
        let best = self.candidates.peek().map_or(0.0, |c| c.ratio);
        let offset = cx.arrival(0);
        let found = first_pointless(cx, |rep, seconds| {
            self.horizon.marginal(cx.state.tree, &mut plan, rep, offset) / seconds < 0.1 * best
        });
        self.plan = Some(plan);
        found
    }

    fn make_room(&mut self, cx: &Context, bytes: u64) -> Discarded {
        let (state, tree) = (cx.state, cx.state.tree);
        let Some(mut plan) = self.plan.take() else { return Discarded::default() };
        let offset = cx.arrival(0);
        // What could not go before may now, and has been left out since.
        self.victims.clear();
        self.victims_known = false;
        self.know_victims(cx, &plan, offset);
        let may_go = |rep: RepId| state.status(rep) == Status::Resident && !state.is_needed(rep);
        let all: u64 = state.residents().filter(|&rep| may_go(rep)).map(|rep| tree.decoded_bytes(rep)).sum();
        let last_used = &self.last_used;
        let used = |rep: RepId| last_used.get(&rep).copied().unwrap_or(0);
        let empty = Horizon::default();
        let horizon = if cx.settings.discards == Discards::Planned { &self.horizon } else { &empty };
        let bytes = bytes.min(all);
        let gone = self.victims.choose(tree, horizon, &mut plan, &[], bytes, offset, f64::INFINITY, used, may_go);
        let gone = gone.unwrap_or_default();
        self.victims.restore(tree, horizon, &mut plan, &gone.reps, offset, used);
        self.plan = Some(plan);
        Discarded { reps: gone.reps, loss: gone.loss }
    }

    fn loss(&mut self, cx: &Context, rep: RepId) -> f64 {
        let Some(mut plan) = self.plan.take() else { return 0.0 };
        let loss = self.horizon.marginal(cx.state.tree, &mut plan, rep, cx.arrival(0));
        self.plan = Some(plan);
        loss
    }

    fn choose(&mut self, cx: &Context) -> Option<Choice> {
        let mut plan = self.plan.take()?;
        let choice = self.choose_with(cx, &mut plan);
        self.plan = Some(plan);
        match &choice {
            Some(choice) => self.typical_gain += 0.1 * (choice.gain - self.typical_gain),
            None if cx.due => self.typical_gain = (0.5 * self.typical_gain).max(TOLERANCES.0),
            None => {}
        }
        choice
    }
}
