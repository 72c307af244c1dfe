//! What a session allows its client: every list that a client can grow has its bound here.

use crate::message::LinkGuess;
use foresight_scheduler::policy::foresight::ForesightSettings;
use foresight_scheduler::policy::specification::{PolicySpec, Trust};
use serde::{Deserialize, Serialize};

/// What a session allows its client, and what it assumes where the client says nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SessionLimits {
    /// Memory that a client may have, bytes.
    pub memory_bytes_max: u64,
    /// Messages in a frame.
    pub messages_max: usize,
    /// Cameras in a view.
    pub cameras_max: usize,
    /// Views in an announced path.
    pub path_views_max: usize,
    /// Residents named by a `hello`.
    pub residents_max: usize,
    /// Bytes of a name or a policy's specification.
    pub text_bytes_max: usize,
    /// Actions taken in answer to one frame; what is left is done in answer to the next.
    pub actions_max: usize,
    /// Errors reported in answer to one frame; the last says how many more there were.
    pub errors_max: usize,
    /// Nodes that a decision may look at (`evaluations`).
    pub evaluations_max: u64,
    /// Intervals of the time ahead (`samples`).
    pub samples_max: usize,
    /// Least opening angle of a cut (`opening`).
    pub opening_min: f64,
    /// Least span between two looks ahead, seconds (`reuse`).
    pub reuse_s_min: f64,
    /// Policy of a client that names none.
    pub policy: String,
    /// Link of a client of which nothing is known.
    pub link: LinkGuess,
}

impl Default for SessionLimits {
    fn default() -> SessionLimits {
        SessionLimits {
            memory_bytes_max: 64 << 30,
            messages_max: 4096,
            cameras_max: 8,
            path_views_max: 4096,
            residents_max: 65_536,
            text_bytes_max: 1024,
            actions_max: 1024,
            errors_max: 16,
            evaluations_max: 8000,
            samples_max: 16,
            opening_min: 0.1,
            reuse_s_min: 0.05,
            policy: "foresight".to_owned(),
            link: LinkGuess { rate: 625_000.0, latency_s: 0.06 },
        }
    }
}

impl SessionLimits {
    /// The policy of this specification, if a client may have it.
    ///
    /// # Errors
    /// What is wrong with it, and what was expected.
    pub fn policy(&self, specification: &str) -> Result<PolicySpec, String> {
        if specification.len() > self.text_bytes_max {
            return Err(format!(
                "the policy's specification has {} bytes; expected at most {}",
                specification.len(),
                self.text_bytes_max
            ));
        }
        let mut specs =
            PolicySpec::parse_list(specification, Trust::adapted(), None).map_err(|error| error.to_string())?;
        let (Some(spec), true) = (specs.pop(), specs.is_empty()) else {
            return Err(format!("`{specification}` names several policies; expected one"));
        };
        if spec.knows_the_future() || spec.name() == "clairvoyant" {
            return Err(format!("policy {specification} knows the future; expected one that a client could run"));
        }
        let ForesightSettings { evaluations, samples, cut, reuse_s, .. } = spec.settings;
        let too_much = |key: &str, value: &dyn core::fmt::Display, expected: &str, bound: &dyn core::fmt::Display| {
            Err(format!("policy {specification}: {key}={value}; expected at {expected} {bound} on this server"))
        };
        if evaluations > self.evaluations_max {
            return too_much("evaluations", &evaluations, "most", &self.evaluations_max);
        }
        if samples > self.samples_max {
            return too_much("samples", &samples, "most", &self.samples_max);
        }
        if cut.opening < self.opening_min {
            return too_much("opening", &cut.opening, "least", &self.opening_min);
        }
        if reuse_s < self.reuse_s_min {
            return too_much("reuse", &reuse_s, "least", &self.reuse_s_min);
        }
        Ok(spec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_gets_one_policy_that_it_could_run() {
        let limits = SessionLimits::default();
        for good in ["foresight", "foresight:alpha=0.2:evaluations=8000", "added-benefit", "potree", "cesium:target=8"]
        {
            assert_eq!(limits.policy(good).map(|spec| spec.label), Ok(good.to_owned()));
        }
        for (bad, why) in [
            ("", "unknown policy"),
            ("all", "several"),
            ("foresight,potree", "several"),
            ("clairvoyant", "knows the future"),
            ("foresight:predictor=true-path", "knows the future"),
            ("foresight:evaluations=1000000", "expected at most 8000"),
            ("foresight:samples=200", "expected at most 16"),
            ("foresight:opening=0", "expected at least 0.1"),
            ("foresight:reuse=0.001", "expected at least 0.05"),
        ] {
            let error = limits.policy(bad).expect_err(bad);
            assert!(error.contains(why), "{bad}: {error}");
        }
        assert!(limits.policy(&"x".repeat(2000)).is_err_and(|e| e.contains("2000 bytes")));
    }
}
