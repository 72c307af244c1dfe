//! What the link costs, estimated from transfers: c seconds per byte, τ seconds of latency (\[ZK\] §5, d = cM + τ).
//!
//! c is bytes per *busy* link-second: time during which at least one request was receiving. Durations of single
//! requests say nothing where requests overlap.

use crate::setting::{SettingError, within};
use crate::units::Time;

/// Busy seconds after which an observation counts half.
const HALF_LIFE_BUSY_S: f64 = 3.0;
/// Latencies remembered; their median is the estimate, so that a few stragglers do not move it.
const LATENCIES: usize = 15;

/// Estimates of c and τ.
#[derive(Clone, Debug)]
pub struct TransferEstimate {
    /// Decayed bytes and busy seconds; a prior of a few tenths of a second's worth is in them from the start.
    bytes: f64,
    busy_s: f64,
    receiving: u32,
    /// Until when busy time has been counted.
    counted_to: Time,
    /// Bytes received so far, as last told.
    received: u64,
    latencies: Vec<f64>,
    next_latency: usize,
    prior_latency_s: f64,
}

/// Refuses a first guess that is no rate (bytes/s) or no latency (s), naming the field.
pub fn check_guesses(rate: f64, latency_s: f64) -> Result<(), SettingError> {
    within("rate_guess", rate, (f64::MIN_POSITIVE, 1e18), "bytes/s, more than 0 and at most 1e18")?;
    within("latency_guess_s", latency_s, (0.0, 1e9), "seconds from 0 to 1e9")
}

impl TransferEstimate {
    /// As [`TransferEstimate::new`]; refuses guesses that are not finite or have the wrong sign.
    pub fn checked(rate: f64, latency_s: f64) -> Result<TransferEstimate, SettingError> {
        check_guesses(rate, latency_s)?;
        Ok(TransferEstimate::new(rate, latency_s))
    }

    /// Starts from a guess of `rate` bytes/s and `latency_s`, which weighs like 0.25 s of observation.
    pub fn new(rate: f64, latency_s: f64) -> TransferEstimate {
        let busy_s = 0.25;
        TransferEstimate {
            bytes: rate * busy_s,
            busy_s,
            receiving: 0,
            counted_to: Time::ZERO,
            received: 0,
            latencies: Vec::with_capacity(LATENCIES),
            next_latency: 0,
            prior_latency_s: latency_s,
        }
    }

    /// A request made at `requested` got its first byte at `now`.
    pub fn responded(&mut self, requested: Time, now: Time) {
        self.pass(now);
        self.receiving += 1;
        let latency = now.since(requested).secs();
        if self.latencies.len() < LATENCIES {
            self.latencies.push(latency);
        } else {
            self.latencies[self.next_latency] = latency;
        }
        self.next_latency = (self.next_latency + 1) % LATENCIES;
    }

    /// A request that had responded ended at `now`, whole or not.
    pub fn ended(&mut self, now: Time) {
        self.pass(now);
        self.receiving = self.receiving.saturating_sub(1);
    }

    /// `total` bytes have been received since the start of the session, over all requests.
    pub fn received(&mut self, total: u64, now: Time) {
        self.pass(now);
        self.bytes += total.saturating_sub(self.received) as f64;
        self.received = self.received.max(total);
    }

    fn pass(&mut self, now: Time) {
        if self.receiving > 0 {
            let passed = now.since(self.counted_to).secs();
            let kept = libm::exp2(-passed / HALF_LIFE_BUSY_S);
            self.bytes *= kept;
            self.busy_s = self.busy_s * kept + passed;
        }
        self.counted_to = self.counted_to.max(now);
    }

    /// Bytes that the remembered latencies occupy.
    pub fn heap_bytes(&self) -> usize {
        self.latencies.capacity() * size_of::<f64>()
    }

    /// 1/c, bytes per second of busy link; at least 1.
    pub fn rate(&self) -> f64 {
        (self.bytes / self.busy_s.max(1e-9)).max(1.0)
    }

    /// τ, seconds: the median of the last latencies.
    pub fn latency_s(&self) -> f64 {
        if self.latencies.is_empty() {
            return self.prior_latency_s;
        }
        let mut sorted = self.latencies.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlapping_requests_do_not_halve_the_rate() {
        let mut estimate = TransferEstimate::new(1e6, 0.5);
        let at = Time::from_secs;
        // Two requests share 100 kB/s for 20 s: each alone would look like 50 kB/s.
        estimate.responded(at(0.0), at(0.1));
        estimate.responded(at(0.0), at(0.1));
        for tick in 1..=200u64 {
            estimate.received(10_000 * tick, at(0.1 + 0.1 * tick as f64));
        }
        assert!((estimate.rate() / 100_000.0 - 1.0).abs() < 0.05, "{}", estimate.rate());
        assert!((estimate.latency_s() - 0.1).abs() < 1e-6);
        // An idle hour changes nothing.
        estimate.ended(at(20.1));
        estimate.ended(at(20.1));
        let before = estimate.rate();
        estimate.received(2_000_000, at(3600.0));
        assert_eq!(estimate.rate(), before);
    }

    #[test]
    fn an_outage_lowers_the_estimate_but_not_to_zero() {
        let mut estimate = TransferEstimate::new(1e6, 0.05);
        estimate.responded(Time::ZERO, Time::ZERO);
        estimate.received(0, Time::from_secs(3600.0));
        assert!(estimate.rate() >= 1.0);
    }
}
