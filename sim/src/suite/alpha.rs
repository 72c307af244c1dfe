//! α adapted and solved for against the best fixed α in hindsight.
//!
//! Each replay of a case is repeated with `foresight` at α = 0, 0.1, … 1 and adapted, and then solved for with Q_min set to
//! the mean W/Σw that the best fixed α reached. Spread is the largest minus the smallest mean deficit of the eleven; regret
//! is a mean deficit minus the smallest. Where the spread is small, α decides nothing, and the quotient means nothing.

use crate::outcome::Comparison;
use serde::Serialize;

/// Version of the JSON document. Raised when a field changes its meaning or goes away.
pub const SCHEMA_VERSION: u32 = 1;

/// Fixed values replayed: 0, 0.1, … 1.
pub const STEPS: usize = 10;

/// Spreads from here on count, as a mean deficit.
pub const SPREAD: f64 = 0.01;

/// Regret ÷ spread that is aimed at, where the spread counts.
pub const AIM: f64 = 0.2;

/// The sweep over the suite.
#[derive(Clone, Debug, Default, Serialize)]
pub struct AlphaSweep {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// The fixed values, in the order of [`AlphaRow::deficits`].
    pub alphas: Vec<f64>,
    /// One a replay.
    pub rows: Vec<AlphaRow>,
}

/// A replay at every α.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AlphaRow {
    /// Case, and which of its replays, from 1.
    pub case: String,
    /// The arguments that repeat the eleven and the adapted one.
    pub command: Vec<String>,
    /// Mean deficit at each α.
    pub deficits: Vec<f64>,
    /// Mean W/Σw at each α.
    pub worst_qualities: Vec<Option<f64>>,
    /// The α with the least mean deficit; the least of several.
    pub best_alpha: f64,
    /// Largest minus smallest mean deficit.
    pub spread: f64,
    /// The same relative to the smallest, floored at 10⁻³.
    pub relative_spread: f64,
    /// α adapted.
    pub adapted: Contender,
    /// α solved for.
    pub solved: Contender,
    /// Q_min of the latter: mean W/Σw at the best α, to a hundredth downwards.
    pub at_least: f64,
}

/// α adapted or solved for, in one replay.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Contender {
    /// Mean deficit.
    pub deficit: f64,
    /// Mean α.
    pub mean_alpha: f64,
    /// Mean W/Σw.
    pub worst_quality: Option<f64>,
    /// Mean deficit minus the smallest of the fixed ones, below 0 if it beats them.
    pub regret: f64,
    /// Regret ÷ spread; `None` where the spread is 0.
    pub share: Option<f64>,
    /// How the constraint stands at the end of each start.
    pub constraint: Vec<&'static str>,
}

/// The policies of the first pass, as `--policy` takes them. `options` are those of the case's own `foresight`.
pub fn policies(options: &str) -> String {
    let fixed = (0..=STEPS).map(|i| format!("foresight:alpha={}:watch=on{options}", alpha(i)));
    fixed.chain([format!("foresight-adapted{options}")]).collect::<Vec<_>>().join(",")
}

/// The policy of the second pass.
pub fn solved_policy(at_least: f64, options: &str) -> String {
    format!("foresight-solved:at-least={at_least}{options}")
}

/// The fixed value at a place.
pub fn alpha(place: usize) -> f64 {
    place as f64 / STEPS as f64
}

/// The first pass of a replay; `None` where nothing was ever in view.
pub fn row(case: String, command: Vec<String>, comparison: &Comparison) -> Option<AlphaRow> {
    let deficits: Vec<f64> =
        comparison.policies.iter().take(STEPS + 1).map(|p| p.mean_deficit).collect::<Option<_>>()?;
    let worst = |place: usize| comparison.policies.get(place)?.alpha.as_ref()?.mean_worst_quality;
    let least = deficits.iter().copied().min_by(f64::total_cmp)?;
    let best = deficits.iter().position(|d| *d == least)?;
    let spread = deficits.iter().copied().fold(least, f64::max) - least;
    let at_least = libm::floor(100.0 * worst(best).unwrap_or(0.0)) / 100.0;
    let mut row = AlphaRow {
        case,
        command,
        worst_qualities: (0..=STEPS).map(worst).collect(),
        best_alpha: alpha(best),
        spread,
        relative_spread: spread / least.max(crate::outcome::DEFICIT_FLOOR),
        deficits,
        at_least,
        ..AlphaRow::default()
    };
    row.adapted = row.contender(comparison, STEPS + 1)?;
    Some(row)
}

impl AlphaRow {
    /// The policy at a place of a comparison, against the fixed ones.
    pub fn contender(&self, comparison: &Comparison, place: usize) -> Option<Contender> {
        let policy = comparison.policies.get(place)?;
        let alpha = policy.alpha.clone()?;
        let deficit = policy.mean_deficit?;
        let regret = deficit - self.deficits.iter().copied().min_by(f64::total_cmp)?;
        Some(Contender {
            deficit,
            mean_alpha: alpha.mean,
            worst_quality: alpha.mean_worst_quality,
            regret,
            share: (self.spread > 0.0).then(|| regret / self.spread),
            constraint: alpha.constraint,
        })
    }

    /// Whether its spread counts.
    pub fn counts(&self) -> bool {
        self.spread >= SPREAD
    }
}

impl AlphaSweep {
    /// Over these replays.
    pub fn new(rows: Vec<AlphaRow>) -> AlphaSweep {
        AlphaSweep { schema_version: SCHEMA_VERSION, alphas: (0..=STEPS).map(alpha).collect(), rows }
    }

    /// Mean deficit over all replays at each α, then adapted, then solved for; `None` without any.
    pub fn mean_deficits(&self) -> Option<Vec<f64>> {
        let count = self.rows.len() as f64;
        let mean = |of: &dyn Fn(&AlphaRow) -> f64| self.rows.iter().map(of).sum::<f64>() / count;
        let fixed = (0..=STEPS).map(|i| mean(&|row: &AlphaRow| row.deficits[i]));
        let both = [mean(&|row: &AlphaRow| row.adapted.deficit), mean(&|row: &AlphaRow| row.solved.deficit)];
        (count > 0.0).then(|| fixed.chain(both).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::{AlphaOutcome, PolicyOutcome};

    #[test]
    fn regret_and_spread_are_against_the_best_fixed_one() {
        let policy = |deficit: f64, worst: f64| PolicyOutcome {
            mean_deficit: Some(deficit),
            alpha: Some(AlphaOutcome { mean: 0.5, mean_worst_quality: Some(worst), ..AlphaOutcome::default() }),
            ..PolicyOutcome::default()
        };
        let mut policies: Vec<_> = (0..=STEPS).map(|i| policy(0.3 - 0.01 * i as f64, 0.8 - 0.02 * i as f64)).collect();
        policies.push(policy(0.22, 0.7));
        let comparison = Comparison { policies, ..Comparison::default() };
        let row = row("turn 1".to_owned(), Vec::new(), &comparison).expect("all are there");
        assert_eq!((row.best_alpha, row.at_least), (1.0, 0.6));
        assert!((row.spread - 0.1).abs() < 1e-12 && (row.relative_spread - 0.5).abs() < 1e-12 && row.counts());
        assert!((row.adapted.regret - 0.02).abs() < 1e-12);
        assert!(row.adapted.share.is_some_and(|s| (s - 0.2).abs() < 1e-9));
    }
}
