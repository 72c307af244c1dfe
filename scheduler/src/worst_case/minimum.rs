//! `minimum` (\[ZK\] eq. 3): W = −max over N(v, ε) of the deficit D(v′) = Σ w·(1 − q), κ = 1, weights clipped and scaled.
//!
//! [`sampled`] takes the largest deficit over a covering set: never too large, and how far too small only guessed.
//! [`certified`] is a branch and bound: boxes of positions × cones of directions, best bound first, each bounded over all
//! its views at once, by intervals ([`Targets::enclose`]) and to first order (`slope.rs`), and halved across the dimension without
//! which the widest of its bounds would be narrowest, until the largest bound is within the tolerance of the largest
//! deficit met, or the budget of evaluations is spent; the gap that is left is stated. From the worst view met the search climbs
//! along one coordinate after the other.

use super::bounds::{Interval, Item};
use super::neighbourhood::Neighbourhood;
use super::scaled_sum::Terms;
use super::slope::{Extent, Slope};
use super::target::{Deficit, Targets};
use super::view_box::{DIMENSIONS, ViewBox};
use super::{WorstCaseError, within};
use crate::estimate::{Certified, Estimate};
use crate::view::View;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Boxes kept at most; more and the search ends with the gap that it has.
const BOXES_MAX: usize = 1 << 18;
/// Targets with their bounds kept at most, over all boxes: 20 bytes each.
const KEPT_MAX: usize = 10_000_000;
/// Views of the whole that are turned towards what its bound is widest for, before it is halved.
const DIRECTED: usize = 1;
/// What is left of what halving has shown at the next halving.
const FORGOTTEN: f64 = 0.95;
/// Most that this shifts the choice between position and turn.
const PREFERENCE_MAX: f64 = 8.0;
/// One in so many of the targets that are bounded anew is tried before a box is halved, the widest first,
const TRIED: usize = 5;
/// but at least so many,
const LEAST_TRIED: usize = 12;
/// and at most so many.
const MOST_TRIED: usize = 16;
/// What the flattest box must gain on the least flattened one to be told from it, as a share of the frustum's solid angle.
const TELLING: f64 = 1e-4;
/// One in so many evaluations may be that of a single view.
const SAMPLED: u64 = 2;
/// Share of a box's width of bounds that is bounded anew in its halves.
const RENEWED: f64 = 0.93;

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
    /// At decision time: 10 % of Σw, or some ten thousand evaluations; most situations need a few hundred.
    fn default() -> MinimumSettings {
        MinimumSettings { tolerance: 0.1, evaluations_max: 30_000, samples: 4 }
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
    /// Where the bound was found, [`Terms::most`].
    lambda: f64,
    id: u32,
    part: ViewBox,
    seen: Box<[Packed]>,
}

/// A target with its bounds, in single precision, rounded outwards.
#[derive(Clone, Copy, Debug)]
struct Packed {
    index: u32,
    weight: [f32; 2],
    share: [f32; 2],
}

impl Packed {
    #[expect(clippy::cast_possible_truncation, reason = "rounded outwards")]
    fn new(&(index, item): &(u32, Item)) -> Packed {
        let outwards = |i: Interval| {
            let (lo, hi) = (i.lo as f32, i.hi as f32);
            [
                if f64::from(lo) > i.lo { lo.next_down() } else { lo },
                if f64::from(hi) < i.hi { hi.next_up() } else { hi },
            ]
        };
        Packed { index, weight: outwards(item.weight), share: outwards(item.share) }
    }

    fn item(&self) -> Item {
        let wide = |i: [f32; 2]| Interval { lo: f64::from(i[0]), hi: f64::from(i[1]) };
        Item { weight: wide(self.weight), share: wide(self.share) }
    }
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
    Search::new(targets, neighbourhood, settings).run()
}

struct Search<'a> {
    targets: &'a Targets,
    neighbourhood: &'a Neighbourhood,
    settings: &'a MinimumSettings,
    radians_per_metre: f64,
    evaluations: u64,
    /// Of these, for single views.
    sampled: u64,
    worst: View,
    largest: f64,
    weight: f64,
    heap: BinaryHeap<Open>,
    /// Targets kept with the boxes of the heap.
    kept: usize,
    boxes: u32,
    /// By how much halving boxes has lowered their bounds, and the lengths halved: along position, and along turns.
    halved: [(f64, f64); 2],
    /// Everything that is reachable.
    whole: ViewBox,
    /// The targets of a box whose bounds are widest, widest first.
    order: Vec<u32>,
    /// Coordinates of the worst view met, the steps that are taken from it, and which is next.
    summit: [f64; DIMENSIONS],
    steps: [f64; DIMENSIONS],
    turn: usize,
    /// Weights to first order of what was bounded last.
    slopes: Vec<(u32, Slope)>,
    /// Room for the terms of a bound: all by their intervals, and those left if the others are taken by their slopes.
    all: Vec<Item>,
    plain: Vec<Item>,
    sloped: Vec<(f64, Slope)>,
}

impl<'a> Search<'a> {
    fn new(targets: &'a Targets, neighbourhood: &'a Neighbourhood, settings: &'a MinimumSettings) -> Search<'a> {
        Search {
            targets,
            neighbourhood,
            settings,
            radians_per_metre: targets.radians_per_metre(),
            evaluations: targets.len() as u64,
            sampled: 0,
            worst: *neighbourhood.view(),
            largest: 0.0,
            weight: 0.0,
            heap: BinaryHeap::new(),
            kept: 0,
            boxes: 0,
            halved: [(0.0, 0.0); 2],
            whole: neighbourhood.whole(),
            order: Vec::new(),
            summit: [0.0; DIMENSIONS],
            steps: neighbourhood.whole().half.map(|half| 0.5 * half),
            turn: 0,
            slopes: Vec::new(),
            all: Vec::new(),
            plain: Vec::new(),
            sloped: Vec::new(),
        }
    }

    /// Whether it is worse than all met before.
    fn meet(&mut self, view: View, met: Deficit) -> bool {
        self.weight = self.weight.max(met.weight);
        let is_worse = met.deficit > self.largest;
        if is_worse {
            (self.largest, self.worst) = (met.deficit, view);
        }
        is_worse
    }

    /// Looks around the worst view met: one step along one of the coordinates, forth or back. Steps that lead on grow, those that
    /// do not shrink.
    fn climb(&mut self, whole: &[(u32, Item)]) {
        let (turn, sign) = (self.turn % (2 * DIMENSIONS), if self.turn.is_multiple_of(2) { 1.0 } else { -1.0 });
        let axis = turn / 2;
        self.turn += 1;
        let step = self.steps[axis];
        if step <= 0.0 {
            return;
        }
        let mut at = self.summit;
        let limit = self.whole;
        at[axis] =
            (at[axis] + sign * step).clamp(limit.mid[axis] - limit.half[axis], limit.mid[axis] + limit.half[axis]);
        let view = self.neighbourhood.reachable(at);
        self.evaluations += whole.len() as u64;
        self.sampled += whole.len() as u64;
        let met = self.targets.at_among(&view, whole);
        if self.meet(view, met) {
            self.summit = at;
            self.steps[axis] *= 1.5;
            // Once more the same way.
            self.turn -= 1;
        } else if sign < 0.0 {
            self.steps[axis] *= 0.5;
        }
    }

    fn spent(&self) -> bool {
        self.evaluations >= u64::from(self.settings.evaluations_max)
            || self.heap.len() >= BOXES_MAX
            || self.kept >= KEPT_MAX
    }

    fn run(mut self) -> Result<Minimum, WorstCaseError> {
        let count = self.targets.len() as u64;
        // The present view is always looked at; more samples only while they leave most of the budget.
        let affordable = u64::from(self.settings.evaluations_max) / 8 / count.max(1);
        let samples = self.settings.samples.min(affordable.max(1) as usize);
        let present = *self.neighbourhood.view();
        let covering = self.neighbourhood.boxes(samples, self.radians_per_metre).into_iter();
        let covering = covering.map(|part| (self.neighbourhood.reachable(part.mid), part.mid));
        // The middle of everything is often the present view once more.
        let covering = covering.filter(|(view, _)| *view != present);
        for (view, at) in core::iter::once((present, [0.0; DIMENSIONS])).chain(covering) {
            self.evaluations += count;
            self.sampled += count;
            if self.meet(view, self.targets.at(&view)) {
                self.summit = at;
            }
        }
        let mut found = Vec::new();
        let whole = self.whole;
        self.targets.enclose_with_slopes(&self.neighbourhood.views(&whole), None, &mut found, &mut self.slopes);
        self.evaluations += count;
        for rank in 0..DIRECTED {
            self.look(&whole, &found, Some(rank));
        }
        let whole_found = found.clone();
        let mut lambda = 0.5;
        let bound = self.bound(&whole, &found, &mut lambda);
        self.push(whole, bound, lambda, &found);
        // Greatest bound of the boxes that are not looked into any more.
        let mut settled = 0.0f64;
        let (mut fresh, mut again) = (Vec::new(), Vec::new());
        while let Some(open) = self.heap.pop() {
            self.kept -= open.seen.len();
            let (spent, enough) = (self.spent(), self.largest + self.settings.tolerance * self.weight);
            if spent || open.bound <= enough {
                // Nothing that is left has a greater bound.
                settled = settled.max(open.bound);
                break;
            }
            let Some(axis) = self.neighbourhood.longest(&open.part, self.radians_per_metre * self.preference()) else {
                settled = settled.max(open.bound);
                continue;
            };
            self.widest(&open.seen, &mut again);
            let axis = self.axis(&open, axis, again.len());
            again.sort_unstable();
            let mut greatest = 0.0f64;
            for part in open.part.split(axis) {
                if self.neighbourhood.is_outside(&part) {
                    continue;
                }
                let views = self.neighbourhood.views(&part);
                self.targets.enclose_with_slopes(&views, Some(&again), &mut fresh, &mut self.slopes);
                self.evaluations += again.len() as u64;
                inherit(&open.seen, &again, &fresh, &mut found);
                let mut lambda = open.lambda;
                let bound = self.bound(&part, &found, &mut lambda).min(open.bound);
                greatest = greatest.max(bound);
                if bound <= self.largest {
                    continue;
                }
                if SAMPLED * self.sampled <= self.evaluations {
                    if !self.boxes.is_multiple_of(4) {
                        self.climb(&whole_found);
                    }
                    self.look(&part, &found, self.boxes.is_multiple_of(2).then_some(0));
                }
                self.push(part, bound, lambda, &found);
            }
            let scale = if axis < 3 { self.radians_per_metre } else { 1.0 };
            let (lowered, length) = &mut self.halved[usize::from(axis >= 3)];
            *lowered = FORGOTTEN * *lowered + (open.bound - greatest).max(0.0);
            *length = FORGOTTEN * *length + scale * open.part.half[axis];
        }
        // What is computed at one view is good to 10⁻⁹; where there is nothing, nothing is missing.
        let omega = if count > 0 { self.targets.solid_angle() } else { 0.0 };
        let lowest = (self.largest - 1e-9 * (self.largest + omega)).max(0.0);
        let highest = settled.max(self.heap.peek().map_or(0.0, |open| open.bound)).max(self.largest);
        let evaluations = self.evaluations.try_into().unwrap_or(u32::MAX);
        let worth = Certified { value: -self.largest, lower: -highest - 1e-12 * omega, upper: -lowest, evaluations };
        Ok(Minimum { worth, weight: self.weight, worst: self.worst, boxes: self.boxes })
    }

    /// Looks at one view of a box: at its middle, or from as near as may be at what its bound is widest for but for `rank`
    /// others.
    fn look(&mut self, part: &ViewBox, found: &[(u32, Item)], rank: Option<usize>) {
        let open = |item: &Item| item.weight.hi * item.share.hi - item.weight.lo * item.share.lo;
        let middle = self.neighbourhood.reachable(part.mid);
        let mut order: Vec<(f64, u32)> = Vec::new();
        if rank.is_some() {
            order.extend(found.iter().map(|(index, item)| (open(item), *index)));
        }
        let widest = rank
            .filter(|&rank| rank < order.len())
            .map(|rank| order.select_nth_unstable_by(rank, |a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1))).1.1);
        let at = match widest {
            Some(index) => self.neighbourhood.towards(part, self.targets.nearest_point(index, middle.position)),
            None => part.mid,
        };
        let view = self.neighbourhood.reachable(at);
        self.evaluations += found.len() as u64;
        self.sampled += found.len() as u64;
        if self.meet(view, self.targets.at_among(&view, found)) {
            self.summit = at;
            for (step, half) in self.steps.iter_mut().zip(part.half) {
                *step = step.max(0.5 * half);
            }
        }
    }

    /// Greatest deficit of a box's views by what can be seen from them: by intervals alone, and with the slopes found last.
    fn bound(&mut self, part: &ViewBox, found: &[(u32, Item)], lambda: &mut f64) -> f64 {
        let extent = Extent::of(&self.neighbourhood.views(part));
        let solid_angle = self.targets.solid_angle();
        self.all.clear();
        self.plain.clear();
        self.sloped.clear();
        let mut slopes = self.slopes.iter().peekable();
        for (index, item) in found {
            self.all.push(*item);
            while slopes.next_if(|s| s.0 < *index).is_some() {}
            match slopes.next_if(|s| s.0 == *index) {
                Some((_, slope)) => self.sloped.push((item.share.hi, *slope)),
                None => self.plain.push(*item),
            }
        }
        let mut most = Terms { plain: &self.all, sloped: &[], extent, solid_angle }.most(lambda);
        if !self.sloped.is_empty() {
            most = most.min(Terms { plain: &self.plain, sloped: &self.sloped, extent, solid_angle }.most(lambda));
        }
        most.min(solid_angle * (1.0 + 1e-12))
    }

    /// How much more halving a length of position has lowered bounds than halving a turn of as many radians.
    fn preference(&self) -> f64 {
        let [position, turn] = self.halved.map(|(lowered, length)| if length > 0.0 { lowered / length } else { 0.0 });
        if position > 0.0 && turn > 0.0 { (position / turn).clamp(1.0 / PREFERENCE_MAX, PREFERENCE_MAX) } else { 1.0 }
    }

    fn push(&mut self, part: ViewBox, bound: f64, lambda: f64, found: &[(u32, Item)]) {
        self.boxes = self.boxes.saturating_add(1);
        self.kept += found.len();
        let seen = found.iter().map(Packed::new).collect();
        self.heap.push(Open { bound, lambda, id: self.boxes, part, seen });
    }

    /// The targets, in order, that are to be bounded anew for the halves of a box: those with the widest bounds, which
    /// make up [`RENEWED`] of all width; the rest keep the bounds of the whole box.
    fn widest(&mut self, seen: &[Packed], again: &mut Vec<u32>) {
        let weight: f64 = seen.iter().map(|p| f64::from(p.weight[0])).sum();
        let omega = self.targets.solid_angle();
        // Where weights are scaled to the frustum, what is like the mean matters least.
        let mean = if weight > 0.5 * omega { self.largest / omega } else { 0.0 };
        let spread = |item: &Item| {
            let off = (item.share.hi - mean).abs().max((item.share.lo - mean).abs());
            let spread = item.weight.width() * off + item.weight.hi * item.share.width();
            if spread.is_nan() { f64::MAX } else { spread }
        };
        let mut order: Vec<(f64, u32)> = seen.iter().map(|p| (spread(&p.item()), p.index)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let all: f64 = order.iter().map(|o| o.0).sum();
        self.order.clear();
        self.order.extend(order.iter().take(MOST_TRIED).map(|o| o.1));
        let mut sum = 0.0;
        again.clear();
        for (spread, index) in order {
            if sum > RENEWED * all {
                break;
            }
            sum += spread;
            again.push(index);
        }
    }

    /// The dimension across which to halve a box: that without whose extent the terms whose bounds are widest would amount to least;
    /// `longest` where all are alike. Halving alone often shows nothing: what some view sees, and some not, is so in both halves.
    fn axis(&mut self, open: &Open, longest: usize, renewed: usize) -> usize {
        let looked = (renewed / TRIED).max(LEAST_TRIED).min(self.order.len());
        let mut tried: Vec<u32> = self.order[..looked].to_vec();
        tried.sort_unstable();
        let mut fresh = Vec::new();
        let mut worths = [f64::INFINITY; DIMENSIONS];
        for axis in (0..DIMENSIONS).filter(|&axis| open.part.is_divisible(axis)) {
            let mut flat = open.part;
            flat.half[axis] = 0.0;
            self.targets.enclose(&self.neighbourhood.views(&flat), Some(&tried), &mut fresh);
            self.evaluations += looked as u64;
            let excess = |item: &Item| {
                let over = item.share.hi - open.lambda;
                over * if over > 0.0 { item.weight.hi } else { item.weight.lo }
            };
            worths[axis] = fresh.iter().map(|(_, item)| excess(item)).sum::<f64>();
        }
        let known = || worths.into_iter().enumerate().filter(|(_, worth)| worth.is_finite());
        let most = known().map(|(_, worth)| worth).fold(f64::NEG_INFINITY, f64::max);
        let least = known().min_by(|a, b| a.1.total_cmp(&b.1));
        let best = least.filter(|(_, worth)| most - worth > TELLING * self.targets.solid_angle());
        best.map_or(longest, |best| best.0)
    }
}

/// What is seen from half a box: bounds found anew for the targets of `again` (missing where nothing is seen any more), those
/// of the whole box for the rest. All in order of the targets.
fn inherit(seen: &[Packed], again: &[u32], fresh: &[(u32, Item)], found: &mut Vec<(u32, Item)>) {
    found.clear();
    let (mut again, mut fresh) = (again.iter().peekable(), fresh.iter().peekable());
    for packed in seen {
        let (index, item) = (packed.index, packed.item());
        if again.next_if(|&&a| a == index).is_none() {
            found.push((index, item));
        } else if let Some(&(_, renewed)) = fresh.next_if(|f| f.0 == index) {
            // Both hold.
            let both =
                |a: Interval, b: Interval| Interval { lo: a.lo.max(b.lo), hi: a.hi.min(b.hi).max(a.lo.max(b.lo)) };
            let item = Item { weight: both(item.weight, renewed.weight), share: both(item.share, renewed.share) };
            found.push((index, item));
        }
    }
}
