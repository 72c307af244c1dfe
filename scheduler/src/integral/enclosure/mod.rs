//! An enclosure with guaranteed bounds: the leg is bisected in time, and over each part the integrand is a Taylor model.
//!
//! Between events a model of degree 4 closes in with the fifth power of the part's length; where a side is not clear over
//! the part (a corner at a plane of the frustum, the eye at a face plane) the remainder holds both cases, and bisection
//! leaves ever shorter parts of that kind. Rounding is in the remainders. Work is bounded: after `evaluations_max` parts
//! the bounds are what they are.

mod model;
mod sight;
mod solid_angle;

use super::{AddedBenefit, Form, events};
use crate::estimate::Certified;
use model::{ULP, UP};
use sight::Scene;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// ∫ over a part ∈ value ± radius, sr·s.
struct Part {
    from: f64,
    to: f64,
    value: f64,
    radius: f64,
}

impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Part {}

impl PartialOrd for Part {
    fn partial_cmp(&self, other: &Part) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Part {
    fn cmp(&self, other: &Part) -> Ordering {
        self.radius.total_cmp(&other.radius).then(other.from.total_cmp(&self.from))
    }
}

fn part(scene: &Scene, from: f64, to: f64, largest_time: f64) -> Part {
    let model = scene.over(from, to);
    let reach = 0.5 * (to - from);
    let (integral, error) = model.integral();
    // The middle and the half length are rounded: each end lies off ±1 by that much.
    let ends = 8.0 * ULP * largest_time * model.magnitude();
    let (mut value, mut radius) = (reach * integral, (reach * error + ends + 4.0 * ULP * reach * integral.abs()) * UP);
    radius += 4.0 * f64::MIN_POSITIVE;
    // The integrand is not negative.
    if value - radius < 0.0 {
        let high = ((value + radius) * UP).max(0.0);
        (value, radius) = (0.5 * high, 0.5 * high * UP);
    }
    Part { from, to, value, radius }
}

/// Bounds whose width is at most `tolerance` × max(value, `floor`), or what `evaluations_max` parts give.
pub(super) fn integrate(benefit: &AddedBenefit, tolerance: f64, floor: f64, evaluations_max: u32) -> Certified {
    let scene = Scene::new(benefit);
    let (from, to) = scene.span;
    let scale = if benefit.target.form() == Form::Leaf { benefit.target.importance() } else { 1.0 };
    if from >= to || scale == 0.0 || benefit.after == benefit.before {
        return Certified { value: 0.0, lower: 0.0, upper: 0.0, evaluations: 0 };
    }
    let found = events(&benefit.leg, &benefit.target, &benefit.cut, benefit.from_s(), benefit.to_s());
    let mut evaluations = 0u32;
    let mut heap = BinaryHeap::new();
    let start = benefit.leg.from_s();
    let mut begin = from;
    // A hair to both sides of each event gets a part of its own: what is not clear there stays there.
    let guard = 1e-7 * (to - from);
    let events = found.times.iter().take(64).map(|u| u - start);
    let cuts = events.flat_map(|t| [t - guard, t + guard]);
    let mut total = Total::default();
    for end in cuts.chain([to]) {
        if end > begin && end <= to {
            let part = part(&scene, begin, end, to);
            evaluations += 1;
            total.add(&part);
            heap.push(part);
            begin = end;
        }
    }
    let mut retired = Vec::new();
    while total.radius * 2.0 * scale > tolerance * (total.value * scale).max(floor) && evaluations < evaluations_max {
        let Some(worst) = heap.pop() else { break };
        let middle = 0.5 * (worst.from + worst.to);
        if middle <= worst.from || middle >= worst.to {
            retired.push(worst);
            continue;
        }
        let (left, right) = (part(&scene, worst.from, middle, to), part(&scene, middle, worst.to, to));
        evaluations += 2;
        total.remove(&worst);
        total.add(&left);
        total.add(&right);
        heap.push(left);
        heap.push(right);
    }
    // Anew, in order of time: additions and removals have rounded.
    let mut parts = heap.into_vec();
    parts.append(&mut retired);
    parts.sort_by(|a, b| a.from.total_cmp(&b.from));
    let mut sum = Total::default();
    for part in &parts {
        sum.add(part);
    }
    let rounded = 2.0 * ULP * parts.len() as f64;
    let radius = sum.radius * (1.0 + 2.0 * rounded) * UP + sum.value * rounded * UP;
    let (value, radius) = (sum.value * scale, (sum.radius.max(radius) * scale + 4.0 * ULP * sum.value * scale) * UP);
    let radius = radius + 4.0 * f64::MIN_POSITIVE;
    let (lower, upper) = ((value - radius).next_down().max(0.0), (value + radius).next_up());
    // A sum beyond every number bounds nothing from above.
    let (value, upper) = if upper.is_finite() { (value, upper) } else { (lower, f64::INFINITY) };
    let evaluations = evaluations.saturating_add(found.evaluations);
    if benefit.after > benefit.before {
        return Certified { value: -value, lower: -upper, upper: -lower, evaluations };
    }
    Certified { value, lower, upper, evaluations }
}

#[derive(Default)]
struct Total {
    value: f64,
    radius: f64,
}

impl Total {
    fn add(&mut self, part: &Part) {
        self.value += part.value;
        self.radius += part.radius;
    }

    fn remove(&mut self, part: &Part) {
        self.value -= part.value;
        self.radius -= part.radius;
    }
}
