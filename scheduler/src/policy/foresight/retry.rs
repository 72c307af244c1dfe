//! When what failed may be asked for again.

use crate::lod_tree::RepId;
use crate::units::Time;
use std::collections::BTreeMap;

/// After the first failure, and at most. Each further failure doubles the time.
const WAIT_SECONDS: (f64, f64) = (0.5, 16.0);

/// What has failed since it last came.
#[derive(Clone, Debug, Default)]
pub(super) struct Retries {
    failed: BTreeMap<RepId, Failed>,
}

#[derive(Clone, Copy, Debug)]
struct Failed {
    /// What the next failure makes it wait, seconds.
    next_wait_s: f64,
    until: Time,
}

impl Retries {
    /// `rep` failed at `now`.
    pub(super) fn failed(&mut self, rep: RepId, now: Time) {
        let wait_s = self.failed.get(&rep).map_or(WAIT_SECONDS.0, |f| f.next_wait_s);
        let next_wait_s = (2.0 * wait_s).min(WAIT_SECONDS.1);
        self.failed.insert(rep, Failed { next_wait_s, until: now + Time::from_secs(wait_s) });
    }

    /// `rep` came.
    pub(super) fn completed(&mut self, rep: RepId) {
        self.failed.remove(&rep);
    }

    /// Whether `rep` may be asked for at `now`.
    pub(super) fn allow(&self, rep: RepId, now: Time) -> bool {
        self.failed.get(&rep).is_none_or(|f| f.until <= now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_a_limit_and_begin_anew() {
        let (mut retries, rep) = (Retries::default(), RepId(3));
        let mut now = Time::ZERO;
        for wait in [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 16.0] {
            retries.failed(rep, now);
            assert!(!retries.allow(rep, now + Time::from_secs(wait - 1e-3)) && retries.allow(RepId(2), now));
            now += Time::from_secs(wait);
            assert!(retries.allow(rep, now));
        }
        retries.completed(rep);
        retries.failed(rep, now);
        assert!(retries.allow(rep, now + Time::from_secs(0.5)));
    }
}
