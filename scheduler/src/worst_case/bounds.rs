//! Intervals of what is summed: solid angles seen from a box of eyes, and sums that are scaled to the frustum.

use crate::benefit::frustum::Frustum;
use crate::view::View;
use core::f64::consts::PI;
use glam::DVec3;

/// A closed interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Interval {
    /// Least.
    pub lo: f64,
    /// Greatest.
    pub hi: f64,
}

impl Interval {
    /// Width.
    pub fn width(&self) -> f64 {
        self.hi - self.lo
    }
}

/// A weight and what it is multiplied by, a deficit or an accuracy.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Item {
    /// w, sr, not negative.
    pub weight: Interval,
    /// In [0, 1].
    pub share: Interval,
}

/// Rounding of a sum of `count` terms, each good to a few ulp, as a share of it.
fn rounding(count: usize) -> f64 {
    (count as f64 + 64.0) * 4.0 * f64::EPSILON
}

/// Bounds on min(1, Ω/Σw)·Σ w·s over weights w and shares s in the items' intervals.
///
/// For any λ, Σ w·s ≤ A(λ) + λ·Σw with A the sum of the largest w·(s − λ); with Σw scaled to at most Ω, A ≥ 0 gives
/// A·min(1, Ω/S) + λ·min(Ω, S′) with S the least and S′ the greatest Σw. Every λ in [0, 1] is a bound; a golden section
/// takes a good one. The lower bound is the same with signs changed.
pub fn scaled_sum(items: impl Iterator<Item = Item> + Clone, solid_angle: f64) -> Interval {
    let (mut weight, mut count) = (Interval::default(), 0);
    let mut least = 1.0f64;
    let mut most = 0.0f64;
    for item in items.clone() {
        weight.lo += item.weight.lo;
        weight.hi += item.weight.hi;
        least = least.min(item.share.lo);
        most = most.max(item.share.hi);
        count += 1;
    }
    if count == 0 {
        return Interval::default();
    }
    let upper = |lambda: f64| {
        let excess: f64 = items
            .clone()
            .map(|i| {
                let over = i.share.hi - lambda;
                over * if over > 0.0 { i.weight.hi } else { i.weight.lo }
            })
            .sum();
        if excess >= 0.0 {
            excess * scale(weight.lo, solid_angle) + lambda * weight.hi.min(solid_angle)
        } else {
            (excess + lambda * weight.hi) * scale(weight.hi, solid_angle)
        }
    };
    let lower = |lambda: f64| {
        let excess: f64 = items
            .clone()
            .map(|i| {
                let over = i.share.lo - lambda;
                over * if over > 0.0 { i.weight.lo } else { i.weight.hi }
            })
            .sum();
        let at = |sum: f64| (excess + lambda * sum) * scale(sum, solid_angle);
        if excess > 0.0 { at(weight.lo).min(at(weight.hi)) } else { at(weight.lo) }
    };
    let (mut hi, mut lo) = (upper(0.0), lower(0.0));
    if weight.hi > solid_angle {
        hi = hi.min(golden(&upper, least, most));
        lo = lo.max(-golden(&|lambda| -lower(lambda), least, most));
    }
    let slack = rounding(count) * weight.hi.min(hi.abs() + lo.abs() + solid_angle);
    Interval { lo: (lo - slack).max(0.0), hi: (hi + slack).max(0.0) }
}

/// min(1, Ω/Σw).
pub fn scale(weight: f64, solid_angle: f64) -> f64 {
    if weight > solid_angle { solid_angle / weight } else { 1.0 }
}

/// Least value met by a golden section of [low, high] in twelve steps.
fn golden(f: &impl Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut a, mut b) = (low, high);
    let (mut c, mut d) = (b - RATIO * (b - a), a + RATIO * (b - a));
    let (mut fc, mut fd) = (f(c), f(d));
    let mut least = f(low).min(f(high)).min(fc).min(fd);
    for _ in 0..12 {
        if fc < fd {
            (b, d, fd) = (d, c, fc);
            c = b - RATIO * (b - a);
            fc = f(c);
        } else {
            (a, c, fc) = (c, d, fd);
            d = a + RATIO * (b - a);
            fd = f(d);
        }
        least = least.min(fc).min(fd);
    }
    least
}

/// Solid angle (sr) of the rectangle at distance `z` > 0 in front, over [x0, x1] × [y0, y1]: the four corners' arc
/// tangents of xy/(z·r), as the argument of one complex product. `None` where it underflows.
fn rectangle(z: f64, x: (f64, f64), y: (f64, f64)) -> Option<f64> {
    let corner = |x: f64, y: f64| {
        let (re, im) = (z * (x * x + y * y + z * z).sqrt(), x * y);
        let length = libm::hypot(re, im);
        (re / length, im / length)
    };
    let product = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let conjugate = |a: (f64, f64)| (a.0, -a.1);
    let plus = product(corner(x.0, y.0), corner(x.1, y.1));
    let minus = product(corner(x.0, y.1), corner(x.1, y.0));
    let (re, im) = product(plus, conjugate(minus));
    let angle = libm::atan2(im, re);
    if angle.is_nan() {
        return None;
    }
    Some(if angle < -1e-12 { angle + 2.0 * PI } else { angle.max(0.0) })
}

/// Interval of the solid angle (sr), unclipped, of the box at `centre` (relative to the middle of the eyes) with half
/// sides `half`, over eyes within `spread` along each axis and within `radius`; 4π from within.
///
/// Every front face is z·∫dA/r³, z its distance along its axis: moving by δ, z changes by at most δ_k and r by the factor
/// 1 ± δ/d, d the distance to the face. That, or the area × z/d³ from the nearest point, whichever is less.
pub fn solid_angle(centre: DVec3, half: DVec3, spread: DVec3, radius: f64) -> Interval {
    // Rounding of the coordinates counts as motion.
    let blur = 4.0 * f64::EPSILON * (centre.abs() + half);
    let spread = spread + blur;
    let radius = radius + 2.0 * blur.max_element();
    let off = centre.abs();
    let outside = off - half;
    if (off + spread).cmple(half).all() {
        return Interval { lo: 4.0 * PI, hi: 4.0 * PI };
    }
    let may_be_within = outside.cmple(spread).all();
    let mut sum = Interval::default();
    for axis in 0..3 {
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let z = outside[axis];
        if z + spread[axis] <= 0.0 {
            continue;
        }
        // From the nearest eye to the face.
        let gap =
            DVec3::new(z.max(0.0) - spread[axis], outside[i] - spread[i], outside[j] - spread[j]).max(DVec3::ZERO);
        let across = libm::hypot(outside[i].max(0.0), outside[j].max(0.0));
        let distance = libm::hypot(z.max(0.0), across);
        let nearest = gap.length().max(distance - radius);
        let area = 4.0 * half[i] * half[j];
        let crude =
            if nearest > 0.0 { area * (z + spread[axis]) / (nearest * nearest * nearest) } else { f64::INFINITY };
        let mut hi = if crude < 2.0 * PI { crude } else { 2.0 * PI };
        if z > spread[axis] {
            let across = (centre[i] - half[i], centre[i] + half[i]);
            let Some(here) = rectangle(z, across, (centre[j] - half[j], centre[j] + half[j])) else {
                sum.hi += hi;
                continue;
            };
            let towards = 1.0 - radius / distance;
            if towards > 0.0 {
                hi = hi.min(here * (1.0 + spread[axis] / z) / (towards * towards * towards) + 1e-14);
            }
            let away = 1.0 + radius / distance;
            let far = (DVec3::new(z, off[i] + half[i], off[j] + half[j]) + spread).length();
            let lo = (here * (1.0 - spread[axis] / z) / (away * away * away) - 1e-14)
                .max(area * (z - spread[axis]) / (far * far * far));
            if lo > 0.0 {
                sum.lo += lo;
            }
        }
        sum.hi += hi;
    }
    let hi = if may_be_within { 4.0 * PI } else { sum.hi.min(2.0 * PI) };
    let round = 32.0 * f64::EPSILON;
    let lo = (sum.lo * (1.0 - round)).clamp(0.0, 2.0 * PI);
    Interval { lo, hi: (hi * (1.0 + round)).max(lo) }
}

/// Interval of Σ ι·Ω over the leaves of a group whose boxes lie within `half` of `centre` (relative to the eye) and
/// whose face areas sum to `areas`: every face's centre distance is in [D − ρ, D + ρ].
pub fn group_solid_angle(centre: DVec3, half: DVec3, areas: DVec3) -> Interval {
    let off = centre.abs();
    let nearest = (off - half).max(DVec3::ZERO).length();
    let far = (off + half).length();
    let most = (off + half).dot(areas) / (nearest * nearest * nearest);
    let least = (off - half).max(DVec3::ZERO).dot(areas) / (far * far * far);
    // Sums of areas are kept in single precision.
    let hi = if most.is_nan() { f64::INFINITY } else { most * (1.0 + 1e-6) + 1e-37 };
    Interval { lo: if least.is_nan() { 0.0 } else { least * (1.0 - 1e-6) }, hi }
}

/// The frustum of a view, its half angles, and those that contain it, or that it contains, under every rotation by at
/// most an angle.
#[derive(Clone, Copy, Debug)]
pub struct Lens {
    /// Half angles across and up, radians.
    half: (f64, f64),
    right_up: (DVec3, DVec3),
    /// As the view has it.
    pub frustum: Frustum,
}

impl Lens {
    /// Of a view that has passed its check.
    pub fn new(view: &View) -> Lens {
        let frustum = Frustum::new(view);
        let up = 0.5 * view.fov_y;
        let across = libm::atan(libm::tan(up) * f64::from(view.viewport[0]) / f64::from(view.viewport[1]));
        Lens { half: (across, up), right_up: (view.orientation * DVec3::X, view.orientation * DVec3::Y), frustum }
    }

    /// A pyramid that contains the frustum turned by any rotation of at most `turn`. A cap of `turn` about a direction at
    /// elevation φ spans asin(sin(turn)/cos φ) of azimuth; φ is at most the half angle the other way. A plane that
    /// would have to be turned past the right angle is left out.
    pub fn widened(&self, turn: f64) -> Frustum {
        self.turned(turn, 1.0)
    }

    /// A pyramid that every rotation of the frustum by at most `turn` contains; `None` if there is no such.
    pub fn narrowed(&self, turn: f64) -> Option<Frustum> {
        let narrow = self.turned(turn, -1.0);
        narrow.solid_angle.is_finite().then_some(narrow)
    }

    fn turned(&self, turn: f64, sign: f64) -> Frustum {
        if turn <= 0.0 {
            return self.frustum;
        }
        let (right, up) = self.right_up;
        let sin = if turn < core::f64::consts::FRAC_PI_2 { libm::sin(turn) } else { 1.0 };
        let widen = |half: f64, other: f64| {
            let ratio = sin / libm::cos(other);
            if ratio < 1.0 { Some(half + sign * libm::asin(ratio)).filter(|a| *a < FRAC_PI_2) } else { None }
        };
        let (across, high) = (widen(self.half.0, self.half.1), widen(self.half.1, self.half.0));
        let mut out = self.frustum;
        let plane = |axis: DVec3, half: Option<f64>| match half {
            Some(half) => out.forward * libm::sin(half) + axis * libm::cos(half),
            None => DVec3::ZERO,
        };
        let planes = [plane(right, across), plane(-right, across), plane(up, high), plane(-up, high)];
        out.planes = planes;
        out.corner_angle = (out.corner_angle + sign * turn).clamp(0.0, PI);
        out.solid_angle = match (across, high) {
            (Some(a), Some(b)) if a > 0.0 && b > 0.0 => {
                let (a, b) = (libm::tan(a), libm::tan(b));
                4.0 * libm::atan2(a * b, (1.0 + a * a + b * b).sqrt())
            }
            _ if sign > 0.0 => 4.0 * PI,
            _ => f64::NAN,
        };
        out
    }
}

const FRAC_PI_2: f64 = core::f64::consts::FRAC_PI_2;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::benefit::solid_angle::of_box;
    use glam::DQuat;
    use proptest::prelude::*;

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-limit..limit).prop_map(DVec3::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

        /// The interval holds the exact solid angle from every eye of the box, and is tight where nothing moves.
        #[test]
        fn solid_angles_lie_within(c in vector(20.0), h in vector(5.0), s in vector(3.0), t in vector(1.0)) {
            let (half, spread) = (h.abs(), s.abs());
            let found = solid_angle(c, half, spread, spread.length());
            let exact = of_box(c - t * spread, half);
            prop_assert!(found.lo - 1e-9 <= exact && exact <= found.hi + 1e-9, "{found:?} {exact}");
            let here = solid_angle(c, half, DVec3::ZERO, 0.0);
            prop_assert!(here.width() <= 1e-6 && (here.lo - of_box(c, half)).abs() < 1e-6, "{here:?} {}", of_box(c, half));
        }

        /// Turned frusta lie between the narrowed and the widened pyramid.
        #[test]
        fn pyramids_hold_what_is_turned(axis in vector(1.0), turn in 0.0..2.0f64, by in 0.0..1.0f64, u in vector(1.0), fov in 0.1..2.9f64) {
            prop_assume!(axis.length() > 0.1 && u.length() > 0.1);
            let view = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: fov, viewport: [1600, 900] };
            let lens = Lens::new(&view);
            let turned = Frustum::new(&View { orientation: DQuat::from_axis_angle(axis.normalize(), turn * by), ..view });
            let inside = |f: &Frustum, slack: f64| f.planes.iter().all(|p| p.dot(u.normalize()) >= slack);
            if inside(&turned, 0.0) {
                prop_assert!(inside(&lens.widened(turn), -1e-9));
            }
            if let Some(narrow) = lens.narrowed(turn)
                && inside(&narrow, 0.0)
            {
                prop_assert!(inside(&turned, -1e-9));
            }
        }

        /// Scaled sums of values picked from the intervals lie within the bounds.
        #[test]
        fn scaled_sums_lie_within(raw in prop::collection::vec((0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64), 0..12), omega in 0.05..6.0f64) {
            let items: Vec<Item> = raw.iter().map(|r| Item {
                weight: Interval { lo: r.0.min(r.1), hi: r.0.max(r.1) },
                share: Interval { lo: r.2.min(r.3), hi: r.2.max(r.3) },
            }).collect();
            let pick = |i: Interval, t: f64| i.lo + t * i.width();
            let weight: f64 = items.iter().zip(&raw).map(|(i, r)| pick(i.weight, r.4)).sum();
            let sum: f64 = items.iter().zip(&raw).map(|(i, r)| pick(i.weight, r.4) * pick(i.share, r.5)).sum();
            let found = scaled_sum(items.iter().copied(), omega);
            let exact = sum * scale(weight, omega);
            prop_assert!(found.lo <= exact && exact <= found.hi, "{found:?} {exact}");
        }
    }
}
