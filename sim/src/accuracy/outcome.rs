//! What `accuracy` yields: the document that `--json` prints.

use serde::Serialize;

/// Version of the JSON document. Raised when a field changes its meaning or goes away.
pub const SCHEMA_VERSION: u32 = 1;

/// Relative errors are of max(|gain|, this × the best gain of the scene).
pub const GAIN_FLOOR: f64 = 1e-4;

/// The document.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Accuracy {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Seed of everything random.
    pub seed: u64,
    /// Candidates asked for, over all scenes.
    pub candidates: u64,
    /// The added-benefit integral: a row a scene, method and setting, and over all scenes a row a method and setting.
    pub integral: Vec<ErrorRow>,
    /// Event splitting against the fixed grid.
    pub splitting: Option<Splitting>,
    /// Enclosures set against the reference, if only these were checked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub proof: Option<ProofCounts>,
    /// The worst case, `union` and `minimum`.
    pub worst_case: Vec<ErrorRow>,
    /// Choosing the best candidate.
    pub choice: Vec<ChoiceRow>,
    /// Decisions as the world grows.
    pub scale: Vec<ScaleRow>,
    /// The replay's upper bound on tiny instances.
    pub upper_bound: Vec<UpperBoundRow>,
    /// Rows where an uncertified method lies, a proven bound is violated, or a bound is loose; a sentence each.
    pub findings: Vec<Finding>,
}

/// What was found of enclosures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ProofCounts {
    /// Candidates.
    pub candidates: u64,
    /// Their legs, each enclosed by itself.
    pub legs: u64,
    /// Legs where the reference, give or take its error, lies within the bounds; where it only meets them, it is not
    /// good enough to tell.
    pub legs_within: u64,
    /// Candidates with a leg whose bounds the reference contradicts.
    pub violated: u64,
}

impl ProofCounts {
    /// Adds others.
    pub fn add(&mut self, other: &ProofCounts) {
        self.candidates += other.candidates;
        self.legs += other.legs;
        self.legs_within += other.legs_within;
        self.violated += other.violated;
    }
}

/// Where a row's inputs come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Situations of a replay.
    Real,
    /// Made so that the integrand changes fast somewhere.
    Stiff,
    /// Made from the ends of what numbers can hold.
    Extreme,
}

impl Kind {
    /// As in the document.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Real => "real",
            Kind::Stiff => "stiff",
            Kind::Extreme => "extreme",
        }
    }
}

/// Error and cost of a method at a setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorRow {
    /// The scene; `all` for all scenes of the kind together.
    pub case: String,
    /// Where it comes from.
    pub kind: Kind,
    /// What is estimated where that is not the row's list: `union`, `minimum`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reading: Option<String>,
    /// The method.
    pub method: String,
    /// Its setting, as `name=value`.
    pub setting: String,
    /// Whether it proves its bounds.
    pub certified: bool,
    /// Whether decisions use it unless told otherwise.
    pub default: bool,
    /// Candidates evaluated.
    pub candidates: u64,
    /// Mean evaluations a candidate, root finding counted.
    pub evaluations: f64,
    /// Mean run time a candidate on one core; differs from run to run.
    pub ns_per_candidate: f64,
    /// Largest |value − reference| ÷ max(|reference|, 10⁻⁴ × the best of the scene); for `minimum` ÷ Σw. What is infinite
    /// is `null` in the document.
    pub max_relative_error: f64,
    /// 99.9th percentile of the same, by nearest rank.
    pub p999_relative_error: f64,
    /// Median of the same.
    pub median_relative_error: f64,
    /// Certified: bounds that do not hold. Uncertified: errors above the method's own estimate, beyond rounding.
    pub bound_violations: u64,
    /// Mean width of the bounds (or of twice the error estimate) relative as the errors are; of a worst case, ÷ Σw.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gap: Option<f64>,
    /// Largest of the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_gap: Option<f64>,
}

/// Evaluations that splitting at events saves at equal error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Splitting {
    /// The error reached by the split method, 99.9th percentile over the real candidates.
    pub p999_relative_error: f64,
    /// The split method and its setting.
    pub split: String,
    /// Mean evaluations a candidate of the split method, root finding counted.
    pub split_evaluations: f64,
    /// The fixed grid that first reaches that error, or the finest tried.
    pub fixed: String,
    /// Its evaluations.
    pub fixed_evaluations: f64,
    /// Whether that grid reaches the error; otherwise the ratio is a lower bound.
    pub reached: bool,
    /// fixed ÷ split, means.
    pub ratio: f64,
    /// The same with the fixed grid that first reaches the split method's *median* error.
    pub ratio_at_median: f64,
}

/// Choosing the best candidate, against the exhaustive winner.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChoiceRow {
    /// The world and flight.
    pub case: String,
    /// How it is chosen.
    pub method: String,
    /// Regret asked for at most, relative; 0 for the exhaustive winner itself.
    pub tolerance: f64,
    /// Whether the regret is proven to be at most the tolerance.
    pub certified: bool,
    /// Whether decisions use it unless told otherwise.
    pub default: bool,
    /// Decisions whose choice is worth less than the exhaustive winner's under the same estimator.
    pub wrong_choices: u64,
    /// Decisions.
    pub decisions: u64,
    /// Largest (best − chosen) ÷ best under the same estimator; of finer ones than decisions use, what is not proven to be
    /// within the tolerance.
    pub max_regret: f64,
    /// Largest regret measured leaf by leaf with a fine quadrature, where that was done.
    pub max_regret_reference: Option<f64>,
    /// Mean of the same.
    pub mean_regret_reference: Option<f64>,
    /// Mean run time on one core; differs from run to run.
    pub ns_per_decision: f64,
    /// Mean candidates whose value was worked out.
    pub candidates_evaluated: f64,
}

/// Run time of one decision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Median.
    pub p50: u64,
    /// 99th percentile, by nearest rank.
    pub p99: u64,
}

/// Decisions of the scheduler itself in a world of a size.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ScaleRow {
    /// Representations in the world.
    pub representations: u64,
    /// `moving`, `memory-full` or `turn-180`.
    pub situation: &'static str,
    /// Observing a view and deciding until there is nothing left to do, on one core; differs from run to run.
    pub decision_ns: Percentiles,
    /// One answer alone, a fetch, a discard, a cancellation or to wait; the first after a view with the observation. Differs from
    /// run to run.
    pub action_ns: Percentiles,
    /// Mean nodes opened a decision; `null` where the policy does not tell.
    pub nodes_opened: Option<f64>,
    /// Ticks timed.
    pub decisions: u64,
    /// Fetches, cancellations and discards over these.
    pub actions: u64,
    /// Bytes a representation that all sessions share.
    pub bytes_per_representation: f64,
    /// Bytes of one session's state at the end, with what its policy keeps.
    pub session_bytes: u64,
}

/// A replay's bound against the exact optimum on a tiny instance.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UpperBoundRow {
    /// The instance, by its seed.
    pub case: String,
    /// `ample`, `matched` or `scarce`.
    pub stratum: String,
    /// The proven bound.
    pub bound: f64,
    /// What the best policy reaches, by search.
    pub exact: f64,
}

/// What a row shows that its reader must know.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Which kind of finding.
    pub verdict: Verdict,
    /// The row and its figures.
    pub text: String,
}

/// Kinds of findings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// A proven bound does not hold: a bug.
    Violated,
    /// An uncertified method errs by more than it says.
    Lies,
    /// A proven bound is wide.
    Loose,
}
