//! Whether a comparison can mean anything: what the path needs against what link and memory give.

use foresight_scheduler::benefit::accuracy::{HALF_ACCURACY_PX, RIVALS_TARGET_PX};
use foresight_scheduler::benefit::cut::{Cut, Patch};
use foresight_scheduler::benefit::element::{ELEMENTS, errors};
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use std::collections::VecDeque;

/// Calls `need` with every representation of the coarsest set that shows each leaf of the cut at no more than 16 px of
/// error, prerequisites included; where nothing is good enough, with the best there is. May repeat itself.
///
/// In a world with directions that is so for every element of a leaf's surface that faces the eye: each is taken from the
/// topmost node that shows it well enough, and of a node's own representations the cheapest that show its elements, by
/// greedy cover (the most elements a byte first), are needed.
pub fn for_each_needed(tree: &LodTree, cut: &Cut, mut need: impl FnMut(RepId)) {
    if tree.has_directions() {
        let mut need = |rep: RepId| core::iter::successors(Some(rep), |&r| tree.prerequisite(r)).for_each(&mut need);
        return cut.patches.iter().for_each(|patch| for_each_element_needed(tree, cut, patch, &mut need));
    }
    let mut closure = |rep: RepId| {
        for r in core::iter::successors(Some(rep), |&r| tree.prerequisite(r)) {
            need(r);
        }
    };
    let good = |node: NodeId, limit: f64| {
        tree.own(node)
            .filter(|&r| tree.error(r) <= limit)
            .max_by(|&a, &b| tree.error(a).total_cmp(&tree.error(b)).then(b.cmp(&a)))
    };
    for patch in &cut.patches {
        // 16 px at this patch's distance, in metres.
        let limit = RIVALS_TARGET_PX / HALF_ACCURACY_PX / patch.sharpness.sqrt();
        if let Some(rep) = tree.ancestors(patch.node).filter_map(|n| good(n, limit)).last() {
            closure(rep);
            continue;
        }
        let end = tree.subtree_end(patch.node);
        let mut next = NodeId(patch.node.0 + 1);
        let mut served = patch.node.0 + 1 == end.0;
        if served {
            finest(tree, patch.node).into_iter().for_each(&mut closure);
        }
        while next < end {
            served = true;
            match good(next, limit) {
                Some(rep) => {
                    closure(rep);
                    next = tree.subtree_end(next);
                }
                None => {
                    if tree.is_leaf(next) {
                        finest(tree, next).into_iter().for_each(&mut closure);
                    }
                    next = NodeId(next.0 + 1);
                }
            }
        }
        debug_assert!(served, "a patch has leaves");
    }
}

/// A set of elements, a bit each.
type Mask = u16;

fn elements(is_in: impl Fn(usize) -> bool) -> Mask {
    (0..ELEMENTS).filter(|&s| is_in(s)).fold(0, |mask, s| mask | 1 << s)
}

/// What a patch needs, element by element.
fn for_each_element_needed(tree: &LodTree, cut: &Cut, patch: &Patch, need: &mut impl FnMut(RepId)) {
    let limit = RIVALS_TARGET_PX / HALF_ACCURACY_PX / patch.sharpness.sqrt();
    let shares = cut.shares(tree, patch.node);
    let mut missing = elements(|s| shares[s] > 0.0);
    let chain: Vec<NodeId> = tree.ancestors(patch.node).collect();
    for &node in chain.iter().rev() {
        missing = cover(tree, node, limit, missing, need);
    }
    let mut open = vec![(patch.node, missing)];
    while let Some((node, missing)) = open.pop() {
        if missing == 0 {
            continue;
        }
        if tree.is_leaf(node) {
            best_of_all(tree, node, missing, need);
            continue;
        }
        for child in tree.children(node) {
            let surface = tree.surface(child);
            let left = cover(tree, child, limit, missing & elements(|s| surface[s] > 0.0), need);
            open.push((child, left));
        }
    }
}

/// Needs those of a node's own that show what they can of `missing` within `limit` metres; returns what is left.
fn cover(tree: &LodTree, node: NodeId, limit: f64, mut missing: Mask, need: &mut impl FnMut(RepId)) -> Mask {
    if missing == 0 {
        return 0;
    }
    let shown: Vec<(RepId, Mask)> = tree
        .own(node)
        .map(|rep| (rep, errors(tree, rep)))
        .map(|(rep, errors)| (rep, elements(|s| f64::from(errors[s]) <= limit)))
        .collect();
    let per_byte = |(rep, mask): &(RepId, Mask), missing: Mask| {
        f64::from((mask & missing).count_ones()) / tree.wire_bytes(*rep) as f64
    };
    loop {
        let useful = shown.iter().filter(|(_, mask)| mask & missing != 0);
        let best = useful.max_by(|a, b| per_byte(a, missing).total_cmp(&per_byte(b, missing)).then(b.0.cmp(&a.0)));
        let Some(&(rep, mask)) = best else { return missing };
        need(rep);
        missing &= !mask;
    }
}

/// Needs the best that there is for each missing element of a leaf.
fn best_of_all(tree: &LodTree, leaf: NodeId, missing: Mask, need: &mut impl FnMut(RepId)) {
    for s in (0..ELEMENTS).filter(|s| missing >> s & 1 != 0) {
        let all = tree.ancestors(leaf).flat_map(|n| tree.own(n)).map(|rep| (errors(tree, rep)[s], rep));
        let best =
            all.filter(|(error, _)| *error < f32::INFINITY).min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        best.into_iter().for_each(|(_, rep)| need(rep));
    }
}

/// The best that there is for a leaf.
fn finest(tree: &LodTree, leaf: NodeId) -> Option<RepId> {
    tree.ancestors(leaf)
        .flat_map(|n| tree.own(n))
        .min_by(|&a, &b| tree.error(a).total_cmp(&tree.error(b)).then(a.cmp(&b)))
}

/// Needs of a whole flight.
#[derive(Clone, Debug, Default)]
pub struct Needs {
    /// One a frame, each representation once, in the order of the cut.
    pub frames: Vec<Vec<RepId>>,
    /// Wire bytes of the union of all.
    pub union_bytes: u64,
    /// Decoded bytes of the largest.
    pub largest_bytes: u64,
}

impl Needs {
    /// Works out the needs of every frame.
    pub fn new(tree: &LodTree, cuts: &[Cut]) -> Needs {
        let mut needs = Needs::default();
        // Frame in which each representation was last needed.
        let mut needed_in = vec![u32::MAX; tree.representations()];
        for (number, cut) in cuts.iter().enumerate() {
            let mut frame = Vec::new();
            let mut decoded = 0;
            for_each_needed(tree, cut, |rep| {
                let before = core::mem::replace(&mut needed_in[rep.index()], number as u32);
                if before != number as u32 {
                    frame.push(rep);
                    decoded += tree.decoded_bytes(rep);
                }
                if before == u32::MAX {
                    needs.union_bytes += tree.wire_bytes(rep);
                }
            });
            needs.largest_bytes = needs.largest_bytes.max(decoded);
            needs.frames.push(frame);
        }
        needs
    }

    /// Wire bytes that become needed after the first frame when a memory of `budget` decoded bytes forgets the least
    /// recently needed first, re-fetches included.
    pub fn newly_needed_bytes(&self, tree: &LodTree, budget: u64) -> u64 {
        // Touches in order of time; only the latest of each representation is not stale.
        let mut order: VecDeque<(u32, RepId)> = VecDeque::new();
        let mut last = vec![u32::MAX; tree.representations()];
        let (mut held, mut fetched) = (0u64, 0u64);
        for (frame, needed) in self.frames.iter().enumerate() {
            let frame = frame as u32;
            for &rep in needed {
                if last[rep.index()] == u32::MAX {
                    held += tree.decoded_bytes(rep);
                    if frame > 0 {
                        fetched += tree.wire_bytes(rep);
                    }
                }
                last[rep.index()] = frame;
                order.push_back((frame, rep));
            }
            while held > budget {
                // What this frame needs is not forgotten in it, even if it alone exceeds the budget.
                let Some(&(touched, rep)) = order.front().filter(|(touched, _)| *touched < frame) else { break };
                order.pop_front();
                if last[rep.index()] == touched {
                    last[rep.index()] = u32::MAX;
                    held -= tree.decoded_bytes(rep);
                }
            }
        }
        fetched
    }
}
