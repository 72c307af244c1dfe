//! How much a connection may send.

use std::time::{Duration, Instant};

/// Seconds of the rate that may come at once.
const BURST_S: f64 = 2.0;

/// A token bucket.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rate {
    per_second: f64,
    most: f64,
    left: f64,
    at: Instant,
}

impl Rate {
    /// Full; `least` is what must fit in it at once.
    pub(super) fn new(per_second: u64, least: u64, now: Instant) -> Rate {
        let most = (per_second as f64 * BURST_S).max(least as f64);
        Rate { per_second: per_second as f64, most, left: most, at: now }
    }

    /// Takes so much out; false, and nothing taken, if there is not enough.
    pub(super) fn take(&mut self, amount: u64, now: Instant) -> bool {
        let passed = now.saturating_duration_since(self.at);
        self.at = self.at.max(now);
        self.left = (self.left + passed.as_secs_f64() * self.per_second).min(self.most);
        let amount = amount as f64;
        let enough = self.left >= amount;
        if enough {
            self.left -= amount;
        }
        enough
    }

    /// How long until so much could be taken.
    pub(super) fn wait(&self, amount: u64) -> Duration {
        Duration::from_secs_f64(((amount as f64 - self.left) / self.per_second).clamp(0.0, 3600.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_then_the_rate() {
        let start = crate::clock::now();
        let mut rate = Rate::new(10, 1, start);
        assert!((0..20).all(|_| rate.take(1, start)));
        assert!(!rate.take(1, start));
        assert_eq!(rate.wait(1), Duration::from_millis(100));
        assert!(rate.take(1, start + Duration::from_millis(101)));
        assert!(!rate.take(1, start + Duration::from_millis(102)));
        assert!(!rate.take(21, start + Duration::from_secs(60)));
    }
}
