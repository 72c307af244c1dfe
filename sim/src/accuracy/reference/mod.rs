//! The added benefit in double-double arithmetic: what every method is measured against.
//!
//! Where a closed form exists it is evaluated; otherwise Gauss–Legendre rules of ten nodes, themselves in double-double,
//! are bisected, from the events on, until two levels agree. The error of the closed form is that of its arithmetic; that of the
//! quadrature is the sum over all parts of the distance between a part and its halves, and of what the interpolant misses at
//! the ends, while the value is the halves': where the integrand is smooth this overstates the error by about 2²⁰, at a kink by
//! about 4. It is demonstrated, not proven: a feature narrower than the gaps between the nodes of a part can pass unseen,
//! and `UNSEEN` is allowed for that.

mod closed_form;
mod double;
mod rule;
mod scene;

use double::{difference, double};
use foresight_scheduler::integral::{AddedBenefit, IntegralError, Method, events, integrate};
use rule::{at_ends, rule};
use scene::Scene;
use std::collections::BinaryHeap;
use twofloat::TwoFloat;

/// Relative error at which the quadrature stops.
const TOLERANCE: f64 = 1e-10;
/// Relative error of the quadrature that is allowed for in any case.
const UNSEEN: f64 = 1e-10;
/// Most evaluations of the integrand.
const EVALUATIONS_MAX: usize = 40_000;
/// Most parts to begin with.
const PARTS_MAX: f64 = 400.0;

/// A value and how far it is off at most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// sr·s, rounded to a double.
    pub value: f64,
    /// Bound on its error, sr·s.
    pub error: f64,
    /// Whether it is a closed form, good to 10⁻¹² relative.
    pub is_closed_form: bool,
}

/// The added benefit, as well as can be.
///
/// # Errors
/// What the scheduler's methods refuse.
pub fn reference(benefit: &AddedBenefit) -> Result<Reference, IntegralError> {
    until(benefit, |_, _| false)
}

/// As [`reference()`], but only until value ± error lies within `bounds`: then that they hold is known. Where it never
/// does, as well as can be.
///
/// # Errors
/// What the scheduler's methods refuse.
pub fn reference_within(benefit: &AddedBenefit, bounds: [f64; 2]) -> Result<Reference, IntegralError> {
    let margin = |value: f64, error: f64| 2e-16 * value.abs() + 1e-300 + error;
    until(benefit, |value, error| {
        let margin = margin(value, error + UNSEEN * value.abs());
        bounds[0] <= value - margin && value + margin <= bounds[1]
    })
}

/// As well as can be, or until `is_enough` says so of a value and its error.
fn until(benefit: &AddedBenefit, is_enough: impl Fn(f64, f64) -> bool) -> Result<Reference, IntegralError> {
    let has_closed_form = match integrate(benefit, &Method::ClosedForm) {
        Ok(_) => true,
        Err(IntegralError::NoClosedForm(_)) => false,
        Err(error) => return Err(error),
    };
    let scene = Scene::new(benefit);
    let from = difference(benefit.from_s(), benefit.leg.from_s());
    let to = difference(benefit.to_s(), benefit.leg.from_s());
    let with = |value: TwoFloat, error: f64, is_closed_form: bool| {
        let value = value.hi();
        Reference { value, error: error + 2e-16 * value.abs() + 1e-300, is_closed_form }
    };
    if from >= to {
        return Ok(with(double(0.0), 0.0, false));
    }
    if has_closed_form && let Some((value, error)) = closed_form::integrate(benefit, &scene, from, to) {
        let is_outside = value.hi() != 0.0 && scene.value((from + to) * 0.5).hi() == 0.0;
        if !is_outside && error <= 1e-12 * value.hi().abs() {
            return Ok(with(value, error, true));
        }
    }
    let (value, error) = quadrature(benefit, &scene, from, to, is_enough);
    Ok(with(value, error, false))
}

/// A part with its halves.
struct Part {
    from: TwoFloat,
    to: TwoFloat,
    halves: [TwoFloat; 2],
    error: f64,
}

impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Part {}

impl PartialOrd for Part {
    fn partial_cmp(&self, other: &Part) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Part {
    fn cmp(&self, other: &Part) -> std::cmp::Ordering {
        self.error.total_cmp(&other.error).then(other.from.hi().total_cmp(&self.from.hi()))
    }
}

fn quadrature(
    benefit: &AddedBenefit,
    scene: &Scene,
    from: TwoFloat,
    to: TwoFloat,
    is_enough: impl Fn(f64, f64) -> bool,
) -> (TwoFloat, f64) {
    // (integral, error from what the interpolant misses at the ends).
    let apply = |from: TwoFloat, to: TwoFloat| {
        let (middle, half) = ((from + to) * 0.5, (to - from) * 0.5);
        let mut sum = double(0.0);
        let mut values = [0.0; 10];
        for (&(node, weight), kept) in rule().iter().zip(&mut values) {
            let value = scene.value(middle + half * node);
            *kept = value.hi();
            sum += value * weight;
        }
        let ends = at_ends(&values);
        // Just inside: where the integrand jumps, it belongs to the neighbour.
        let inset = half * (1.0 - 1e-12);
        let missed =
            (scene.value(middle - inset).hi() - ends[0]).abs() + (scene.value(middle + inset).hi() - ends[1]).abs();
        // The outermost nodes lie 1.3 % of the half length from the ends.
        (sum * half, 0.02 * missed * half.hi())
    };
    let mut evaluations = 0usize;
    let mut halved = |from: TwoFloat, to: TwoFloat, whole: TwoFloat| {
        let middle = (from + to) * 0.5;
        let [(left, a), (right, b)] = [apply(from, middle), apply(middle, to)];
        evaluations += 2 * (rule().len() + 2);
        let error = (whole - left - right).hi().abs() + a + b;
        (Part { from, to, halves: [left, right], error }, evaluations)
    };
    // Parts that turn little, so that nothing passes between two nodes unseen.
    let turn = benefit.leg.rate() * (to - from).hi();
    let count = libm::ceil(turn / 0.5).clamp(1.0, PARTS_MAX);
    let mut ends: Vec<TwoFloat> = (0..=count as u32).map(|i| from + (to - from) * (f64::from(i) / count)).collect();
    let found = events(&benefit.leg, &benefit.target, &benefit.cut, benefit.from_s(), benefit.to_s());
    let times = found.times.iter().take(PARTS_MAX as usize);
    ends.extend(times.map(|&u| difference(u, benefit.leg.from_s())).filter(|&t| t > from && t < to));
    ends.sort_by(|a, b| a.hi().total_cmp(&b.hi()).then(a.lo().total_cmp(&b.lo())));
    let mut parts = BinaryHeap::new();
    let mut used = 0;
    for pair in ends.windows(2) {
        if pair[0] < pair[1] {
            let (part, evaluations) = halved(pair[0], pair[1], apply(pair[0], pair[1]).0);
            used = evaluations;
            parts.push(part);
        }
    }
    let sum = |parts: &BinaryHeap<Part>| {
        parts.iter().fold((double(0.0), 0.0), |(value, error), part| {
            (value + part.halves[0] + part.halves[1], error + part.error)
        })
    };
    let (mut value, mut error) = sum(&parts);
    while error > TOLERANCE * value.hi().abs() && used < EVALUATIONS_MAX && !is_enough(value.hi(), error) {
        let Some(worst) = parts.pop() else { break };
        let middle = (worst.from + worst.to) * 0.5;
        let (left, _) = halved(worst.from, middle, worst.halves[0]);
        let (right, evaluations) = halved(middle, worst.to, worst.halves[1]);
        used = evaluations;
        value = value - worst.halves[0] - worst.halves[1];
        error = (error - worst.error).max(0.0);
        for part in [left, right] {
            value += part.halves[0] + part.halves[1];
            error += part.error;
            parts.push(part);
        }
    }
    let (value, error) = sum(&parts);
    // Thirty digits of the integrand, with some to spare for solid angles of what is tiny and far.
    (value, error + UNSEEN * value.hi().abs())
}
