//! Numbers that carry their error: what is proven, and what is only estimated (ARCHITECTURE.md, "Numbers").

/// A value with proven bounds: `lower` ≤ truth ≤ `upper`, rounding included. A violated bound is a bug.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Certified {
    /// Best guess, within the bounds.
    pub value: f64,
    /// Proven lower bound.
    pub lower: f64,
    /// Proven upper bound.
    pub upper: f64,
    /// Evaluations of the integrand, or of whatever is bounded, that it took; root finding counts.
    pub evaluations: u32,
}

impl Certified {
    /// Width of the enclosure.
    pub fn gap(&self) -> f64 {
        self.upper - self.lower
    }

    /// Whether `truth` lies within.
    pub fn holds(&self, truth: f64) -> bool {
        self.lower <= truth && truth <= self.upper
    }
}

/// A value with a guess of its error, which may be wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// How far it is thought to be off.
    pub error_estimate: f64,
    /// Evaluations that it took; root finding counts.
    pub evaluations: u32,
}

/// What a method answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// With proof.
    Certified(Certified),
    /// Without.
    Estimate(Estimate),
}

impl Outcome {
    /// The value, proven or not.
    pub fn value(&self) -> f64 {
        match self {
            Outcome::Certified(c) => c.value,
            Outcome::Estimate(e) => e.value,
        }
    }

    /// Evaluations that it took.
    pub fn evaluations(&self) -> u32 {
        match self {
            Outcome::Certified(c) => c.evaluations,
            Outcome::Estimate(e) => e.evaluations,
        }
    }
}
