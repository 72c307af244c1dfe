//! The integrand: what an error adds where another was shown.

use super::target::check_cut;
use super::{IntegralError, Leg, Target, within};
use crate::benefit::accuracy::accuracy;
use crate::benefit::cut::CutSettings;

/// The added benefit of one error over another along a leg.
#[derive(Clone, Copy, Debug)]
pub struct AddedBenefit {
    /// The motion.
    pub leg: Leg,
    /// What is seen.
    pub target: Target,
    /// Geometric error g₁ that is shown from the arrival on, metres; ∞ is nothing.
    pub after: f64,
    /// Geometric error g₀ that was shown, metres; ∞ is nothing.
    pub before: f64,
    /// When g₁ is there, seconds; nothing counts before.
    pub arrival_s: f64,
    /// How the target weighs.
    pub cut: CutSettings,
    /// Attenuation rate, 1/s: att(u) = exp(−rate·u).
    pub attenuation: f64,
}

/// Geometric errors, metres, are at most this, or ∞.
const ERROR_MAX: f64 = 1e40;

impl AddedBenefit {
    /// Refuses what no method can integrate.
    ///
    /// # Errors
    /// The field that is NaN, negative or out of range.
    pub fn check(&self) -> Result<(), IntegralError> {
        for (field, error) in [("after", self.after), ("before", self.before)] {
            if error != f64::INFINITY {
                within(field, error, 0.0, ERROR_MAX, "0 to 1e40 m, or infinity for nothing")?;
            }
        }
        within("arrival_s", self.arrival_s, 0.0, f64::MAX, "a finite number ≥ 0")?;
        check_cut(&self.cut)?;
        check_attenuation(self.attenuation)
    }

    /// Where the integral begins, seconds.
    pub fn from_s(&self) -> f64 {
        self.leg.from_s().max(self.arrival_s).min(self.leg.to_s())
    }

    /// Where the integral ends, seconds.
    pub fn to_s(&self) -> f64 {
        self.leg.to_s()
    }

    /// The integrand at `u` seconds, sr.
    pub fn value(&self, u: f64) -> f64 {
        let sight = self.target.seen(&self.leg, &self.cut, u);
        if sight.weight <= 0.0 {
            return 0.0;
        }
        attenuated(self.attenuation, u) * sight.weight * accuracy_gain(self.after, self.before, sight.sharpness)
    }
}

pub(super) fn check_attenuation(rate: f64) -> Result<(), IntegralError> {
    within("attenuation", rate, 0.0, 1e9, "0 to 1e9 per second")
}

/// exp(−rate·u).
pub(super) fn attenuated(rate: f64, u: f64) -> f64 {
    if rate == 0.0 { 1.0 } else { libm::exp(-rate * u) }
}

/// a(after) − a(before) at `sharpness`, without cancellation; errors in metres, ∞ for nothing.
pub fn accuracy_gain(after: f64, before: f64, sharpness: f64) -> f64 {
    if after == f64::INFINITY || before == f64::INFINITY {
        return accuracy(after, sharpness) - accuracy(before, sharpness);
    }
    let (x, y) = (after * after * sharpness, before * before * sharpness);
    (before - after) * (before + after) * sharpness / ((1.0 + x) * (1.0 + y))
}
