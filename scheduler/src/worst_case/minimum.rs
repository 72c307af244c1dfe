//! `minimum` (\[ZK\] eq. 3): W = −max over N(v, ε) of the deficit D(v′) = Σ w·(1 − q), κ = 1, weights clipped and scaled.
//!
//! [`sampled`] takes the largest deficit over a covering set: never too large, and how far too small only guessed.
//! [`certified`] is a branch and bound: boxes of positions × cones of directions, best bound first, each bounded over all
//! its views at once ([`Targets::enclose`]) and halved until the largest bound is within the tolerance of the largest
//! deficit met, or the budget of evaluations is spent; the gap that is left is stated.

use super::bounds::Item;
use super::neighbourhood::Neighbourhood;
use super::target::{Deficit, Targets};
use super::view_box::ViewBox;
use super::{WorstCaseError, within};
use crate::estimate::{Certified, Estimate};
use crate::view::View;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::rc::Rc;

/// Boxes kept at most; more and the search ends with the gap that it has.
const BOXES_MAX: usize = 1 << 15;

/// How hard to look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MinimumSettings {
    /// The gap asked for, as a share of Σw.
    pub tolerance: f64,
    /// Targets looked at, at most; checked between boxes.
    pub evaluations_max: u32,
    /// Samples of the covering set.
    pub samples: usize,
}

impl Default for MinimumSettings {
    /// At decision time: 10 % of Σw, or a few thousand evaluations.
    fn default() -> MinimumSettings {
        MinimumSettings { tolerance: 0.1, evaluations_max: 4000, samples: 4 }
    }
}

impl MinimumSettings {
    /// Offline: 1 % of Σw, or some seconds.
    pub const OFFLINE: MinimumSettings = MinimumSettings { tolerance: 0.01, evaluations_max: 50_000_000, samples: 64 };

    fn check(&self) -> Result<(), WorstCaseError> {
        within("tolerance", self.tolerance, 0.0, 1.0, "a share from 0 to 1")?;
        within("samples", self.samples as f64, 1.0, 1e6, "a count from 1 to 10⁶")?;
        Ok(())
    }
}

/// What branch and bound found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Minimum {
    /// W, sr: minus the largest deficit. Evaluations are targets looked at.
    pub worth: Certified,
    /// Largest scaled Σw of the views met, sr: what the gap is relative to.
    pub weight: f64,
    /// The view with the largest deficit met.
    pub worst: View,
    /// Boxes bounded.
    pub boxes: u32,
}

impl Minimum {
    /// The gap as a share of Σw; in sr if nothing was in view at any view met.
    pub fn gap(&self) -> f64 {
        let gap = self.worth.gap();
        if self.weight > 0.0 { gap / self.weight } else { gap }
    }
}

/// The samples of a covering set with their deficits, in its order.
pub fn deficits(targets: &Targets, neighbourhood: &Neighbourhood, samples: usize) -> Vec<(View, Deficit)> {
    let covering = neighbourhood.covering(samples, targets.radians_per_metre());
    covering.views.into_iter().map(|view| (view, targets.at(&view))).collect()
}

/// W by the covering set. The error is guessed as the largest difference between samples next to each other.
pub fn sampled(targets: &Targets, neighbourhood: &Neighbourhood, samples: usize) -> Result<Estimate, WorstCaseError> {
    within("samples", samples as f64, 1.0, 1e6, "a count from 1 to 10⁶")?;
    let found = deficits(targets, neighbourhood, samples);
    let largest = found.iter().map(|(_, d)| d.deficit).fold(0.0, f64::max);
    let step = found.windows(2).map(|w| (w[0].1.deficit - w[1].1.deficit).abs()).fold(0.0, f64::max);
    let evaluations = found.len() * targets.len();
    Ok(Estimate { value: -largest, error_estimate: step, evaluations: evaluations.try_into().unwrap_or(u32::MAX) })
}

/// The worst of the covering set, `keep` of them, with positive weights that sum to 1: exp((D − D_max)/(`softness`·D_max)),
/// normalised. They are the gradient of a smoothed maximum, so that a greedy choice sees more than one view at a time.
pub fn worst_views(
    targets: &Targets,
    neighbourhood: &Neighbourhood,
    samples: usize,
    keep: usize,
    softness: f64,
) -> Vec<(f64, View)> {
    let mut found = deficits(targets, neighbourhood, samples.clamp(1, 1 << 12));
    found.sort_by(|a, b| b.1.deficit.total_cmp(&a.1.deficit));
    found.truncate(keep.max(1));
    let most = found.first().map_or(0.0, |f| f.1.deficit);
    let weigh = |d: f64| if most > 0.0 { libm::exp((d - most) / (softness.max(1e-6) * most)) } else { 1.0 };
    let sum: f64 = found.iter().map(|(_, d)| weigh(d.deficit)).sum();
    found.into_iter().map(|(view, d)| (weigh(d.deficit) / sum, view)).collect()
}

/// A box with its bound, and what can be seen from it.
struct Open {
    bound: f64,
    id: u32,
    part: ViewBox,
    live: Rc<[u32]>,
}

impl PartialEq for Open {
    fn eq(&self, other: &Open) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Open) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    fn cmp(&self, other: &Open) -> Ordering {
        self.bound.total_cmp(&other.bound).then(other.id.cmp(&self.id))
    }
}

/// W with proven bounds.
pub fn certified(
    targets: &Targets,
    neighbourhood: &Neighbourhood,
    settings: &MinimumSettings,
) -> Result<Minimum, WorstCaseError> {
    settings.check()?;
    let budget = u64::from(settings.evaluations_max);
    let omega = targets.solid_angle();
    let radians_per_metre = targets.radians_per_metre();
    let mut evaluations = targets.len() as u64;
    let (mut worst, mut largest, mut weight) = (*neighbourhood.view(), 0.0f64, 0.0f64);
    let mut meet = |view: View, met: Deficit, largest: &mut f64, weight: &mut f64| {
        *weight = weight.max(met.weight);
        if met.deficit > *largest {
            *largest = met.deficit;
            worst = view;
        }
    };
    // The present view is always looked at; more samples only while they leave most of the budget.
    let samples = settings.samples.min((budget / 4 / (targets.len() as u64).max(1)).max(1) as usize);
    for view in neighbourhood.covering(samples, radians_per_metre).views {
        evaluations += targets.len() as u64;
        meet(view, targets.at(&view), &mut largest, &mut weight);
    }
    let (mut live, mut items): (Vec<u32>, Vec<Item>) = (Vec::new(), Vec::new());
    let mut heap = BinaryHeap::new();
    // Greatest bound of the boxes that are not looked into any more.
    let mut settled = 0.0f64;
    let mut boxes = 1u32;
    let whole = neighbourhood.whole();
    targets.enclose(&neighbourhood.views(&whole), None, &mut live, &mut items);
    evaluations += targets.len() as u64;
    heap.push(Open { bound: targets.deficit_bounds(&items).hi, id: 0, part: whole, live: Rc::from(&live[..]) });
    while let Some(open) = heap.pop() {
        let enough = largest + settings.tolerance * weight;
        let spent = evaluations + 2 * open.live.len() as u64 > budget || heap.len() >= BOXES_MAX;
        let axis = neighbourhood.longest(&open.part, radians_per_metre).filter(|_| !spent && open.bound > enough);
        let Some(axis) = axis else {
            settled = settled.max(open.bound);
            if spent || open.bound <= enough {
                // Nothing that is left has a greater bound.
                break;
            }
            continue;
        };
        for part in open.part.split(axis) {
            if neighbourhood.is_outside(&part) {
                continue;
            }
            boxes = boxes.saturating_add(1);
            targets.enclose(&neighbourhood.views(&part), Some(&open.live), &mut live, &mut items);
            evaluations += open.live.len() as u64;
            let bound = targets.deficit_bounds(&items).hi.min(open.bound);
            if bound <= largest {
                continue;
            }
            let view = neighbourhood.sample(&part);
            evaluations += live.len() as u64;
            meet(view, targets.at_among(&view, &live), &mut largest, &mut weight);
            heap.push(Open { bound, id: boxes, part, live: Rc::from(&live[..]) });
        }
    }
    // What is computed at one view is good to 10⁻⁹.
    let lowest = (largest - 1e-9 * (largest + omega)).max(0.0);
    let highest = settled.max(heap.peek().map_or(0.0, |open| open.bound)).max(largest);
    let evaluations = evaluations.try_into().unwrap_or(u32::MAX);
    let worth = Certified { value: -largest, lower: -highest - 1e-12 * omega, upper: -lowest, evaluations };
    Ok(Minimum { worth, weight, worst, boxes })
}
