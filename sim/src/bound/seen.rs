//! What a replay sees: the steps of time, the patches of each, and which groups are opened for all of them.

use super::elements::ElementDensity;
use super::frame::CheapestBeneath;
use foresight_scheduler::benefit::cut::{Cut, projected_area};
use foresight_scheduler::benefit::element::ELEMENTS;
use foresight_scheduler::lod_tree::{LodTree, NodeId};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Early steps are this share of the time that has gone by: what the link has brought by then grows as fast.
const GROWTH: usize = 12;

/// Cuts `frames` into steps: single frames at first, then a twelfth of the time gone by, then `frames`/`count` each.
pub(super) fn steps(frames: usize, count: usize) -> Vec<Range<usize>> {
    let longest = frames.div_ceil(count.max(1)).max(1);
    let mut steps = Vec::new();
    let mut from = 0;
    while from < frames {
        let to = (from + (from / GROWTH).clamp(1, longest)).min(frames);
        steps.push(from..to);
        from = to;
    }
    steps
}

/// A node of the cuts in one step, summed over the step's frames. Weights are shares of a frame's, divided by the number
/// of frames with something in view.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patched {
    pub(super) node: NodeId,
    /// Of its surface, in a world with directions; otherwise 0.
    pub(super) element: u8,
    /// Σ weight, and Σ weight × sharpness.
    pub(super) weight: [f64; 2],
    /// Σ weight per projected area × |direction|: its product with a group's face areas is the group's weight; and the
    /// same × sharpness. Of an element, along x only: weight per area ([`areas`]).
    pub(super) density: [DVec3; 2],
    /// Least and greatest sharpness.
    pub(super) sharpness: [f64; 2],
}

/// The patches of each step, by node.
pub(super) fn patches(tree: &LodTree, cuts: &[Cut], steps: &[Range<usize>]) -> Vec<Vec<Patched>> {
    let nonempty = cuts.iter().filter(|cut| cut.total_weight > 0.0).count().max(1) as f64;
    let of_step = |step: &Range<usize>| {
        let mut all: Vec<Patched> = Vec::new();
        for cut in cuts[step.clone()].iter().filter(|cut| cut.total_weight > 0.0) {
            for patch in &cut.patches {
                if tree.has_directions() {
                    let weight = patch.weight / cut.total_weight / nonempty;
                    let densities = ElementDensity::new(tree, cut, patch, weight);
                    let surface = tree.surface(patch.node);
                    for s in (0..ELEMENTS).filter(|&s| surface[s] * densities.of(s) > 0.0) {
                        let (weight, density) = (surface[s] * densities.of(s), DVec3::X * densities.of(s));
                        all.push(Patched {
                            node: patch.node,
                            element: s as u8,
                            weight: [weight, weight * patch.sharpness],
                            density: [density, density * patch.sharpness],
                            sharpness: [patch.sharpness; 2],
                        });
                    }
                    continue;
                }
                let direction = (tree.centre(patch.node) - cut.eye).normalize_or_zero();
                let area = projected_area(tree, patch.node, direction);
                let weight = patch.weight / cut.total_weight / nonempty;
                let density = if area > 0.0 { direction.abs() * (weight / area) } else { DVec3::ZERO };
                all.push(Patched {
                    node: patch.node,
                    element: 0,
                    weight: [weight, weight * patch.sharpness],
                    density: [density, density * patch.sharpness],
                    sharpness: [patch.sharpness; 2],
                });
            }
        }
        sum(all)
    };
    steps.par_iter().map(of_step).collect()
}

/// Those of one node as one.
fn sum(mut all: Vec<Patched>) -> Vec<Patched> {
    // Stable, so that sums have one order.
    all.sort_by_key(|p| (p.node, p.element));
    all.dedup_by(|next, first| {
        let same = (next.node, next.element) == (first.node, first.element);
        if same {
            first.add(next.weight, next.density, next.sharpness);
        }
        same
    });
    all.shrink_to_fit();
    all
}

impl Patched {
    /// The patches of several steps as those of one.
    pub(super) fn merged(steps: &[Vec<Patched>]) -> Vec<Patched> {
        sum(steps.concat())
    }

    fn add(&mut self, weight: [f64; 2], density: [DVec3; 2], sharpness: [f64; 2]) {
        for k in 0..2 {
            self.weight[k] += weight[k];
            self.density[k] += density[k];
        }
        self.sharpness = [self.sharpness[0].min(sharpness[0]), self.sharpness[1].max(sharpness[1])];
    }
}

/// The areas that a patch's density is multiplied by.
pub(super) fn areas(tree: &LodTree, node: NodeId, element: u8) -> DVec3 {
    if tree.has_directions() { DVec3::X * tree.surface(node)[usize::from(element)] } else { tree.face_areas(node) }
}

/// What the whole replay sees of each node.
pub(super) struct Sight {
    /// Σ density over the patches at the node or above it.
    density: Vec<DVec3>,
    /// Whether it is a patch of some cut, or has one beneath it.
    seen: Vec<Seen>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Seen {
    Never,
    Whole,
    Opened,
}

impl Sight {
    pub(super) fn new(tree: &LodTree, patches: &[Vec<Patched>]) -> Sight {
        let mut sight = Sight { density: vec![DVec3::ZERO; tree.nodes()], seen: vec![Seen::Never; tree.nodes()] };
        for patch in patches.iter().flatten() {
            // By element as much per area of all elements as there is of it.
            sight.density[patch.node.index()] += if tree.has_directions() {
                DVec3::X * (patch.weight[0] / tree.surface(patch.node).iter().sum::<f64>())
            } else {
                patch.density[0]
            };
            if sight.seen[patch.node.index()] == Seen::Never {
                sight.seen[patch.node.index()] = Seen::Whole;
            }
            for above in tree.ancestors(patch.node).skip(1) {
                if sight.seen[above.index()] == Seen::Opened {
                    break;
                }
                sight.seen[above.index()] = Seen::Opened;
            }
        }
        for node in (1..tree.nodes() as u32).map(NodeId) {
            if let Some(parent) = tree.parent(node) {
                let above = sight.density[parent.index()];
                sight.density[node.index()] += above;
            }
        }
        sight
    }

    fn is_seen(&self, node: NodeId) -> bool {
        self.seen[node.index()] != Seen::Never || self.density[node.index()] != DVec3::ZERO
    }

    /// Opened where a cut opens it, or where it weighs more than `share` of the replay.
    fn is_open(&self, tree: &LodTree, node: NodeId, share: f64) -> bool {
        let weight = || {
            let density = self.density[node.index()];
            if tree.has_directions() {
                density.x * tree.surface(node).iter().sum::<f64>()
            } else {
                density.dot(tree.face_areas(node))
            }
        };
        !tree.is_leaf(node) && (self.seen[node.index()] == Seen::Opened || weight() > share)
    }
}

/// Nodes at which something is owned or seen, in preorder.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub(super) node: NodeId,
    /// The item next above; itself for the first.
    pub(super) parent: usize,
    /// Wire and decoded bytes that show all beneath it without error; ∞ where there is nothing beneath.
    pub(super) beneath: [f64; 2],
}

/// The items, and which of them are not open, in preorder.
#[derive(Debug, Default)]
pub(super) struct Items {
    pub(super) all: Vec<Item>,
    /// Nodes of the closed ones, with their place among all.
    pub(super) closed: Vec<(NodeId, usize)>,
}

impl Items {
    pub(super) fn new(tree: &LodTree, cheapest: &CheapestBeneath, sight: &Sight, share: f64) -> Items {
        let mut items = Items::default();
        let mut open: Vec<usize> = Vec::new();
        let end = tree.nodes() as u32;
        let mut next = NodeId(0);
        while next.0 < end {
            while open.last().is_some_and(|&top| !tree.is_beneath(next, items.all[top].node)) {
                open.pop();
            }
            if !sight.is_seen(next) {
                next = tree.subtree_end(next);
                continue;
            }
            let is_open = sight.is_open(tree, next, share);
            let place = items.all.len();
            let parent = open.last().copied().unwrap_or(place);
            let mut beneath = [f64::INFINITY; 2];
            if !is_open {
                items.closed.push((next, place));
                if !tree.is_leaf(next) {
                    beneath = match &cheapest.by_element {
                        Some(by_element) => by_element.each_ref().map(|cheapest| cheapest.whole(tree, next)),
                        None => [whole(tree, &cheapest.wire, next), whole(tree, &cheapest.decoded, next)],
                    };
                }
            }
            items.all.push(Item { node: next, parent, beneath });
            if is_open {
                open.push(place);
                next = NodeId(next.0 + 1);
            } else {
                next = tree.subtree_end(next);
            }
        }
        items
    }

    /// The closed ones at or beneath a node.
    pub(super) fn closed_beneath(&self, tree: &LodTree, node: NodeId) -> Range<usize> {
        let end = tree.subtree_end(node);
        self.closed.partition_point(|c| c.0 < node)..self.closed.partition_point(|c| c.0 < end)
    }
}

/// Least bytes that show everything beneath `node`: what costs M bytes shows at most the share M ÷ (β_i·A_i) along every
/// axis i, so from every direction at most M over the least of these.
fn whole(tree: &LodTree, beneath: &[[f32; 3]], node: NodeId) -> f64 {
    let (beta, areas) = (beneath[node.index()], tree.face_areas(node));
    if beta[0].is_infinite() {
        return f64::INFINITY;
    }
    let axes = (0..3).filter(|&i| areas[i] > 0.0).map(|i| f64::from(beta[i].next_down()) * areas[i]);
    let least = axes.fold(f64::INFINITY, f64::min);
    // Areas are sums in single precision.
    if least.is_finite() { (least * (1.0 - 1e-6)).max(0.0) } else { 0.0 }
}
