//! Best first: the heap of what could still win.

use super::bound::{ALL, Mask, ShownElements, Target};
use super::marginal::Scratch;
use super::objective::Objective;
use super::standing::Standing;
use crate::benefit::element;
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::sparse::IdMap;
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::collections::binary_heap::PeekMut;

/// Children that one opening looks at; the rest waits under the same bound.
const CHILDREN_AT_ONCE: usize = 32;
/// Closures that a new search looks at first.
const SEEDS: usize = 12;
/// Rough looks that count as one evaluation.
const ROUGH_LOOKS: u64 = 4;
/// Closures evaluated when a search is cut short.
const LAST_LOOKS: usize = 8;
/// Gains computed before and after a change elsewhere may differ by the rounding of areas to f32.
const REFRESH_WITHIN: f64 = 1.0 + 1e-6;

/// What the link makes of bytes.
#[derive(Clone, Copy)]
pub struct Link<'a> {
    /// c, seconds of link per byte.
    pub seconds_per_byte: f64,
    /// o, seconds of link per request.
    pub request_cost_s: f64,
    /// When the first byte of a request made now would come at the earliest, seconds from the objective's start.
    pub first_byte_s: f64,
    /// Seconds of arrival per byte of the closure; 0 where `arrival` knows better or arrivals do not count.
    pub arrival_per_byte_s: f64,
    /// When a closure of so many bytes arrives, where it is known: never before `first_byte_s`, later with more bytes.
    pub arrival: Option<&'a dyn Fn(u64) -> f64>,
}

impl Link<'_> {
    /// When a closure of `bytes` would be here, seconds from the objective's start.
    pub fn arrival_of(&self, bytes: u64) -> f64 {
        match self.arrival {
            Some(arrival) => arrival(bytes),
            None => self.first_byte_s + self.arrival_per_byte_s * bytes as f64,
        }
    }

    /// Seconds of link that the members occupy, c·M + o each.
    pub fn cost(&self, tree: &LodTree, members: &[RepId]) -> f64 {
        let bytes: u64 = members.iter().map(|&m| tree.wire_bytes(m)).sum();
        self.seconds_per_byte * bytes as f64 + self.request_cost_s * members.len() as f64
    }
}

/// What a choice is asked over.
pub struct Ask<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// The objective.
    pub objective: &'a Objective,
    /// The link.
    pub link: Link<'a>,
    /// Whether a representation may be requested now.
    pub allowed: &'a dyn Fn(RepId) -> bool,
}

/// When a search may end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// Relative: the choice may miss this share of the best ratio.
    pub tolerance: f64,
    /// Candidates of at most this ratio do not matter.
    pub floor: f64,
    /// Evaluations after which the best found so far is taken, as [`Search::evaluations`] counts them.
    pub evaluations_max: u64,
}

/// A closure with its exact gain.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranked {
    /// What it is for.
    pub rep: RepId,
    /// With what it needs first, in order.
    pub members: Vec<RepId>,
    /// ΔJ.
    pub gain: f64,
    /// Seconds of link.
    pub cost: f64,
    /// Gain / cost.
    pub ratio: f64,
    seen: usize,
}

/// Everything strictly beneath a node, from the child `from` on; with `from` = `node` the node's own candidates too, none of
/// which has been looked at.
#[derive(Clone, Copy, Debug)]
struct Below {
    ratio: f64,
    node: NodeId,
    from: NodeId,
    /// Error with which all of it is shown, at most.
    shown: f32,
    mask: Mask,
}

/// A closure that has not been evaluated.
#[derive(Clone, Copy, Debug)]
struct Bounded {
    ratio: f64,
    rep: RepId,
}

#[derive(Clone, Copy, Debug)]
struct Exact {
    ratio: f64,
    rep: RepId,
    gain: f64,
    cost: f64,
    /// How many changes of the plan the evaluation knew.
    seen: usize,
}

macro_rules! ordered {
    ($type:ty, $by:expr) => {
        impl PartialEq for $type {
            fn eq(&self, other: &$type) -> bool {
                self.cmp(other) == Ordering::Equal
            }
        }
        impl Eq for $type {}
        impl PartialOrd for $type {
            fn partial_cmp(&self, other: &$type) -> Option<Ordering> {
                Some(self.cmp(other))
            }
        }
        impl Ord for $type {
            fn cmp(&self, other: &$type) -> Ordering {
                self.ratio.total_cmp(&other.ratio).then_with(|| $by(other).cmp(&$by(self)))
            }
        }
    };
}

ordered!(Below, |below: &Below| (below.node, below.from));
ordered!(Bounded, |bounded: &Bounded| bounded.rep);
ordered!(Exact, |exact: &Exact| exact.rep);

/// The candidates of one sampling of the objective.
#[derive(Clone, Debug, Default)]
pub struct Search {
    below: BinaryHeap<Below>,
    bounded: BinaryHeap<Bounded>,
    exact: BinaryHeap<Exact>,
    /// Nodes at which the plan has changed since.
    changes: Vec<NodeId>,
    /// Closures evaluated: changes known and cost then.
    evaluated: IdMap<(usize, f64)>,
    /// Nodes opened from their first child on: changes known then.
    opened: IdMap<usize>,
    /// Closures by a member that they need first, with the bound on what they add by themselves.
    waiting: IdMap<Vec<(RepId, f64)>>,
    scratch: Scratch,
    weights: Vec<f64>,
    /// Shares by place, for what is looked at roughly.
    place_weights: Vec<f64>,
    rough_looks: u64,
    targets: Vec<Target>,
    reps: Vec<RepId>,
    out: Vec<f64>,
    nodes_opened: u64,
    evaluations: u64,
}

/// Empties a heap for another search, which is likely to need as much memory as the last: what one search out of many needed
/// is given back.
fn clear<T: Ord>(heap: &mut BinaryHeap<T>) {
    let kept = 2 * heap.len();
    heap.clear();
    heap.shrink_to(kept);
}

/// What must be fetched for `rep` to be of use under partial refinement, in order: missing prerequisites first.
pub fn closure(tree: &LodTree, standing: &Standing, rep: RepId) -> Vec<RepId> {
    let missing =
        core::iter::successors(Some(rep), |&r| tree.prerequisite(r)).take_while(|r| !standing.plan().contains(*r));
    let mut members: Vec<RepId> = missing.collect();
    members.reverse();
    members
}

impl Search {
    /// Starts over: everything is a candidate. What came out best before is looked at first, so that a search that is cut
    /// short has something good.
    pub fn restart(&mut self, tree: &LodTree, standing: &Standing) {
        let best: Vec<RepId> = core::iter::from_fn(|| self.exact.pop()).take(SEEDS).map(|e| e.rep).collect();
        clear(&mut self.below);
        clear(&mut self.bounded);
        clear(&mut self.exact);
        self.changes.clear();
        self.evaluated.clear();
        self.opened.clear();
        self.waiting.clear();
        let root = tree.root();
        for rep in tree.own(root).filter(|&r| !standing.plan().contains(r)) {
            self.bounded.push(Bounded { ratio: f64::INFINITY, rep });
        }
        self.bounded.extend(best.into_iter().map(|rep| Bounded { ratio: f64::INFINITY, rep }));
        self.push_beneath(f64::INFINITY, root, standing.plan().best_at(root), ALL);
    }

    /// Bytes that its heaps and tables occupy.
    pub fn heap_bytes(&self) -> usize {
        let waiting: usize = self.waiting.values().map(Vec::capacity).sum();
        self.below.capacity() * size_of::<Below>()
            + self.bounded.capacity() * size_of::<Bounded>()
            + self.exact.capacity() * size_of::<Exact>()
            + self.changes.capacity() * size_of::<NodeId>()
            + self.evaluated.allocation_size()
            + self.opened.allocation_size()
            + self.waiting.allocation_size()
            + waiting * size_of::<(RepId, f64)>()
    }

    /// Nodes visited since the start, for bounds and for exact values; of those only glanced at, a quarter.
    pub fn evaluations(&self) -> u64 {
        self.evaluations + self.rough_looks / ROUGH_LOOKS + self.scratch.visited
    }

    /// Nodes opened since the start.
    pub fn nodes_opened(&self) -> u64 {
        self.nodes_opened
    }

    /// No candidate's ratio exceeds this.
    pub fn upper(&self) -> f64 {
        self.bound().max(self.exact.peek().map_or(0.0, |e| e.ratio * REFRESH_WITHIN))
    }

    /// The largest ratio that something not evaluated could have.
    fn bound(&self) -> f64 {
        let below = self.below.peek().map_or(0.0, |b| b.ratio);
        below.max(self.bounded.peek().map_or(0.0, |b| b.ratio))
    }

    fn pop_bounded(&mut self, wanted: impl Fn(f64) -> bool) -> Option<Bounded> {
        let first = self.bounded.peek_mut()?;
        wanted(first.ratio).then(|| PeekMut::pop(first))
    }

    fn push_beneath(&mut self, ratio: f64, node: NodeId, shown: f32, mask: Mask) {
        let from = NodeId(node.0 + 1);
        self.below.push(Below { ratio, node, from, shown, mask });
    }

    /// `rep` has been planned.
    pub fn added(&mut self, ask: &Ask, rep: RepId) {
        self.changes.push(ask.tree.node_of(rep));
        // What needed it has become cheaper.
        for (rep, ratio) in self.waiting.remove(&rep.0).unwrap_or_default() {
            self.bounded.push(Bounded { ratio, rep });
        }
    }

    /// `rep` is planned no more: it, and all above and beneath it, may gain more than before.
    pub fn removed(&mut self, ask: &Ask, standing: &Standing, rep: RepId) {
        let (tree, node) = (ask.tree, ask.tree.node_of(rep));
        self.changes.push(node);
        for above in tree.ancestors(node) {
            let shown = standing.plan().best_above(tree, above);
            self.look(ask, standing, above, shown, ALL, above == node);
        }
    }

    /// Enters the bounds of a node's own candidates and, if asked, of everything strictly beneath it. `shown` is the least
    /// error planned at the node or above.
    fn look(&mut self, ask: &Ask, standing: &Standing, node: NodeId, shown: f32, mask: Mask, beneath_too: bool) {
        let (tree, link) = (ask.tree, &ask.link);
        self.evaluations += 1;
        let summary = standing.beneath(tree, node);
        let (worst_shown, elements) = if tree.has_directions() {
            let above = standing.plan().elements_above(tree, node).errors;
            let worst = element::least(&above, &standing.elements_beneath(node));
            let elements = ShownElements::new(tree, node, &worst);
            (elements.errors.iter().copied().fold(0.0, f32::max), Some(elements))
        } else {
            (shown.min(summary.shown), None)
        };
        self.targets.clear();
        self.reps.clear();
        let mut least_wire = f32::INFINITY;
        for rep in tree.own(node) {
            let errors = elements.as_ref().map(|_| element::errors(tree, rep));
            let improves = match (&errors, &elements) {
                (Some(errors), Some(elements)) => element::improves(errors, &elements.errors),
                _ => (tree.error(rep) as f32) < worst_shown,
            };
            if improves && !standing.plan().contains(rep) {
                least_wire = least_wire.min((tree.wire_bytes(rep) as f32).next_down());
                let density = tree.face_areas(node) / tree.wire_bytes(rep) as f64;
                let target = Target::of_area(density, tree.error(rep) as f32, worst_shown);
                self.targets.push(match (&errors, &elements) {
                    (Some(errors), Some(elements)) => target.of_elements(errors, &elements.errors),
                    _ => target,
                });
                self.reps.push(rep);
            }
        }
        let beneath = beneath_too && !tree.is_leaf(node) && summary.left.least_error < worst_shown;
        if beneath {
            least_wire = least_wire.min(summary.left.least_wire);
            self.targets.push(Target::new(&summary.left, worst_shown));
            if link.request_cost_s > 0.0 {
                self.targets.push(Target::of_area(tree.face_areas(node), summary.left.least_error, worst_shown));
            }
        }
        if self.targets.is_empty() {
            return;
        }
        let earliest = link.first_byte_s + link.arrival_per_byte_s * f64::from(least_wire);
        ask.objective.weights(earliest, &mut self.weights);
        let (centre, half) = (tree.centre(node), tree.half(node));
        let (weights, targets) = (&self.weights, &self.targets);
        let seen = ask.objective.bound(weights, centre, half, mask, targets, elements.as_ref(), &mut self.out);
        for (i, &rep) in self.reps.iter().enumerate() {
            let ratio = self.out[i] * tree.wire_bytes(rep) as f64 / link.cost(tree, &[rep]);
            if ratio > 0.0 {
                self.bounded.push(Bounded { ratio, rep });
            }
        }
        if beneath {
            let place = self.reps.len();
            let mut ratio = self.out[place] / link.seconds_per_byte;
            if link.request_cost_s > 0.0 {
                let least = link.request_cost_s + link.seconds_per_byte * f64::from(summary.left.least_wire);
                ratio = ratio.min(self.out[place + 1] / least);
            }
            if ratio > 0.0 {
                self.push_beneath(ratio, node, worst_shown, seen);
            }
        }
    }

    /// Whether the plan has changed above, at or beneath one of the nodes of `members` since the first `seen` changes.
    pub(super) fn is_touched(&self, tree: &LodTree, members: &[RepId], seen: usize) -> bool {
        let changed = &self.changes[seen.min(self.changes.len())..];
        !changed.is_empty()
            && members
                .iter()
                .map(|&m| tree.node_of(m))
                .any(|node| changed.iter().any(|&other| tree.is_beneath(node, other) || tree.is_beneath(other, node)))
    }

    /// A rough bound for a child's own candidates and everything beneath it, if any of it can gain. `shown` is the least
    /// error planned above it; `is_held` says whether something may be planned at it or beneath.
    fn glance(
        &mut self,
        ask: &Ask,
        standing: &Standing,
        child: NodeId,
        shown: f32,
        mask: Mask,
        is_held: bool,
    ) -> Option<Below> {
        let tree = ask.tree;
        self.rough_looks += 1;
        let (own, is_held_beneath) = if is_held { standing.plan().at(child) } else { (f32::INFINITY, false) };
        let shown = shown.min(own);
        let (left, beneath_shown) = if is_held_beneath {
            let summary = standing.beneath(tree, child);
            (summary.left, summary.shown)
        } else {
            (tree.beneath_bounds(child), f32::INFINITY)
        };
        let worst_shown = shown.min(beneath_shown);
        let areas = tree.face_areas(child);
        let (mut least_wire, mut least_error) = (u64::MAX, f32::INFINITY);
        for rep in tree.own(child) {
            let error = tree.error(rep) as f32;
            if error < worst_shown && !(own < f32::INFINITY && standing.plan().contains(rep)) {
                (least_wire, least_error) = (least_wire.min(tree.wire_bytes(rep)), least_error.min(error));
            }
        }
        let mut density = DVec3::ZERO;
        if least_wire < u64::MAX {
            density = areas / least_wire as f64;
        }
        if left.least_error < worst_shown {
            density = density.max(DVec3::from(left.density.map(f64::from)));
            least_error = least_error.min(left.least_error);
        }
        if least_error == f32::INFINITY {
            return None;
        }
        let target = Target::of_area(density, least_error, worst_shown);
        let (centre, half) = (tree.centre(child), tree.half(child));
        let gain_per_byte = ask.objective.rough_bound(&self.place_weights, centre, half, &target);
        let ratio = gain_per_byte / ask.link.seconds_per_byte;
        (ratio > 0.0).then_some(Below { ratio, node: child, from: child, shown, mask })
    }

    fn open(&mut self, ask: &Ask, standing: &Standing, below: Below) {
        let Below { node, from, shown, mask, .. } = below;
        let tree = ask.tree;
        if from == node {
            let shown = shown.min(standing.plan().best_at(node));
            return self.look(ask, standing, node, shown, mask, true);
        }
        if from.0 == node.0 + 1 {
            if let Some(&seen) = self.opened.get(&node.0) {
                let changed = &self.changes[seen.min(self.changes.len())..];
                if !changed.iter().any(|&c| tree.is_beneath(c, node) || tree.is_beneath(node, c)) {
                    return;
                }
            }
            self.opened.insert(node.0, self.changes.len());
        }
        self.nodes_opened += 1;
        let end = tree.subtree_end(node);
        let mut child = from;
        let is_rough = !tree.has_directions();
        if is_rough {
            ask.objective.weights(ask.link.first_byte_s, &mut self.weights);
            ask.objective.place_weights(&self.weights, mask, &mut self.place_weights);
        }
        let is_held_beneath = standing.plan().any_beneath(node);
        // The most promising child is looked at in any case: a search that is cut short then has something to take.
        let mut first: Option<Below> = None;
        for _ in 0..CHILDREN_AT_ONCE {
            if child >= end {
                break;
            }
            if is_rough {
                let below = self.glance(ask, standing, child, shown, mask, is_held_beneath);
                let is_first = |below: &Below| first.is_none_or(|first| *below > first) && tree.own(child).len() > 0;
                let rest = match below {
                    Some(below) if is_first(&below) => first.replace(below),
                    other => other,
                };
                if let Some(rest) = rest {
                    self.below.push(rest);
                }
            } else {
                let shown = shown.min(standing.plan().best_at(child));
                self.look(ask, standing, child, shown, mask, true);
            }
            child = tree.subtree_end(child);
        }
        if child < end {
            self.below.push(Below { from: child, ..below });
        }
        if let Some(Below { node, shown, mask, .. }) = first {
            let shown = shown.min(standing.plan().best_at(node));
            self.look(ask, standing, node, shown, mask, true);
        }
    }

    /// How many changes of the plan are known.
    pub(super) fn changes(&self) -> usize {
        self.changes.len()
    }

    /// The exact gain of a closure beside the plan, which is as before afterwards.
    fn gain(&mut self, ask: &Ask, standing: &mut Standing, members: &[RepId], offset: f64) -> f64 {
        let (tree, objective) = (ask.tree, ask.objective);
        objective.weights(offset, &mut self.weights);
        if let [only] = members {
            return objective.marginal(tree, standing, *only, &self.weights, &mut self.scratch);
        }
        let mut sum = 0.0;
        for &member in members {
            sum += objective.marginal(tree, standing, member, &self.weights, &mut self.scratch);
            standing.insert(tree, member);
        }
        for &member in members {
            standing.remove(tree, member);
        }
        sum
    }

    /// Evaluates a closure for the present plan; `None` if it cannot be requested.
    fn rank(&mut self, ask: &Ask, standing: &mut Standing, rep: RepId) -> Option<Ranked> {
        let tree = ask.tree;
        if standing.plan().contains(rep) {
            return None;
        }
        let members = closure(tree, standing, rep);
        if !members.iter().all(|&m| (ask.allowed)(m)) {
            return None;
        }
        let bytes: u64 = members.iter().map(|&m| tree.wire_bytes(m)).sum();
        let cost = ask.link.cost(tree, &members);
        let gain = self.gain(ask, standing, &members, ask.link.arrival_of(bytes));
        Some(Ranked { rep, members, gain, cost, ratio: gain / cost, seen: self.changes.len() })
    }

    /// Notes what the last of `members` needs first: once that is planned, the rest is cheaper. By itself it adds at most
    /// `bound`.
    fn await_members(&mut self, members: &[RepId], bound: f64) {
        let Some((&rep, needed)) = members.split_last() else { return };
        for member in needed {
            let waiting = self.waiting.entry(member.0).or_default();
            match waiting.iter_mut().find(|(r, _)| *r == rep) {
                Some((_, known)) => *known = known.max(bound),
                None => waiting.push((rep, bound)),
            }
        }
    }

    fn evaluate(&mut self, ask: &Ask, standing: &mut Standing, rep: RepId, bound: f64) {
        let tree = ask.tree;
        if standing.plan().contains(rep) {
            return;
        }
        let members = closure(tree, standing, rep);
        if let Some(&(seen, cost)) = self.evaluated.get(&rep.0)
            && cost == ask.link.cost(tree, &members)
            && !self.is_touched(tree, &members, seen)
        {
            return;
        }
        self.await_members(&members, bound);
        if let Some(ranked) = self.rank(ask, standing, rep) {
            self.evaluated.insert(rep.0, (ranked.seen, ranked.cost));
            if ranked.ratio > 0.0 {
                self.give_back(&ranked);
            }
        }
    }

    /// Enters a closure that [`Search::next`] gave and that was not taken.
    pub fn give_back(&mut self, ranked: &Ranked) {
        let Ranked { ratio, rep, gain, cost, seen, .. } = *ranked;
        self.exact.push(Exact { ratio, rep, gain, cost, seen });
    }

    /// The first of the exact ones, evaluated for the present plan, with all that could come before it.
    fn first_exact(&mut self, ask: &Ask, standing: &mut Standing) -> Option<Exact> {
        let tree = ask.tree;
        let mut first: Option<Exact> = None;
        while let Some(top) = self.exact.peek().copied() {
            if first.is_some_and(|f| top.ratio * REFRESH_WITHIN < f.ratio) {
                break;
            }
            // What was entered anew may be there twice.
            if standing.plan().contains(top.rep) || first.is_some_and(|f| f.rep == top.rep) {
                self.exact.pop();
                continue;
            }
            let members = closure(tree, standing, top.rep);
            let is_fresh = !self.is_touched(tree, &members, top.seen) && top.cost == ask.link.cost(tree, &members);
            if is_fresh && (first.is_none() || first.is_some_and(|f| f > top)) {
                break;
            }
            self.exact.pop();
            let fresh = if is_fresh {
                Some(top)
            } else {
                self.await_members(&members, f64::INFINITY);
                self.rank(ask, standing, top.rep).map(|r| {
                    self.evaluated.insert(r.rep.0, (r.seen, r.cost));
                    Exact { ratio: r.ratio, rep: r.rep, gain: r.gain, cost: r.cost, seen: r.seen }
                })
            };
            if let Some(fresh) = fresh.filter(|f| f.ratio > 0.0) {
                match first {
                    Some(f) if f >= fresh => self.exact.push(fresh),
                    _ => {
                        if let Some(f) = first.replace(fresh) {
                            self.exact.push(f);
                        }
                    }
                }
            }
        }
        if let Some(first) = first {
            self.exact.push(first);
        }
        self.exact.peek().copied()
    }

    /// The best closure, taken out of the heap; `None` if nothing above the floor gains, or nothing was found in time.
    /// Afterwards [`Search::upper`] bounds every other one.
    pub fn next(&mut self, ask: &Ask, standing: &mut Standing, stop: Stop) -> Option<Ranked> {
        let mut last = 0;
        let mut first = self.first_exact(ask, standing);
        loop {
            let bound = self.bound();
            let exact = first.map_or(0.0, |e| e.ratio);
            let missed = bound > exact && bound > stop.floor && bound * (1.0 - stop.tolerance) > exact;
            // Equal bounds are opened too: among equals the least id wins.
            let missed = missed || (stop.tolerance <= 0.0 && bound >= exact && bound > stop.floor && bound > 0.0);
            if missed && self.evaluations() < stop.evaluations_max {
                let below = self.below.peek().map_or(0.0, |b| b.ratio);
                match self.pop_bounded(|ratio| ratio >= below) {
                    Some(Bounded { ratio, rep }) => {
                        self.evaluate(ask, standing, rep, ratio);
                        first = self.first_exact(ask, standing);
                    }
                    None => {
                        let Some(below) = self.below.pop() else { continue };
                        self.open(ask, standing, below);
                    }
                }
                continue;
            }
            if missed && exact <= stop.floor && last < LAST_LOOKS {
                // Out of time: the most promising closures seen are all that can still be looked at.
                if let Some(Bounded { ratio, rep }) = self.pop_bounded(|ratio| ratio > exact) {
                    last += 1;
                    self.evaluate(ask, standing, rep, ratio);
                    first = self.first_exact(ask, standing);
                    continue;
                }
            }
            let Exact { ratio, rep, gain, cost, seen } = first.filter(|e| e.ratio > stop.floor)?;
            self.exact.pop();
            let members = closure(ask.tree, standing, rep);
            if members.iter().all(|&m| (ask.allowed)(m)) {
                return Some(Ranked { rep, members, gain, cost, ratio, seen });
            }
            first = self.first_exact(ask, standing);
        }
    }

    /// A representation's ΔJ beside everything else that is planned, counted from `offset`.
    pub fn marginal(&mut self, ask: &Ask, standing: &Standing, rep: RepId, offset: f64) -> f64 {
        ask.objective.weights(offset, &mut self.weights);
        ask.objective.marginal(ask.tree, standing, rep, &self.weights, &mut self.scratch)
    }

    /// What the worst case has of a closure's gain. Not counted among the evaluations.
    pub fn gain_of_worst_case(&mut self, ask: &Ask, standing: &mut Standing, members: &[RepId]) -> f64 {
        let visited = self.scratch.visited;
        // After all time, only the terms without an interval count.
        let gain = self.gain(ask, standing, members, f64::INFINITY);
        self.scratch.visited = visited;
        gain
    }

    /// Any representation's exact ratio as a candidate, as [`Search::next`] computes it; `None` if it cannot be requested.
    pub fn exact(&mut self, ask: &Ask, standing: &mut Standing, rep: RepId) -> Option<Ranked> {
        self.rank(ask, standing, rep)
    }

    /// The rough bound on the ratios of a node's own candidates and everything beneath it, of a world without directions.
    pub fn rough_bound_of(&mut self, ask: &Ask, standing: &Standing, node: NodeId) -> f64 {
        ask.objective.weights(ask.link.first_byte_s, &mut self.weights);
        ask.objective.place_weights(&self.weights, ALL, &mut self.place_weights);
        let above = ask.tree.parent(node).map_or(f32::INFINITY, |parent| standing.plan().best_above(ask.tree, parent));
        self.glance(ask, standing, node, above, ALL, true).map_or(0.0, |below| below.ratio)
    }

    /// Upper bounds on the ratios of a node's own candidates and of everything strictly beneath it, as a search without
    /// anything known would compute them. Ends the search.
    pub fn bounds_of(&mut self, ask: &Ask, standing: &Standing, node: NodeId) -> (Vec<(RepId, f64)>, f64) {
        self.below.clear();
        self.bounded.clear();
        let shown = standing.plan().best_above(ask.tree, node);
        self.look(ask, standing, node, shown, ALL, true);
        let own = self.bounded.drain().map(|b| (b.rep, b.ratio)).collect();
        let beneath = self.below.drain().map(|b| b.ratio).fold(0.0, f64::max);
        (own, beneath)
    }
}
