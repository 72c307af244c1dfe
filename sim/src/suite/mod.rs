//! The benchmark suite: named cases, each a few replays, and what they say together about `foresight` against each rival.

pub mod alpha;
mod cases;
mod standing;

#[cfg(test)]
mod tests;

use crate::outcome::{Comparison, Limits};
use serde::Serialize;
use std::path::Path;

pub use cases::CASES;
pub use standing::{Standing, Verdict, standings};

/// Version of the JSON document. Raised when a field changes its meaning or goes away.
pub const SCHEMA_VERSION: u32 = 1;

/// Mean deficits nearer than this are level where a tie is due: start-up takes the policies fractions of a second each.
pub const TIE: f64 = 5e-3;

/// Stands for the folder of recorded worlds, paths and links in a case's replays.
const DATA: &str = "{data}";

/// A named case.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// By which it is asked for.
    pub name: &'static str,
    /// Why it is there.
    pub why: &'static str,
    /// What its figures can show, and what they cannot.
    pub shows: &'static str,
    /// What must come out.
    pub due: Due,
    /// Options of `replay`, a line a replay; `{data}` stands for the folder of recorded data.
    pub replays: &'static [&'static str],
}

/// What must come out of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Due {
    /// Whatever comes out.
    Open,
    /// All mean deficits within [`TIE`] of that of `foresight`: the link or the world leaves nothing to decide.
    Tie,
}

impl Case {
    /// Whether it needs recorded data.
    pub fn needs_data(&self) -> bool {
        self.replays.iter().any(|line| line.contains(DATA))
    }

    /// The arguments of each replay, `replay` first.
    pub fn commands(&self, data: &Path) -> Vec<Vec<String>> {
        let data = data.to_string_lossy();
        let command = |line: &&str| {
            let options = line.split_whitespace().map(|word| word.replace(DATA, &data));
            std::iter::once("replay".to_owned()).chain(options).collect()
        };
        self.replays.iter().map(command).collect()
    }
}

/// What one replay of a case yielded.
#[derive(Clone, Debug, Serialize)]
pub struct ReplayOutcome {
    /// The arguments that repeat it.
    pub command: Vec<String>,
    /// `starved`, `matched` or `ample`, by ρ.
    pub regime: &'static str,
    /// The result.
    pub comparison: Comparison,
}

/// What a case yielded.
#[derive(Clone, Debug, Serialize)]
pub struct CaseOutcome {
    /// Of [`Case`].
    pub name: &'static str,
    /// Of [`Case`].
    pub why: &'static str,
    /// Of [`Case`].
    pub shows: &'static str,
    /// Of [`Case`].
    pub due: Due,
    /// `foresight` against each rival.
    pub standings: Vec<Standing>,
    /// What keeps `foresight` from the upper bound, mean over the replays that tell; `None` where none does.
    pub limits: Option<Limits>,
    /// One a replay.
    pub replays: Vec<ReplayOutcome>,
}

/// What the suite yielded.
#[derive(Clone, Debug, Serialize)]
pub struct SuiteOutcome {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// `foresight` against each rival, over all cases but those in which a tie is due.
    pub standings: Vec<Standing>,
    /// Those that ran.
    pub cases: Vec<CaseOutcome>,
    /// Those that did not, with the reason.
    pub skipped: Vec<Skipped>,
    /// Seconds that the suite took.
    pub wall_s: f64,
    /// Most memory that the process held, bytes, where the system tells.
    pub peak_memory_bytes: Option<u64>,
}

/// A case that did not run.
#[derive(Clone, Debug, Serialize)]
pub struct Skipped {
    /// Of [`Case`].
    pub name: &'static str,
    /// Why.
    pub reason: String,
}

impl CaseOutcome {
    /// A case's replays, with `foresight` set against each rival.
    pub fn new(case: &Case, replays: Vec<ReplayOutcome>) -> CaseOutcome {
        let standings = standing::of_case(&replays.iter().map(|r| &r.comparison).collect::<Vec<_>>());
        let limits: Vec<Limits> = replays.iter().filter_map(|r| r.comparison.limits).collect();
        let limits = Limits::mean(&limits);
        CaseOutcome { name: case.name, why: case.why, shows: case.shows, due: case.due, standings, limits, replays }
    }

    /// The rivals with which `foresight` is not level although a tie is due.
    pub fn not_as_due(&self) -> impl Iterator<Item = &Standing> {
        let due = self.due == Due::Tie;
        self.standings.iter().filter(move |s| due && s.difference.abs() > TIE)
    }
}
