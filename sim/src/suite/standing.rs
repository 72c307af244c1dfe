//! `foresight` against each rival: relative deficits, their geometric means and 95 % intervals.

use crate::compare::interval;
use crate::outcome::{Comparison, DEFICIT_FLOOR, Interval, PolicyOutcome, relative_deficit};
use serde::Serialize;
use std::collections::BTreeMap;

use super::{CaseOutcome, Due};

/// Relative deficits nearer to 1 than this are a tie whatever their interval says.
const LEVEL: f64 = 0.01;

/// Who is ahead.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// `foresight` has the smaller deficit.
    Ahead,
    /// Within 1 %, within 10⁻³ of deficit, or the interval holds 1.
    Tie,
    /// The rival has the smaller deficit.
    Behind,
}

/// `foresight` against one rival: the relative deficit max(d, 10⁻³) ÷ max(d_rival, 10⁻³); below 1 is better.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Standing {
    /// As labelled in the comparisons.
    pub rival: String,
    /// Geometric mean: over replays and starts within a case, over cases within the suite.
    pub relative_deficit: f64,
    /// Its 95 % interval by Student's t on the logarithms; `None` where there is one value only.
    pub interval: Option<Interval>,
    /// Values that it is the mean of: starts of a case's replays, or cases.
    pub values: usize,
    /// Mean of d − d_rival over the same values; over the suite, over the cases.
    pub difference: f64,
    /// Who is ahead.
    pub verdict: Verdict,
    /// Cases in which `foresight` is ahead, level and behind; of a case, its own verdict counted once.
    pub ahead: usize,
    /// See `ahead`.
    pub level: usize,
    /// See `ahead`.
    pub behind: usize,
}

/// The policy that the others are measured against: the first called `foresight…`.
fn own(comparison: &Comparison) -> Option<&PolicyOutcome> {
    comparison.policies.iter().find(|p| p.name.starts_with("foresight"))
}

/// Within a case: starts are paired, each replay weighs the same.
pub(super) fn of_case(replays: &[&Comparison]) -> Vec<Standing> {
    // Per rival, a list of replays, each a list of starts: the logarithm of the relative deficit, and the difference.
    let mut found: BTreeMap<(usize, &str), Vec<Vec<[f64; 2]>>> = BTreeMap::new();
    for comparison in replays {
        let Some(own) = own(comparison) else { continue };
        let ours = &own.mean_deficit_by_start;
        for (place, rival) in comparison.policies.iter().enumerate().filter(|(_, p)| p.name != own.name) {
            let pairs: Vec<[f64; 2]> = (ours.iter().zip(&rival.mean_deficit_by_start))
                .filter_map(|(x, y)| Some([(*x)?, (*y)?]))
                .map(|[x, y]| [libm::log(relative_deficit(x, y)), x - y])
                .collect();
            if !pairs.is_empty() {
                found.entry((place, &rival.name)).or_default().push(pairs);
            }
        }
    }
    let standing = |((_, rival), replays): ((usize, &str), Vec<Vec<[f64; 2]>>)| {
        let mean = |of: &dyn Fn(&Vec<[f64; 2]>) -> f64| replays.iter().map(of).sum::<f64>() / replays.len() as f64;
        let over = |values: &Vec<[f64; 2]>, k: usize| values.iter().map(|v| v[k]).sum::<f64>() / values.len() as f64;
        let difference = mean(&|values| over(values, 1));
        // Every replay has as many starts as the others, or the shortest counts: the spread is that over the starts.
        let starts = replays.iter().map(Vec::len).min().unwrap_or(0);
        let by_start = |s: usize| replays.iter().map(|values| values[s][0]).sum::<f64>() / replays.len() as f64;
        let logarithms: Vec<f64> = (0..starts).map(by_start).collect();
        Standing::new(rival, &logarithms, difference).counted_once()
    };
    found.into_iter().map(standing).collect()
}

/// Over the cases that ran, those left out in which a tie is due: each case weighs the same.
pub fn standings(cases: &[CaseOutcome]) -> Vec<Standing> {
    let mut by_rival: Vec<(&str, Vec<&Standing>)> = Vec::new();
    for standing in cases.iter().filter(|c| c.due == Due::Open).flat_map(|c| &c.standings) {
        match by_rival.iter_mut().find(|(rival, _)| *rival == standing.rival) {
            Some((_, list)) => list.push(standing),
            None => by_rival.push((&standing.rival, vec![standing])),
        }
    }
    let overall = |(rival, list): (&str, Vec<&Standing>)| {
        let logarithms: Vec<f64> = list.iter().map(|s| libm::log(s.relative_deficit)).collect();
        let count = |verdict| list.iter().filter(|s| s.verdict == verdict).count();
        let (ahead, level, behind) = (count(Verdict::Ahead), count(Verdict::Tie), count(Verdict::Behind));
        let difference = list.iter().map(|s| s.difference).sum::<f64>() / list.len() as f64;
        Standing { ahead, level, behind, ..Standing::new(rival, &logarithms, difference) }
    };
    by_rival.into_iter().map(overall).collect()
}

impl Standing {
    fn new(rival: &str, logarithms: &[f64], difference: f64) -> Standing {
        let mean = logarithms.iter().sum::<f64>() / logarithms.len().max(1) as f64;
        let spread = interval(&logarithms.iter().copied().map(Some).collect::<Vec<_>>());
        let apart = spread.map_or(mean != 0.0, |i| i.lower > 0.0 || i.upper < 0.0);
        let relative_deficit = libm::exp(mean);
        let verdict = match relative_deficit {
            _ if difference.abs() < DEFICIT_FLOOR || !apart => Verdict::Tie,
            r if r < 1.0 - LEVEL => Verdict::Ahead,
            r if r > 1.0 + LEVEL => Verdict::Behind,
            _ => Verdict::Tie,
        };
        Standing {
            rival: rival.to_owned(),
            relative_deficit,
            interval: spread.map(|i| Interval { lower: libm::exp(i.lower), upper: libm::exp(i.upper) }),
            values: logarithms.len(),
            difference,
            verdict,
            ahead: 0,
            level: 0,
            behind: 0,
        }
    }

    fn counted_once(self) -> Standing {
        let is = |verdict| usize::from(self.verdict == verdict);
        Standing { ahead: is(Verdict::Ahead), level: is(Verdict::Tie), behind: is(Verdict::Behind), ..self }
    }
}
