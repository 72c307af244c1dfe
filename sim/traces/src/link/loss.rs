//! Transfers that break off: each request fails with the same probability, at a point of its transfer that a seed names.

use crate::random::SplitMix64;

/// How requests fail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Loss {
    /// Of a request, 0 to 1.
    pub(super) probability: f64,
    pub(super) seed: u64,
}

impl Loss {
    pub(super) const NONE: Loss = Loss { probability: 0.0, seed: 1 };

    /// Bytes after which the transfer breaks off, less than `bytes` unless that is 0; `None` if it does not.
    ///
    /// It depends on the seed, on where in the link the replay starts, on what is asked for and how often that was asked
    /// for before, and on nothing that a policy does otherwise: policies meet the same fates.
    pub(super) fn breaks_after(self, start: u64, subject: u64, attempt: u64, bytes: u64) -> Option<u64> {
        if self.probability <= 0.0 {
            return None;
        }
        let mut key = self.seed;
        for part in [start, subject, attempt] {
            key = SplitMix64::new(key ^ part).bits();
        }
        let mut random = SplitMix64::new(key);
        let fails = random.uniform() < self.probability;
        let share = random.uniform();
        fails.then_some((share * bytes as f64) as u64)
    }
}
