//! What is shown of a node: one error, or in a world with directions one for each element of its surface.

use super::bound::Target;
use super::standing::Standing;
use crate::benefit::accuracy::accuracy;
use crate::benefit::coverage::Coverage;
use crate::benefit::cut::projected_area;
use crate::benefit::element::{self, ELEMENTS, Errors};
use crate::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;

/// A node's box from an eye.
#[derive(Clone, Copy, Debug)]
pub(super) struct Looked {
    pub(super) node: NodeId,
    /// Its middle from the eye, metres.
    pub(super) centre: DVec3,
    pub(super) half: DVec3,
    /// By how much the eye may move, metres.
    pub(super) reach: f64,
    /// (pixels per metre / e₀)².
    pub(super) sharpness: f64,
}

/// Errors of everything that is told apart about a node.
pub(super) trait Lanes: Copy {
    /// A group's weight per area that its parts are divided by.
    type Density: Copy;
    /// Of a representation.
    fn of(tree: &LodTree, rep: RepId) -> Self;
    /// Of what is planned at the node itself.
    fn at(plan: &Coverage, node: NodeId) -> Self;
    /// Of what is planned at or above the node of `rep`, without it.
    fn without(tree: &LodTree, plan: &Coverage, rep: RepId) -> Self;
    /// At least the largest errors with which what is planned strictly beneath shows any part.
    fn beneath(tree: &LodTree, standing: &Standing, node: NodeId) -> Self;
    /// The lesser of each.
    fn least(self, other: Self) -> Self;
    /// Whether anything is better than in `others`.
    fn improves(&self, others: &Self) -> bool;
    /// Accuracy that these add to `others` at a node.
    fn added(&self, others: &Self, tree: &LodTree, at: &Looked) -> f64;
    /// The same, to within rounding.
    fn guessed(&self, others: &Self, tree: &LodTree, at: &Looked) -> f64 {
        self.added(others, tree, at)
    }
    /// How `weight` is divided among the parts of a group; `None` if it has no area.
    fn density(tree: &LodTree, at: &Looked, weight: f64) -> Option<Self::Density>;
    /// Weight × accuracy that these add to `others` at a part of the group.
    fn added_to_part(&self, others: &Self, tree: &LodTree, part: NodeId, at: &Looked, density: Self::Density) -> f64;
}

fn added(error: f32, others: f32, sharpness: f64) -> f64 {
    accuracy(f64::from(error), sharpness) - accuracy(f64::from(others), sharpness)
}

impl Lanes for f32 {
    /// With the direction along which areas are projected.
    type Density = (f64, DVec3);

    fn of(tree: &LodTree, rep: RepId) -> f32 {
        tree.error(rep) as f32
    }

    fn at(plan: &Coverage, node: NodeId) -> f32 {
        plan.best_at(node)
    }

    fn without(tree: &LodTree, plan: &Coverage, rep: RepId) -> f32 {
        let node = tree.node_of(rep);
        let mut others = tree.parent(node).map_or(f32::INFINITY, |p| plan.best_above(tree, p));
        for other in tree.own(node) {
            if other != rep && plan.contains(other) {
                others = others.min(tree.error(other) as f32);
            }
        }
        others
    }

    fn beneath(tree: &LodTree, standing: &Standing, node: NodeId) -> f32 {
        standing.beneath(tree, node).shown
    }

    fn least(self, other: f32) -> f32 {
        self.min(other)
    }

    fn improves(&self, others: &f32) -> bool {
        self < others
    }

    fn added(&self, others: &f32, _tree: &LodTree, at: &Looked) -> f64 {
        added(*self, *others, at.sharpness)
    }

    fn guessed(&self, others: &f32, _tree: &LodTree, at: &Looked) -> f64 {
        Target::of_area(DVec3::ONE, *self, *others).added_at(at.sharpness)
    }

    fn density(tree: &LodTree, at: &Looked, weight: f64) -> Option<(f64, DVec3)> {
        let direction = at.centre.normalize_or_zero();
        let whole = projected_area(tree, at.node, direction);
        (whole > 0.0).then(|| (weight / whole, direction))
    }

    fn added_to_part(
        &self,
        others: &f32,
        tree: &LodTree,
        part: NodeId,
        at: &Looked,
        (density, direction): (f64, DVec3),
    ) -> f64 {
        density * projected_area(tree, part, direction) * added(*self, *others, at.sharpness)
    }
}

impl Lanes for Errors {
    type Density = [f64; ELEMENTS];

    fn of(tree: &LodTree, rep: RepId) -> Errors {
        element::errors(tree, rep)
    }

    fn at(plan: &Coverage, node: NodeId) -> Errors {
        plan.elements_at(node).errors
    }

    fn without(tree: &LodTree, plan: &Coverage, rep: RepId) -> Errors {
        plan.elements_without(tree, rep).errors
    }

    fn beneath(_tree: &LodTree, standing: &Standing, node: NodeId) -> Errors {
        standing.elements_beneath(node)
    }

    fn least(self, other: Errors) -> Errors {
        element::least(&self, &other)
    }

    fn improves(&self, others: &Errors) -> bool {
        element::improves(self, others)
    }

    fn added(&self, others: &Errors, tree: &LodTree, at: &Looked) -> f64 {
        element::mean_gain(&element::shares(tree, at.node, at.centre, at.half, at.reach), self, others, at.sharpness)
    }

    fn density(tree: &LodTree, at: &Looked, weight: f64) -> Option<[f64; ELEMENTS]> {
        let facing = element::facing(at.centre, at.half, at.reach);
        let whole = element::projected(&tree.surface(at.node), &facing);
        (whole > 0.0).then(|| facing.map(|m| weight * m / whole))
    }

    fn added_to_part(
        &self,
        others: &Errors,
        tree: &LodTree,
        part: NodeId,
        at: &Looked,
        density: [f64; ELEMENTS],
    ) -> f64 {
        let mut weights = tree.surface(part);
        weights.iter_mut().zip(density).for_each(|(weight, density)| *weight *= density);
        element::mean_gain(&weights, self, others, at.sharpness)
    }
}
