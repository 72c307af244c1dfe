//! The link that a replay uses when it is given none.

use foresight_scheduler::units::Time;

use super::{LinkTrace, RatePiece};
use crate::random::SplitMix64;

const SECONDS: usize = 120;
const MEAN_MBIT: f64 = 1.5;
/// Where the walk begins, Mbit/s.
const WALK_START: f64 = 6.0;
/// Bounds of the walk before it is brought to its mean, Mbit/s.
const WALK_MIN: f64 = 1.5;
const WALK_MAX: f64 = 18.0;
/// Standard deviation of a step of the walk, in the logarithm of the rate.
const STEP: f64 = 0.3;
/// First second, length and share of the rate that remains, of each dip.
const DIPS: [(usize, usize, f64); 3] = [(34, 4, 0.03), (71, 6, 0.02), (103, 3, 0.03)];

/// A generated LTE-like link: the logarithm of the rate walks at random in steps of 1 s, reflected at its bounds, with
/// three deep dips; 120 s, mean 1.5 Mbit/s, round trip 60 ms. The same on every machine.
pub fn built_in() -> LinkTrace {
    let (low, high) = (libm::log(WALK_MIN), libm::log(WALK_MAX));
    let mut random = SplitMix64::new(0x05ee_d0f1);
    let mut log_rate = libm::log(WALK_START);
    let mut rates = [0.0; SECONDS];
    for (second, rate) in rates.iter_mut().enumerate() {
        // The sum of twelve uniform numbers less 6 has mean 0 and variance 1.
        let normal = (0..12).map(|_| random.uniform()).sum::<f64>() - 6.0;
        log_rate += STEP * normal;
        // One step is less than the distance between the bounds, so one reflection at each suffices.
        if log_rate > high {
            log_rate = 2.0 * high - log_rate;
        }
        if log_rate < low {
            log_rate = 2.0 * low - log_rate;
        }
        let dip = DIPS.iter().find(|(first, length, _)| (*first..first + length).contains(&second));
        *rate = libm::exp(log_rate) * dip.map_or(1.0, |(_, _, remains)| *remains);
    }
    let factor = MEAN_MBIT * 1e6 * SECONDS as f64 / rates.iter().sum::<f64>();
    let pieces = rates
        .iter()
        .enumerate()
        .map(|(second, rate)| RatePiece {
            from: Time(second as u64 * 1_000_000_000),
            bits_per_second: libm::round(rate * factor) as u64,
        })
        .collect();
    let period = Time(SECONDS as u64 * 1_000_000_000);
    LinkTrace::from_rates("built-in LTE-like link", pieces, period, Time(60_000_000))
        .expect("the pieces increase, their rates are positive and far below the limit")
}
