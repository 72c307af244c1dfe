//! `foresight`: the objective of ARCHITECTURE.md with everything in it.
//!
//! Rank every closure by net return per second of link occupancy,
//!
//! ```text
//! G = Σ_terms share(t_a) · w · (a(R∖X ∪ r) − a(R)) ,   ratio = G / (c·M + o)
//! ```
//!
//! with the predicted paths weighing α and the worst case 1 − α; fetch the best while the pipeline has room; when memory
//! is full, grow the discards X by least loss per byte and swap only if the gain exceeds (1+η) times their loss; wait if
//! nothing gains. The terms are sampled anew every D seconds (\[ZK\] §6); between, gains are re-evaluated lazily, which is
//! exact because they only fall while the resident set grows. What failed is asked for again after a while that doubles
//! with each failure.

mod alpha;
mod closure;
mod retry;
mod settings;

pub use alpha::{AT_LEAST, AlphaReport, AlphaRule, Constraint};
pub use settings::{Discards, ForesightSettings};

use super::Policy;
use crate::benefit::accuracy::accuracy;
use crate::benefit::coverage::{Coverage, Refinement};
use crate::lod_tree::{NodeId, RepId};
use crate::predict::Predictor;
use crate::predict::motion::Motion;
use crate::scheduler::Action;
use crate::select::discard::{Victim, Victims};
use crate::select::horizon::{Horizon, HorizonSettings};
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use alpha::{Alpha, Sampled};
use closure::{closure, common_ancestor, needed_by};
use retry::Retries;
use std::cmp::Ordering;
use std::collections::{BinaryHeap, VecDeque};

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

/// A closure chosen, with what has to go for it.
#[derive(Clone, Debug)]
struct Choice {
    ratio: f64,
    gain: f64,
    rep: RepId,
    members: Vec<RepId>,
    discards: Vec<RepId>,
}

/// When `bytes` more than what is outstanding will have come, seconds from now; the true link, for a simulator to give.
pub type ArrivalOracle = Box<dyn Fn(Time, u64) -> f64 + Send>;

/// The policy.
pub struct Foresight {
    name: String,
    oracle: Option<ArrivalOracle>,
    settings: ForesightSettings,
    predictor: Box<dyn Predictor>,
    motion: Motion,
    alpha: Alpha,
    horizon: Horizon,
    sampled: Option<Time>,
    /// Outstanding when the objective was sampled.
    queued_bytes: u64,
    /// Nodes at which the plan has changed since.
    changes: Vec<NodeId>,
    candidates: BinaryHeap<Candidate>,
    victims: Victims,
    victims_known: bool,
    /// The planned set as this policy's own actions have left it; `None` when it must be read from the state.
    plan: Option<Coverage>,
    /// Rest of a closure that has been begun, and discards that must come first.
    committed: VecDeque<Action>,
    /// When each representation was last the best of something in the nearest sampled view, counted in samplings.
    last_used: Vec<u32>,
    uses: u32,
    gain: Vec<f64>,
    touched: Vec<RepId>,
    covered: bool,
    retries: Retries,
    mean_fetch_bytes: f64,
    /// Running mean of the gains of what was chosen; halved when nothing was found to gain.
    typical_gain: f64,
}

impl Foresight {
    /// The policy under `name`.
    pub fn new(name: impl Into<String>, settings: ForesightSettings) -> Foresight {
        Foresight::with_predictor(name, settings, settings.predictor.build())
    }

    /// With a predictor of one's own: the simulator's `clairvoyant` knows the true path.
    pub fn with_predictor(
        name: impl Into<String>,
        settings: ForesightSettings,
        predictor: Box<dyn Predictor>,
    ) -> Foresight {
        Foresight {
            name: name.into(),
            oracle: None,
            settings,
            predictor,
            motion: Motion::default(),
            alpha: Alpha::new(settings.alpha_rule, settings.alpha),
            horizon: Horizon::default(),
            sampled: None,
            queued_bytes: 0,
            changes: Vec::new(),
            candidates: BinaryHeap::new(),
            victims: Victims::default(),
            victims_known: false,
            plan: None,
            committed: VecDeque::new(),
            last_used: Vec::new(),
            uses: 0,
            gain: Vec::new(),
            touched: Vec::new(),
            covered: false,
            retries: Retries::default(),
            mean_fetch_bytes: 0.0,
            typical_gain: 5e-3,
        }
    }

    /// Takes arrivals from `oracle` instead of the estimates of c and τ.
    pub fn with_oracle(mut self, oracle: ArrivalOracle) -> Foresight {
        self.oracle = Some(oracle);
        self
    }

    /// Seconds from the horizon's start until a closure of `bytes` requested there would be here. One moment for all
    /// candidates of a sampling: what is ranked together is compared alike, and gains between samplings change only
    /// where the plan has changed.
    fn arrival(&self, state: &ClientState, bytes: u64) -> f64 {
        if !self.settings.gains_from_arrival {
            return 0.0;
        }
        let bytes = self.queued_bytes + bytes;
        match (&self.oracle, self.sampled) {
            (Some(oracle), Some(sampled)) => oracle(sampled, bytes),
            _ => state.link.latency_s() + bytes as f64 / state.link.rate(),
        }
    }

    /// Samples the objective anew and ranks all candidates.
    fn sample(&mut self, state: &ClientState, plan: &mut Coverage, now: Time) {
        let Some(view) = state.view else { return };
        let tree = state.tree;
        let s = &self.settings;
        let typical = state.link.latency_s() + self.mean_fetch_bytes / state.link.rate();
        let epsilon = s.reuse_s.max(typical);
        let delta = s.horizon_s.max(4.0 * epsilon);
        let n = s.samples.max(1);
        let bounds: Vec<f64> = (0..=n).map(|i| delta * i as f64 / n as f64).collect();
        let middles: Vec<f64> = bounds.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
        let mut paths = self.predictor.predict(now, &middles);
        if paths.is_empty() {
            paths.push(crate::predict::PredictedPath { weight: 1.0, views: vec![view; n] });
        }
        let region = s.reach.region(self.motion.percentile(), epsilon);
        let (worst, cut, attenuation) = ([(1.0, view, region)], &s.cut, s.attenuation);
        let sampled = Sampled { now, paths: &paths, offsets: &middles, worst: &worst, cut, attenuation };
        let horizon = HorizonSettings {
            alpha: self.alpha.at(state, &sampled),
            attenuation: s.attenuation,
            tolerance: (s.tolerance * self.typical_gain).clamp(TOLERANCES.0, TOLERANCES.1),
            cut: s.cut,
        };
        self.horizon.make(tree, plan, &paths, &bounds, (&view, region), &horizon);
        self.sampled = Some(now);
        self.queued_bytes = state.outstanding_bytes();
        self.changes.clear();
        self.uses += 1;
        self.victims.clear();
        self.victims_known = false;

        // One pass over all patches gives every candidate's gain, with the earliest arrival any could have.
        let earliest = self.arrival(state, 0);
        self.gain.resize(tree.representations(), 0.0);
        self.last_used.resize(tree.representations(), 0);
        let (gain, touched, last_used, uses) = (&mut self.gain, &mut self.touched, &mut self.last_used, self.uses);
        self.horizon.for_each(tree, plan, earliest, |patch, share, chain, present| {
            if let (true, Some(owner)) = (present, chain.owner) {
                for rep in tree.own(owner) {
                    if plan.contains(rep) {
                        last_used[rep.index()] = uses;
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
                        if gain[rep.index()] == 0.0 {
                            touched.push(rep);
                        }
                        gain[rep.index()] += share * patch.weight * added;
                    }
                }
            }
        });
        let alone = !tree.has_prerequisites() && plan.refinement() == Refinement::Partial;
        let mut ranked = core::mem::take(&mut self.candidates).into_vec();
        ranked.clear();
        for &rep in &self.touched {
            if state.status(rep) != Status::Absent || !self.retries.allow(rep, now) {
                continue;
            }
            let ratio = if alone {
                self.gain[rep.index()] / self.cost(state, &[rep])
            } else {
                let members = closure(state, plan, rep);
                members.iter().map(|m| self.gain[m.index()]).sum::<f64>() / self.cost(state, &members)
            };
            if ratio > 0.0 {
                ranked.push(Candidate { ratio, rep, gain: 0.0, seen: None });
            }
        }
        self.candidates = BinaryHeap::from(ranked);
        for rep in self.touched.drain(..) {
            self.gain[rep.index()] = 0.0;
        }
    }

    /// Seconds of link that the closure occupies, c·M + o.
    fn cost(&self, state: &ClientState, members: &[RepId]) -> f64 {
        let bytes: u64 = members.iter().map(|&m| state.tree.wire_bytes(m)).sum();
        bytes as f64 / state.link.rate() + self.settings.request_cost_s * members.len() as f64
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
    fn know_victims(&mut self, state: &ClientState, plan: &Coverage, offset: f64) {
        if self.victims_known {
            return;
        }
        self.victims_known = true;
        let tree = state.tree;
        let planned = self.settings.discards == Discards::Planned;
        // Singly, only the best of each patch loses anything: the difference to the second best. One pass adds it up.
        let (gain, touched) = (&mut self.gain, &mut self.touched);
        self.horizon.for_each(tree, plan, offset, |patch, share, chain, _| {
            let Some(owner) = chain.owner.filter(|_| planned && share > 0.0) else { return };
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
                if gain[rep.index()] == 0.0 {
                    touched.push(rep);
                }
                gain[rep.index()] += share * patch.weight * lost;
            }
        });
        for rep in state.residents() {
            let loss_per_byte = gain[rep.index()] / tree.decoded_bytes(rep).max(1) as f64;
            self.victims.push(Victim { loss_per_byte, last_used: self.last_used[rep.index()], rep });
        }
        for rep in touched.drain(..) {
            gain[rep.index()] = 0.0;
        }
    }

    /// The best closure that gains, with its discards; the plan is as before.
    fn choose(&mut self, state: &ClientState, plan: &mut Coverage) -> Option<Choice> {
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
            // What is doomed can be asked for again only when it is gone, what failed only after a while.
            let sampled = self.sampled.unwrap_or(Time::ZERO);
            if members.iter().any(|&m| state.status(m) != Status::Absent || !self.retries.allow(m, sampled)) {
                continue;
            }
            let bytes: u64 = members.iter().map(|&m| tree.wire_bytes(m)).sum();
            let offset = self.arrival(state, bytes);
            let gain = match top.seen {
                Some(seen) if !self.is_touched(state, &members, seen) => top.gain,
                _ => self.closure_gain(state, plan, &members, offset),
            };
            let seen = Some(self.changes.len());
            let cost = self.cost(state, &members);
            let ratio = gain / cost;
            if ratio <= 0.0 {
                continue;
            }
            // Below the next one's bound? Then it has to wait for its turn again.
            if self.candidates.peek().is_some_and(|next| next.ratio > ratio) && ratio < top.ratio {
                self.candidates.push(Candidate { ratio, gain, seen, ..top });
                continue;
            }
            let need: u64 = members.iter().map(|&m| state.request_bytes(m)).sum();
            let free = state.free_bytes();
            if need <= free {
                if best.as_ref().is_none_or(|b| ratio > b.ratio) {
                    best = Some(Choice { ratio, gain, rep: top.rep, members, discards: Vec::new() });
                } else {
                    passed_over.push(Candidate { ratio, gain, seen, ..top });
                }
                break;
            }
            weighed += 1;
            self.know_victims(state, plan, offset);
            match self.swap(state, plan, &members, need - free, gain, offset) {
                Some((discards, loss)) => {
                    let net = (gain - loss) / cost;
                    let candidate = Candidate { ratio: net, gain, seen, ..top };
                    if best.as_ref().is_none_or(|b| net > b.ratio) {
                        if let Some(b) = best.replace(Choice { ratio: net, gain, rep: top.rep, members, discards }) {
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
        state: &ClientState,
        plan: &mut Coverage,
        members: &[RepId],
        bytes: u64,
        gain: f64,
        offset: f64,
    ) -> Option<(Vec<RepId>, f64)> {
        let tree = state.tree;
        for &member in members {
            plan.insert(tree, member);
        }
        let may_go = |rep: RepId| {
            state.status(rep) == Status::Resident && !state.is_needed(rep) && !needed_by(state, rep, members)
        };
        let last_used = &self.last_used;
        let used = |rep: RepId| last_used[rep.index()];
        let planned = self.settings.discards == Discards::Planned;
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
        let limit = if planned { gain / (1.0 + self.settings.hysteresis) } else { f64::INFINITY };
        let empty = Horizon::default();
        // Without planning, nothing is lost as far as the policy knows: only recency orders the victims.
        let horizon = if planned { &self.horizon } else { &empty };
        let chosen = self.victims.choose(tree, horizon, plan, &replaced, bytes, offset, limit, used, may_go);
        let swap = chosen.filter(|s| !planned || gain > (1.0 + self.settings.hysteresis) * s.loss).map(|s| {
            self.victims.restore(tree, horizon, plan, &s.reps, offset, used);
            (s.reps, s.loss)
        });
        for &member in members {
            plan.remove(tree, member);
        }
        swap
    }

    /// At the start: the coarsest representation of what weighs most and is covered by nothing.
    fn cover(&mut self, state: &ClientState, plan: &Coverage, now: Time) -> Option<RepId> {
        let tree = state.tree;
        let (gain, touched) = (&mut self.gain, &mut self.touched);
        self.horizon.for_each(tree, plan, 0.0, |patch, _, chain, present| {
            if !present || chain.owner.is_some() {
                return;
            }
            let coarsest = tree.ancestors(patch.node).filter_map(|n| tree.own(n).next()).last();
            if let Some(rep) = coarsest {
                if gain[rep.index()] == 0.0 {
                    touched.push(rep);
                }
                gain[rep.index()] += patch.weight;
            }
        });
        let per_byte = |r: RepId| gain[r.index()] / tree.wire_bytes(r) as f64;
        let best = touched
            .iter()
            .copied()
            .filter(|&r| state.status(r) == Status::Absent && state.has_prerequisite(r))
            .filter(|&r| self.retries.allow(r, now))
            .filter(|&r| state.request_bytes(r) <= state.free_bytes())
            .max_by(|&a, &b| per_byte(a).total_cmp(&per_byte(b)).then(b.cmp(&a)));
        for rep in touched.drain(..) {
            gain[rep.index()] = 0.0;
        }
        best
    }

    /// A request that has lost its point: nothing gained by it any more, or far less than by the best candidate.
    fn pointless_request(&mut self, state: &ClientState, plan: &mut Coverage) -> Option<RepId> {
        let asked: u64 = state.requests().iter().map(|r| state.tree.wire_bytes(r.rep)).sum();
        let left = state.outstanding_bytes() as f64 / asked.max(1) as f64;
        let best = self.candidates.peek().map_or(0.0, |c| c.ratio);
        let offset = self.arrival(state, 0);
        state.requests().iter().map(|r| r.rep).find(|&rep| {
            let seconds = left * state.tree.wire_bytes(rep) as f64 / state.link.rate();
            // What ends within a reuse period is not worth the bytes already charged.
            seconds > self.settings.reuse_s
                && !state.is_needed(rep)
                && self.horizon.marginal(state.tree, plan, rep, offset) / seconds < 0.1 * best
        })
    }

    fn decide_with(&mut self, state: &ClientState, plan: &mut Coverage, now: Time) -> Action {
        let wait = Action::WaitUntil(now + Time::from_secs(1.0 / 60.0));
        if state.view.is_none() {
            return wait;
        }
        if let Some(action) = self.committed.pop_front() {
            return action;
        }
        let link = &state.link;
        let full = !state.requests().is_empty()
            && state.outstanding_bytes() as f64 >= link.rate() * (link.latency_s() + self.settings.slack_s);
        let due = self.sampled.is_none_or(|t| now.since(t).secs() >= self.settings.reuse_s);
        if due {
            self.sample(state, plan, now);
            if let Some(rep) = self.pointless_request(state, plan) {
                // What the request had doomed stays: read the plan anew.
                self.plan = None;
                self.sampled = None;
                return Action::Cancel(rep);
            }
        }
        if full {
            return wait;
        }
        if self.settings.cover_first && !self.covered {
            if let Some(rep) = self.cover(state, plan, now) {
                return Action::Fetch { rep, discard_on_arrival: Vec::new() };
            }
            self.covered = true;
        }
        let Some(choice) = self.choose(state, plan) else {
            if due {
                self.typical_gain = (0.5 * self.typical_gain).max(TOLERANCES.0);
            }
            return wait;
        };
        self.typical_gain += 0.1 * (choice.gain - self.typical_gain);
        self.commit(state, choice)
    }

    /// Turns a choice into actions: discards wait for the arrival where memory allows.
    fn commit(&mut self, state: &ClientState, choice: Choice) -> Action {
        let tree = state.tree;
        let mut discards = choice.discards;
        if let [only] = choice.members[..] {
            let handed_over: u64 = discards.iter().map(|&d| tree.decoded_bytes(d)).sum();
            let reserve = tree.wire_bytes(only) + tree.decoded_bytes(only).saturating_sub(handed_over);
            if reserve <= state.free_bytes() {
                return Action::Fetch { rep: only, discard_on_arrival: discards };
            }
        }
        self.committed.extend(discards.drain(..).map(Action::Discard));
        let fetches = choice.members.iter().map(|&rep| Action::Fetch { rep, discard_on_arrival: Vec::new() });
        self.committed.extend(fetches);
        self.committed.pop_front().unwrap_or(Action::WaitUntil(Time::ZERO))
    }
}

impl Policy for Foresight {
    fn name(&self) -> &str {
        &self.name
    }

    fn observe(&mut self, state: &ClientState, view: &View, now: Time) {
        self.alpha.observe(state.tree, view, now);
        if self.motion.observe(view, now) {
            // A teleport: nothing sampled before it holds.
            self.sampled = None;
            self.covered = false;
        }
        self.predictor.observe(view, now);
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        let mut plan = self.plan.take().unwrap_or_else(|| state.hypothetical());
        let action = self.decide_with(state, &mut plan, now);
        match &action {
            Action::Fetch { rep, discard_on_arrival } => {
                for &doomed in discard_on_arrival {
                    plan.remove(state.tree, doomed);
                    self.changes.push(state.tree.node_of(doomed));
                }
                self.changes.push(state.tree.node_of(*rep));
                plan.insert(state.tree, *rep);
                let bytes = state.tree.wire_bytes(*rep) as f64;
                self.mean_fetch_bytes += 0.1 * (bytes - self.mean_fetch_bytes);
            }
            Action::Discard(rep) => {
                self.changes.push(state.tree.node_of(*rep));
                plan.remove(state.tree, *rep);
            }
            Action::Cancel(_) => return action,
            Action::WaitUntil(_) => {}
        }
        self.plan = Some(plan);
        action
    }

    fn completed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        self.retries.completed(rep);
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, now: Time) {
        self.retries.failed(rep, now);
        self.plan = None;
        self.sampled = None;
        self.committed.clear();
    }

    fn alpha(&self) -> Option<AlphaReport> {
        Some(self.alpha.report())
    }

    fn announce_path(&mut self, path: &[(Time, View)]) {
        if self.predictor.announce_path(path) {
            self.sampled = None;
        }
    }
}
