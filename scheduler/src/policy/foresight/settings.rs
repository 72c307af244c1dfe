//! Every constant of `foresight`, with its default, in one place.

use super::AlphaRule;
use crate::benefit::cut::CutSettings;
use crate::predict::PredictorKind;
use crate::setting::{SettingError, within};
use crate::worst_case::neighbourhood::NeighbourhoodKind;
use crate::worst_case::{Reach, WorstCaseKind};

/// How room is made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Discards {
    /// By least loss per byte, and only if the swap gains.
    #[default]
    Planned,
    /// By least recent use, whatever it costs (Teler & Lischinski plan none).
    LeastRecentlyUsed,
}

/// How the best closure is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChoiceMethod {
    /// By branch and bound ([`crate::select::certified`]); sampled under atomic refinement.
    #[default]
    Certified,
    /// By one pass over the patches of every predicted view ([`crate::select::horizon`]).
    Sampled,
}

/// Every constant of the policy, with its default.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForesightSettings {
    /// α ∈ [0, 1]: trust in the prediction; where it is solved for or adapted, at the start.
    pub alpha: f64,
    /// Where α comes from.
    pub alpha_rule: AlphaRule,
    /// δ₀, seconds: least span that the integral looks ahead.
    pub horizon_s: f64,
    /// D, seconds: evaluations are reused this long, and ε is at least this.
    pub reuse_s: f64,
    /// η: a swap must gain more than 1+η times its loss.
    pub hysteresis: f64,
    /// att(u) = exp(−rate·u), per second.
    pub attenuation: f64,
    /// o, seconds of link that a request costs beside its bytes.
    pub request_cost_s: f64,
    /// Intervals of the midpoint rule.
    pub samples: usize,
    /// How the cuts are made: opening angle, near plane, centre weighting κ.
    pub cut: CutSettings,
    /// How choices are made.
    pub choice: ChoiceMethod,
    /// Share of the best ratio that a certified choice may miss.
    pub tolerance: f64,
    /// Nodes that a certified choice may look at between two observations; then the best found so far is taken, with what
    /// it may miss, and the search goes on at the next.
    pub evaluations: u64,
    /// Sampled choice: groups are opened until what could be gained beneath is this share of a typical gain. Where every
    /// choice is worth much, little things are not looked at; where only little things are left, they are.
    pub grouping: f64,
    /// Limits of the client's motion.
    pub reach: Reach,
    /// How the client moves: what it could reach if the prediction fails.
    pub neighbourhood: NeighbourhoodKind,
    /// The reading of the worst case.
    pub worst_case: WorstCaseKind,
    /// Under `minimum`: samples of the covering set, of which the worst become terms of the objective.
    pub worst_samples: usize,
    /// How room is made.
    pub discards: Discards,
    /// Whether a gain counts from the arrival of the bytes; otherwise from now.
    pub gains_from_arrival: bool,
    /// Whether every visible leaf is first given something.
    pub cover_first: bool,
    /// Requests are made while what is outstanding lasts less than the latency plus this, seconds.
    pub slack_s: f64,
    /// The predictor.
    pub predictor: PredictorKind,
}

impl Default for ForesightSettings {
    fn default() -> ForesightSettings {
        ForesightSettings {
            alpha: 0.7,
            alpha_rule: AlphaRule::Adapted,
            horizon_s: 4.0,
            reuse_s: 0.25,
            hysteresis: 0.1,
            attenuation: 0.0,
            request_cost_s: 0.0,
            samples: 4,
            cut: CutSettings { opening: 0.3, near: 0.1, centre_falloff: 0.0 },
            choice: ChoiceMethod::Certified,
            tolerance: 1e-3,
            evaluations: 800,
            grouping: 0.1,
            reach: Reach::default(),
            neighbourhood: NeighbourhoodKind::Free,
            worst_case: WorstCaseKind::Union,
            worst_samples: 16,
            discards: Discards::Planned,
            gains_from_arrival: true,
            cover_first: true,
            slack_s: 0.05,
            predictor: PredictorKind::Mixture,
        }
    }
}

impl ForesightSettings {
    /// Refuses what no decision could be made with, naming the field.
    pub fn check(&self) -> Result<(), SettingError> {
        const SPAN: (f64, f64) = (1e-9, 1e9);
        const COUNT: (f64, f64) = (1.0, 4096.0);
        const NOT_NEGATIVE: (f64, f64) = (0.0, 1e12);
        within("alpha", self.alpha, (0.0, 1.0), "a number from 0 to 1")?;
        within("horizon_s", self.horizon_s, SPAN, "seconds from 1e-9 to 1e9")?;
        within("reuse_s", self.reuse_s, SPAN, "seconds from 1e-9 to 1e9")?;
        within("hysteresis", self.hysteresis, NOT_NEGATIVE, "a number from 0 to 1e12")?;
        within("attenuation", self.attenuation, NOT_NEGATIVE, "a rate per second from 0 to 1e12")?;
        within("request_cost_s", self.request_cost_s, NOT_NEGATIVE, "seconds from 0 to 1e12")?;
        within("samples", self.samples as f64, COUNT, "a count from 1 to 4096")?;
        within("tolerance", self.tolerance, NOT_NEGATIVE, "a number from 0 to 1e12")?;
        within("slack_s", self.slack_s, NOT_NEGATIVE, "seconds from 0 to 1e12")?;
        within("grouping", self.grouping, NOT_NEGATIVE, "a number from 0 to 1e12")?;
        within("worst_samples", self.worst_samples as f64, COUNT, "a count from 1 to 4096")?;
        if let AlphaRule::Solved { at_least } = self.alpha_rule {
            within("alpha_rule.at_least", at_least, (0.0, 1.0), "a quality from 0 to 1")?;
        }
        if let NeighbourhoodKind::Walk { step, pitch_max } = self.neighbourhood {
            within("neighbourhood.step", step, (0.0, 1e15), "metres from 0 to 1e15")?;
            within("neighbourhood.pitch_max", pitch_max, (0.0, core::f64::consts::FRAC_PI_2), "radians from 0 to π/2")?;
        }
        self.cut.check()?;
        const SPEED: (f64, f64) = (0.0, f64::MAX);
        let reach = &self.reach;
        within("reach.linear_max", reach.linear_max, SPEED, "a finite speed, m/s, not negative")?;
        within("reach.angular_max", reach.angular_max, SPEED, "a finite rate, rad/s, not negative")?;
        within("reach.stand_off", reach.stand_off, (0.0, 1e15), "metres from 0 to 1e15")?;
        within("reach.up.length", reach.up.length(), (1.0 - 1e-6, 1.0 + 1e-6), "1 within 1e-6")?;
        if let Some(rate) = reach.clearance_rate {
            within("reach.clearance_rate", rate, (0.0, 1e9), "a rate per second from 0 to 1e9")?;
        }
        if let Some(speeds) = reach.declared {
            within("reach.declared.linear", speeds.linear, SPEED, "a finite speed, m/s, not negative")?;
            within("reach.declared.angular", speeds.angular, SPEED, "a finite rate, rad/s, not negative")?;
        }
        Ok(())
    }
}
