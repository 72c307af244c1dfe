//! What a method did over a set of candidates.

use super::outcome::{ErrorRow, Kind};
use super::statistics::Quantiles;

/// What a method answers: a value within bounds, proven or thought.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Answer {
    pub(super) value: f64,
    /// Proven bounds, or value ∓ error estimate; infinite where the method says nothing.
    pub(super) lower: f64,
    pub(super) upper: f64,
    pub(super) evaluations: u64,
}

impl Answer {
    /// A value whose method says nothing about its error.
    pub(super) fn bare(value: f64, evaluations: u64) -> Answer {
        Answer { value, lower: f64::NEG_INFINITY, upper: f64::INFINITY, evaluations }
    }

    /// Whether it says that the truth may lie within [`low`, `high`], and its value lies within its own bounds.
    pub(super) fn meets(&self, low: f64, high: f64) -> bool {
        let is_sound = self.lower <= self.value && self.value <= self.upper;
        is_sound && self.lower <= high && low <= self.upper
    }
}

/// Errors and costs.
#[derive(Clone, Debug, Default)]
pub(super) struct Record {
    pub(super) errors: Vec<f64>,
    /// Width of the bounds, or twice the error estimate, relative as errors are.
    pub(super) gaps: Vec<f64>,
    pub(super) nanos: u64,
    pub(super) evaluations: u64,
    pub(super) violations: u64,
}

impl Record {
    pub(super) fn merge(&mut self, other: &Record) {
        self.errors.extend(&other.errors);
        self.gaps.extend(&other.gaps);
        self.nanos += other.nanos;
        self.evaluations += other.evaluations;
        self.violations += other.violations;
    }

    /// A row without what names it; `None` of nothing.
    pub(super) fn row(&self, case: &str, kind: Kind) -> Option<ErrorRow> {
        let count = self.errors.len();
        let q = Quantiles::of(&mut self.errors.clone());
        let gaps = Quantiles::of(&mut self.gaps.clone());
        let has_gaps = !self.gaps.is_empty();
        (count > 0).then(|| ErrorRow {
            case: case.to_owned(),
            kind,
            reading: None,
            method: String::new(),
            setting: String::new(),
            certified: false,
            default: false,
            candidates: count as u64,
            evaluations: self.evaluations as f64 / count as f64,
            ns_per_candidate: self.nanos as f64 / count as f64,
            max_relative_error: q.max,
            p999_relative_error: q.p999,
            median_relative_error: q.median,
            bound_violations: self.violations,
            gap: has_gaps.then_some(gaps.mean),
            max_gap: has_gaps.then_some(gaps.max),
        })
    }
}
