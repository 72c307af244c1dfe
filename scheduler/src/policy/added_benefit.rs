//! `added-benefit`: \[ZK\] eq. 2, the policy of Teler & Lischinski (2001).
//!
//! Greedy by ∫ b(v_t) ⊖ b_now(v_t) dt per second of transfer along the path predicted by constant velocity. No worst case
//! (α = 1), no discards planned: when memory is full, the least recently used go. Settled: the gain counts from now, as
//! eq. 2 prints it, not from the arrival; and used is what is best in the nearest sampled view, at every sampling.

use super::foresight::{AlphaRule, Discards, Foresight, ForesightSettings};
use crate::predict::PredictorKind;

/// The settings that make the common machinery this policy.
pub fn settings(base: ForesightSettings) -> ForesightSettings {
    ForesightSettings {
        alpha: 1.0,
        alpha_rule: AlphaRule::Fixed,
        discards: Discards::LeastRecentlyUsed,
        gains_from_arrival: false,
        cover_first: false,
        predictor: PredictorKind::ConstantVelocity,
        ..base
    }
}

/// The policy.
pub fn added_benefit(base: ForesightSettings) -> Foresight {
    Foresight::new("added-benefit", settings(base))
}
