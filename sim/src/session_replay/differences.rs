//! In what a live session differs from its simulation.

use crate::replay::Run;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use serde::Serialize;
use std::collections::BTreeMap;

/// How much later something happened live than simulated, over what happened in both: the k-th time of each
/// representation there with the k-th here.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Shift {
    /// How often it happened in both.
    pub matched: u64,
    /// Live only.
    pub live_only: u64,
    /// Simulated only.
    pub simulated_only: u64,
    /// Median of how much later it happened live, ms; negative if earlier.
    pub median_ms: Option<f64>,
    /// Median of its amount, ms.
    pub median_amount_ms: Option<f64>,
    /// 99th percentile of its amount, ms, by nearest rank.
    pub p99_amount_ms: Option<f64>,
}

/// In what a live session differs from its simulation.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Differences {
    /// First request after the first view, live, ms.
    pub first_request_live_ms: Option<f64>,
    /// The same, simulated.
    pub first_request_simulated_ms: Option<f64>,
    /// Of requests.
    pub requests: Shift,
    /// Of completions.
    pub completions: Shift,
}

impl Differences {
    /// Live against simulated.
    pub fn between(live: &Run, simulated: &Run) -> Differences {
        let requests = |run: &Run| run.requests.iter().map(|r| (r.rep, r.at)).collect::<Vec<_>>();
        let completions = |run: &Run| run.completions.iter().map(|c| (c.rep, c.at)).collect::<Vec<_>>();
        let first = |run: &Run| run.requests.first().map(|request| request.at.secs() * 1e3);
        Differences {
            first_request_live_ms: first(live),
            first_request_simulated_ms: first(simulated),
            requests: Shift::between(&requests(live), &requests(simulated)),
            completions: Shift::between(&completions(live), &completions(simulated)),
        }
    }
}

impl Shift {
    fn between(live: &[(RepId, Time)], simulated: &[(RepId, Time)]) -> Shift {
        let by_rep = |events: &[(RepId, Time)]| {
            let mut times = BTreeMap::<RepId, Vec<Time>>::new();
            events.iter().for_each(|&(rep, at)| times.entry(rep).or_default().push(at));
            times
        };
        let (there, here) = (by_rep(simulated), by_rep(live));
        let pairs = here.iter().flat_map(|(rep, live)| {
            let simulated = there.get(rep).map_or(&[][..], |times| times);
            live.iter().zip(simulated)
        });
        let mut shifts: Vec<f64> = pairs.map(|(live, simulated)| (live.secs() - simulated.secs()) * 1e3).collect();
        shifts.sort_by(f64::total_cmp);
        let mut amounts: Vec<f64> = shifts.iter().map(|shift| shift.abs()).collect();
        amounts.sort_by(f64::total_cmp);
        Shift {
            matched: shifts.len() as u64,
            live_only: (live.len() - shifts.len()) as u64,
            simulated_only: (simulated.len() - shifts.len()) as u64,
            median_ms: rank(&shifts, 50),
            median_amount_ms: rank(&amounts, 50),
            p99_amount_ms: rank(&amounts, 99),
        }
    }
}

/// By nearest rank.
fn rank(sorted: &[f64], percent: usize) -> Option<f64> {
    sorted.get((sorted.len() * percent).div_ceil(100).saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shifts_are_of_the_same_time_that_each_happened() {
        let ms = |ms: u64| Time(ms * 1_000_000);
        let (a, b, c) = (RepId(1), RepId(2), RepId(3));
        let simulated = [(a, ms(10)), (b, ms(20)), (a, ms(50))];
        let live = [(a, ms(14)), (b, ms(18)), (c, ms(30)), (a, ms(56))];
        let shift = Shift::between(&live, &simulated);
        assert_eq!((shift.matched, shift.live_only, shift.simulated_only), (3, 1, 0));
        let near = |value: Option<f64>, expected: f64| value.is_some_and(|value| (value - expected).abs() < 1e-9);
        assert!(near(shift.median_ms, 4.0) && near(shift.median_amount_ms, 4.0) && near(shift.p99_amount_ms, 6.0));
    }
}
