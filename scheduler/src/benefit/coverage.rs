//! Which error each node is shown with: the resident set, folded onto the tree.

use crate::lod_tree::{LodTree, NodeId, RepId};

/// Whether a representation counts as soon as it is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refinement {
    /// A child is drawn beside its parent.
    #[default]
    Partial,
    /// A parent stays until all of its children are there (stock 3D Tiles viewers).
    Atomic,
}

/// A set of representations, kept so that the best error at or above a node is found by walking up, and a subtree in
/// which nothing is shown by itself is recognised at once. Insertion and removal take time in the depth of the tree.
#[derive(Clone, Debug)]
pub struct Coverage {
    refinement: Refinement,
    /// Bit per representation.
    held: Vec<u64>,
    /// Per node, the least error among its own representations that count; ∞ if none does.
    best: Vec<f32>,
    /// Per node, how many representations at nodes strictly beneath it count.
    beneath: Vec<u32>,
    /// Under `Atomic`, per content parent (last: the top), members of its group that are still missing.
    missing: Vec<u32>,
}

impl Coverage {
    /// The empty set.
    pub fn new(tree: &LodTree, refinement: Refinement) -> Coverage {
        let mut missing = Vec::new();
        if refinement == Refinement::Atomic {
            missing = vec![0; tree.nodes() + 1];
            // Preorder: a node's content parent is known before the node.
            let mut content_parent = vec![tree.nodes() as u32; tree.nodes()];
            for node in (0..tree.nodes() as u32).map(NodeId) {
                if let Some(parent) = tree.parent(node) {
                    content_parent[node.index()] =
                        if tree.own(parent).len() > 0 { parent.0 } else { content_parent[parent.index()] };
                }
                if tree.own(node).len() > 0 {
                    missing[content_parent[node.index()] as usize] += 1;
                }
            }
        }
        Coverage {
            refinement,
            held: vec![0; tree.representations().div_ceil(64)],
            best: vec![f32::INFINITY; tree.nodes()],
            beneath: vec![0; tree.nodes()],
            missing,
        }
    }

    /// The refinement given at the start.
    pub fn refinement(&self) -> Refinement {
        self.refinement
    }

    /// Whether `rep` is in the set.
    pub fn contains(&self, rep: RepId) -> bool {
        self.held[rep.index() / 64] >> (rep.index() % 64) & 1 != 0
    }

    /// The members in order of id.
    pub fn iter(&self) -> impl Iterator<Item = RepId> + '_ {
        self.held.iter().enumerate().flat_map(|(word, &bits)| {
            core::iter::successors((bits != 0).then_some(bits), |b| Some(b & (b - 1)).filter(|b| *b != 0))
                .map(move |b| RepId((word * 64) as u32 + b.trailing_zeros()))
        })
    }

    /// Least error (m) among the node's own representations that count; ∞ if none does.
    pub fn best_at(&self, node: NodeId) -> f32 {
        self.best[node.index()]
    }

    /// Least error (m) at the node or above it; ∞ where nothing is shown.
    pub fn best_above(&self, tree: &LodTree, node: NodeId) -> f32 {
        self.shown_at(tree, node).1
    }

    /// The node at or above `node` whose own representations show it best, and with which error; ∞ for nothing.
    pub fn shown_at(&self, tree: &LodTree, node: NodeId) -> (Option<NodeId>, f32) {
        let mut shown = (None, f32::INFINITY);
        for above in tree.ancestors(node) {
            let error = self.best[above.index()];
            if error < shown.1 {
                shown = (Some(above), error);
                if tree.errors_fall() {
                    break;
                }
            }
        }
        shown
    }

    /// Whether something strictly beneath the node counts.
    pub fn any_beneath(&self, node: NodeId) -> bool {
        self.beneath[node.index()] > 0
    }

    /// Whether the whole sibling group of `node` is there, so that it may count. Always true under `Partial`.
    pub fn counts(&self, tree: &LodTree, node: NodeId) -> bool {
        self.refinement == Refinement::Partial || self.missing[group_index(tree, node)] == 0
    }

    /// Adds a representation; false if it was there.
    pub fn insert(&mut self, tree: &LodTree, rep: RepId) -> bool {
        if self.contains(rep) {
            return false;
        }
        let node = tree.node_of(rep);
        let first_of_node = !tree.own(node).any(|r| self.contains(r));
        self.held[rep.index() / 64] |= 1 << (rep.index() % 64);
        if self.refinement == Refinement::Atomic && first_of_node {
            let group = group_index(tree, node);
            self.missing[group] -= 1;
            if self.missing[group] == 0 {
                for member in tree.sibling_group(tree.content_parent(node)) {
                    self.refresh(tree, member, true);
                }
                return true;
            }
        }
        let counts = self.counts(tree, node);
        self.refresh(tree, node, counts);
        true
    }

    /// Takes a representation out; false if it was not there.
    pub fn remove(&mut self, tree: &LodTree, rep: RepId) -> bool {
        if !self.contains(rep) {
            return false;
        }
        let node = tree.node_of(rep);
        self.held[rep.index() / 64] &= !(1 << (rep.index() % 64));
        if self.refinement == Refinement::Atomic && !tree.own(node).any(|r| self.contains(r)) {
            let group = group_index(tree, node);
            self.missing[group] += 1;
            if self.missing[group] == 1 {
                for member in tree.sibling_group(tree.content_parent(node)) {
                    self.refresh(tree, member, false);
                }
                return true;
            }
        }
        let counts = self.counts(tree, node);
        self.refresh(tree, node, counts);
        true
    }

    /// Recomputes what the node itself is shown with, and tells its ancestors if that begins or ends.
    fn refresh(&mut self, tree: &LodTree, node: NodeId, counts: bool) {
        let best = if counts {
            tree.own(node).filter(|&r| self.contains(r)).fold(f32::INFINITY, |best, r| best.min(tree.error(r) as f32))
        } else {
            f32::INFINITY
        };
        let (was, is) = (self.best[node.index()] < f32::INFINITY, best < f32::INFINITY);
        self.best[node.index()] = best;
        if was != is {
            for above in tree.ancestors(node).skip(1) {
                let count = &mut self.beneath[above.index()];
                *count = if is { *count + 1 } else { *count - 1 };
            }
        }
    }
}

fn group_index(tree: &LodTree, node: NodeId) -> usize {
    tree.content_parent(node).map_or(tree.nodes(), NodeId::index)
}
