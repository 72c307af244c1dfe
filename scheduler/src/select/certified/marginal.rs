//! Exact gains and losses: a candidate's subtree, summed over all terms at once.
//!
//! Each term opens a group until it is small from its eye (θ) and takes leaves exactly, as a cut does; but it starts at the
//! candidate's node, so that a small candidate far away is not a share of a large group.

use super::bound::Mask;
use super::objective::Objective;
use super::standing::Standing;
use crate::benefit::accuracy::accuracy;
use crate::benefit::cut::projected_area;
use crate::benefit::frustum::Side;
use crate::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;

/// Scratch of the sums, kept for its memory.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    stack: Vec<Open>,
    parts: Vec<(NodeId, f32)>,
    /// Nodes visited.
    pub(super) visited: u64,
}

#[derive(Clone, Copy, Debug)]
struct Open {
    node: NodeId,
    /// Least error that others show here.
    others: f32,
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
        let (node, plan) = (tree.node_of(rep), standing.plan());
        let error = tree.error(rep) as f32;
        let mut others = tree.parent(node).map_or(f32::INFINITY, |p| plan.best_above(tree, p));
        for other in tree.own(node) {
            if other != rep && plan.contains(other) {
                others = others.min(tree.error(other) as f32);
            }
        }
        scratch.visited += 1;
        if error >= others || error >= standing.beneath(tree, node).shown {
            return 0.0;
        }
        let mut sum = 0.0;
        for (block, terms) in self.terms.chunks(64).enumerate() {
            let weights = &weights[block * 64..];
            let counts = terms.iter().zip(weights).enumerate().filter(|(_, (_, weight))| **weight > 0.0);
            let terms_left = counts.fold(0, |mask: Mask, (i, _)| mask | 1 << i);
            scratch.stack.clear();
            scratch.stack.push(Open { node, others, terms: terms_left, inside: 0 });
            while let Some(open) = scratch.stack.pop() {
                sum += self.visit(tree, standing, open, error, block, weights, scratch);
            }
        }
        sum
    }

    #[expect(clippy::too_many_arguments, reason = "the state of the loop above, split off for its length")]
    fn visit(
        &self,
        tree: &LodTree,
        standing: &Standing,
        open: Open,
        error: f32,
        block: usize,
        weights: &[f64],
        scratch: &mut Scratch,
    ) -> f64 {
        let Open { node, others, mut terms, inside } = open;
        scratch.visited += 1;
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
            sum += weights[i]
                * if divided {
                    let direction = centre.normalize_or_zero();
                    divide(tree, standing, node, weight, direction, error, others, sharpness, scratch)
                } else {
                    weight * added(error, others, sharpness)
                };
        }
        if opened != 0 {
            for child in tree.children(node) {
                let others = others.min(standing.plan().best_at(child));
                if error < others && error < standing.beneath(tree, child).shown {
                    scratch.stack.push(Open { node: child, others, terms: opened, inside: whole });
                }
            }
        }
        sum
    }
}

fn added(error: f32, others: f32, sharpness: f64) -> f64 {
    accuracy(f64::from(error), sharpness) - accuracy(f64::from(others), sharpness)
}

/// Σ of a group's weight × accuracy added, divided by projected area where something beneath it is shown by itself.
#[expect(clippy::too_many_arguments, reason = "one call; grouping the inputs would only rename them")]
fn divide(
    tree: &LodTree,
    standing: &Standing,
    node: NodeId,
    weight: f64,
    direction: DVec3,
    error: f32,
    others: f32,
    sharpness: f64,
    scratch: &mut Scratch,
) -> f64 {
    let whole = projected_area(tree, node, direction);
    if whole <= 0.0 {
        return 0.0;
    }
    let density = weight / whole;
    let mut sum = 0.0;
    scratch.parts.clear();
    scratch.parts.push((node, others));
    while let Some((node, others)) = scratch.parts.pop() {
        scratch.visited += 1;
        for child in tree.children(node) {
            let others = others.min(standing.plan().best_at(child));
            if error >= others {
                continue;
            }
            if standing.plan().any_beneath(child) {
                if error < standing.beneath(tree, child).shown {
                    scratch.parts.push((child, others));
                }
            } else {
                sum += density * projected_area(tree, child, direction) * added(error, others, sharpness);
            }
        }
    }
    sum
}
