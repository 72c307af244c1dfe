//! What is believed of a link, and how an observation changes it.

/// Milliseconds in which what was observed comes to count half: a link is like yesterday's, less like last week's.
const HALF_LIFE_MS: f64 = 86_400_000.0;

/// Seconds of observation that count at most, so that a changed link shows within an hour.
const WEIGHT_MAX_S: f64 = 3600.0;

/// What is believed of a client's link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkEstimate {
    /// Bytes per busy second, positive.
    pub rate: f64,
    /// Seconds, not negative.
    pub latency_s: f64,
    /// Seconds of observation behind it, as they counted at `updated_ms`; they halve each day.
    pub weight_s: f64,
    /// When it changed, milliseconds since 1970-01-01 UTC.
    pub updated_ms: i64,
}

/// What a session has found of its client's link since the last observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Observation {
    /// What the client calls itself.
    pub client: String,
    /// Bytes per busy second, positive.
    pub rate: f64,
    /// Seconds, not negative.
    pub latency_s: f64,
    /// How long it was observed, seconds.
    pub seconds: f64,
    /// When, milliseconds since 1970-01-01 UTC.
    pub at_ms: i64,
}

impl Observation {
    /// Whether its values can be stored; others are left out.
    pub(super) fn is_sound(&self) -> bool {
        let finite = self.rate.is_finite() && self.latency_s.is_finite() && self.seconds.is_finite();
        finite && self.rate > 0.0 && self.latency_s >= 0.0 && self.seconds > 0.0 && !self.client.contains('\0')
    }

    /// The estimate after it: means weighted by seconds of observation, of the logarithm for the rate; what was known
    /// before counts 2^(−age / day).
    pub(super) fn onto(&self, known: Option<LinkEstimate>) -> LinkEstimate {
        let seconds = self.seconds.min(WEIGHT_MAX_S);
        let fresh =
            LinkEstimate { rate: self.rate, latency_s: self.latency_s, weight_s: seconds, updated_ms: self.at_ms };
        let sound = |e: &LinkEstimate| {
            e.rate.is_finite() && e.rate > 0.0 && e.latency_s.is_finite() && e.latency_s >= 0.0 && e.weight_s > 0.0
        };
        let Some(known) = known.filter(sound) else { return fresh };
        let age_ms = self.at_ms.saturating_sub(known.updated_ms).max(0) as f64;
        let before = known.weight_s.min(WEIGHT_MAX_S - seconds) * libm::exp2(-age_ms / HALF_LIFE_MS);
        let weight_s = before + seconds;
        let share = seconds / weight_s;
        LinkEstimate {
            rate: libm::exp(libm::log(known.rate) + share * (libm::log(self.rate) - libm::log(known.rate))),
            latency_s: known.latency_s + share * (self.latency_s - known.latency_s),
            weight_s,
            updated_ms: self.at_ms.max(known.updated_ms),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observed(rate: f64, latency_s: f64, seconds: f64, at_ms: i64) -> Observation {
        Observation { client: "c".to_owned(), rate, latency_s, seconds, at_ms }
    }

    #[test]
    fn equal_times_give_the_means() {
        let first = observed(1e5, 0.1, 30.0, 0).onto(None);
        assert_eq!(first, LinkEstimate { rate: 1e5, latency_s: 0.1, weight_s: 30.0, updated_ms: 0 });
        let both = observed(4e5, 0.3, 30.0, 0).onto(Some(first));
        assert!((both.rate - 2e5).abs() < 1e-6 && (both.latency_s - 0.2).abs() < 1e-12, "{both:?}");
        assert_eq!(both.weight_s, 60.0);
    }

    #[test]
    fn a_day_halves_and_an_hour_is_the_most() {
        let day = observed(1e5, 0.1, 30.0, 86_400_000).onto(Some(observed(1e5, 0.1, 60.0, 0).onto(None)));
        assert!((day.weight_s - 60.0).abs() < 1e-9, "{day:?}");
        let long = observed(1e5, 0.1, 1e9, 0).onto(None);
        assert_eq!(long.weight_s, 3600.0);
        let more = observed(1e6, 0.1, 3600.0, 0).onto(Some(long));
        assert!((more.rate - 1e6).abs() < 1e-3, "a whole hour replaces what was known: {more:?}");
    }
}
