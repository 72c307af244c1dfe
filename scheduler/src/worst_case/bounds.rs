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
pub(super) fn rounding(count: usize) -> f64 {
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
/// A front face at distance z is z·∫dA/r³. For one z it falls with the eye's distance from the face's middle along either
/// axis, so that the least and the greatest such distances bound it; for one place across, the integral falls with z, and
/// above the face so does the whole. That, or the area × z/d³ from the nearest point, whichever is less.
pub fn solid_angle(centre: DVec3, half: DVec3, spread: DVec3, radius: f64) -> Interval {
    // Rounding of the coordinates counts as motion.
    let blur = 4.0 * f64::EPSILON * (centre.abs() + half);
    solid_angle_over(centre, half, spread + blur, radius + 2.0 * blur.max_element())
}

/// As [`solid_angle`] from one eye; the box is where doubles have it, so that the eye is within or not.
pub fn solid_angle_from_eye(centre: DVec3, half: DVec3) -> Interval {
    solid_angle_over(centre, half, DVec3::ZERO, 0.0)
}

fn solid_angle_over(centre: DVec3, half: DVec3, spread: DVec3, radius: f64) -> Interval {
    let off = centre.abs();
    let outside = off - half;
    if (off + spread).cmple(half).all() {
        return Interval { lo: 4.0 * PI, hi: 4.0 * PI };
    }
    let may_be_within = outside.cmple(spread).all();
    let (near, far) = ((off - spread).max(DVec3::ZERO), off + spread);
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
        let (z_near, z_far) = (z - spread[axis], z + spread[axis]);
        let crude = if nearest > 0.0 { area * z_far / (nearest * nearest * nearest) } else { f64::INFINITY };
        let mut hi = if crude < 2.0 * PI { crude } else { 2.0 * PI };
        if z_near > 0.0 {
            let seen_from = |z: f64, at: DVec3| {
                rectangle(z, (at[i] - half[i], at[i] + half[i]), (at[j] - half[j], at[j] + half[j]))
            };
            // Eyes that all lie above the face see it grow as they come nearer.
            let grows = far[i] <= half[i] && far[j] <= half[j];
            let stretch = if grows { 1.0 } else { z_far / z_near };
            if let Some(most) = seen_from(z_near, near) {
                hi = hi.min(most * stretch + 1e-14);
            }
            let farthest = DVec3::new(z_far, far[i] + half[i], far[j] + half[j]).length();
            let mut lo = area * z_near / (farthest * farthest * farthest);
            if let Some(least) = seen_from(z_far, far) {
                lo = lo.max(least / stretch - 1e-14);
            }
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
    /// Half angles across and up, radians, and their tangents.
    half: (f64, f64),
    tan: (f64, f64),
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
        let tan = (libm::tan(across), libm::tan(up));
        Lens { half: (across, up), tan, right_up: (view.orientation * DVec3::X, view.orientation * DVec3::Y), frustum }
    }

    /// The camera's right and up.
    pub fn axes(&self) -> [DVec3; 2] {
        [self.right_up.0, self.right_up.1]
    }

    /// The corners of what is shown at distance 1 along the line of sight.
    pub fn corners(&self) -> [DVec3; 4] {
        let (right, up) = (self.right_up.0 * self.tan.0, self.right_up.1 * self.tan.1);
        let forward = self.frustum.forward;
        [forward - right - up, forward + right - up, forward + right + up, forward - right + up]
    }

    /// A pyramid that contains the frustum turned by any rotation of at most `turn` that is one of angular velocities of at
    /// most `turns` about the camera's axes in unit time.
    pub fn widened(&self, turn: f64, turns: DVec3) -> Frustum {
        if turn <= 0.0 {
            return self.frustum;
        }
        let (across, high) = self.by_cap(turn, 1.0);
        let by_axis = self.widened_by_axis(turns);
        // Both hold, and so does what they have in common.
        let least = |cap: Option<f64>, axis: Option<f64>| match (cap, axis) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
        self.with(least(across, by_axis.map(|a| a.0)), least(high, by_axis.map(|a| a.1)), turn)
    }

    /// A pyramid that every such rotation of the frustum contains; `None` if there is no such.
    pub fn narrowed(&self, turn: f64, turns: DVec3) -> Option<Frustum> {
        if turn <= 0.0 {
            return Some(self.frustum);
        }
        let some = |(across, high): (f64, f64)| {
            (across > 0.0 && high > 0.0).then(|| self.with(Some(across), Some(high), -turn))
        };
        let by_cap = match self.by_cap(turn, -1.0) {
            (Some(across), Some(high)) => some((across, high)),
            _ => None,
        };
        let (a, b) = self.half;
        let by_axis = some((
            a - turns.y - libm::tan(b) * (0.5 * turns.x + turns.z),
            b - turns.x - libm::tan(a) * (0.5 * turns.y + turns.z),
        ));
        // Each holds by itself; the larger is taken.
        [by_cap, by_axis].into_iter().flatten().max_by(|a, b| a.solid_angle.total_cmp(&b.solid_angle))
    }

    /// Half angles across and up, wider or narrower by a cap of `turn`: about a direction at elevation φ it spans
    /// asin(sin(turn)/cos φ) of azimuth, and φ is at most the half angle the other way. `None` where a plane would have to be
    /// turned past the right angle.
    fn by_cap(&self, turn: f64, sign: f64) -> (Option<f64>, Option<f64>) {
        let sin = if turn < FRAC_PI_2 { libm::sin(turn) } else { 1.0 };
        let widen = |half: f64, other: f64| {
            let ratio = sin / libm::cos(other);
            if ratio < 1.0 { Some(half + sign * libm::asin(ratio)).filter(|a| *a < FRAC_PI_2) } else { None }
        };
        (widen(self.half.0, self.half.1), widen(self.half.1, self.half.0))
    }

    /// The azimuth α and the elevation β of a direction in the turning camera's frame, tan α = x/−z and tan β = y/−z, change
    /// at |α̇| ≤ |ω_y| + tan β·(|ω_x|·sin(2α)/2 + |ω_z|·cos²α), β likewise. So A = a + Y + tan B·(X/2 + Z·cos²a) and
    /// B = b + X + tan A·(Y/2 + Z·cos²b) bound them if they hold with ≥.
    fn widened_by_axis(&self, turns: DVec3) -> Option<(f64, f64)> {
        let (a, b) = self.half;
        let (cos_a, cos_b) = (libm::cos(a), libm::cos(b));
        let next = |across: f64, high: f64| {
            (
                a + turns.y + libm::tan(high) * (0.5 * turns.x + turns.z * cos_a * cos_a),
                b + turns.x + libm::tan(across) * (0.5 * turns.y + turns.z * cos_b * cos_b),
            )
        };
        let fits = |half: f64| half < FRAC_PI_2 - 1e-3;
        let (mut across, mut high) = (a, b);
        for _ in 0..4 {
            if !fits(across) || !fits(high) {
                return None;
            }
            (across, high) = next(across, high);
        }
        // A little more than where this leads to.
        (across, high) = (across + 0.02 * (across - a) + 1e-12, high + 0.02 * (high - b) + 1e-12);
        if !fits(across) || !fits(high) {
            return None;
        }
        let (least_across, least_high) = next(across, high);
        (least_across <= across && least_high <= high).then_some((across, high))
    }

    /// The frustum with other half angles; a plane without is left out. `turn` is how far a corner moves at most.
    fn with(&self, across: Option<f64>, high: Option<f64>, turn: f64) -> Frustum {
        let (right, up) = self.right_up;
        let mut out = self.frustum;
        let plane = |axis: DVec3, half: Option<f64>| match half {
            Some(half) => out.forward * libm::sin(half) + axis * libm::cos(half),
            None => DVec3::ZERO,
        };
        let planes = [plane(right, across), plane(-right, across), plane(up, high), plane(-up, high)];
        out.planes = planes;
        out.corner_angle = (out.corner_angle + turn).clamp(0.0, PI);
        out.solid_angle = match (across, high) {
            (Some(a), Some(b)) => {
                let (a, b) = (libm::tan(a), libm::tan(b));
                out.corner_angle = out.corner_angle.min(libm::atan(libm::hypot(a, b)));
                4.0 * libm::atan2(a * b, (1.0 + a * a + b * b).sqrt())
            }
            _ => 4.0 * PI,
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
                prop_assert!(inside(&lens.widened(turn, DVec3::splat(turn)), -1e-9));
            }
            if let Some(narrow) = lens.narrowed(turn, DVec3::splat(turn))
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
