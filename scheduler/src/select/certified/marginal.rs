//! Exact gains and losses: a candidate's subtree, summed over all terms at once.
//!
//! Each term opens a group until it is small from its eye (θ) and takes leaves exactly, as a cut does; but it starts at the
//! candidate's node, so that a small candidate far away is not a share of a large group.

use super::bound::Mask;
use super::lanes::{Lanes, Looked};
use super::objective::Objective;
use super::standing::Standing;
use crate::benefit::element::Errors;
use crate::benefit::frustum::Side;
use crate::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;

/// Scratch of the sums, kept for its memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    whole: Stacks<f32>,
    by_element: Stacks<Errors>,
    /// Nodes visited.
    pub(super) visited: u64,
}

#[derive(Clone, Debug)]
struct Stacks<L> {
    open: Vec<Open<L>>,
    parts: Vec<(NodeId, L)>,
}

impl<L> Default for Stacks<L> {
    fn default() -> Stacks<L> {
        Stacks { open: Vec::new(), parts: Vec::new() }
    }
}

#[derive(Clone, Copy, Debug)]
struct Open<L> {
    node: NodeId,
    /// Least errors that others show here.
    others: L,
    /// Terms of the block that still open, and those that see all of it.
    terms: Mask,
    inside: Mask,
}

impl Objective {
    /// ΔJ of having `rep` beside everything else that is planned: a gain if it is not planned, the loss of discarding it
    /// if it is. `weights` are the terms' shares.
    pub(super) fn marginal(
        &self,
        tree: &LodTree,
        standing: &Standing,
        rep: RepId,
        weights: &[f64],
        scratch: &mut Scratch,
    ) -> f64 {
        let Scratch { whole, by_element, visited } = scratch;
        if tree.has_directions() {
            self.marginal_of(tree, standing, rep, weights, by_element, visited)
        } else {
            self.marginal_of(tree, standing, rep, weights, whole, visited)
        }
    }

    fn marginal_of<L: Lanes>(
        &self,
        tree: &LodTree,
        standing: &Standing,
        rep: RepId,
        weights: &[f64],
        stacks: &mut Stacks<L>,
        visited: &mut u64,
    ) -> f64 {
        let node = tree.node_of(rep);
        let error = L::of(tree, rep);
        let others = L::without(tree, standing.plan(), rep);
        *visited += 1;
        if !error.improves(&others) || !error.improves(&L::beneath(tree, standing, node)) {
            return 0.0;
        }
        let mut sum = 0.0;
        for (block, terms) in self.terms.chunks(64).enumerate() {
            let weights = &weights[block * 64..];
            let counts = terms.iter().zip(weights).enumerate().filter(|(_, (_, weight))| **weight > 0.0);
            let terms_left = counts.fold(0, |mask: Mask, (i, _)| mask | 1 << i);
            stacks.open.clear();
            stacks.open.push(Open { node, others, terms: terms_left, inside: 0 });
            while let Some(open) = stacks.open.pop() {
                sum += self.visit(tree, standing, open, error, block, weights, stacks, visited);
            }
        }
        sum
    }

    #[expect(clippy::too_many_arguments, reason = "the state of the loop above, split off for its length")]
    fn visit<L: Lanes>(
        &self,
        tree: &LodTree,
        standing: &Standing,
        open: Open<L>,
        error: L,
        block: usize,
        weights: &[f64],
        stacks: &mut Stacks<L>,
        visited: &mut u64,
    ) -> f64 {
        let Open { node, others, mut terms, inside } = open;
        *visited += 1;
        let (middle, half) = (tree.centre(node), tree.half(node));
        let is_leaf = tree.is_leaf(node);
        let divided = !is_leaf && standing.plan().any_beneath(node);
        let (mut sum, mut opened, mut whole) = (0.0, 0, 0);
        while terms != 0 {
            let i = terms.trailing_zeros() as usize;
            terms &= terms - 1;
            let eye = &self.terms[block * 64 + i].eye;
            let centre = middle - eye.frustum.eye;
            let side = if inside >> i & 1 != 0 { Side::Inside } else { eye.side(centre, half) };
            if side == Side::Outside {
                continue;
            }
            let is_far = eye.is_far(centre, half, side);
            if !is_leaf && !is_far {
                opened |= 1 << i;
                whole |= Mask::from(side == Side::Inside) << i;
                continue;
            }
            let Some((mut weight, sharpness)) = eye.weigh(tree, node, centre, half, is_far, side) else { continue };
            if is_leaf && !is_far {
                // A face is seen under at most its area × cosine / d²: without this, rounding can leave something of a tile
                // that is seen from its edge.
                let distance = (centre.abs() - half).max(DVec3::ZERO).length();
                let cosines = ((centre.abs() + half) / distance.max(f64::MIN_POSITIVE)).min(DVec3::ONE);
                let most = tree.face_areas(node).dot(cosines) / (distance * distance);
                weight = if distance > 0.0 { weight.min(most) } else { weight };
            }
            let at = Looked { node, centre, half, reach: eye.reach(), sharpness };
            sum += weights[i]
                * if divided {
                    divide(tree, standing, &at, weight, error, others, &mut stacks.parts, visited)
                } else {
                    weight * error.added(&others, tree, &at)
                };
        }
        if opened != 0 {
            for child in tree.children(node) {
                let others = others.least(L::at(standing.plan(), child));
                if error.improves(&others) && error.improves(&L::beneath(tree, standing, child)) {
                    stacks.open.push(Open { node: child, others, terms: opened, inside: whole });
                }
            }
        }
        sum
    }
}

/// Σ of a group's weight × accuracy added, divided by projected area where something beneath it is shown by itself.
#[expect(clippy::too_many_arguments, reason = "one call; grouping the inputs would only rename them")]
fn divide<L: Lanes>(
    tree: &LodTree,
    standing: &Standing,
    at: &Looked,
    weight: f64,
    error: L,
    others: L,
    parts: &mut Vec<(NodeId, L)>,
    visited: &mut u64,
) -> f64 {
    let Some(density) = L::density(tree, at, weight) else { return 0.0 };
    let mut sum = 0.0;
    parts.clear();
    parts.push((at.node, others));
    while let Some((node, others)) = parts.pop() {
        *visited += 1;
        for child in tree.children(node) {
            let others = others.least(L::at(standing.plan(), child));
            if !error.improves(&others) {
                continue;
            }
            if standing.plan().any_beneath(child) {
                if error.improves(&L::beneath(tree, standing, child)) {
                    parts.push((child, others));
                }
            } else {
                sum += error.added_to_part(&others, tree, child, at, density);
            }
        }
    }
    sum
}
