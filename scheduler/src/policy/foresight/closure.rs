//! Closures: what has to come together for a representation to be of use.

use crate::benefit::coverage::{Coverage, Refinement};
use crate::benefit::element::{self, ELEMENTS};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::state::ClientState;

/// What must be fetched for `rep` to be of use, in order: missing prerequisites first, and under atomic refinement the
/// missing members of its sibling group, each with its coarsest.
pub(super) fn closure(state: &ClientState, plan: &Coverage, rep: RepId) -> Vec<RepId> {
    let tree = state.tree;
    let mut members = Vec::new();
    let mut with_prerequisites = |rep: RepId| {
        let first = members.len();
        let mut next = Some(rep);
        while let Some(r) = next.filter(|r| !plan.contains(*r) && !members.contains(r)) {
            members.push(r);
            next = tree.prerequisite(r);
        }
        members[first..].reverse();
    };
    if plan.refinement() == Refinement::Atomic {
        let node = tree.node_of(rep);
        if !plan.counts(tree, node) {
            for sibling in tree.sibling_group(tree.content_parent(node)) {
                if sibling != node && !tree.own(sibling).any(|r| plan.contains(r)) {
                    tree.own(sibling).next().into_iter().for_each(&mut with_prerequisites);
                }
            }
        }
    }
    with_prerequisites(rep);
    members
}

/// Whether one of `members` needs `rep` first.
pub(super) fn needed_by(state: &ClientState, rep: RepId, members: &[RepId]) -> bool {
    state.tree.has_prerequisites()
        && members.iter().any(|&m| core::iter::successors(Some(m), |&r| state.tree.prerequisite(r)).any(|r| r == rep))
}

/// The lowest node above all of `members`.
pub(super) fn common_ancestor(state: &ClientState, members: &[RepId]) -> NodeId {
    let tree = state.tree;
    let mut top = members.first().map_or(tree.root(), |&m| tree.node_of(m));
    for &member in members {
        while !tree.is_beneath(tree.node_of(member), top) {
            match tree.parent(top) {
                Some(parent) => top = parent,
                None => return top,
            }
        }
    }
    top
}

/// The first representation of the topmost node that has one, at or above `node`.
pub(super) fn coarsest(tree: &LodTree, node: NodeId) -> Option<RepId> {
    tree.ancestors(node).filter_map(|n| tree.own(n).next()).last()
}

/// Of the topmost node that shows some of what faces the eye, the representation that shows the largest share of it.
pub(super) fn coarsest_facing(tree: &LodTree, node: NodeId, shares: &[f64; ELEMENTS]) -> Option<RepId> {
    let shown = |rep: RepId| -> f64 {
        let errors = element::errors(tree, rep);
        (0..ELEMENTS).filter(|&s| errors[s] < f32::INFINITY).map(|s| shares[s]).sum()
    };
    let of_node = |n: NodeId| {
        let own = tree.own(n).map(|rep| (shown(rep), rep)).filter(|(share, _)| *share > 0.0);
        own.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1))).map(|(_, rep)| rep)
    };
    tree.ancestors(node).filter_map(of_node).last()
}
