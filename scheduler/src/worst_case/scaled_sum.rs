//! The greatest scaled sum min(1, Ω/Σw)·Σ w·s over a set of views, from bounds of its terms and from their slopes.
//!
//! With A(λ) ≥ Σ w·(s − λ) it is at most A·min(1, Ω/S) + λ·min(Ω, S′), S the least and S′ the greatest Σw, as
//! [`super::bounds::scaled_sum`] says. Every λ is a bound, and the bound is convex in λ: where the tangents on both sides of its
//! least value meet is the next to try.

use super::bounds::{Item, rounding, scale};
use super::slope::{Extent, Slope};
use glam::DVec3;

/// Passes over the terms at most.
const PASSES: usize = 6;
/// By how much a bound may be above the least one, as a share of the frustum's solid angle.
const ENOUGH: f64 = 1e-5;

/// Terms by their intervals, and terms by their slopes over views as far apart as `extent` says.
pub(super) struct Terms<'a> {
    pub(super) plain: &'a [Item],
    pub(super) sloped: &'a [(f64, Slope)],
    pub(super) extent: Extent,
    pub(super) solid_angle: f64,
}

/// Σ w·c of the sloped terms for coefficients c: its value at the middle, and its slope.
#[derive(Clone, Copy, Default)]
struct Line {
    middle: f64,
    moved: DVec3,
    turned: DVec3,
}

impl Line {
    fn add(&mut self, factor: f64, slope: &Slope, sign: f64) {
        self.middle += factor * (slope.middle + sign * slope.rest);
        self.moved += slope.moved * factor;
        self.turned += slope.turned * factor;
    }
}

impl Terms<'_> {
    /// The bound. `lambda` is where to look first, and then where the least bound was found.
    pub(super) fn most(&self, lambda: &mut f64) -> f64 {
        let (mut low, mut high, mut product, mut dull) = (0.0, 0.0, 0.0, 0.0);
        for item in self.plain {
            low += item.weight.lo;
            high += item.weight.hi;
            product += item.weight.hi * item.share.hi;
            dull += item.weight.lo * item.share.hi;
        }
        let (mut least, mut most) = (Line::default(), Line::default());
        for (share, slope) in self.sloped {
            least.add(-1.0, slope, -1.0);
            most.add(1.0, slope, 1.0);
            dull += (slope.middle - slope.rest - self.extent.most(slope.moved, slope.turned)).max(0.0) * share;
        }
        low = (low - self.greatest(&least)).max(0.0);
        high += self.greatest(&most);
        if !product.is_finite() || !high.is_finite() {
            return f64::INFINITY;
        }
        let least = scale(low, self.solid_angle);
        // Value and slope of the bound.
        let judge = |lambda: f64, (excess, counted): (f64, f64)| {
            if excess >= 0.0 {
                (excess * least + lambda * high.min(self.solid_angle), high.min(self.solid_angle) - counted * least)
            } else {
                let scale = scale(high, self.solid_angle);
                ((excess + lambda * high) * scale, (high - counted) * scale)
            }
        };
        let at_zero = judge(0.0, self.excess(0.0));
        let mut best = at_zero.0;
        if high > self.solid_angle {
            let mut from = (0.0, at_zero);
            // Nothing is above 1: every weight is least.
            let mut to = (1.0, judge(1.0, (dull - low, low)));
            let mut next = *lambda;
            for _ in 0..PASSES {
                // NaN too.
                if !(from.0 < next && next < to.0) {
                    break;
                }
                let found = judge(next, self.excess(next));
                if found.0 < best {
                    (best, *lambda) = (found.0, next);
                }
                if found.1 <= 0.0 {
                    from = (next, found);
                } else {
                    to = (next, found);
                }
                // Where the tangents meet, and how low the bound can be at all.
                let ((a, (at_a, slope_a)), (b, (at_b, slope_b))) = (from, to);
                next = (at_a - at_b + slope_b * b - slope_a * a) / (slope_b - slope_a);
                if best - (at_a + slope_a * (next - a)) <= ENOUGH * self.solid_angle {
                    break;
                }
            }
        }
        let slack = rounding(self.plain.len() + 16 * self.sloped.len()) * high.min(best.abs() + self.solid_angle);
        (best + slack).max(0.0)
    }

    fn greatest(&self, line: &Line) -> f64 {
        line.middle + self.extent.most(line.moved, line.turned)
    }

    /// A(λ), and the Σw that belongs to it.
    fn excess(&self, lambda: f64) -> (f64, f64) {
        let (mut excess, mut counted) = (0.0, 0.0);
        for item in self.plain {
            let over = item.share.hi - lambda;
            let weight = if over > 0.0 { item.weight.hi } else { item.weight.lo };
            excess += over * weight;
            counted += weight;
        }
        if self.sloped.is_empty() {
            return (excess, counted);
        }
        let (mut over_all, mut of_weight) = (Line::default(), Line::default());
        for (share, slope) in self.sloped {
            let over = share - lambda;
            over_all.add(over, slope, 1f64.copysign(over));
            of_weight.add(1.0, slope, 1f64.copysign(over));
        }
        let (moved, turned) = self.extent.farthest(over_all.moved, over_all.turned);
        counted += of_weight.middle + of_weight.moved.dot(moved) + of_weight.turned.dot(turned);
        (excess + self.greatest(&over_all), counted)
    }
}

#[cfg(test)]
mod tests {
    use super::super::bounds::Interval;
    use super::super::view_box::Views;
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-limit..limit).prop_map(DVec3::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(4000) })]

        /// Sums of weights picked from the intervals, and along the slopes at one view for all, are at most the bound; without
        /// slopes it is about that of the golden section.
        #[test]
        fn sums_are_at_most_the_bound(
            plain in prop::collection::vec(prop::array::uniform5(0.0..1.0f64), 0..8),
            sloped in prop::collection::vec((prop::array::uniform4(0.0..1.0f64), vector(0.4), vector(0.4)), 0..8),
            half in vector(1.0), turns in vector(1.0), at in (vector(1.0), vector(1.0)),
            omega in 0.05..6.0f64, first in 0.0..1.0f64,
        ) {
            let (half, turns) = (half.abs(), turns.abs());
            let views = Views { eye: DVec3::ZERO, half, radius: half.length(), orientation: DQuat::IDENTITY, turn: 1.0, turns };
            let extent = Extent::of(&views);
            let (moved, turned) = (at.0 * half, at.1 * turns);
            let items: Vec<Item> = plain.iter().map(|r| Item {
                weight: Interval { lo: r[0].min(r[1]), hi: r[0].max(r[1]) },
                share: Interval { lo: 0.5 * r[2], hi: r[2] },
            }).collect();
            let mut terms: Vec<(f64, f64)> = items.iter().zip(&plain)
                .map(|(i, r)| (i.weight.lo + r[3] * i.weight.width(), i.share.lo + r[4] * i.share.width())).collect();
            let mut slopes = Vec::new();
            for (r, along, about) in &sloped {
                let rest = 0.2 * r[1];
                let slope = Slope { middle: r[0], moved: *along, turned: *about, rest };
                let weight = r[0] + along.dot(moved) + about.dot(turned) + rest * (2.0 * r[3] - 1.0);
                // No weight is negative.
                if weight >= 0.0 {
                    slopes.push((r[2], slope));
                    terms.push((weight, r[2]));
                }
            }
            let weight: f64 = terms.iter().map(|t| t.0).sum();
            let exact = terms.iter().map(|t| t.0 * t.1).sum::<f64>() * scale(weight, omega);
            let mut lambda = first;
            let bound = Terms { plain: &items, sloped: &slopes, extent, solid_angle: omega }.most(&mut lambda);
            prop_assert!(exact <= bound, "{exact} {bound}");
            prop_assert!((0.0..=1.0).contains(&lambda));
            let alone = Terms { plain: &items, sloped: &[], extent, solid_angle: omega }.most(&mut lambda);
            let golden = super::super::bounds::scaled_sum(items.iter().copied(), omega).hi;
            prop_assert!(alone <= golden + 0.01 * omega, "{alone} {golden}");
        }
    }
}
