//! The policies by name, with their options, as commands and configurations name them: `name[:key=value…]`.

use super::foresight::{AT_LEAST, AlphaRule, ChoiceMethod, Discards, Foresight, ForesightSettings};
use super::{Policy, RIVALS, Rival, RivalSettings, added_benefit};
use crate::lod_tree::LodTree;
use crate::predict::PredictorKind;
use crate::setting::SettingError;
use crate::worst_case::WorstCaseKind;
use crate::worst_case::neighbourhood::NeighbourhoodKind;
use std::str::FromStr;

/// Names in the order of the comparison: those that follow the objective around the rivals of [`RIVALS`].
pub fn names() -> impl Iterator<Item = &'static str> + Clone {
    let rivals = RIVALS.iter().map(|rival| rival.name);
    ["foresight", "added-benefit"].into_iter().chain(rivals).chain(["clairvoyant"])
}

/// Policies that `all` leaves out: `foresight` with α adapted, and with α solved for.
pub const VARIANTS: [&str; 2] = ["foresight-adapted", "foresight-solved"];

/// The rival of that name.
pub fn rival(name: &str) -> Option<&'static Rival> {
    RIVALS.iter().find(|rival| rival.name == name)
}

/// Whether a policy of this label knows the true path: no client could run it.
pub fn knows_the_future(label: &str) -> bool {
    label.starts_with("clairvoyant") || label.contains("predictor=true-path")
}

/// α as asked for: a number, or where it comes from and a number to start at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trust {
    /// At the start.
    pub alpha: f64,
    /// From then on.
    pub rule: AlphaRule,
}

impl Trust {
    /// What the command line accepts.
    pub const EXPECTED: &'static str = "a number from 0 to 1, adapted, or solved";

    /// Where α comes from, as the command line says it; `None` for a number.
    pub fn word(&self) -> Option<String> {
        match self.rule {
            AlphaRule::Fixed | AlphaRule::Watched => None,
            AlphaRule::Adapted => Some("adapted".to_owned()),
            AlphaRule::Solved { at_least } => Some(format!("solved:at-least={at_least}")),
        }
    }

    /// The default: adapted, from the default α on.
    pub fn adapted() -> Trust {
        Trust { alpha: ForesightSettings::default().alpha, rule: AlphaRule::Adapted }
    }
}

impl From<f64> for Trust {
    fn from(alpha: f64) -> Trust {
        Trust { alpha, rule: AlphaRule::Fixed }
    }
}

impl FromStr for Trust {
    type Err = String;

    fn from_str(text: &str) -> Result<Trust, String> {
        let alpha = ForesightSettings::default().alpha;
        let least = text.strip_prefix("solved:at-least=").map(|q| q.parse::<f64>().ok());
        match (text, least) {
            ("adapted", _) => Ok(Trust::adapted()),
            ("solved", _) => Ok(Trust { alpha, rule: AlphaRule::Solved { at_least: AT_LEAST } }),
            (_, Some(Some(at_least))) if (0.0..=1.0).contains(&at_least) => {
                Ok(Trust { alpha, rule: AlphaRule::Solved { at_least } })
            }
            _ => {
                let number = text.parse::<f64>().ok().filter(|alpha| (0.0..=1.0).contains(alpha));
                number.map(Trust::from).ok_or_else(|| {
                    format!("`{text}`; expected {}, or solved:at-least= with a quality from 0 to 1", Trust::EXPECTED)
                })
            }
        }
    }
}

/// A policy with its options, as on the command line: `name[:key=value…]`.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicySpec {
    /// As given; names the results.
    pub label: String,
    name: &'static str,
    /// For the policies that follow the objective.
    pub settings: ForesightSettings,
    /// Pixels aimed at, for the rivals.
    pub error_target_px: f64,
    parallel: Option<usize>,
    true_path: bool,
}

/// What is wrong with a policy's specification.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PolicySpecError {
    /// No such policy.
    #[error("unknown policy `{0}`; expected one of {list} or all", list = names().chain(VARIANTS).collect::<Vec<_>>().join(", "))]
    Name(String),
    /// No such option.
    #[error("policy {policy}: unknown option `{option}`; expected {expected}")]
    Option {
        /// The policy.
        policy: &'static str,
        /// As given.
        option: String,
        /// What there is.
        expected: &'static str,
    },
    /// A setting without meaning, although each option was in its range.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A value out of range.
    #[error("policy {policy}: {key}={value}; expected {expected}")]
    Value {
        /// The policy.
        policy: &'static str,
        /// Of the option.
        key: String,
        /// As given.
        value: String,
        /// The range.
        expected: &'static str,
    },
}

const OBJECTIVE_OPTIONS: &str = "alpha, at-least, watch, predictor, discards, arrival, cover, horizon, reuse, hysteresis, attenuation, \
                                 samples, opening, falloff, choice, tolerance, evaluations, grouping, slack, turn-rate, speed, request-cost, \
                                 worst, neighbourhood or clearance";

impl PolicySpec {
    /// Parses a list separated by commas, in which `all` stands for every name. `alpha` is the default of those that have one; `error_target_px`
    /// that of the rivals that have one, instead of what each ships with.
    pub fn parse_list(
        list: &str,
        alpha: impl Into<Trust>,
        error_target_px: Option<f64>,
    ) -> Result<Vec<PolicySpec>, PolicySpecError> {
        let trust = alpha.into();
        let specs = list.split(',').map(str::trim).flat_map(|spec| match spec {
            "all" => names().collect(),
            _ => vec![spec],
        });
        specs.map(|spec| PolicySpec::parse(spec, trust, error_target_px)).collect()
    }

    /// Whether it may be replayed in a world whose representations show one direction only.
    pub fn tells_directions(&self) -> bool {
        rival(self.name).is_none_or(|rival| rival.tells_directions)
    }

    fn parse(spec: &str, trust: Trust, error_target_px: Option<f64>) -> Result<PolicySpec, PolicySpecError> {
        let mut parts = spec.split(':');
        let given = parts.next().unwrap_or_default();
        let name =
            names().chain(VARIANTS).find(|n| *n == given).ok_or_else(|| PolicySpecError::Name(given.to_owned()))?;
        let base = ForesightSettings { alpha: trust.alpha, ..ForesightSettings::default() };
        let settings = match name {
            "added-benefit" => added_benefit::settings(base),
            "clairvoyant" => {
                let (alpha_rule, predictor) = (AlphaRule::Fixed, PredictorKind::KnownPath);
                ForesightSettings { alpha: 1.0, alpha_rule, predictor, ..base }
            }
            "foresight" => ForesightSettings { alpha_rule: trust.rule, ..base },
            "foresight-adapted" => ForesightSettings { alpha_rule: AlphaRule::Adapted, ..base },
            "foresight-solved" => {
                let at_least = if let AlphaRule::Solved { at_least } = trust.rule { at_least } else { AT_LEAST };
                ForesightSettings { alpha_rule: AlphaRule::Solved { at_least }, ..base }
            }
            _ => base,
        };
        let mut policy = PolicySpec {
            label: spec.to_owned(),
            name,
            settings,
            error_target_px: error_target_px.or_else(|| rival(name)?.error_target_px).unwrap_or_default(),
            parallel: None,
            true_path: name == "clairvoyant",
        };
        for option in parts {
            policy.set(option)?;
        }
        policy.settings.check()?;
        Ok(policy)
    }

    fn set(&mut self, option: &str) -> Result<(), PolicySpecError> {
        let policy = self.name;
        let expected = match rival(policy) {
            Some(Rival { error_target_px: Some(_), .. }) => "target or parallel",
            Some(_) => "parallel",
            None => OBJECTIVE_OPTIONS,
        };
        let unknown = || PolicySpecError::Option { policy, option: option.to_owned(), expected };
        let (key, value) = option.split_once('=').ok_or_else(unknown)?;
        let wrong =
            |expected| PolicySpecError::Value { policy, key: key.to_owned(), value: value.to_owned(), expected };
        let number = |low: f64, high: f64, expected| {
            value.parse::<f64>().ok().filter(|v| (low..=high).contains(v)).ok_or_else(|| wrong(expected))
        };
        let switch = |on: &str, off: &str, expected| match value {
            v if v == on => Ok(true),
            v if v == off => Ok(false),
            _ => Err(wrong(expected)),
        };
        if rival(policy).is_some() {
            match key {
                "target" if self.has_target() => self.error_target_px = number(0.01, 1e4, "pixels from 0.01 to 10000")?,
                "parallel" => self.parallel = Some(number(1.0, 1e4, "a count from 1 to 10000")? as usize),
                _ => return Err(unknown()),
            }
            return Ok(());
        }
        let s = &mut self.settings;
        match key {
            "alpha" if value == "adapted" => s.alpha_rule = AlphaRule::Adapted,
            "alpha" if value == "solved" => {
                if !matches!(s.alpha_rule, AlphaRule::Solved { .. }) {
                    s.alpha_rule = AlphaRule::Solved { at_least: AT_LEAST };
                }
            }
            "alpha" => {
                s.alpha = number(0.0, 1.0, Trust::EXPECTED)?;
                // A variant starts there.
                if !VARIANTS.contains(&policy) && s.alpha_rule != AlphaRule::Watched {
                    s.alpha_rule = AlphaRule::Fixed;
                }
            }
            "at-least" => s.alpha_rule = AlphaRule::Solved { at_least: number(0.0, 1.0, "a quality from 0 to 1")? },
            "watch" => match (switch("on", "off", "on or off")?, s.alpha_rule) {
                (true, AlphaRule::Fixed) => s.alpha_rule = AlphaRule::Watched,
                (false, AlphaRule::Watched) => s.alpha_rule = AlphaRule::Fixed,
                _ => {}
            },
            "horizon" => s.horizon_s = number(0.01, 600.0, "seconds from 0.01 to 600")?,
            "reuse" => s.reuse_s = number(0.001, 60.0, "seconds from 0.001 to 60")?,
            "hysteresis" => s.hysteresis = number(0.0, 100.0, "a number from 0 to 100")?,
            "attenuation" => s.attenuation = number(0.0, 100.0, "a rate per second from 0 to 100")?,
            "samples" => s.samples = number(1.0, 256.0, "a count from 1 to 256")? as usize,
            "opening" => s.cut.opening = number(0.0, 2.0, "an angle from 0 to 2")?,
            "falloff" => s.cut.centre_falloff = number(0.0, 100.0, "a number from 0 to 100")?,
            "choice" => {
                s.choice = if switch("certified", "sampled", "certified or sampled")? {
                    ChoiceMethod::Certified
                } else {
                    ChoiceMethod::Sampled
                }
            }
            "tolerance" => s.tolerance = number(0.0, 1.0, "a share from 0 to 1")?,
            "evaluations" => s.evaluations = number(1.0, 1e9, "a count from 1 to 1000000000")? as u64,
            "grouping" => s.grouping = number(0.0, 1.0, "a share from 0 to 1")?,
            "turn-rate" | "speed" => {
                let mut speeds = s.reach.declared.unwrap_or_default();
                let value = number(0.0, 1e6, "a speed in rad/s or m/s from 0 to 1000000")?;
                *(if key == "speed" { &mut speeds.linear } else { &mut speeds.angular }) = value;
                s.reach.declared = Some(speeds);
            }
            "slack" => s.slack_s = number(0.0, 60.0, "seconds from 0 to 60")?,
            "request-cost" => s.request_cost_s = number(0.0, 60.0, "seconds from 0 to 60")?,
            "arrival" => s.gains_from_arrival = switch("on", "off", "on or off")?,
            "cover" => s.cover_first = switch("on", "off", "on or off")?,
            "discards" => {
                s.discards = if switch("planned", "lru", "planned or lru")? {
                    Discards::Planned
                } else {
                    Discards::LeastRecentlyUsed
                }
            }
            "worst" => {
                let known = WorstCaseKind::ALL.into_iter().find(|(name, _)| *name == value);
                s.worst_case = known.ok_or_else(|| wrong("union or minimum"))?.1;
            }
            "neighbourhood" => {
                let known = NeighbourhoodKind::ALL.into_iter().find(|(name, _)| *name == value);
                s.neighbourhood = known.ok_or_else(|| wrong("free, walk, orbit or path"))?.1;
            }
            "clearance" => s.reach.clearance_rate = Some(number(0.0, 1e6, "a rate per second from 0 to 1000000")?),
            "predictor" if value == "true-path" => self.true_path = true,
            "predictor" => {
                let known = PredictorKind::ALL.into_iter().find(|(name, _)| *name == value);
                let expected = "constant-velocity, constant-turn, kalman, mixture, known-path or true-path";
                s.predictor = known.ok_or_else(|| wrong(expected))?.1;
                self.true_path = false;
            }
            _ => return Err(unknown()),
        }
        Ok(())
    }

    /// The same policy aiming at another error.
    pub fn with_target(&self, px: f64) -> PolicySpec {
        PolicySpec { error_target_px: px, label: format!("{}:target={px}", self.label), ..self.clone() }
    }

    /// The reading of the worst case with the neighbourhood, for reports: `union`, `minimum (walk)`; `None` for rivals.
    pub fn worst_case(&self) -> Option<String> {
        let (reading, kind) = (self.settings.worst_case.name(), self.settings.neighbourhood);
        let named =
            if kind == NeighbourhoodKind::Free { reading.to_owned() } else { format!("{reading} ({})", kind.name()) };
        rival(self.name).is_none().then_some(named)
    }

    /// Where α comes from, in a word; `None` where it is fixed, and for the rivals.
    pub fn alpha_rule(&self) -> Option<&'static str> {
        match self.settings.alpha_rule {
            _ if rival(self.name).is_some() => None,
            AlphaRule::Fixed => None,
            AlphaRule::Watched => Some("watched"),
            AlphaRule::Solved { .. } => Some("solved"),
            AlphaRule::Adapted => Some("adapted"),
        }
    }

    /// Whether it aims at an error on the screen.
    pub fn has_target(&self) -> bool {
        rival(self.name).is_some_and(|rival| rival.error_target_px.is_some())
    }

    /// The name without its options.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Whether it is given the true path: no client could run it.
    pub fn knows_the_future(&self) -> bool {
        self.true_path
    }

    /// The policy, for one client. One that knows the future gets what it knows from
    /// [`Foresight::with_predictor`] and [`Foresight::with_oracle`]; made here, it knows what the client announces.
    pub fn build<'a>(&self, tree: &'a LodTree) -> Box<dyn Policy + 'a> {
        match rival(self.name) {
            Some(rival) => {
                let parallel = self.parallel.unwrap_or(rival.parallel);
                (rival.build)(tree, &RivalSettings { error_target_px: self.error_target_px, parallel })
            }
            None => Box::new(Foresight::new(self.label.clone(), self.settings)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(list: &str, trust: impl Into<Trust>) -> (f64, AlphaRule) {
        let spec = PolicySpec::parse_list(list, trust, None).expect("the options exist").remove(0);
        (spec.settings.alpha, spec.settings.alpha_rule)
    }

    #[test]
    fn the_worst_case_is_named_by_reading_and_neighbourhood() {
        for (spec, expected) in [
            ("foresight", Some("union")),
            ("foresight:worst=minimum", Some("minimum")),
            ("foresight:neighbourhood=orbit", Some("union (orbit)")),
            ("foresight:neighbourhood=path:worst=minimum:clearance=0.5", Some("minimum (path)")),
            ("potree", None),
        ] {
            let parsed = PolicySpec::parse_list(spec, 0.5, None).expect("the options exist").remove(0);
            assert_eq!(parsed.worst_case().as_deref(), expected, "{spec}");
        }
        assert!(PolicySpec::parse_list("foresight:worst=mean", 0.5, None).is_err());
        assert!(PolicySpec::parse_list("foresight:neighbourhood=swim", 0.5, None).is_err());
    }

    #[test]
    fn alpha_is_a_number_or_a_rule() {
        let solved = |at_least| AlphaRule::Solved { at_least };
        for (list, expected) in [
            ("foresight", (0.5, AlphaRule::Fixed)),
            ("foresight:alpha=0.2", (0.2, AlphaRule::Fixed)),
            ("foresight:alpha=0.2:watch=on", (0.2, AlphaRule::Watched)),
            ("foresight:alpha=adapted", (0.5, AlphaRule::Adapted)),
            ("foresight:alpha=solved", (0.5, solved(AT_LEAST))),
            ("foresight:alpha=solved:at-least=0.3", (0.5, solved(0.3))),
            ("foresight:at-least=0.3:alpha=solved", (0.5, solved(0.3))),
            ("foresight-adapted:alpha=0.9", (0.9, AlphaRule::Adapted)),
            ("foresight-solved:at-least=0.9", (0.5, solved(0.9))),
        ] {
            assert_eq!(rule(list, 0.5), expected, "{list}");
        }
        for word in ["adapted", "solved:at-least=0.25"] {
            assert_eq!(word.parse::<Trust>().expect("a word").word().as_deref(), Some(word));
        }
        let adapted: Trust = "adapted".parse().expect("a word");
        assert_eq!(rule("foresight", adapted).1, AlphaRule::Adapted);
        assert_eq!(rule("foresight:alpha=0.3", adapted).1, AlphaRule::Fixed);
        assert_eq!(rule("added-benefit", adapted), (1.0, AlphaRule::Fixed));
        let given: Trust = "solved:at-least=0.4".parse().expect("a word with a quality");
        assert_eq!((rule("foresight", given).1, rule("foresight-solved", given).1), (solved(0.4), solved(0.4)));
        for wrong in ["", "1.1", "-0", "NaN", "solve", "solved:at-least=2", "solved:at-least="] {
            let parsed = wrong.parse::<Trust>();
            assert!(parsed.is_err() || wrong == "-0", "{wrong}: {parsed:?}");
        }
        for wrong in
            ["foresight:at-least=2", "foresight:watch=yes", "foresight:alpha=adaptive", "3d-tiles-renderer:alpha=1"]
        {
            assert!(PolicySpec::parse_list(wrong, 0.5, None).is_err(), "{wrong}");
        }
        // What `all` stands for has the variants not.
        let all = PolicySpec::parse_list("all", 0.5, None).expect("all");
        assert!(all.iter().all(|spec| spec.alpha_rule().is_none()));
    }
}
