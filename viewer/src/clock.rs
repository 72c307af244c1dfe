//! The only place of the client that reads a clock.

use std::time::Duration;

/// Real time since the program began, shared by everything in it.
#[derive(Clone, Copy, Debug)]
pub struct Clock(tokio::time::Instant);

impl Clock {
    /// Time zero is now.
    #[expect(clippy::disallowed_methods, reason = "a client that plays in real time has to read a clock, here alone")]
    pub fn start() -> Clock {
        Clock(tokio::time::Instant::from_std(std::time::Instant::now()))
    }

    /// Nanoseconds since time zero.
    pub fn now_ns(self) -> u64 {
        u64::try_from(self.0.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    /// The instant `at_ns` after time zero, for window systems.
    pub fn instant(self, at_ns: u64) -> std::time::Instant {
        (self.0 + Duration::from_nanos(at_ns)).into_std()
    }

    /// Returns at `at_ns` or up to a millisecond later, which is the timer's resolution; at once if that has passed.
    pub async fn sleep_until(self, at_ns: u64) {
        tokio::time::sleep_until(self.0 + Duration::from_nanos(at_ns)).await;
    }
}
