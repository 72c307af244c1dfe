//! The antiderivative for a group inside the view, in double-double.
//!
//! With τ along the path from the point closest to the centre, d² = b² + τ², x = τ/d, k² = E/(b²+E):
//! ∫ τ dτ/(d(d²+E)) = atan(d/√E)/√E and ∫ dτ/(d(d²+E)) = atanh(kx)/√(E(b²+E)); −1/d and x/b² for E = 0.

use super::double::{Vector, atan2, dot, double, ln, minus, plus, ratio, times};
use super::scene::Scene;
use foresight_scheduler::integral::AddedBenefit;
use twofloat::TwoFloat;

/// (value, error) between two times after the leg's begin; `None` for a camera that hardly moves. There must be a
/// closed form at all.
pub(super) fn integrate(
    benefit: &AddedBenefit,
    scene: &Scene,
    from: TwoFloat,
    to: TwoFloat,
) -> Option<(TwoFloat, f64)> {
    let velocity = scene.velocity();
    let speed = dot(velocity, velocity).sqrt();
    if speed.hi() <= 0.0 {
        return None;
    }
    let direction = times(velocity, ratio(double(1.0), speed));
    let start = scene.relative(from);
    let first = -dot(&start, &direction);
    let last = first + speed * (to - from);
    let closest = plus(&start, &times(&direction, first));
    let b_squared = dot(&closest, &closest);
    let mut ends = vec![first, last];
    for k in 0..3 {
        if direction[k].hi() != 0.0 {
            let at = ratio(closest[k], direction[k]);
            if at > first && at < last {
                ends.push(at);
            }
        }
    }
    ends.sort_by(|a, b| a.hi().total_cmp(&b.hi()).then(a.lo().total_cmp(&b.lo())));
    let areas = benefit.target.face_areas().to_array();
    let (mut value, mut magnitude) = (double(0.0), 0.0);
    for (error, sign) in [(benefit.after, 1.0), (benefit.before, -1.0)] {
        if error == f64::INFINITY {
            continue;
        }
        let e_squared = scene.sharpness * TwoFloat::new_mul(error, error);
        for pair in ends.windows(2) {
            let middle = minus(&closest, &times(&direction, (pair[0] + pair[1]) * 0.5));
            let signed: Vector = [0, 1, 2].map(|k| double(if middle[k].hi() < 0.0 { -areas[k] } else { areas[k] }));
            let (along, across) = (dot(&signed, &direction), dot(&signed, &closest));
            let [p, q] = [pair[0], pair[1]].map(|tau| antiderivatives(b_squared, e_squared, tau));
            value += (across * (q.0 - p.0) - along * (q.1 - p.1)) * sign;
            magnitude += across.hi().abs() * (q.0.hi().abs() + p.0.hi().abs())
                + along.hi().abs() * (q.1.hi().abs() + p.1.hi().abs());
        }
    }
    // Thirty digits of what was subtracted, with two to spare.
    Some((ratio(value, speed), 1e-28 * magnitude / speed.hi()))
}

/// (∫ dτ/(d(d²+E)), ∫ τ dτ/(d(d²+E))) at τ.
fn antiderivatives(b_squared: TwoFloat, e_squared: TwoFloat, tau: TwoFloat) -> (TwoFloat, TwoFloat) {
    let squared = b_squared + tau * tau;
    let d = squared.sqrt();
    if e_squared.hi() == 0.0 {
        let even = if b_squared.hi() > 0.0 { ratio(ratio(tau, d), b_squared) } else { double(0.0) };
        return (even, ratio(double(-1.0), d));
    }
    let e = e_squared.sqrt();
    let odd = ratio(atan2(d, e), e);
    if b_squared.hi() <= 0.0 {
        return (double(0.0), odd);
    }
    let root = (b_squared + e_squared).sqrt();
    let kx = ratio(e * tau.abs(), root * d);
    // (1 + kx)/(1 − kx) = (1 + kx)²/(1 − k²x²), and 1 − k²x² has no cancellation.
    let quotient =
        ratio((kx + 1.0) * (kx + 1.0) * squared * (b_squared + e_squared), b_squared * (squared + e_squared));
    let even = ratio(ln(quotient) / 2.0, e * root);
    (if tau.hi() < 0.0 { -even } else { even }, odd)
}
