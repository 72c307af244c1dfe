//! The antiderivative along a straight segment, for a group that lies inside the view as a whole.
//!
//! With τ the way from the point closest to the centre, b the distance there, d² = b² + τ² and E = g²·(px/m ÷ e₀)², the
//! benefit is Σ S_k·|α_k + β_k·τ| / (d·(d² + E)), and between sign changes
//!
//! ```text
//! ∫ τ dτ / (d·(d²+E)) = atan(d/√E)/√E ,                                1/d with a minus for E = 0;
//! ∫   dτ / (d·(d²+E)) = atanh(x·√(E/(b²+E))) / √(E·(b²+E)) , x = τ/d,   x/b² for E = 0.
//! ```
//!
//! Differences are taken inside the functions, so that short segments lose no digits. Rotation does not matter, because
//! nothing is clipped. There is none with attenuation, with κ, across the frustum's border, below `near`, or for leaves.

use super::events::Span;
use super::{AddedBenefit, Form, IntegralError};
use crate::benefit::accuracy::HALF_ACCURACY_PX;
use crate::benefit::frustum::Side;
use crate::estimate::Estimate;
use glam::DVec3;

pub(super) fn integrate(benefit: &AddedBenefit) -> Result<Estimate, IntegralError> {
    let refuse = |why| Err(IntegralError::NoClosedForm(why));
    let AddedBenefit { leg, target, cut, .. } = benefit;
    let (from, to) = (benefit.from_s(), benefit.to_s());
    if target.form() != Form::Group {
        return refuse("the target is a leaf");
    }
    if target.facet().is_some() {
        return refuse("the shares of elements turn with the view");
    }
    if benefit.attenuation != 0.0 || cut.centre_falloff != 0.0 {
        return refuse("attenuation and centre weighting are not elementary with it");
    }
    match (Span { leg, target, from_s: from, to_s: to }).swept(&leg.frustum(from), &leg.frustum(to)) {
        Side::Outside => return Ok(Estimate { value: 0.0, error_estimate: 0.0, evaluations: 1 }),
        Side::Straddles(_) => return refuse("the target may not lie inside the view as a whole all along the leg"),
        Side::Inside => {}
    }
    let velocity = leg.velocity();
    let speed = velocity.length();
    let start = leg.relative(target.centre(), from);
    let seconds = to - from;
    if speed * seconds <= 1e-9 * start.length() {
        // Constant to 10⁻⁹; the midpoint is exact to its square.
        if start.length() <= 2.0 * cut.near {
            return refuse("the path comes nearer than `near`");
        }
        let value = seconds * benefit.value(0.5 * (from + to));
        return Ok(Estimate { value, error_estimate: 1e-15 * value.abs(), evaluations: 1 });
    }
    let direction = velocity / speed;
    let first = -start.dot(direction);
    let closest = start + direction * first;
    let b_squared = closest.length_squared();
    let last = first + speed * seconds;
    let nearest =
        if first * last < 0.0 { b_squared.sqrt() } else { libm::hypot(b_squared.sqrt(), first.abs().min(last.abs())) };
    if nearest <= cut.near {
        return refuse("the path comes nearer than `near`");
    }
    let mut ends = vec![first, last];
    for k in 0..3 {
        // The component changes its sign where closest − direction·τ does.
        let at = closest[k] / direction[k];
        if at > first && at < last {
            ends.push(at);
        }
    }
    ends.sort_by(f64::total_cmp);
    let pixels = leg.base().pixels_per_radian / HALF_ACCURACY_PX;
    let areas = target.face_areas();
    let (mut value, mut magnitude) = (0.0, 0.0);
    for (error, sign) in [(benefit.after, 1.0), (benefit.before, -1.0)] {
        if error == f64::INFINITY {
            continue;
        }
        let e = error * pixels;
        for pair in ends.windows(2) {
            let middle = closest - direction * (0.5 * (pair[0] + pair[1]));
            let signed = areas * DVec3::select(middle.cmplt(DVec3::ZERO), DVec3::NEG_ONE, DVec3::ONE);
            let part = signed.dot(closest) * even(b_squared, e, pair[0], pair[1])
                - signed.dot(direction) * odd(b_squared, e, pair[0], pair[1]);
            value += sign * part;
            magnitude += part.abs();
        }
    }
    Ok(Estimate { value: value / speed, error_estimate: 1e-14 * magnitude / speed, evaluations: ends.len() as u32 })
}

/// ∫ τ dτ / (d·(d²+e²)) from `p` to `q`.
fn odd(b_squared: f64, e: f64, p: f64, q: f64) -> f64 {
    let (dp, dq) = ((b_squared + p * p).sqrt(), (b_squared + q * q).sqrt());
    let grown = (q - p) * (q + p) / (dp + dq);
    if e == 0.0 { grown / (dp * dq) } else { libm::atan2(grown * e, e * e + dp * dq) / e }
}

/// ∫ dτ / (d·(d²+e²)) from `p` to `q`.
fn even(b_squared: f64, e: f64, p: f64, q: f64) -> f64 {
    if b_squared == 0.0 {
        // Multiplied by a closest point that is zero.
        return 0.0;
    }
    let (dp, dq) = ((b_squared + p * p).sqrt(), (b_squared + q * q).sqrt());
    let is_one_sided = p * q > 0.0;
    // x_q − x_p and 1 − x_p·x_q, without cancellation.
    let grown =
        if is_one_sided { b_squared * (q - p) * (q + p) / (dp * dq * (q * dp + p * dq)) } else { q / dq - p / dp };
    if e == 0.0 {
        return grown / b_squared;
    }
    let co = if is_one_sided {
        b_squared * (b_squared + p * p + q * q) / (dp * dq * (dp * dq + p * q))
    } else {
        1.0 - p * q / (dp * dq)
    };
    let root = (b_squared + e * e).sqrt();
    // atanh(kx_q) − atanh(kx_p) = atanh(k(x_q − x_p)/(1 − k²x_p·x_q)), k = e/root.
    libm::atanh((e * grown * root / (b_squared + e * e * co)).min(1.0f64.next_down())) / (e * root)
}
