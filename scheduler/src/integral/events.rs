//! When the integrand has kinks.
//!
//! - The box begins or ceases to touch a plane of the frustum, or to lie inside it as a whole: h ± x = 0 for the centre's
//!   height h over the plane and the box's extent x across it. Linear in time without rotation, otherwise bracketed by
//!   bisection, which a bound on the distance to the chord steers, and refined by the Illinois method.
//! - The eye crosses a face plane of a leaf's box, or a plane of symmetry of a group's: linear.
//! - The distance reaches the floor `near`: piecewise quadratic.
//! - An element of the surface turns to the eye or away: linear.

use super::{Form, Leg, Target};
use crate::benefit::cut::CutSettings;
use crate::benefit::element::normals;
use crate::benefit::frustum::{Frustum, Side};
use crate::benefit::weight::nearest_distance;
use glam::DVec3;

/// Bisections on the way to brackets, over one plane: some, and more for each radian turned, up to a most. Then what is
/// left unclear is let be.
const BRACKETING: (f64, f64, f64) = (100.0, 20.0, 2000.0);
/// Steps of the refinement of one root.
const REFINING_MAX: u32 = 60;
/// Most events; a longer spin is split at the first ones only.
const EVENTS_MAX: usize = 1024;

/// Events in order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Events {
    /// Seconds, ascending, without repetition, inside the span.
    pub times: Vec<f64>,
    /// Evaluations of a height or an extent that finding them took.
    pub evaluations: u32,
}

/// The events of a target along a leg between `from_s` and `to_s`, to the last bits.
///
/// Of a spin of many turns only the first events may be found (the work is bounded).
pub fn events(leg: &Leg, target: &Target, cut: &CutSettings, from_s: f64, to_s: f64) -> Events {
    let mut out = Events::default();
    let span = Span { leg, target, from_s, to_s };
    if from_s >= to_s {
        return out;
    }
    let swept = span.swept(&leg.frustum(from_s), &leg.frustum(to_s));
    out.evaluations += 2;
    if swept == Side::Outside {
        return out;
    }
    if let Side::Straddles(planes) = swept {
        for plane in (0..4).filter(|plane| planes & (1 << plane) != 0) {
            span.plane_events(plane, 0.0, &mut out);
        }
    }
    span.box_events(cut, &mut out);
    out.times.sort_by(f64::total_cmp);
    out.times.dedup();
    out
}

impl Events {
    fn push(&mut self, span: &Span, u: f64) {
        if u > span.from_s && u < span.to_s {
            self.times.push(u);
        }
    }
}

/// A target along a part of a leg.
pub(super) struct Span<'a> {
    pub(super) leg: &'a Leg,
    pub(super) target: &'a Target,
    pub(super) from_s: f64,
    pub(super) to_s: f64,
}

impl Span<'_> {
    /// Where the box lies relative to the frustum throughout: the side it has at every time, or the planes that may cut
    /// it at some. Heights and extents stay near the chords between their ends: |h″| ≤ ρ²·|c| + 2ρ·|v| and, where it
    /// exists, |x″| ≤ ρ²·Σhalf, while kinks only lower x.
    ///
    /// `a` and `b` are the frusta at the ends.
    pub(super) fn swept(&self, a: &Frustum, b: &Frustum) -> Side {
        let (c, e) =
            (self.leg.relative(self.target.centre(), self.from_s), self.leg.relative(self.target.centre(), self.to_s));
        let half = self.target.half();
        let seconds = self.to_s - self.from_s;
        let slack = if self.leg.rate() > 0.0 {
            let rate = self.leg.rate();
            // The distance to the centre is largest at an end.
            let second = self.second_derivative(c.length_squared().max(e.length_squared()).sqrt());
            0.125 * seconds * seconds * (second + rate * rate * half.element_sum())
        } else {
            0.0
        };
        let mut planes = 0u8;
        for i in 0..4 {
            let (h, k) = (a.planes[i].dot(c), b.planes[i].dot(e));
            let (x, y) = (a.planes[i].abs().dot(half), b.planes[i].abs().dot(half));
            if h + x < -slack && k + y < -slack {
                return Side::Outside;
            }
            if h - x < slack || k - y < slack {
                planes |= 1 << i;
            }
        }
        if planes == 0 { Side::Inside } else { Side::Straddles(planes) }
    }

    /// Bound on |h″|, m/s², where the centre is at most `farthest` metres away.
    fn second_derivative(&self, farthest: f64) -> f64 {
        let rate = self.leg.rate();
        rate * rate * farthest + 2.0 * rate * self.leg.velocity().length()
    }

    /// (height of the centre over plane `plane`, extent of the box across it) at `u`.
    fn height(&self, plane: usize, u: f64) -> (f64, f64) {
        let t = u - self.leg.from_s();
        let normal = self.leg.base().planes[plane];
        let normal = if self.leg.rate() > 0.0 {
            let (sin, cos) = libm::sincos(self.leg.rate() * t);
            self.leg.turned(normal, sin, cos)
        } else {
            normal
        };
        (normal.dot(self.leg.relative(self.target.centre(), u)), normal.abs().dot(self.target.half()))
    }

    /// Zeros of h + x and h − x, to within `tolerance_s` seconds.
    pub(super) fn plane_events(&self, plane: usize, tolerance_s: f64, out: &mut Events) {
        let (h0, x0) = self.height(plane, self.from_s);
        let (h1, x1) = self.height(plane, self.to_s);
        out.evaluations += 2;
        let seconds = self.to_s - self.from_s;
        if self.leg.rate() == 0.0 {
            for (a, b) in [(h0 - x0, h1 - x1), (h0 + x0, h1 + x1)] {
                if (a < 0.0) != (b < 0.0) {
                    out.push(self, self.from_s + seconds * (a / (a - b)));
                }
            }
            return;
        }
        let farthest = [self.from_s, self.to_s]
            .map(|u| self.leg.relative(self.target.centre(), u).length())
            .into_iter()
            .fold(0.0, f64::max);
        let curvature = self.second_derivative(farthest) / 8.0;
        let stretch = 0.5 * self.leg.rate() * self.target.half().element_sum();
        // Depth first, in order of time.
        let (some, each, most) = BRACKETING;
        let mut budget = (some + each * self.leg.rate() * seconds).min(most) as u32;
        let mut open = vec![(self.from_s, h0, x0, self.to_s, h1, x1)];
        while let Some((u0, h0, x0, u1, h1, x1)) = open.pop() {
            if out.times.len() >= EVENTS_MAX {
                return;
            }
            let width = u1 - u0;
            let slack = width * (width * curvature + stretch.min(self.target.half().element_sum() / width));
            let clear = |a: f64, b: f64| (a < 0.0) == (b < 0.0) && a.abs().min(b.abs()) > slack;
            let (inner, outer) = (clear(h0 - x0, h1 - x1), clear(h0 + x0, h1 + x1));
            if inner && outer {
                continue;
            }
            let middle = 0.5 * (u0 + u1);
            // A turn by less than this has at most one crossing worth telling apart.
            let is_short = self.leg.rate() * width <= 0.05 || width <= tolerance_s;
            if budget > 0 && !is_short && middle > u0 && middle < u1 {
                budget -= 1;
                out.evaluations += 1;
                let (h, x) = self.height(plane, middle);
                open.push((middle, h, x, u1, h1, x1));
                open.push((u0, h0, x0, middle, h, x));
                continue;
            }
            for sign in [-1.0, 1.0] {
                let (a, b) = (h0 + sign * x0, h1 + sign * x1);
                if (a < 0.0) != (b < 0.0) {
                    let mut f = |u: f64| {
                        let (h, x) = self.height(plane, u);
                        h + sign * x
                    };
                    let (root, evaluations) = illinois(&mut f, (u0, a), (u1, b), tolerance_s);
                    out.push(self, root);
                    out.evaluations += evaluations;
                }
            }
        }
    }

    /// Where the eye crosses the planes of the box, and where the distance reaches the floor.
    pub(super) fn box_events(&self, cut: &CutSettings, out: &mut Events) {
        let velocity = self.leg.velocity();
        let centre = self.leg.relative(self.target.centre(), self.from_s);
        let seconds = self.to_s - self.from_s;
        let half = self.target.half();
        let mut push = |t: f64| out.push(self, self.from_s + t);
        let (symmetry, faces) = match self.target.form() {
            Form::Leaf => (false, true),
            Form::FarLeaf => (true, true),
            Form::Group => (true, false),
        };
        let end = centre - velocity * seconds;
        for k in 0..3 {
            // Whether the component passes a value between the ends.
            let passes = |at: f64| (centre[k] < at) != (end[k] < at);
            if symmetry && passes(0.0) {
                push(centre[k] / velocity[k]);
            }
            if faces && passes(half[k]) {
                push((centre[k] - half[k]) / velocity[k]);
            }
            if faces && passes(-half[k]) {
                push((centre[k] + half[k]) / velocity[k]);
            }
        }
        if let Some(facet) = self.target.facet() {
            for (normal, _) in normals().into_iter().zip(facet.surface).filter(|(_, area)| *area > 0.0) {
                // Height of the eye over the plane; it changes by the velocity along the normal.
                let above = normal.abs().dot(half) - normal.dot(centre);
                let rate = normal.dot(velocity);
                if (above < 0.0) != (above + rate * seconds < 0.0) {
                    push(-above / rate);
                }
            }
        }
        // How near the path comes at least.
        let way = velocity.length() * seconds;
        if symmetry && centre.length() - way < cut.near {
            for t in reaches(centre, velocity, cut.near) {
                push(t);
            }
        }
        if faces && nearest_distance(centre, half) - way < cut.near {
            // The nearest point is on a face, an edge or a corner: each axis is either free or at one of its ends.
            for case in 1..27 {
                let ends = [case % 3, case / 3 % 3, case / 9];
                let mask = DVec3::from_array(ends.map(|end| if end == 0 { 0.0 } else { 1.0 }));
                let end = |k: usize| if ends[k] == 1 { -half[k] } else { half[k] };
                let point = (centre + DVec3::new(end(0), end(1), end(2))) * mask;
                for t in reaches(point, velocity * mask, cut.near) {
                    let outside = (centre - velocity * t).abs().cmpgt(half);
                    if (0..3).all(|k| outside.test(k) == (ends[k] != 0)) {
                        push(t);
                    }
                }
            }
        }
    }
}

/// Times at which |point − velocity·t| is `distance`; none if it always or never is.
fn reaches(point: DVec3, velocity: DVec3, distance: f64) -> impl Iterator<Item = f64> {
    let speed = velocity.length();
    let (mut times, mut count) = ([0.0; 2], 0);
    if speed > 0.0 {
        let along = velocity / speed;
        let closest = point.dot(along);
        let off = (point - along * closest).length();
        if off < distance {
            let reach = ((distance - off) * (distance + off)).sqrt();
            times = [(closest - reach) / speed, (closest + reach) / speed];
            count = 2;
        }
    }
    times.into_iter().take(count)
}

/// The root of `f` in a bracket, by regula falsi with the Illinois weighting and bisection where that is slow.
pub(super) fn illinois(
    f: &mut impl FnMut(f64) -> f64,
    (mut a, mut fa): (f64, f64),
    (mut b, mut fb): (f64, f64),
    tolerance: f64,
) -> (f64, u32) {
    let mut evaluations = 0;
    let mut last = f64::NAN;
    // How often one end has stayed: the false position creeps then.
    let (mut stays, mut was_left) = (0, true);
    let tolerance = tolerance.max(2.0 * f64::EPSILON * a.abs().max(b.abs()));
    while evaluations < REFINING_MAX && b - a > tolerance {
        let secant = a + (b - a) * (fa / (fa - fb));
        let guess = if stays < 3 && secant > a && secant < b { secant } else { 0.5 * (a + b) };
        if guess <= a || guess >= b || (guess - last).abs() <= tolerance {
            return (guess.clamp(a, b), evaluations);
        }
        last = guess;
        let value = f(guess);
        evaluations += 1;
        if value == 0.0 {
            return (guess, evaluations);
        }
        let is_left = (value < 0.0) == (fa < 0.0);
        stays = if is_left == was_left { stays + 1 } else { 0 };
        was_left = is_left;
        // Halving the value at an end that stays twice pulls the next guess beyond the root (Illinois).
        let weight = if stays > 0 { 0.5 } else { 1.0 };
        if is_left {
            (a, fa) = (guess, value);
            fb *= weight;
        } else {
            (b, fb) = (guess, value);
            fa *= weight;
        }
    }
    (0.5 * (a + b), evaluations)
}
