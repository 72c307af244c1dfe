//! `union` (\[ZK\] §5) with proven bounds: W = min(1, Ω/Σw)·Σ w·q over all leaves in the reachable region.
//!
//! w is the whole solid angle of the leaf's content box from the present eye, unclipped, times ι. q is the best that the
//! resident set offers where each representation counts with the least accuracy over the reachable interval of
//! distances (stand-off floor). In a world with directions that is so for each element of the leaf's surface, and those
//! that some reachable eye sees share the weight ([`crate::benefit::element`]). A leaf counts unless it, or a node above
//! it, is outside the region that the cut uses.
//!
//! Groups are bounded as a whole: with D the distance of the group's middle and ρ its radius, all that lies beneath has
//! distances in [D − ρ, D + ρ], directions within asin(ρ/D), and Σ w in Σ ι·A·\[cos\]/\[r²\] over those; the relative width is
//! about 6ρ/D, so an opening angle θ leaves 6θ of a group's weight open. The groups with the widest bounds are opened
//! until the gap asked for is reached, down to single leaves, whose width is rounding.

use super::bounds::{Interval, Item, group_solid_angle, scale, scaled_sum, solid_angle_from_eye};
use super::neighbourhood::Neighbourhood;
use super::{COORDINATE_MAX, WorstCaseError, within};
use crate::benefit::accuracy::{accuracy, sharpness};
use crate::benefit::coverage::{Coverage, Refinement};
use crate::benefit::cut::{CutSettings, Eye, Region};
use crate::benefit::element::{self, ELEMENTS, Errors};
use crate::benefit::frustum::{Frustum, Side};
use crate::estimate::Certified;
use crate::lod_tree::{LodTree, NodeId, RepId};
use core::f64::consts::PI;
use glam::DVec3;

/// How hard to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnionSettings {
    /// Gap asked for, relative to the value, or to 10⁻⁴ of the whole scaled weight if that is more.
    pub tolerance: f64,
    /// Nodes looked at, at most; checked between groups.
    pub evaluations_max: u32,
    /// Distances are at least this, metres, and at least the stand-off.
    pub near: f64,
}

impl Default for UnionSettings {
    fn default() -> UnionSettings {
        UnionSettings { tolerance: 1e-3, evaluations_max: 1 << 22, near: 0.1 }
    }
}

impl UnionSettings {
    fn check(&self) -> Result<(), WorstCaseError> {
        within("tolerance", self.tolerance, 0.0, 1.0, "a share from 0 to 1")?;
        within("near", self.near, f64::MIN_POSITIVE, COORDINATE_MAX, "metres, more than 0")?;
        Ok(())
    }
}

/// W of a resident set, sr.
pub fn worth(
    tree: &LodTree,
    neighbourhood: &Neighbourhood,
    coverage: &Coverage,
    settings: &UnionSettings,
) -> Result<Certified, WorstCaseError> {
    settings.check()?;
    let scene = Scene::new(tree, neighbourhood, settings);
    let share = |node: NodeId, seen: &Seen| scene.accuracy(coverage, node, seen);
    Ok(scene.refine(settings, share))
}

/// W with `rep` beside the resident set, minus W without, sr.
pub fn gain(
    tree: &LodTree,
    neighbourhood: &Neighbourhood,
    coverage: &Coverage,
    rep: RepId,
    settings: &UnionSettings,
) -> Result<Certified, WorstCaseError> {
    settings.check()?;
    within("representation", f64::from(rep.0), 0.0, tree.representations() as f64 - 1.0, "one of the tree's")?;
    let mut with = coverage.clone();
    with.insert(tree, rep);
    // A sibling group counts together.
    let node = tree.node_of(rep);
    let changed = match coverage.refinement() {
        Refinement::Partial => node,
        Refinement::Atomic => tree.content_parent(node).unwrap_or(tree.root()),
    };
    let scene = Scene::new(tree, neighbourhood, settings);
    let share = |node: NodeId, seen: &Seen| {
        if !tree.is_beneath(node, changed) && !tree.is_beneath(changed, node) {
            return Interval::default();
        }
        if tree.has_directions() && !tree.is_leaf(node) {
            return scene.gain_by_element(coverage, &with, node, seen);
        }
        let (before, after) = (scene.accuracy(coverage, node, seen), scene.accuracy(&with, node, seen));
        if tree.is_leaf(node) {
            let gained = (after.lo - before.lo).max(0.0);
            return Interval { lo: gained, hi: gained };
        }
        if before == after && !coverage.any_beneath(node) && !with.any_beneath(node) {
            return Interval::default();
        }
        Interval { lo: (after.lo - before.hi).max(0.0), hi: (after.hi - before.lo).max(0.0) }
    };
    Ok(scene.refine(settings, share))
}

/// How a node is seen from the neighbourhood.
struct Seen {
    /// Least distance from a reachable eye to any leaf beneath, and the greatest that the least distance to a leaf
    /// beneath can be; metres, floors included.
    distance: Interval,
    /// From the present eye to the middle of the node.
    centre: DVec3,
}

#[derive(Clone, Copy)]
struct Open {
    node: NodeId,
    /// The region holds everything beneath.
    is_inside: bool,
    item: Item,
}

struct Scene<'a> {
    tree: &'a LodTree,
    neighbourhood: &'a Neighbourhood,
    frustum: Frustum,
    /// Tells whether the region meets a box.
    eye: Eye,
    reach: f64,
    floor: f64,
}

impl<'a> Scene<'a> {
    fn new(tree: &'a LodTree, neighbourhood: &'a Neighbourhood, settings: &UnionSettings) -> Scene<'a> {
        let region = neighbourhood.region();
        let reach = match region {
            Region::Reachable { reach, .. } => reach,
            Region::Frustum => 0.0,
        };
        let eye = Eye::new(neighbourhood.view(), region, &CutSettings::default());
        let floor = settings.near.max(neighbourhood.stand_off());
        Scene { tree, neighbourhood, frustum: Frustum::new(neighbourhood.view()), eye, reach, floor }
    }

    fn accuracy_at(&self, error: f64, distance: f64) -> f64 {
        accuracy(error, sharpness(self.frustum.pixels_per_radian, distance))
    }

    /// Interval of the least accuracy of what the set shows at the leaves beneath `node`; of a leaf a single number.
    fn accuracy(&self, coverage: &Coverage, node: NodeId, seen: &Seen) -> Interval {
        let tree = self.tree;
        let mut found = if tree.has_directions() {
            self.accuracy_by_element(&coverage.elements_above(tree, node).errors, node, seen)
        } else {
            let error = f64::from(coverage.best_above(tree, node));
            Interval { lo: self.accuracy_at(error, seen.distance.lo), hi: self.accuracy_at(error, seen.distance.hi) }
        };
        if coverage.any_beneath(node) {
            found.hi = 1.0;
        }
        found
    }

    /// The elements of a node that may face a reachable eye, with their errors' accuracies.
    fn facing<'b>(
        &'b self,
        errors: &'b Errors,
        node: NodeId,
        seen: &'b Seen,
    ) -> impl Iterator<Item = (usize, Interval)> {
        let surface = self.tree.surface(node);
        let facing = element::facing(seen.centre, self.tree.half(node), self.reach);
        (0..ELEMENTS).filter(move |&s| surface[s] > 0.0 && facing[s] > 0.0).map(|s| {
            let error = f64::from(errors[s]);
            let (lo, hi) = (self.accuracy_at(error, seen.distance.lo), self.accuracy_at(error, seen.distance.hi));
            (s, Interval { lo, hi })
        })
    }

    /// As [`Scene::accuracy`], by element: of a leaf their mean, of a group all that a mean could be.
    fn accuracy_by_element(&self, errors: &Errors, node: NodeId, seen: &Seen) -> Interval {
        let tree = self.tree;
        if tree.is_leaf(node) {
            let shares = element::shares(tree, node, seen.centre, tree.half(node), self.reach);
            let sharpness = sharpness(self.frustum.pixels_per_radian, seen.distance.lo);
            let mean = element::mean_accuracy(&shares, errors, sharpness);
            return Interval { lo: mean, hi: mean };
        }
        let mut found = Interval { lo: 1.0, hi: 0.0 };
        for (_, one) in self.facing(errors, node, seen) {
            found = Interval { lo: found.lo.min(one.lo), hi: found.hi.max(one.hi) };
        }
        // Means are rounded.
        let round = 64.0 * f64::EPSILON;
        Interval { lo: found.lo.min(found.hi) * (1.0 - round), hi: (found.hi * (1.0 + round)).min(1.0) }
    }

    /// Interval of what `with` adds to `coverage` at the leaves beneath a group.
    fn gain_by_element(&self, coverage: &Coverage, with: &Coverage, node: NodeId, seen: &Seen) -> Interval {
        let [before, after] = [coverage, with].map(|set| set.elements_above(self.tree, node).errors);
        if coverage.any_beneath(node) || with.any_beneath(node) {
            let least = self.facing(&before, node, seen).map(|(_, one)| one.lo).fold(1.0, f64::min);
            return Interval { lo: 0.0, hi: 1.0 - least };
        }
        let later = self.facing(&after, node, seen);
        let gains = self.facing(&before, node, seen).zip(later).filter(|((s, _), _)| after[*s] < before[*s]);
        let most = gains.map(|((_, was), (_, is))| is.hi - was.lo).fold(0.0, f64::max);
        Interval { lo: 0.0, hi: most }
    }

    /// What is to be known of a node; `None` if the region misses it.
    fn look(&self, node: NodeId, was_inside: bool, share: &impl Fn(NodeId, &Seen) -> Interval) -> Option<Open> {
        let tree = self.tree;
        let (centre, half) = (tree.centre(node) - self.frustum.eye, tree.half(node));
        let side = match was_inside {
            true => Side::Inside,
            false => self.eye.side(centre, half),
        };
        if side == Side::Outside {
            return None;
        }
        let is_leaf = tree.is_leaf(node);
        let bounds = tree.bounds(node);
        let nearest = self.neighbourhood.nearest(&bounds).max(self.floor);
        let farthest = if is_leaf { nearest } else { self.neighbourhood.nearest_at_most(&bounds).max(nearest) };
        let seen = Seen { distance: Interval { lo: nearest, hi: farthest }, centre };
        let is_inside = side == Side::Inside;
        let mut weight = if is_leaf {
            let omega = solid_angle_from_eye(centre, half);
            let importance = tree.importance(node);
            Interval { lo: importance * omega.lo, hi: importance * omega.hi }
        } else {
            let omega = group_solid_angle(centre, half, tree.face_areas(node));
            // From within, at most 4π for each of them; finite, so that nothing times it is nothing.
            let count = f64::from(tree.subtree_end(node).0 - node.0);
            Interval { lo: omega.lo, hi: omega.hi.min(4.0 * PI * f64::from(f32::MAX) * count) }
        };
        if !is_inside && !is_leaf {
            weight.lo = 0.0;
        }
        if tree.has_directions() {
            if !element::faces(tree, node, centre, half, self.reach) {
                return None;
            }
            // Unless every surface faces the eye from all of the box, some leaf may turn its back.
            let nearest = element::facing(centre, -half, self.reach);
            let surface = tree.surface(node);
            if !is_leaf && (0..ELEMENTS).any(|s| surface[s] > 0.0 && nearest[s] <= 0.0) {
                weight.lo = 0.0;
            }
        }
        Some(Open { node, is_inside, item: Item { weight, share: share(node, &seen) } })
    }

    /// Opens groups until the gap is reached or the budget spent.
    fn refine(&self, settings: &UnionSettings, share: impl Fn(NodeId, &Seen) -> Interval) -> Certified {
        let tree = self.tree;
        let omega = self.frustum.solid_angle;
        let mut evaluations = 1u32;
        let mut open: Vec<Open> = self.look(tree.root(), false, &share).into_iter().collect();
        loop {
            let found = scaled_sum(open.iter().map(|o| o.item), omega);
            let weight = open.iter().fold(Interval::default(), |sum, o| Interval {
                lo: sum.lo + o.item.weight.lo,
                hi: sum.hi + o.item.weight.hi,
            });
            let value = 0.5 * (found.lo + found.hi.min(omega));
            let unit = value.max(1e-4 * weight.lo.min(omega));
            let done = found.width() <= settings.tolerance * unit;
            if done || evaluations >= settings.evaluations_max {
                let upper = found.hi.min(omega * (1.0 + 1e-12));
                return Certified {
                    value: value.clamp(found.lo.min(upper), upper),
                    lower: found.lo.min(upper),
                    upper,
                    evaluations,
                };
            }
            // Where the sum is scaled, what is like the mean matters least.
            let mean = if weight.hi > omega { value * scale(weight.lo.max(omega), omega) / omega } else { 0.0 };
            let spread = |o: &Open| {
                let off = (o.item.share.hi - mean).abs().max((o.item.share.lo - mean).abs());
                let spread = o.item.weight.width() * off + o.item.weight.hi * o.item.share.width();
                spread.min(4.0 * omega)
            };
            let mut groups: Vec<(f64, usize)> = open
                .iter()
                .enumerate()
                .filter(|(_, o)| !tree.is_leaf(o.node))
                .map(|(i, o)| (spread(o), i))
                .filter(|(spread, _)| *spread > 0.0)
                .collect();
            if groups.is_empty() {
                // Only rounding is left.
                let upper = found.hi;
                return Certified { value, lower: found.lo, upper, evaluations };
            }
            groups.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let all: f64 = groups.iter().map(|g| g.0).sum();
            let mut opened = 0.0;
            let count = groups.iter().take_while(|g| {
                let take = opened <= 0.5 * all;
                opened += g.0;
                take
            });
            let mut chosen: Vec<usize> = count.map(|g| g.1).collect();
            chosen.sort_unstable();
            for &index in chosen.iter().rev() {
                if evaluations >= settings.evaluations_max {
                    break;
                }
                let parent = open.swap_remove(index);
                for child in tree.children(parent.node) {
                    evaluations = evaluations.saturating_add(1);
                    open.extend(self.look(child, parent.is_inside, &share));
                }
            }
        }
    }
}
