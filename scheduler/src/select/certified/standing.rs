//! The planned set, with what is left to choose and how badly things are shown beneath each of its nodes.

use crate::benefit::coverage::Coverage;
use crate::benefit::element::{self, ELEMENTS, Errors};
use crate::lod_tree::{Beneath, LodTree, NodeId, RepId};
use crate::sparse::IdMap;

/// Nodes with more children than this are summarised step by step instead of anew.
const CHILDREN_MAX: usize = 64;

/// What lies strictly beneath a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Summary {
    /// Bounds for what is not held.
    pub(super) left: Beneath,
    /// At least the largest error with which what is held strictly beneath shows any part of the node; ∞ if some part is
    /// not shown from beneath.
    pub(super) shown: f32,
    /// Face areas of what something strictly beneath shows, summed over the axes, m².
    pub(super) covered: f32,
}

/// A planned set under partial refinement. Changes take time in the depth of the tree and the children on the way.
#[derive(Clone, Debug)]
pub struct Standing {
    plan: Coverage,
    /// By node, where something is held beneath.
    summaries: IdMap<Summary>,
    /// The same in a world with directions: by element, at least the largest error with which what is held strictly
    /// beneath shows any part; 0 where there is no such surface.
    elements: IdMap<Errors>,
}

impl Standing {
    /// What `plan` holds.
    pub fn new(tree: &LodTree, plan: Coverage) -> Standing {
        let mut standing = Standing { plan, summaries: IdMap::default(), elements: IdMap::default() };
        let held: Vec<RepId> = standing.plan.iter().collect();
        // From the last node back, so that what lies beneath is known; ancestors shared by neighbours are done once more
        // for each, which stops as soon as nothing changes.
        for rep in held.into_iter().rev() {
            standing.refresh(tree, tree.node_of(rep), true);
        }
        standing
    }

    /// The set itself.
    pub fn plan(&self) -> &Coverage {
        &self.plan
    }

    /// Adds a representation; false if it was there.
    pub fn insert(&mut self, tree: &LodTree, rep: RepId) -> bool {
        let changed = self.plan.insert(tree, rep);
        if changed {
            self.refresh(tree, tree.node_of(rep), true);
        }
        changed
    }

    /// Takes a representation out; false if it was not there.
    pub fn remove(&mut self, tree: &LodTree, rep: RepId) -> bool {
        let changed = self.plan.remove(tree, rep);
        if changed {
            self.refresh(tree, tree.node_of(rep), false);
        }
        changed
    }

    /// Bytes that it occupies.
    pub fn heap_bytes(&self) -> usize {
        self.plan.heap_bytes() + self.summaries.allocation_size() + self.elements.allocation_size()
    }

    /// What lies strictly beneath a node.
    pub(super) fn beneath(&self, tree: &LodTree, node: NodeId) -> Summary {
        let known = if self.plan.any_beneath(node) { self.summaries.get(&node.0).copied() } else { None };
        known.unwrap_or_else(|| Summary { left: tree.beneath_bounds(node), shown: f32::INFINITY, covered: 0.0 })
    }

    /// By element, at least the largest error with which what is held strictly beneath shows any part of the node.
    pub(super) fn elements_beneath(&self, node: NodeId) -> Errors {
        let known = if self.plan.any_beneath(node) { self.elements.get(&node.0).copied() } else { None };
        known.unwrap_or(element::NOTHING)
    }

    /// Summarises the nodes above `node` anew.
    fn refresh(&mut self, tree: &LodTree, node: NodeId, added: bool) {
        let mut child = node;
        for above in tree.ancestors(node).skip(1) {
            if !self.plan.any_beneath(above) {
                self.summaries.remove(&above.0);
                self.elements.remove(&above.0);
                child = above;
                continue;
            }
            let was = self.summaries.get(&above.0).copied();
            let is = match tree.children(above).nth(CHILDREN_MAX) {
                None => self.summarise(tree, above),
                Some(_) => {
                    // Bounds that hold: nothing is taken off when something is added, all is put on when it goes.
                    let was = self.beneath(tree, above);
                    let one = self.summary_of_child(tree, child);
                    if added {
                        was
                    } else {
                        Summary { left: was.left.union(one.left), shown: was.shown.max(one.shown), covered: 0.0 }
                    }
                }
            };
            let changes = tree.has_directions() && self.refresh_elements(tree, above, child, added);
            if was == Some(is) && !changes {
                return;
            }
            self.summaries.insert(above.0, is);
            child = above;
        }
    }

    /// As above, by element; whether anything has changed.
    fn refresh_elements(&mut self, tree: &LodTree, above: NodeId, child: NodeId, added: bool) -> bool {
        let was = self.elements.get(&above.0).copied();
        let is = match tree.children(above).nth(CHILDREN_MAX) {
            None => {
                let of_children = tree.children(above).map(|child| self.elements_of_child(tree, child));
                of_children.fold([0.0f32; ELEMENTS], |a, b| core::array::from_fn(|s| a[s].max(b[s])))
            }
            Some(_) => {
                let was = self.elements_beneath(above);
                let one = self.elements_of_child(tree, child);
                if added { was } else { core::array::from_fn(|s| was[s].max(one[s])) }
            }
        };
        self.elements.insert(above.0, is);
        was != Some(is)
    }

    fn elements_of_child(&self, tree: &LodTree, child: NodeId) -> Errors {
        let (own, beneath) = (self.plan.elements_at(child).errors, self.elements_beneath(child));
        let surface = tree.surface(child);
        core::array::from_fn(|s| if surface[s] > 0.0 { own[s].min(beneath[s]) } else { 0.0 })
    }

    fn summarise(&self, tree: &LodTree, node: NodeId) -> Summary {
        let mut sum = Summary { left: Beneath::NONE, shown: 0.0, covered: 0.0 };
        for child in tree.children(node) {
            let one = self.summary_of_child(tree, child);
            sum.left = sum.left.union(one.left);
            sum.shown = sum.shown.max(one.shown);
            sum.covered += one.covered;
        }
        sum
    }

    /// A child with its own representations, as a part of its parent.
    fn summary_of_child(&self, tree: &LodTree, child: NodeId) -> Summary {
        let own = self.plan.best_at(child);
        let beneath = self.beneath(tree, child);
        let mut left = beneath.left;
        for rep in tree.own(child) {
            let improves = if tree.has_directions() {
                element::improves(&element::errors(tree, rep), &self.plan.elements_at(child).errors)
            } else {
                (tree.error(rep) as f32) < own
            };
            if !self.plan.contains(rep) && improves {
                left = left.union(tree.own_bounds(rep));
            }
        }
        let covered = if own < f32::INFINITY { tree.face_areas(child).element_sum() as f32 } else { beneath.covered };
        // By element in a world with directions: a direction does not show any part.
        let shown = if tree.has_directions() { f32::INFINITY } else { own.min(beneath.shown) };
        Summary { left, shown, covered }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::benefit::coverage::Refinement;
    use crate::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, Representation};
    use glam::DVec3;

    #[test]
    fn what_is_held_leaves_the_bounds_and_comes_back() -> Result<(), LodTreeError> {
        let rep = |wire_bytes, error| Representation {
            wire_bytes,
            decoded_bytes: wire_bytes,
            error,
            prerequisite: None,
            direction: None,
        };
        let mut b = LodTreeBuilder::default();
        b.open()?;
        b.add(rep(64, 8.0))?;
        let mut leaves = Vec::new();
        for x in [0.0, 2.0] {
            b.open()?;
            leaves.push(b.add(rep(128, 1.0))?);
            let min = DVec3::new(x, 0.0, 0.0);
            b.close(Some(Aabb { min, max: min + DVec3::ONE }), 1.0)?;
        }
        b.close(None, 1.0)?;
        let tree = b.finish()?;
        let mut standing = Standing::new(&tree, Coverage::new(&tree, Refinement::Partial));
        let before = standing.beneath(&tree, tree.root());
        assert!(before.left.density == [1.0 / 128.0; 3] && before.shown == f32::INFINITY);
        standing.insert(&tree, leaves[0]);
        let half = standing.beneath(&tree, tree.root());
        assert!(half.left == before.left && half.shown == f32::INFINITY && half.covered == 3.0);
        standing.insert(&tree, leaves[1]);
        let all = standing.beneath(&tree, tree.root());
        assert!(all.left == Beneath::NONE && all.shown == 1.0 && all.covered == 6.0);
        let anew = Standing::new(&tree, standing.plan().clone());
        assert_eq!(anew.beneath(&tree, tree.root()), all);
        standing.remove(&tree, leaves[1]);
        assert_eq!(standing.beneath(&tree, tree.root()), half);
        standing.remove(&tree, leaves[0]);
        assert_eq!(standing.beneath(&tree, tree.root()), before);
        Ok(())
    }
}
