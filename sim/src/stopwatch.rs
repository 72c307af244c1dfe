//! The only place that reads a clock: how long decisions take on this machine, and when a run was made.

use crate::outcome::DecisionNanos;

/// Measures a span of real time.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch(std::time::Instant);

impl Stopwatch {
    /// Starts now.
    #[expect(clippy::disallowed_methods, reason = "the stopwatch itself; nothing that it shows reaches a decision")]
    pub fn start() -> Stopwatch {
        Stopwatch(std::time::Instant::now())
    }

    /// Nanoseconds since the start.
    pub fn nanos(self) -> u64 {
        u64::try_from(self.0.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }
}

/// Milliseconds since 1970-01-01 UTC.
#[expect(clippy::disallowed_methods, reason = "when a run was made; nothing of it reaches a decision")]
pub fn unix_ms() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.ok().and_then(|since| i64::try_from(since.as_millis()).ok()).unwrap_or(0)
}

/// Median, 99th percentile and maximum, by nearest rank; zeros of nothing.
pub fn percentiles(nanos: &mut [u64]) -> DecisionNanos {
    nanos.sort_unstable();
    let rank =
        |percent: usize| nanos.get((nanos.len() * percent).div_ceil(100).saturating_sub(1)).copied().unwrap_or(0);
    DecisionNanos { p50: rank(50), p99: rank(99), max: nanos.last().copied().unwrap_or(0) }
}
