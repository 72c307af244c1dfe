//! Error against run time: every estimator, method and setting, on situations of replays and on scenes made to be hard.
//!
//! Everything but nanoseconds follows from the seed. What is timed runs on one core, a method and setting at a time; the
//! reference, which is not timed, runs on all.

pub mod choice;
pub mod findings;
mod gains;
pub mod grouping;
pub mod hard;
pub mod integral;
pub mod outcome;
pub mod proof;
mod record;
pub mod reference;
pub mod scale;
pub mod scene;
pub mod situation;
pub mod statistics;
pub mod upper_bound;
pub mod worst_case;

/// The stream of numbers from which candidates are drawn.
pub use foresight_traces::random::SplitMix64 as Draws;

/// The parts of the measurement, in the order in which they run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    /// The added-benefit integral.
    Integral,
    /// The worst case.
    WorstCase,
    /// Choosing the best candidate.
    Choice,
    /// Decisions as the world grows.
    Scale,
    /// The replay's upper bound.
    UpperBound,
}

impl Part {
    /// Every part with the name by which it is asked for.
    pub const ALL: [(&'static str, Part); 5] = [
        ("integral", Part::Integral),
        ("worst-case", Part::WorstCase),
        ("choice", Part::Choice),
        ("scale", Part::Scale),
        ("upper-bound", Part::UpperBound),
    ];
}

#[cfg(test)]
mod tests;
