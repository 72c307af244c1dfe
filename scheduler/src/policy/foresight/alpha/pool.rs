//! α from the measured prediction error: the weight of the prediction in an optimal prediction pool.
//!
//! The objective says twice how what will be seen is distributed over the world: P, the weights along the predicted paths,
//! and U, those of the worst case; α pools them linearly. When the time has come the true view gives A, and the pool that
//! would have predicted it best maximises the mean log score E_A log(α·P + (1−α)·U) (Geweke and Amisano, Optimal
//! prediction pools, 2011). Its maximum is the fixed point of expectation maximisation, taken online as in `predict/mixture.rs`:
//!
//! ```text
//! r = Σ_i A_i·αP_i/(αP_i + (1−α)U_i) / Σ_i A_i       α ← α + κ·(r − α)
//! ```
//!
//! over the patches i of the true view; what neither foresaw says nothing about either and is left out of both sums, and
//! where both say the same, α stays. Neither is ever given up: α stays within 1 − [`super::ALPHA_MAX`] and that. P and U count in sr, as in the objective, so that a prediction that looks into the
//! void claims nothing. Parts of a patch are compared by area.

use super::{ALPHA_MAX, Sampled};
use crate::benefit::cut::{Cut, CutSettings, Region};
use crate::lod_tree::{LodTree, NodeId};
use crate::predict::PredictedPath;
use crate::units::Time;
use crate::view::View;
use std::collections::VecDeque;

/// Share of the old α that a judgement leaves; the first ones are averaged evenly.
const KEPT: f64 = 0.95;
/// Views of a path that are judged, at most.
const JUDGED_MAX: usize = 4;
/// Predictions that wait to be judged, at most.
const PENDING_MAX: usize = 8;
/// A view that comes later than this after the time that was predicted, seconds, does not judge it.
const LATE_S_MAX: f64 = 0.25;
/// Cuts that one observation of many makes.
const CUTS_AT_ONCE: usize = 2;
/// Least opening angle of the cuts: where a view's weight lies need be known roughly only.
const OPENING_MIN: f64 = 0.8;

/// A prediction that waits for its time.
struct Pending {
    at: Time,
    /// Judged next, of `offsets`.
    next: usize,
    /// Seconds from `at`, ascending.
    offsets: Vec<f64>,
    paths: Vec<PredictedPath>,
    worst: Vec<(f64, View, Region)>,
    cut: CutSettings,
    attenuation: f64,
}

/// What was foreseen for the time that is being judged.
struct Foreseen {
    /// How long before, seconds.
    offset: f64,
    attenuation: f64,
    cut: CutSettings,
    /// Weights and views: the paths', then the worst case's.
    views: Vec<(f64, View, Region)>,
    /// How many of them are the paths'.
    paths: usize,
    /// Cuts made so far.
    made: usize,
}

/// The pool's weight and what it is learnt from.
pub(super) struct Pool {
    alpha: f64,
    judged: u32,
    pending: VecDeque<Pending>,
    /// The judgement under way, what was then seen with the cameras' shares, and the cuts of what was foreseen.
    foreseen: Option<Foreseen>,
    seen: Vec<(f64, Cut)>,
    cuts: Vec<(f64, Cut)>,
}

impl Pool {
    pub(super) fn new(alpha: f64) -> Pool {
        let alpha = alpha.clamp(1.0 - ALPHA_MAX, ALPHA_MAX);
        Pool { alpha, judged: 0, pending: VecDeque::new(), foreseen: None, seen: Vec::new(), cuts: Vec::new() }
    }

    pub(super) fn heap_bytes(&self) -> usize {
        self.seen.iter().chain(&self.cuts).map(|(_, cut)| cut.heap_bytes()).sum()
    }

    pub(super) fn alpha(&self) -> f64 {
        self.alpha
    }

    /// Keeps a prediction to be judged; one at a time, and at most four that overlap.
    pub(super) fn remember(&mut self, sampled: &Sampled) {
        let Some(&last) = sampled.offsets.last() else { return };
        let spacing_s = last / JUDGED_MAX as f64;
        let is_due = self.pending.back().is_none_or(|p| sampled.now.since(p.at).secs() >= spacing_s);
        if !is_due || self.pending.len() >= PENDING_MAX || sampled.worst.is_empty() {
            return;
        }
        let count = sampled.offsets.len();
        let kept: Vec<usize> = (1..=JUDGED_MAX.min(count)).map(|i| i * count / JUDGED_MAX.min(count) - 1).collect();
        let views = |path: &PredictedPath| kept.iter().filter_map(|&i| path.views.get(i).copied()).collect();
        self.pending.push_back(Pending {
            at: sampled.now,
            next: 0,
            offsets: kept.iter().map(|&i| sampled.offsets[i]).collect(),
            paths: sampled.paths.iter().map(|p| PredictedPath { weight: p.weight, views: views(p) }).collect(),
            worst: sampled.worst.to_vec(),
            cut: CutSettings {
                opening: sampled.cut.opening.max(OPENING_MIN),
                near: sampled.cut.near,
                centre_falloff: 0.0,
            },
            attenuation: sampled.attenuation,
        });
    }

    /// Judges what was predicted for now by the true views, of which each counts by its share: all of it at once, or a part
    /// of one judgement if the next call `is_soon`. Whether there was anything to do.
    pub(super) fn judge(&mut self, tree: &LodTree, cameras: &[(f64, View)], now: Time, is_soon: bool) -> bool {
        let mut has_worked = false;
        while self.foreseen.is_some() || self.begin(tree, cameras, now) {
            self.step(tree);
            has_worked = true;
            if is_soon {
                break;
            }
        }
        has_worked
    }

    /// Begins the first judgement that is due; false if none is.
    fn begin(&mut self, tree: &LodTree, cameras: &[(f64, View)], now: Time) -> bool {
        let mut begun = None;
        for prediction in &mut self.pending {
            while begun.is_none()
                && let Some(&offset) = prediction.offsets.get(prediction.next)
                && prediction.at + Time::from_secs(offset) <= now
            {
                let which = prediction.next;
                prediction.next += 1;
                if now.since(prediction.at + Time::from_secs(offset)).secs() <= LATE_S_MAX {
                    begun = Some(prediction.foreseen(which, offset));
                }
            }
        }
        self.pending.retain(|p| p.next < p.offsets.len());
        self.foreseen = begun;
        let Some(foreseen) = &self.foreseen else { return false };
        self.seen.resize_with(cameras.len(), Default::default);
        for (seen, (share, view)) in self.seen.iter_mut().zip(cameras) {
            seen.0 = *share;
            seen.1.make(tree, view, Region::Frustum, &foreseen.cut);
        }
        true
    }

    /// Makes the next cuts of what was foreseen, or after the last of them learns from it.
    fn step(&mut self, tree: &LodTree) {
        let Some(foreseen) = &mut self.foreseen else { return };
        let (all, made) = (foreseen.views.len(), foreseen.made);
        if made < all {
            foreseen.made = (made + CUTS_AT_ONCE).min(all);
            self.cuts.resize_with(self.cuts.len().max(all), Default::default);
            for ((weight, view, region), cut) in foreseen.views.iter().zip(&mut self.cuts).skip(made).take(CUTS_AT_ONCE)
            {
                cut.0 = *weight;
                cut.1.make(tree, view, *region, &foreseen.cut);
            }
            return;
        }
        let discount = libm::exp(-foreseen.attenuation * foreseen.offset);
        let (paths, all) = (foreseen.paths, foreseen.views.len());
        self.foreseen = None;
        if let Some(explained) = self.explained(tree, paths, all) {
            self.judged = self.judged.saturating_add(1);
            let kept = KEPT.min(1.0 - 1.0 / (f64::from(self.judged) + 1.0));
            let step = (1.0 - kept) * discount;
            self.alpha = (self.alpha + step * (explained - self.alpha)).clamp(1.0 - ALPHA_MAX, ALPHA_MAX);
        }
    }

    /// r: the share of what is seen that the predicted paths, the first of `all` cuts, explain, against the worst case;
    /// `None` if neither foresaw any of it.
    fn explained(&self, tree: &LodTree, paths: usize, all: usize) -> Option<f64> {
        let (predicted, worst) = self.cuts[..all].split_at(paths);
        let (mut by_paths, mut by_either) = (0.0, 0.0);
        for (share, seen) in &self.seen {
            for patch in &seen.patches {
                let density =
                    |cuts: &[(f64, Cut)]| cuts.iter().map(|(w, cut)| w * weight_at(tree, cut, patch.node)).sum();
                let (p, u): (f64, f64) = (density(predicted), density(worst));
                let pooled = self.alpha * p + (1.0 - self.alpha) * u;
                if pooled > 0.0 && pooled.is_finite() {
                    by_paths += share * patch.weight * (self.alpha * p / pooled);
                    by_either += share * patch.weight;
                }
            }
        }
        (by_either > 0.0).then(|| (by_paths / by_either).clamp(0.0, 1.0))
    }
}

impl Pending {
    /// What is to be judged of it, at the offset numbered `which`.
    fn foreseen(&self, which: usize, offset: f64) -> Foreseen {
        let paths = self.paths.iter().filter_map(|p| Some((p.weight, *p.views.get(which)?, Region::Frustum)));
        let mut views: Vec<_> = paths.collect();
        let paths = views.len();
        views.extend_from_slice(&self.worst);
        Foreseen { offset, attenuation: self.attenuation, cut: self.cut, views, paths, made: 0 }
    }
}

/// Scaled weight that a cut gives to what lies beneath `node`, sr; of a group above it, the share of its area.
fn weight_at(tree: &LodTree, cut: &Cut, node: NodeId) -> f64 {
    let end = tree.subtree_end(node);
    let first = cut.patches.partition_point(|p| p.node < node);
    let beneath = cut.patches[first..].iter().take_while(|p| p.node < end);
    let mut weight: f64 = beneath.map(|p| p.weight).sum();
    if let Some(group) = first.checked_sub(1).map(|i| &cut.patches[i]).filter(|g| tree.is_beneath(node, g.node)) {
        let whole = tree.face_areas(group.node).element_sum();
        if whole > 0.0 {
            weight += group.weight * (tree.face_areas(node).element_sum() / whole).min(1.0);
        }
    }
    weight * cut.scale
}
