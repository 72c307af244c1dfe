//! The added benefit of an error over a leg of a path, by several methods behind one interface.
//!
//! On a leg the eye moves at constant velocity and the view turns at constant rate about one axis. What is seen is a
//! [`Target`], a leaf or a far group with the weights of the cuts ([`crate::benefit::cut`]). Showing it with the error g₁
//! where g₀ was shown adds
//!
//! ```text
//! ∫ exp(−rate·u) · w(u) · [a(g₁, u) − a(g₀, u)] du ,  u from the arrival to the leg's end, seconds.
//! ```
//!
//! The integrand has kinks where the target meets a plane of the frustum or the eye a face plane of its box
//! ([`events`]); between them it is smooth. [`Method`] lists what can be done about it, and what each answer is worth;
//! [`Sampler`] takes the same quadrature apart into nodes that serve any pair of errors.

mod closed_form;
mod enclosure;
mod events;
mod gauss_kronrod;
mod gauss_legendre;
mod integrand;
mod leg;
mod pieces;
mod sampler;
mod target;
mod trapezoid;

pub use events::{Events, events};
pub use integrand::{AddedBenefit, accuracy_gain};
pub use leg::Leg;
pub use sampler::{Node, Sampler, gain};
pub use target::{Facet, Form, Sight, Target};

use crate::estimate::Outcome;
use crate::view::ViewError;

/// How an added benefit is integrated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Method {
    /// The composite trapezoid rule; O(n⁻²) where the integrand is smooth.
    Trapezoid {
        /// Intervals over the whole leg, or in each piece between events.
        intervals: u32,
        /// Whether to split at events; finding them counts as evaluations.
        split: bool,
    },
    /// Gauss–Legendre; O(n⁻²ᵏ) over n panels of k nodes where the integrand is smooth.
    GaussLegendre {
        /// Nodes in a panel, 1 to 8.
        nodes: u32,
        /// Panels over the whole leg, or in each piece between events.
        panels: u32,
        /// Whether to split at events; finding them counts as evaluations.
        split: bool,
    },
    /// Gauss–Kronrod (7, 15), bisected where the two rules disagree most. Its error estimate may lie.
    GaussKronrod {
        /// Error relative to the value at which it stops.
        tolerance: f64,
        /// Most evaluations; at least 15.
        evaluations_max: u32,
    },
    /// The antiderivative; only along straight segments where a group lies inside the view as a whole.
    ClosedForm,
    /// Proven bounds, closing in by bisection.
    Enclosure {
        /// Width of the bounds at which it stops, relative to the value.
        tolerance: f64,
        /// Values below this, sr·s, count as this much.
        floor: f64,
        /// Most evaluations, finding events not counted; then the bounds are as wide as they are.
        evaluations_max: u32,
    },
    /// The default: what [`Sampler`] takes, with its own choice of pieces and nodes.
    #[default]
    Sampled,
}

/// Why something cannot be integrated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IntegralError {
    /// The leg begins or ends at no legal view.
    #[error(transparent)]
    View(#[from] ViewError),
    /// A number that is NaN, infinite or out of range.
    #[error("{field} is {value}; expected {expected}")]
    Number {
        /// Whose value it is.
        field: &'static str,
        /// As given.
        value: f64,
        /// What would have been legal.
        expected: &'static str,
    },
    /// There is no antiderivative that [`Method::ClosedForm`] knows.
    #[error("there is no closed form: {0}")]
    NoClosedForm(&'static str),
}

/// Integrates by one method.
///
/// # Errors
/// [`IntegralError`] if `benefit` or the method's settings are not legal, or there is no closed form.
pub fn integrate(benefit: &AddedBenefit, method: &Method) -> Result<Outcome, IntegralError> {
    benefit.check()?;
    let estimate = match *method {
        Method::Trapezoid { intervals, split } => {
            count("intervals", intervals, 1, 1 << 24)?;
            trapezoid::integrate(benefit, intervals, split)
        }
        Method::GaussLegendre { nodes, panels, split } => {
            count("nodes", nodes, 1, gauss_legendre::NODES_MAX)?;
            count("panels", panels, 1, 1 << 24)?;
            gauss_legendre::integrate(benefit, nodes, panels, split)
        }
        Method::GaussKronrod { tolerance, evaluations_max } => {
            within("tolerance", tolerance, 0.0, 1.0, "0 to 1")?;
            count("evaluations_max", evaluations_max, 15, 1 << 24)?;
            gauss_kronrod::integrate(benefit, tolerance, evaluations_max)
        }
        Method::Enclosure { tolerance, floor, evaluations_max } => {
            within("tolerance", tolerance, 0.0, 1.0, "0 to 1")?;
            within("floor", floor, 0.0, f64::MAX, "a finite number ≥ 0")?;
            count("evaluations_max", evaluations_max, 1, 1 << 24)?;
            return Ok(Outcome::Certified(enclosure::integrate(benefit, tolerance, floor, evaluations_max)));
        }
        Method::ClosedForm => closed_form::integrate(benefit)?,
        Method::Sampled => sampler::integrate(benefit),
    };
    Ok(Outcome::Estimate(estimate))
}

/// Refuses a value outside [`low`, `high`], NaN included.
fn within(field: &'static str, value: f64, low: f64, high: f64, expected: &'static str) -> Result<(), IntegralError> {
    if value >= low && value <= high { Ok(()) } else { Err(IntegralError::Number { field, value, expected }) }
}

fn count(field: &'static str, value: u32, low: u32, high: u32) -> Result<(), IntegralError> {
    within(field, f64::from(value), f64::from(low), f64::from(high), "a count within the method's limits")
}
