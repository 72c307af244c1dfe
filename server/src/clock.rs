//! The only place of this crate that reads a clock.

use std::time::{Duration, Instant, SystemTime};

/// The monotonic clock.
#[expect(clippy::disallowed_methods, reason = "a server lives in real time; what decides takes time as an argument")]
pub fn now() -> Instant {
    Instant::now()
}

/// The wall clock, as time since 1970-01-01 UTC; zero before.
#[expect(
    clippy::disallowed_methods,
    reason = "for dates that people and files carry; nothing of it reaches a decision"
)]
pub fn unix() -> Duration {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default()
}

/// Nanoseconds from `origin` to `at`; 0 if `at` is not later.
pub fn nanos(origin: Instant, at: Instant) -> u64 {
    u64::try_from(at.saturating_duration_since(origin).as_nanos()).unwrap_or(u64::MAX)
}
