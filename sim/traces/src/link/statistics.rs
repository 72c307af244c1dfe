//! Figures of a link over one period.

use foresight_scheduler::units::Time;

use super::LinkTrace;

/// Windows are seconds, or longer where a period has more than this many.
const WINDOWS_MAX: u64 = 1_000_000;

/// A second that delivers less than this share of the mean is near zero.
const NEAR_ZERO: f64 = 0.05;

/// Figures of a link over one period, from where its time zero lies.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkStatistics {
    /// 5th, 25th, 50th, 75th and 95th percentile of the rate in a second, bytes/s; the least value that at least this
    /// share of the seconds does not exceed.
    pub percentiles: [f64; 5],
    /// Share of the seconds that deliver less than 5 % of the mean rate.
    pub near_zero_share: f64,
    /// Longest stretch of such seconds, the repetition included.
    pub longest_near_zero: Time,
    /// Longest time in which no byte comes, the repetition included.
    pub longest_outage: Time,
}

impl LinkStatistics {
    /// Works them out. A last part of a second counts as its rate says.
    pub fn new(link: &LinkTrace) -> LinkStatistics {
        let period = link.period().0;
        let window = 1_000_000_000.max(period.div_ceil(WINDOWS_MAX));
        let windows = (0..period.div_ceil(window)).map(|i| (Time(i * window), Time(((i + 1) * window).min(period))));
        let by_time: Vec<(Time, f64)> = windows
            .map(|(from, to)| (to.since(from), link.bytes_deliverable(from, to) as f64 / to.since(from).secs()))
            .collect();
        let limit = NEAR_ZERO * link.mean_rate();
        let (mut longest, mut current) = (Time::ZERO, Time::ZERO);
        // Twice around, so that what ends the period goes on at its start.
        for &(lasts, rate) in by_time.iter().chain(&by_time) {
            current = if rate < limit { current + lasts } else { Time::ZERO };
            longest = longest.max(current);
        }
        let mut rates: Vec<f64> = by_time.iter().map(|&(_, rate)| rate).collect();
        rates.sort_by(f64::total_cmp);
        let near_zero = rates.partition_point(|&rate| rate < limit);
        let percentile = |percent: usize| rates[(rates.len() * percent).div_ceil(100).max(1) - 1];
        LinkStatistics {
            percentiles: [5, 25, 50, 75, 95].map(percentile),
            near_zero_share: near_zero as f64 / rates.len() as f64,
            longest_near_zero: longest.min(link.period()),
            longest_outage: link.longest_outage(),
        }
    }
}
