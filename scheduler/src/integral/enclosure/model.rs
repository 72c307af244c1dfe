//! Taylor models: a function of s ∈ [−1, 1] as a polynomial and a bound on the distance to it (Makino & Berz 2003).
//!
//! |f(s) − Σ p_k s^k| ≤ r holds for the exact f whatever has been rounded: every operation adds to r what it truncates and
//! at least what it rounds. One operation of f64 rounds by at most [`ULP`] of its result, or by less than
//! [`f64::MIN_POSITIVE`] where it underflows; the bounds themselves are computed in f64 and inflated by [`UP`].

use core::ops::{Add, Mul, Neg, Sub};

/// Number of coefficients.
pub(super) const TERMS: usize = 5;
/// Unit roundoff, 2⁻⁵³.
pub(super) const ULP: f64 = 0.5 * f64::EPSILON;
/// More than a hundred operations round.
pub(super) const UP: f64 = 1.0 + 128.0 * f64::EPSILON;
/// What libm's functions are off by at most, relative: they claim 1 ulp.
pub(super) const LIBM: f64 = 4.0 * f64::EPSILON;

/// A polynomial in s with a remainder.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    p: [f64; TERMS],
    r: f64,
}

impl Model {
    pub(super) const ZERO: Model = Model::exact(0.0);

    /// A constant that is a double.
    pub(super) const fn exact(value: f64) -> Model {
        Model { p: [value, 0.0, 0.0, 0.0, 0.0], r: 0.0 }
    }

    /// A constant known to within `radius`.
    pub(super) const fn constant(value: f64, radius: f64) -> Model {
        Model { p: [value, 0.0, 0.0, 0.0, 0.0], r: radius }
    }

    /// Anything between `low` and `high`.
    pub(super) fn between(low: f64, high: f64) -> Model {
        let middle = 0.5 * low + 0.5 * high;
        Model::constant(middle, (high - middle).max(middle - low).max(0.0) * UP + f64::MIN_POSITIVE)
    }

    /// `value` + `slope`·s, off by at most `radius`.
    pub(super) fn linear(value: f64, slope: f64, radius: f64) -> Model {
        Model { p: [value, slope, 0.0, 0.0, 0.0], r: radius }
    }

    /// (sin, cos) of `angle` + `swing`·s, where the angle is off by at most `radius`.
    pub(super) fn sincos(angle: f64, swing: f64, radius: f64) -> (Model, Model) {
        if swing.is_nan() || swing.abs() > 1.5 || !angle.is_finite() {
            return (Model::constant(0.0, 1.0), Model::constant(0.0, 1.0));
        }
        let (sin, cos) = libm::sincos(angle);
        let (f, g) = (swing, swing * swing);
        // The next terms are at most f⁵/120 and f⁶/720, together less than f⁵/90.
        let r = (radius + f.abs() * g * g / 90.0 + 32.0 * LIBM) * UP;
        let model = |a: f64, b: f64| Model { p: [a, b * f, -0.5 * a * g, -b * f * g / 6.0, a * g * g / 24.0], r };
        (model(sin, cos), model(cos, -sin))
    }

    /// How far the values lie from the one in the middle at most.
    fn spread(&self) -> f64 {
        (self.p[1].abs() + self.p[2].abs() + self.p[3].abs() + self.p[4].abs() + self.r) * UP
    }

    /// Greatest absolute value, at most.
    pub(super) fn magnitude(&self) -> f64 {
        (self.p[0].abs() + self.spread()) * UP
    }

    /// Value in the middle.
    pub(super) fn middle(&self) -> f64 {
        self.p[0]
    }

    pub(super) fn low(&self) -> f64 {
        let spread = self.spread();
        if spread == 0.0 { self.p[0] } else { (self.p[0] - spread).next_down() }
    }

    pub(super) fn high(&self) -> f64 {
        let spread = self.spread();
        if spread == 0.0 { self.p[0] } else { (self.p[0] + spread).next_up() }
    }

    pub(super) fn is_finite(&self) -> bool {
        self.p.iter().all(|p| p.is_finite()) && self.r.is_finite()
    }

    /// (∫ p, 2r) over [−1, 1].
    pub(super) fn integral(&self) -> (f64, f64) {
        let value = 2.0 * (self.p[0] + self.p[2] / 3.0 + self.p[4] / 5.0);
        (value, (2.0 * self.r + 16.0 * ULP * self.magnitude()) * UP)
    }

    /// Off by `by` more.
    pub(super) fn widened(mut self, by: f64) -> Model {
        self.r = (self.r + by) * UP;
        self
    }

    /// Times a double.
    pub(super) fn scaled(mut self, by: f64) -> Model {
        let mut sum = 0.0;
        for p in &mut self.p {
            *p *= by;
            sum += p.abs();
        }
        let is_exact = by.abs() == 1.0 || by == 0.0 && self.r == 0.0;
        self.r = if is_exact { self.r } else { (self.r * by.abs() + 2.0 * ULP * sum) * UP + f64::MIN_POSITIVE };
        self
    }

    pub(super) fn squared(self) -> Model {
        self * self
    }

    pub(super) fn abs(self) -> Model {
        let (low, high) = (self.low(), self.high());
        if low >= 0.0 {
            return self;
        }
        if high <= 0.0 {
            return -self;
        }
        let (sign, rest) = if -low < high { (1.0, -low) } else { (-1.0, high) };
        let whole = (-low).max(high);
        if self.r + rest < 0.5 * whole {
            // |x| = ±x + [0, 2·rest].
            let mut model = self.scaled(sign);
            model.p[0] += rest;
            model.r = (model.r + rest + 2.0 * ULP * whole) * UP;
            return model;
        }
        Model::between(0.0, whole)
    }

    /// max(x, `floor`) for a double.
    pub(super) fn at_least(self, floor: f64) -> Model {
        let (low, high) = (self.low(), self.high());
        if low >= floor {
            return self;
        }
        if high <= floor {
            return Model::exact(floor);
        }
        let rest = 0.5 * (floor - low);
        if self.r + rest < 0.25 * (high - floor) {
            // x + [0, floor − low].
            let mut model = self;
            model.p[0] += rest;
            model.r = (model.r + rest + 4.0 * ULP * (self.magnitude() + floor.abs())) * UP;
            return model;
        }
        Model::between(floor, high)
    }

    /// min(max(x, 0), 1).
    pub(super) fn clamped(self) -> Model {
        let floored = self.at_least(0.0);
        if floored.high() <= 1.0 { floored } else { Model::exact(1.0) - (Model::exact(1.0) - floored).at_least(0.0) }
    }

    pub(super) fn max(self, other: Model) -> Model {
        other + (self - other).at_least(0.0)
    }

    /// `head`·Σ c_k z^k for x = 1/`unit`·(1 + z), where c_k alternate and fall from the second on, `next` is the first one
    /// left out, and `head` is off by a few ulps.
    fn series(self, unit: f64, head: f64, c: [f64; TERMS], next: f64) -> Model {
        let z = self.scaled(unit) - Model::exact(1.0);
        let rho = z.magnitude();
        if rho.is_nan() || rho >= 0.999 {
            return Model::constant(0.0, f64::INFINITY);
        }
        let mut sum = Model::exact(c[TERMS - 1]);
        for k in (0..TERMS - 1).rev() {
            sum = sum * z + Model::exact(c[k]);
        }
        let squared = rho * rho;
        sum.r = (sum.r + next * squared * squared * rho / (1.0 - rho)) * UP;
        let model = sum.scaled(head);
        let rounded = 16.0 * ULP * model.magnitude();
        model.widened(rounded)
    }

    /// The narrower of a series and of what the extremes of a monotonic function leave.
    fn narrower(self, low: f64, high: f64) -> Model {
        let plain = Model::between((low * (1.0 - LIBM)).next_down(), (high * (1.0 + LIBM)).next_up());
        if self.r < plain.r && self.is_finite() { self } else { plain }
    }

    /// 1/x; `None` where x may be 0.
    pub(super) fn recip(self) -> Option<Model> {
        let (low, high) = (self.low(), self.high());
        if high < 0.0 {
            return Some(-(-self).recip()?);
        }
        if low.is_nan() || low <= 0.0 || !self.is_finite() {
            return None;
        }
        let unit = 1.0 / self.p[0];
        let series = self.series(unit, unit, [1.0, -1.0, 1.0, -1.0, 1.0], 1.0);
        Some(series.narrower(1.0 / high, 1.0 / low))
    }

    /// √max(x, 0).
    pub(super) fn sqrt(self) -> Model {
        let (low, high) = (self.low().max(0.0), self.high().max(0.0));
        if low == 0.0 {
            return Model::between(0.0, high.sqrt().next_up());
        }
        let (unit, head) = (1.0 / self.p[0], self.p[0].sqrt());
        let series = self.series(unit, head, [1.0, 0.5, -0.125, 0.0625, -0.0390625], 0.02734375);
        series.narrower(low.sqrt(), high.sqrt())
    }

    /// 1/√x; `None` where x may be 0.
    pub(super) fn rsqrt(self) -> Option<Model> {
        let (low, high) = (self.low(), self.high());
        if low.is_nan() || low <= 0.0 || !self.is_finite() {
            return None;
        }
        let unit = 1.0 / self.p[0];
        let series = self.series(unit, unit.sqrt(), [1.0, -0.5, 0.375, -0.3125, 0.2734375], 0.24609375);
        Some(series.narrower(1.0 / high.sqrt(), 1.0 / low.sqrt()))
    }

    /// The argument of the complex number x + iy, continued from the one in the middle; `None` where it turns by a
    /// quarter or more.
    pub(super) fn argument(x: Model, y: Model) -> Option<Model> {
        let (x0, y0) = (x.p[0], y.p[0]);
        let along = x.scaled(x0) + y.scaled(y0);
        let tangent = (y.scaled(x0) - x.scaled(y0)) * along.recip()?;
        let rho = tangent.magnitude();
        let angle = libm::atan2(y0, x0);
        let rounded = LIBM * angle.abs();
        if rho.is_nan() || rho >= 1.0 {
            let most = libm::atan(rho.abs()) * (1.0 + LIBM);
            return (!rho.is_nan()).then(|| Model::constant(angle, (most + rounded) * UP));
        }
        let squared = tangent.squared();
        let mut turned = tangent - tangent * squared.scaled(1.0 / 3.0);
        turned.r = (turned.r + rho * rho * rho * rho * rho / 5.0) * UP;
        Some(Model::constant(angle, rounded) + turned)
    }
}

impl Add for Model {
    type Output = Model;
    fn add(mut self, other: Model) -> Model {
        let mut sum = 0.0;
        for (p, q) in self.p.iter_mut().zip(other.p) {
            if q != 0.0 {
                *p += q;
                sum += p.abs();
            }
        }
        self.r =
            if self.r == 0.0 && other.r == 0.0 && sum == 0.0 { 0.0 } else { (self.r + other.r + 2.0 * ULP * sum) * UP };
        self
    }
}

impl Neg for Model {
    type Output = Model;
    fn neg(self) -> Model {
        Model { p: self.p.map(|p| -p), r: self.r }
    }
}

impl Sub for Model {
    type Output = Model;
    fn sub(self, other: Model) -> Model {
        self + -other
    }
}

impl Mul for Model {
    type Output = Model;
    fn mul(self, other: Model) -> Model {
        let (a, b) = (&self.p, &other.p);
        let mut p = [0.0; TERMS];
        for i in 0..TERMS {
            for j in 0..TERMS - i {
                p[i + j] += a[i] * b[j];
            }
        }
        let (a, b) = (a.map(f64::abs), b.map(f64::abs));
        // Σ |b_j| over j ≥ k meets |a_i| for i + k = TERMS.
        let mut cut = 0.0;
        let mut tail = 0.0;
        for i in 1..TERMS {
            tail += b[TERMS - i];
            cut += a[i] * tail;
        }
        let (whole_a, whole_b) = (a.iter().sum::<f64>(), b.iter().sum::<f64>());
        let carried = whole_a * other.r + whole_b * self.r + self.r * other.r;
        let rounded = 8.0 * ULP * whole_a * whole_b;
        let is_zero = whole_a == 0.0 && self.r == 0.0 || whole_b == 0.0 && other.r == 0.0;
        let r = if is_zero { 0.0 } else { (cut + carried + rounded) * UP + 8.0 * f64::MIN_POSITIVE };
        Model { p, r }
    }
}

/// Three models: a vector.
pub(super) type Vector = [Model; 3];

pub(super) fn dot(a: &Vector, b: &Vector) -> Model {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: &Vector, b: &Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub(super) fn plus(a: &Vector, b: &Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

pub(super) fn minus(a: &Vector, b: &Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(super) fn times(a: &Vector, by: Model) -> Vector {
    [a[0] * by, a[1] * by, a[2] * by]
}
