//! Which error each node is shown with: the resident set, folded onto the tree.

use super::element::{self, ELEMENTS, Errors};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::sparse::{IdMap, RepSet};

/// Whether a representation counts as soon as it is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Refinement {
    /// A child is drawn beside its parent.
    #[default]
    Partial,
    /// A parent stays until all of its children are there (stock 3D Tiles viewers).
    Atomic,
}

/// How a node takes part in what is shown.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// The least error among the node's own representations that count; ∞ if none does.
    best: f32,
    /// How many nodes strictly beneath it have a representation that counts.
    beneath: u32,
}

/// What shows each element of a surface: the least error and whose it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elements {
    /// Metres; ∞ for what is not shown.
    pub errors: Errors,
    reps: [u32; ELEMENTS],
}

/// No representation has this number.
const NO_REP: u32 = u32::MAX;

impl Elements {
    /// Nothing.
    pub const NOTHING: Elements = Elements { errors: element::NOTHING, reps: [NO_REP; ELEMENTS] };

    /// What shows element `s`.
    pub fn rep(&self, s: usize) -> Option<RepId> {
        Some(RepId(self.reps[s])).filter(|rep| rep.0 != NO_REP)
    }

    /// Takes from `other` what it shows better, or just as well if `ties` says so.
    fn take(&mut self, other: &Elements, ties: bool) {
        for s in 0..ELEMENTS {
            if other.errors[s] < self.errors[s] || ties && other.reps[s] != NO_REP && other.errors[s] <= self.errors[s]
            {
                (self.errors[s], self.reps[s]) = (other.errors[s], other.reps[s]);
            }
        }
    }

    fn of(errors: Errors, rep: RepId) -> Elements {
        Elements { errors, reps: errors.map(|error| if error < f32::INFINITY { rep.0 } else { NO_REP }) }
    }
}

/// A sibling group of which something is there.
#[derive(Clone, Copy, Debug)]
struct Group {
    members: u32,
    /// Members that have a representation.
    present: u32,
}

/// A set of representations, kept so that the best error at or above a node is found by walking up, and a subtree in
/// which nothing is shown by itself is recognised at once. Insertion and removal take time in the depth of the tree;
/// memory is taken for the members and the nodes above them only.
#[derive(Clone, Debug)]
pub struct Coverage {
    refinement: Refinement,
    held: RepSet,
    /// The nodes at or beneath which something counts.
    parts: IdMap<Part>,
    /// Under `Atomic`, by content parent, the groups of which something is there.
    groups: IdMap<Group>,
    /// Where the world has directions, what the node's own representations that count show.
    elements: IdMap<Elements>,
}

/// Stands for the content parent of the topmost group; no node has this number.
const TOP: u32 = u32::MAX;

impl Coverage {
    /// The empty set of representations of a tree.
    pub fn new(_tree: &LodTree, refinement: Refinement) -> Coverage {
        Coverage {
            refinement,
            held: RepSet::default(),
            parts: IdMap::default(),
            groups: IdMap::default(),
            elements: IdMap::default(),
        }
    }

    /// The refinement given at the start.
    pub fn refinement(&self) -> Refinement {
        self.refinement
    }

    /// Bytes that the set occupies.
    pub fn heap_bytes(&self) -> usize {
        self.held.heap_bytes()
            + self.parts.allocation_size()
            + self.groups.allocation_size()
            + self.elements.allocation_size()
    }

    /// Whether `rep` is in the set.
    pub fn contains(&self, rep: RepId) -> bool {
        self.held.contains(rep)
    }

    /// The members in order of id; they are sorted first.
    pub fn iter(&self) -> impl Iterator<Item = RepId> + '_ {
        self.held.iter()
    }

    /// Least error (m) among the node's own representations that count, ∞ if none does; and whether something strictly
    /// beneath the node counts.
    pub fn at(&self, node: NodeId) -> (f32, bool) {
        self.parts.get(&node.0).map_or((f32::INFINITY, false), |part| (part.best, part.beneath > 0))
    }

    /// Least error (m) among the node's own representations that count; ∞ if none does.
    pub fn best_at(&self, node: NodeId) -> f32 {
        self.at(node).0
    }

    /// Whether something strictly beneath the node counts.
    pub fn any_beneath(&self, node: NodeId) -> bool {
        self.at(node).1
    }

    /// Least error (m) at the node or above it; ∞ where nothing is shown.
    pub fn best_above(&self, tree: &LodTree, node: NodeId) -> f32 {
        self.shown_at(tree, node).1
    }

    /// The node at or above `node` whose own representations show it best, and with which error; ∞ for nothing.
    pub fn shown_at(&self, tree: &LodTree, node: NodeId) -> (Option<NodeId>, f32) {
        let mut shown = (None, f32::INFINITY);
        for above in tree.ancestors(node) {
            let error = self.best_at(above);
            if error < shown.1 {
                shown = (Some(above), error);
                if tree.errors_fall() {
                    break;
                }
            }
        }
        shown
    }

    /// What the node's own representations that count show. Only of a world with directions.
    pub fn elements_at(&self, node: NodeId) -> Elements {
        self.elements.get(&node.0).copied().unwrap_or(Elements::NOTHING)
    }

    /// What shows each element of the node, at it or above it; of equals, the nearest. Only of a world with directions.
    pub fn elements_above(&self, tree: &LodTree, node: NodeId) -> Elements {
        let mut shown = Elements::NOTHING;
        for above in tree.ancestors(node) {
            if let Some(own) = self.elements.get(&above.0) {
                shown.take(own, false);
            }
        }
        shown
    }

    /// What everything but `rep` shows of its node, at it or above it.
    pub fn elements_without(&self, tree: &LodTree, rep: RepId) -> Elements {
        let node = tree.node_of(rep);
        let mut shown = tree.parent(node).map_or(Elements::NOTHING, |parent| self.elements_above(tree, parent));
        if self.counts(tree, node) {
            for other in tree.own(node).filter(|&other| other != rep && self.contains(other)) {
                shown.take(&Elements::of(element::errors(tree, other), other), true);
            }
        }
        shown
    }

    /// As [`Coverage::sweep`], by element.
    pub fn sweep_elements<'a>(&'a self, tree: &'a LodTree, top: NodeId) -> Sweep<'a, Elements> {
        self.sweep_from(tree, top, self.elements_above(tree, top))
    }

    /// A sweep as if `top` were shown by `shown`, whatever is at it and above it.
    pub fn sweep_from<'a, S: Shown>(&'a self, tree: &'a LodTree, top: NodeId, shown: S) -> Sweep<'a, S> {
        let level = Level { node: top, end: tree.subtree_end(top), shown, any_beneath: self.any_beneath(top) };
        Sweep { coverage: self, tree, levels: vec![level] }
    }

    /// The same as [`Coverage::shown_at`] for many nodes in ascending order, at or beneath `top`.
    pub fn sweep<'a>(&'a self, tree: &'a LodTree, top: NodeId) -> Sweep<'a> {
        self.sweep_beneath(tree, top, self.shown_at(tree, top))
    }

    /// A sweep as if `top` were shown by `shown`, whatever is at it and above it.
    pub fn sweep_beneath<'a>(&'a self, tree: &'a LodTree, top: NodeId, shown: (Option<NodeId>, f32)) -> Sweep<'a> {
        self.sweep_from(tree, top, shown)
    }

    /// Whether the whole sibling group of `node` is there, so that it may count. Always true under `Partial`.
    pub fn counts(&self, tree: &LodTree, node: NodeId) -> bool {
        if self.refinement == Refinement::Partial {
            return true;
        }
        match self.groups.get(&group_key(tree, node)) {
            Some(group) => group.present == group.members,
            // Nothing of the group is there; it is whole only if it has no members.
            None => tree.own(node).len() == 0 && tree.sibling_group(tree.content_parent(node)).is_empty(),
        }
    }

    /// Adds a representation; false if it was there.
    pub fn insert(&mut self, tree: &LodTree, rep: RepId) -> bool {
        let node = tree.node_of(rep);
        let first_of_node = self.refinement == Refinement::Atomic && !tree.own(node).any(|r| self.contains(r));
        if !self.held.insert(rep) {
            return false;
        }
        if first_of_node {
            let parent = tree.content_parent(node);
            let group = self
                .groups
                .entry(parent.map_or(TOP, |p| p.0))
                .or_insert_with(|| Group { members: tree.sibling_group(parent).len() as u32, present: 0 });
            group.present += 1;
            if group.present == group.members {
                for member in tree.sibling_group(parent) {
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
        if !self.held.remove(rep) {
            return false;
        }
        let node = tree.node_of(rep);
        if self.refinement == Refinement::Atomic && !tree.own(node).any(|r| self.contains(r)) {
            let key = group_key(tree, node);
            let mut was_whole = false;
            if let Some(group) = self.groups.get_mut(&key) {
                was_whole = group.present == group.members;
                group.present -= 1;
                if group.present == 0 {
                    self.groups.remove(&key);
                }
            }
            if was_whole {
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
        if tree.has_directions() {
            self.refresh_elements(tree, node, counts);
        }
        let was = self.best_at(node);
        self.change(node, |part| part.best = best);
        if (was < f32::INFINITY) != (best < f32::INFINITY) {
            for above in tree.ancestors(node).skip(1) {
                let step = if best < f32::INFINITY { 1 } else { -1 };
                self.change(above, |part| part.beneath = part.beneath.saturating_add_signed(step));
            }
        }
    }

    fn refresh_elements(&mut self, tree: &LodTree, node: NodeId, counts: bool) {
        let mut shown = Elements::NOTHING;
        for rep in tree.own(node).filter(|&rep| counts && self.contains(rep)) {
            shown.take(&Elements::of(element::errors(tree, rep), rep), false);
        }
        if shown == Elements::NOTHING {
            self.elements.remove(&node.0);
        } else {
            self.elements.insert(node.0, shown);
        }
    }

    /// Alters a node's part; what takes no part is not kept.
    fn change(&mut self, node: NodeId, alter: impl FnOnce(&mut Part)) {
        let part = self.parts.entry(node.0).or_insert(Part { best: f32::INFINITY, beneath: 0 });
        alter(part);
        if part.beneath == 0 && part.best == f32::INFINITY {
            self.parts.remove(&node.0);
        }
    }
}

/// What a sweep carries downwards: who shows a node, and how well.
pub trait Shown: Copy {
    /// With what the node itself has; `own` is the least error there, ∞ if nothing counts.
    fn at(self, coverage: &Coverage, node: NodeId, own: f32) -> Self;
}

/// The node that shows it best, and with which error (∞ for nothing).
impl Shown for (Option<NodeId>, f32) {
    #[inline]
    fn at(self, _coverage: &Coverage, node: NodeId, own: f32) -> Self {
        // Of equals, the nearest shows it.
        if own <= self.1 && own < f32::INFINITY { (Some(node), own) } else { self }
    }
}

impl Shown for Elements {
    fn at(mut self, coverage: &Coverage, node: NodeId, own: f32) -> Self {
        if let Some(elements) = coverage.elements.get(&node.0).filter(|_| own < f32::INFINITY) {
            self.take(elements, true);
        }
        self
    }
}

/// A node of the path from the top of a sweep to where it is.
#[derive(Clone, Copy, Debug)]
struct Level<S> {
    node: NodeId,
    end: NodeId,
    shown: S,
    any_beneath: bool,
}

/// Asks what shows one node after the other: each node above them is looked up once, and nothing beneath a node beneath
/// which nothing counts.
#[derive(Debug)]
pub struct Sweep<'a, S = (Option<NodeId>, f32)> {
    coverage: &'a Coverage,
    tree: &'a LodTree,
    /// From the top down, each within the one before.
    levels: Vec<Level<S>>,
}

impl Sweep<'_> {
    /// The node at or above `node` whose own representations show it best, with which error (∞ for nothing), and whether
    /// something beneath `node` counts. `node` lies beneath the top and is not less than the one asked for before.
    #[inline]
    pub fn shown_at(&mut self, node: NodeId) -> (Option<NodeId>, f32, bool) {
        let ((owner, error), any_beneath) = self.at(node);
        (owner, error, any_beneath)
    }
}

impl<S: Shown> Sweep<'_, S> {
    /// Begins anew at the top.
    pub fn restart(&mut self) {
        self.levels.truncate(1);
    }

    /// What shows `node`, and whether something beneath it counts. `node` lies beneath the top and is not less than the
    /// one asked for before.
    #[inline]
    pub fn at(&mut self, node: NodeId) -> (S, bool) {
        let last = &self.levels[self.levels.len() - 1];
        if node < last.end && !last.any_beneath {
            return (last.shown, false);
        }
        self.descend(node)
    }

    fn descend(&mut self, node: NodeId) -> (S, bool) {
        while self.levels.len() > 1 && self.levels[self.levels.len() - 1].end <= node {
            self.levels.pop();
        }
        let known = self.levels.len();
        let last = &self.levels[known - 1];
        let (from, mut shown, mut any_beneath) = (last.node, last.shown, last.any_beneath);
        if any_beneath && from != node {
            for n in self.tree.ancestors(node).take_while(|&n| n != from) {
                self.levels.push(Level { node: n, end: self.tree.subtree_end(n), shown, any_beneath });
            }
            self.levels[known..].reverse();
            for i in known..self.levels.len() {
                let level = &mut self.levels[i];
                let own;
                (own, any_beneath) = self.coverage.at(level.node);
                shown = shown.at(self.coverage, level.node, own);
                (level.shown, level.any_beneath) = (shown, any_beneath);
                if !any_beneath {
                    self.levels.truncate(i + 1);
                    break;
                }
            }
        }
        (shown, any_beneath)
    }
}

fn group_key(tree: &LodTree, node: NodeId) -> u32 {
    tree.content_parent(node).map_or(TOP, |parent| parent.0)
}
