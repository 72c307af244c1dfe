//! The choice that is proven: best-first branch and bound over the tree.
//!
//! A closure's ratio is its gain over its cost in seconds of link. Every node knows how much area a byte can show at most
//! beneath it, and with which least error; with the nearest distance from each predicted eye that bounds the ratio of all
//! candidates beneath. Nodes wait in a heap by that bound, and only what could still win is opened: first the node, then
//! a candidate's own bound, then its exact gain. The choice ends when the best exact ratio is at least every bound that is
//! left, or close enough to it.
//!
//! Of the children of an opened node only the most promising is looked at; the others wait under a rough bound that takes the
//! eyes of an interval of time as one box and asks no frustum. Most of them are never looked at.
//!
//! Bounds hold for the estimator, not only for the integral: its weights are positive, so its largest term bounds its sum.
//! They hold while things are added. What is discarded enters anew, with all above and beneath it.

mod bound;
mod instance;
mod lanes;
mod marginal;
mod objective;
mod residents;
mod rough;
mod search;
mod standing;

pub use instance::{Instance, Winner, certified_winner, exhaustive_winner};
pub use objective::{Objective, ObjectiveSettings};
pub use residents::{MayGo, Residents, Sacrifice};
pub use search::{Ask, Link, Ranked, Search, Stop, closure};
pub use standing::Standing;

/// What is proven about one decision.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Certificate {
    /// Ratio (gain per second of link) of what was chosen; 0 if nothing was.
    pub ratio_lower: f64,
    /// No candidate's ratio exceeds this.
    pub ratio_upper: f64,
    /// (upper − lower) / upper: share of the best ratio that the choice may have missed.
    pub regret: f64,
    /// Nodes looked at, for bounds and for exact gains.
    pub evaluations: u64,
    /// Nodes opened.
    pub nodes_opened: u64,
    /// Share by which the requests made since the objective was sampled may fall short of the best set that takes as long
    /// on the link: (λC) / (f + λC), where f is what they gain, C what they cost, and λ bounds every ratio that is left.
    pub plan_gap: f64,
    /// Whether the choice was cut short by its limit on evaluations.
    pub cut_short: bool,
}

impl Certificate {
    /// Of a choice with this ratio when no candidate exceeds `upper`.
    pub fn of(ratio: f64, upper: f64) -> Certificate {
        let upper = upper.max(ratio).max(0.0);
        let regret = if upper > 0.0 && upper.is_finite() {
            (upper - ratio) / upper
        } else if upper > 0.0 {
            1.0
        } else {
            0.0
        };
        Certificate { ratio_lower: ratio, ratio_upper: upper, regret, ..Certificate::default() }
    }
}
