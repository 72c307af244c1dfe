//! Elementary functions in double-double arithmetic, about 30 digits.
//!
//! The crate `twofloat` gives sums, products, quotients by a double and square roots to 10⁻³¹; its quotients of two
//! double-doubles and its transcendental functions are good to about 10⁻¹⁶ only, and these take their place.

use twofloat::TwoFloat;
use twofloat::consts::{FRAC_PI_2, LN_2};

/// From a double, exactly.
pub(super) fn double(x: f64) -> TwoFloat {
    TwoFloat::from(x)
}

/// a − b of two doubles, exactly.
pub(super) fn difference(a: f64, b: f64) -> TwoFloat {
    TwoFloat::new_sub(a, b)
}

/// a/b by long division.
pub(super) fn ratio(a: TwoFloat, b: TwoFloat) -> TwoFloat {
    let mut quotient = double(0.0);
    let mut rest = a;
    for _ in 0..4 {
        let digit = rest.hi() / b.hi();
        quotient += digit;
        rest -= b * digit;
    }
    quotient
}

/// (sin, cos) by quarter turns and Taylor's series; the reduction loses |x|·10⁻³².
pub(super) fn sin_cos(x: TwoFloat) -> (TwoFloat, TwoFloat) {
    let quarters = libm::round(x.hi() / FRAC_PI_2.hi());
    let r = x - FRAC_PI_2 * quarters;
    let square = r * r;
    // (π/4)^28 / 28! < 10⁻³¹.
    let (mut sin, mut cos) = (double(1.0), double(1.0));
    for k in (1..14).rev() {
        let k = f64::from(k);
        sin = double(1.0) - square * sin / (2.0 * k * (2.0 * k + 1.0));
        cos = double(1.0) - square * cos / ((2.0 * k - 1.0) * 2.0 * k);
    }
    let sin = r * sin;
    match libm::fmod(quarters, 4.0) as i32 {
        0 => (sin, cos),
        1 | -3 => (cos, -sin),
        2 | -2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// The angle of (x, y) in (−π, π], by one correction of the double's.
pub(super) fn atan2(y: TwoFloat, x: TwoFloat) -> TwoFloat {
    // Scaled, so that the squares neither overflow nor lose their tails.
    let scale = 1.0 / y.hi().abs().max(x.hi().abs());
    if !scale.is_finite() {
        return double(0.0);
    }
    let (x, y) = (x * scale, y * scale);
    let first = libm::atan2(y.hi(), x.hi());
    let (sin, cos) = sin_cos(double(first));
    let off = ratio(y * cos - x * sin, (x * x + y * y).sqrt());
    // asin z = z + z³/6 + …, for z of about 10⁻¹⁶.
    double(first) + off + off * off * off / 6.0
}

/// exp(x) for |x| up to some hundreds, by halving to a small argument and Taylor's series.
pub(super) fn exp(x: TwoFloat) -> TwoFloat {
    if x.hi() < -700.0 {
        return double(0.0);
    }
    let twos = libm::round(x.hi() / LN_2.hi());
    let r = (x - LN_2 * twos) / 64.0;
    let mut sum = double(1.0);
    for k in (1..15).rev() {
        sum = double(1.0) + r * sum / f64::from(k);
    }
    for _ in 0..6 {
        sum = sum * sum;
    }
    sum * libm::exp2(twos)
}

/// ln(x) for x > 0, by one Newton step from the double's.
pub(super) fn ln(x: TwoFloat) -> TwoFloat {
    let first = libm::log(x.hi());
    let z = x * exp(double(-first)) - 1.0;
    // ln(1+z) = z − z²/2 + z³/3, for z of about 10⁻¹⁶ · |ln x|.
    double(first) + z - z * z / 2.0 + z * z * z / 3.0
}

/// Three coordinates.
pub(super) type Vector = [TwoFloat; 3];

pub(super) fn dot(a: &Vector, b: &Vector) -> TwoFloat {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: &Vector, b: &Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn minus(a: &Vector, b: &Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn plus(a: &Vector, b: &Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn times(a: &Vector, by: TwoFloat) -> Vector {
    [a[0] * by, a[1] * by, a[2] * by]
}

#[cfg(test)]
mod tests {
    use super::*;
    use twofloat::consts::PI;

    fn is_small(x: TwoFloat) -> bool {
        x.hi().abs() < 1e-29
    }

    #[test]
    fn functions_satisfy_their_identities_to_thirty_digits() {
        let mut x = 0.0137;
        for _ in 0..2000 {
            x = libm::fmod(x * 1.731, 40.0) + 1e-4;
            let t = double(x) / 3.0;
            let (sin, cos) = sin_cos(t);
            assert!(is_small(sin * sin + cos * cos - 1.0), "{x}");
            let (sin2, cos2) = sin_cos(t * 2.0);
            assert!(is_small(sin2 - sin * cos * 2.0) && is_small(cos2 - (cos * cos * 2.0 - 1.0)), "{x}");
            let (sin3, _) = sin_cos(t * 3.0);
            assert!(is_small(sin3 - (sin * 3.0 - sin * sin * sin * 4.0)), "{x}");
            let angle = atan2(t, double(1.0));
            let (sin, cos) = sin_cos(angle);
            assert!(is_small(ratio(sin - t * cos, (t * t + 1.0).sqrt())), "{x}");
            assert!(is_small(ratio(t, sin2) * sin2 - t), "{x}");
            assert!(is_small(exp(t) * exp(-t) - 1.0), "{x}");
            assert!(is_small(ratio(exp(ln(t)) - t, t)), "{x}");
        }
        assert!(is_small(atan2(double(1.0), double(1.0)) * 4.0 - PI));
        assert!(is_small(atan2(double(1.0), double(-1.0)) * 4.0 - PI * 3.0));
        assert!(is_small(ln(double(2.0)) - LN_2));
        // e to 33 digits.
        let e = TwoFloat::new_add(core::f64::consts::E, 1.4456468917292502e-16);
        assert!(is_small(exp(double(1.0)) - e), "{:e}", (exp(double(1.0)) - e).hi());
    }
}
