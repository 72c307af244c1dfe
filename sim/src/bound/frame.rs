//! A proven upper bound on the quality of any policy, frame by frame.
//!
//! Whatever a policy does, what is resident at time t took at most W bytes of link (all that the link could deliver by
//! then, and what was there at the start) and at most the memory budget. So the quality of the frame is at most the best
//! of any set within W and within memory, and that is at most the Lagrangian dual of either constraint,
//!
//! ```text
//! min_λ  λ·W + max_R [ Q_R(v) − λ·Σ_{r∈R} M_r ]   (and the same with decoded bytes and the budget).
//! ```
//!
//! Every λ ≥ 0 gives a valid bound (weak duality); the inner maximum over sets R is solved exactly by dynamic programming
//! over the tree: what a subtree is worth depends on what lies outside only through the least error above it. Relaxed
//! upwards: requests, latency (constant or varying), failed requests, decoding, prerequisites and sibling groups cost
//! nothing, and beneath a group too small to open, any part can be shown perfectly at the least bytes per weight that any
//! representation there has. What alone exceeds a limit is in no set.
//!
//! In a world with directions the maximum is taken for each element of the surface by itself, and the price of a
//! representation is split among those that it shows, by what they weigh beneath it: the sum of the maxima is no less
//! than the maximum of the sum, whatever the split.

use super::elements::{CheapestElements, ElementDensity, Lanes};
use foresight_scheduler::benefit::accuracy::accuracy;
use foresight_scheduler::benefit::cut::{Cut, projected_area};
use foresight_scheduler::lod_tree::{LodTree, NodeId};
use glam::DVec3;
use std::collections::BTreeMap;

/// Says how the bound was proven, in every report.
pub const METHOD: &str =
    "per frame: Lagrangian dual of the best set within the bytes deliverable by then, and within memory";

/// Groups with more than this share of the frame's weight are opened.
const OPEN_SHARE: f64 = 1e-3;
/// Multipliers are 0 and this grid: λ_i = LEAST·STEP^i. Between two neighbours the bound is at most a few per mille loose.
const LEAST: f64 = 1e-13;
const STEP: f64 = 1.3;
const GRID: usize = 144;
/// A chain with more options than this makes a frame's bound the trivial 1.
const OPTIONS_MAX: usize = 256;
/// Rounding of single-precision areas, added so that it stays a bound.
pub(super) const ROUNDING: f64 = 1e-5;

/// Least bytes per square metre, by axis, of what lies strictly beneath each node.
#[derive(Clone, Debug)]
pub struct CheapestBeneath {
    pub(super) wire: Vec<[f32; 3]>,
    pub(super) decoded: Vec<[f32; 3]>,
    /// Wire and decoded bytes by element, in a world with directions.
    pub(super) by_element: Option<[CheapestElements; 2]>,
}

impl CheapestBeneath {
    /// One pass over the tree.
    pub fn new(tree: &LodTree) -> CheapestBeneath {
        let free = [f32::INFINITY; 3];
        let by_element = tree
            .has_directions()
            .then(|| [LodTree::wire_bytes, LodTree::decoded_bytes].map(|bytes| CheapestElements::new(tree, bytes)));
        let (wire, decoded) = (vec![free; tree.nodes()], vec![free; tree.nodes()]);
        let mut cheapest = CheapestBeneath { wire, decoded, by_element };
        for node in (1..tree.nodes() as u32).rev().map(NodeId) {
            let Some(parent) = tree.parent(node) else { continue };
            let areas = tree.face_areas(node);
            for axis in 0..3 {
                let (mut wire, mut decoded) = (cheapest.wire[node.index()][axis], cheapest.decoded[node.index()][axis]);
                for rep in tree.own(node) {
                    // A vanishing face is paid for by the other two.
                    let area = areas[axis].max(f64::MIN_POSITIVE);
                    wire = wire.min((tree.wire_bytes(rep) as f64 / area).min(f64::from(f32::MAX)) as f32);
                    decoded = decoded.min((tree.decoded_bytes(rep) as f64 / area).min(f64::from(f32::MAX)) as f32);
                }
                let above = &mut cheapest.wire[parent.index()][axis];
                *above = above.min(wire);
                let above = &mut cheapest.decoded[parent.index()][axis];
                *above = above.min(decoded);
            }
        }
        cheapest
    }
}

/// The two limits under which a frame is bounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// W: bytes that can have come.
    pub wire: f64,
    /// Memory budget, decoded bytes.
    pub memory: f64,
}

/// The bound of a frame with the prices that prove it: at most one of them is positive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameDual {
    /// Upper bound of Q.
    pub value: f64,
    /// λ: quality per byte of link.
    pub wire: f64,
    /// λ: quality per byte of memory.
    pub memory: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Resource {
    Wire,
    Memory,
}

/// A node of the frame's problem, in preorder.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub(super) node: NodeId,
    /// Place of the nearest item above; itself for the first.
    pub(super) parent: usize,
    /// Options (least errors) that can come from above, the first being nothing at all.
    inherited: usize,
    /// Where this item's values begin.
    first: usize,
    /// For what is seen: its share of the weight and its sharpness; weight 0 for what only groups others.
    weight: f64,
    pub(super) sharpness: f64,
    /// Least wire and decoded bytes per unit of weight at which something beneath improves it; ∞ for leaves.
    beneath: [f64; 2],
}

/// One frame's problem, solved for as many multipliers as are asked for.
pub struct FrameBound<'a> {
    tree: &'a LodTree,
    items: Vec<Item>,
    /// Errors of the options of each item: those inherited, then its own.
    errors: Vec<f64>,
    values: Vec<f64>,
    /// The same problem by element, in a world with directions.
    lanes: Option<Lanes>,
    too_deep: bool,
    /// Bytes of every representation in it, ascending: how many exceed a limit says which.
    bytes: [Vec<u32>; 2],
    /// Relaxed values by resource, then by multiplier and the numbers of representations that fit each limit.
    memo: [BTreeMap<(usize, [usize; 2]), f64>; 2],
}

impl<'a> FrameBound<'a> {
    /// The problem of one frame; `None` when nothing is in view.
    pub fn new(tree: &'a LodTree, cheapest: &CheapestBeneath, cut: &Cut) -> Option<FrameBound<'a>> {
        if cut.total_weight <= 0.0 {
            return None;
        }
        let mut bound = FrameBound {
            tree,
            items: Vec::new(),
            errors: Vec::new(),
            values: Vec::new(),
            lanes: None,
            too_deep: false,
            bytes: [Vec::new(), Vec::new()],
            memo: [BTreeMap::new(), BTreeMap::new()],
        };
        // Items whose subtree the walk is in, innermost last.
        let mut open: Vec<usize> = Vec::new();
        let mut path = Vec::new();
        let mut sights = Vec::new();
        for patch in &cut.patches {
            while open.last().is_some_and(|&top| !tree.is_beneath(patch.node, bound.items[top].node)) {
                open.pop();
            }
            // Only what is not open yet: a second item for a node would charge its representations twice.
            let innermost = open.last().map(|&top| bound.items[top].node);
            path.clear();
            path.extend(tree.ancestors(patch.node).take_while(|&n| Some(n) != innermost));
            for &node in path.iter().rev() {
                bound.enter(&mut open, node);
            }
            let direction = (tree.centre(patch.node) - cut.eye).normalize_or_zero();
            let area = projected_area(tree, patch.node, direction);
            let weight = patch.weight / cut.total_weight;
            let density = if area > 0.0 { weight / area } else { 0.0 };
            let end = tree.subtree_end(patch.node);
            let mut next = patch.node;
            let elements = cheapest.by_element.as_ref().map(|_| ElementDensity::new(tree, cut, patch, weight));
            while next < end {
                let is_patch = next == patch.node;
                let share = if is_patch { weight } else { density * projected_area(tree, next, direction) };
                let item = bound.enter(&mut open, next);
                if !tree.is_leaf(next) && density > 0.0 && share > OPEN_SHARE {
                    next = NodeId(next.0 + 1);
                    continue;
                }
                let beneath = if tree.is_leaf(next) || density <= 0.0 {
                    [f64::INFINITY; 2]
                } else {
                    [
                        per_weight(&cheapest.wire, next, direction, density),
                        per_weight(&cheapest.decoded, next, direction, density),
                    ]
                };
                bound.items[item].weight = share;
                bound.items[item].sharpness = patch.sharpness;
                bound.items[item].beneath = beneath;
                if let (Some(elements), Some(cheapest)) = (&elements, &cheapest.by_element) {
                    sights.push((item, elements.sight(tree, next, cheapest)));
                }
                next = tree.subtree_end(next);
            }
        }
        for item in &bound.items {
            for rep in tree.own(item.node) {
                bound.bytes[0].push(tree.wire_bytes(rep) as u32);
                bound.bytes[1].push(tree.decoded_bytes(rep) as u32);
            }
        }
        bound.bytes.iter_mut().for_each(|bytes| bytes.sort_unstable());
        if tree.has_directions() && !bound.too_deep {
            bound.lanes = Some(Lanes::new(tree, &bound.items, sights));
        }
        Some(bound)
    }

    /// Opens `node` below the items that contain it, unless it is open already.
    fn enter(&mut self, open: &mut Vec<usize>, node: NodeId) -> usize {
        while let Some(&top) = open.last() {
            if self.items[top].node == node {
                return top;
            }
            if self.tree.is_beneath(node, self.items[top].node) {
                break;
            }
            open.pop();
        }
        let place = self.items.len();
        let (parent, inherited) = match open.last() {
            Some(&parent) => (parent, self.items[parent].inherited + self.tree.own(self.items[parent].node).len()),
            None => (place, 1),
        };
        let first = self.errors.len();
        if inherited > OPTIONS_MAX {
            self.too_deep = true;
        } else if parent == place {
            self.errors.push(f64::INFINITY);
        } else {
            let from = self.items[parent].first;
            self.errors.extend_from_within(from..from + inherited);
        }
        self.errors.extend(self.tree.own(node).map(|r| self.tree.error(r)));
        self.items.push(Item {
            node,
            parent,
            inherited,
            first,
            weight: 0.0,
            sharpness: 0.0,
            beneath: [f64::INFINITY; 2],
        });
        open.push(place);
        place
    }

    /// max_R [ Q_R − λ·cost(R) ] over what each fits the limits.
    fn relaxed(&mut self, lambda: f64, resource: Resource, limits: Limits) -> f64 {
        if let Some(lanes) = &self.lanes {
            let wire = resource == Resource::Wire;
            return lanes.relaxed(&mut self.values, lambda, wire, limits);
        }
        let tree = self.tree;
        self.values.clear();
        self.values.resize(self.errors.len(), 0.0);
        let mut root = 0.0;
        for place in (0..self.items.len()).rev() {
            let item = self.items[place];
            let own = tree.own(item.node);
            let options = item.inherited + own.len();
            let (errors, values) = (&self.errors[item.first..item.first + options], &mut self.values[..]);
            if item.weight > 0.0 {
                let per_weight = item.beneath[if resource == Resource::Wire { 0 } else { 1 }];
                let perfect = if per_weight.is_finite() { 1.0 - lambda * per_weight } else { 0.0 };
                for (option, &error) in errors.iter().enumerate() {
                    values[item.first + option] += item.weight * accuracy(error, item.sharpness).max(perfect);
                }
            }
            // Buy one of the own, or go on with what comes from above.
            for option in 0..item.inherited {
                let mut best = values[item.first + option];
                for (i, rep) in own.clone().enumerate() {
                    let (wire, decoded) = (tree.wire_bytes(rep) as f64, tree.decoded_bytes(rep) as f64);
                    let fits = wire <= limits.wire && decoded <= limits.memory;
                    if fits && errors[item.inherited + i] < errors[option] {
                        let bytes = if resource == Resource::Wire { wire } else { decoded };
                        best = best.max(values[item.first + item.inherited + i] - lambda * bytes);
                    }
                }
                if item.parent == place {
                    root = best;
                } else {
                    values[self.items[item.parent].first + option] += best;
                }
            }
        }
        root
    }

    fn dual(&mut self, step: usize, limits: Limits, resource: Resource) -> f64 {
        let lambda = multiplier(step);
        let (which, limit) = match resource {
            Resource::Wire => (0, limits.wire),
            Resource::Memory => (1, limits.memory),
        };
        let fitting = |bytes: &[u32], limit: f64| bytes.partition_point(|&b| f64::from(b) <= limit);
        let key = (step, [fitting(&self.bytes[0], limits.wire), fitting(&self.bytes[1], limits.memory)]);
        let relaxed = match self.memo[which].get(&key) {
            Some(&known) => known,
            None => {
                let relaxed = self.relaxed(lambda, resource, limits);
                self.memo[which].insert(key, relaxed);
                relaxed
            }
        };
        lambda * limit + relaxed
    }

    /// The least dual over the grid, with its multiplier: it is convex in λ, so halving finds it.
    fn least_dual(&mut self, limits: Limits, resource: Resource) -> (f64, f64) {
        let (mut low, mut high) = (0, GRID - 1);
        while low < high {
            let middle = (low + high) / 2;
            if self.dual(middle, limits, resource) <= self.dual(middle + 1, limits, resource) {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        (self.dual(low, limits, resource), multiplier(low))
    }

    /// Upper bound of Q for this frame.
    pub fn bound(&mut self, limits: Limits) -> f64 {
        self.prove(limits).value
    }

    /// Upper bound of Q for this frame, and what one more byte of link or memory would add to it.
    pub fn prove(&mut self, limits: Limits) -> FrameDual {
        if self.too_deep {
            return FrameDual { value: 1.0, ..FrameDual::default() };
        }
        let (by_wire, wire) = self.least_dual(limits, Resource::Wire);
        let (by_memory, memory) = self.least_dual(limits, Resource::Memory);
        let value = by_wire.min(by_memory) + ROUNDING;
        match value {
            v if v >= 1.0 => FrameDual { value: 1.0, ..FrameDual::default() },
            v if by_wire <= by_memory => FrameDual { value: v.max(0.0), wire, memory: 0.0 },
            v => FrameDual { value: v.max(0.0), wire: 0.0, memory },
        }
    }
}

/// λ of a step of the grid, quality per byte; the first is 0, for limits without end.
fn multiplier(step: usize) -> f64 {
    if step == 0 { 0.0 } else { LEAST * libm::pow(STEP, step as f64) }
}

/// Least bytes per unit of weight: r at node m costs M_r ≥ β_i·A_i(m) for every axis i, so its weight
/// density·Σ|u_i|·A_i is at most density·M_r·Σ|u_i|/β_i.
fn per_weight(beneath: &[[f32; 3]], node: NodeId, direction: DVec3, density: f64) -> f64 {
    let beta = beneath[node.index()];
    let mut weight_per_byte = 0.0;
    for axis in 0..3 {
        // Rounded down, so that single precision cannot raise a cost.
        let beta = f64::from(beta[axis].next_down()).max(f64::MIN_POSITIVE);
        weight_per_byte += direction[axis].abs() / beta;
    }
    if beta[0].is_infinite() { f64::INFINITY } else { 1.0 / (density * weight_per_byte).max(f64::MIN_POSITIVE) }
}
