//! What a comparison yields: the document that `replay --json` prints, and the series that the report draws.

use crate::bound::frame;
use crate::bound::whole::{Bound, METHOD_OVER_TIME};
use serde::Serialize;

/// Version of the JSON document. Raised when a field changes its meaning or goes away.
pub const SCHEMA_VERSION: u32 = 1;

/// The document: one world, path and link, and what each policy made of them.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Comparison {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// What was replayed.
    pub inputs: Inputs,
    /// Whether the comparison can mean anything.
    pub pressure: Pressure,
    /// Share of the sampled frames that have something in view.
    pub nonempty_share: f64,
    /// The goal line.
    pub upper_bound: UpperBound,
    /// What more link or memory would have added to the goal line; present where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shadow_prices: Option<ShadowPrices>,
    /// What keeps `foresight` from the goal line; present where it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limits: Option<Limits>,
    /// One entry a policy, in the order asked for.
    pub policies: Vec<PolicyOutcome>,
    /// What the reader of the figures must know: repairs, low pressure, empty views.
    pub warnings: Vec<String>,
    /// For drawing; not part of the document.
    #[serde(skip)]
    pub series: Series,
}

/// What was replayed, so that it can be replayed again.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Inputs {
    /// World as named on the command line, or `built-in city`.
    pub world: String,
    /// BLAKE3 of the world's tree and URIs, hexadecimal.
    pub world_hash: String,
    /// Number of representations in the world.
    pub representations: u64,
    /// Path as named.
    pub path: String,
    /// BLAKE3 of the poses as replayed.
    pub path_hash: String,
    /// Link as named.
    pub link: String,
    /// BLAKE3 of the capacity as replayed.
    pub link_hash: String,
    /// How the path was put into the world.
    pub place: String,
    /// Seconds replayed.
    pub duration_s: f64,
    /// Memory budget, bytes.
    pub memory_bytes: u64,
    /// Trust in the prediction.
    pub alpha: f64,
    /// Which reading of the worst case the objective used: `union` or `minimum`.
    pub worst_case: String,
    /// `partial` or `atomic`.
    pub refinement: String,
    /// Whether the first view's needs were resident at the start.
    pub warm: bool,
    /// Seconds of its path that the client announced, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub announce_s: Option<f64>,
    /// The recorded head that rode on the path, if one did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub head: Option<String>,
    /// Seed of everything random.
    pub seed: u64,
    /// Offsets into the link, seconds, one a replay; the first replay's series are drawn.
    pub starts_s: Vec<f64>,
    /// Viewport in pixels.
    pub viewport: [u32; 2],
    /// Vertical field of view, degrees.
    pub fov_y_deg: f64,
}

/// Deficits below this count as this much when one is divided by another.
pub const DEFICIT_FLOOR: f64 = 1e-3;

/// The relative deficit of `x` against `y`: max(x, 10⁻³) ÷ max(y, 10⁻³).
pub fn relative_deficit(x: f64, y: f64) -> f64 {
    x.max(DEFICIT_FLOOR) / y.max(DEFICIT_FLOOR)
}

/// The word for a pressure ρ: `starved`, `matched` or `ample`.
pub fn regime(rho: f64) -> &'static str {
    match rho {
        r if r > 2.0 => "starved",
        r if r < 0.5 => "ample",
        _ => "matched",
    }
}

/// Whether the comparison can mean anything: demand against supply.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Pressure {
    /// λ: bytes newly needed after the first frame ÷ (duration × mean link rate).
    pub lambda: f64,
    /// ρ: bytes of the union of all needs ÷ bytes that the link delivers.
    pub rho: f64,
    /// μ: memory budget ÷ the largest need, decoded.
    pub mu: f64,
    /// The largest need of a frame, decoded bytes.
    pub largest_need_bytes: u64,
}

/// Proven upper bound on the mean quality of any online policy.
#[derive(Clone, Debug, Default, Serialize)]
pub struct UpperBound {
    /// Mean over the frames with something in view, the smaller of the two beneath in each start; over the starts too.
    pub mean_quality: Option<f64>,
    /// How it was proven.
    pub method: String,
    /// Mean of what bounds each frame by itself.
    pub by_frame: Option<f64>,
    /// The bound over time, of the mean only.
    pub over_time: Option<f64>,
}

impl UpperBound {
    /// The means over the starts.
    pub fn new(starts: &[Bound]) -> UpperBound {
        let mean = |of: &dyn Fn(&Bound) -> Option<f64>| -> Option<f64> {
            let values: Vec<f64> = starts.iter().map(of).collect::<Option<_>>()?;
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        let over_time = starts.iter().filter(|start| start.is_over_time()).count();
        let method = match (starts.first(), over_time) {
            (None, _) => String::new(),
            (Some(first), n) if n == 0 || n == starts.len() => first.method().to_owned(),
            (Some(_), n) => format!("{n} of {} starts {METHOD_OVER_TIME}; the others {}", starts.len(), frame::METHOD),
        };
        UpperBound {
            mean_quality: mean(&|start| start.mean_quality()),
            method,
            by_frame: mean(&|start| start.by_frame),
            over_time: mean(&|start| start.over_time),
        }
    }
}

pub use crate::bound::shadow::ShadowPrices;
pub use crate::limits::Limits;

/// A 95 % interval of a mean over starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Interval {
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

/// Intervals over the starts, present with `--starts` of 2 and more; each beside the figure of the same name.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[allow(missing_docs)]
pub struct Intervals {
    pub mean_quality: Option<Interval>,
    pub mean_deficit: Option<Interval>,
    pub p05_quality: Option<Interval>,
    pub seconds_below_0_9: Option<Interval>,
    pub seconds_to_0_9: Option<Interval>,
    pub share_within_16px: Option<Interval>,
    pub bytes_fetched: Option<Interval>,
    pub bytes_wasted: Option<Interval>,
    pub bytes_cancelled: Option<Interval>,
    pub evictions: Option<Interval>,
}

/// Percentiles of the time a decision took on this machine, nanoseconds. The only figures that differ between runs.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[allow(missing_docs)]
pub struct DecisionNanos {
    pub p50: u64,
    pub p99: u64,
    pub max: u64,
}

/// What one policy reached. Means over the starts where there are several.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PolicyOutcome {
    /// Name with its options, as on the command line.
    pub name: String,
    /// Time-weighted mean of Q over frames with something in view. `None` if there is no such frame.
    pub mean_quality: Option<f64>,
    /// Mean of 1 − Q.
    pub mean_deficit: Option<f64>,
    /// Mean of 1 − Q for each start, in the order of [`Inputs::starts_s`].
    pub mean_deficit_by_start: Vec<Option<f64>>,
    /// 5th percentile of Q.
    pub p05_quality: Option<f64>,
    /// Seconds with Q < 0.9.
    pub seconds_below_0_9: f64,
    /// Seconds until Q first reached 0.9; `None` if never.
    pub seconds_to_0_9: Option<f64>,
    /// Share of the weight shown at an error of at most 16 px, mean over frames.
    pub share_within_16px: Option<f64>,
    /// Bytes that crossed the link, cancelled ones included.
    pub bytes_fetched: f64,
    /// Bytes of representations that were never the best for any leaf with weight.
    pub bytes_wasted: f64,
    /// Bytes that had crossed the link when their request was cancelled.
    pub bytes_cancelled: f64,
    /// Requests that failed, those included that were given up because what they need first failed.
    pub failures: f64,
    /// Representations discarded.
    pub evictions: f64,
    /// Times the policy was asked and chose to do something.
    pub decisions: f64,
    /// How long decisions took.
    pub decision_ns: DecisionNanos,
    /// What the choices may have missed, by a policy that proves it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regret: Option<RegretOutcome>,
    /// What became of α, where it is not fixed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alpha: Option<AlphaOutcome>,
    /// Present with several starts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<Intervals>,
}

/// Share of the best ratio of gain to link time that a decision's last choice may have missed, as proven. With memory full
/// the bound leaves out what making room costs, and is loose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RegretOutcome {
    /// Median over the decisions.
    pub p50: f64,
    /// 99th percentile, by nearest rank.
    pub p99: f64,
    /// Share of the decisions that were cut short by their limit on evaluations.
    pub cut_short: f64,
}

impl RegretOutcome {
    /// Over decisions as (regret, cut short); `None` of nothing.
    pub fn of(mut decisions: Vec<(f64, bool)>) -> Option<RegretOutcome> {
        decisions.sort_by(|a, b| a.0.total_cmp(&b.0));
        let count = decisions.len();
        let rank = |percent: usize| decisions.get((count * percent).div_ceil(100).saturating_sub(1)).map(|d| d.0);
        let cut_short = decisions.iter().filter(|d| d.1).count() as f64 / count.max(1) as f64;
        Some(RegretOutcome { p50: rank(50)?, p99: rank(99)?, cut_short })
    }
}

/// What became of α. Means over the starts where there are several.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AlphaOutcome {
    /// `watched`, `solved` or `adapted`.
    pub rule: &'static str,
    /// Mean over the replay.
    pub mean: f64,
    /// Mean over the last seconds, with a fading memory of half a minute.
    pub settled: f64,
    /// Standard deviation about `settled`.
    pub oscillation: f64,
    /// Mean of W/Σw over the replay: the quality of the worst case; `None` if nothing was ever reachable in one of them.
    pub mean_worst_quality: Option<f64>,
    /// The same over the last seconds.
    pub settled_worst_quality: Option<f64>,
    /// Q_min, where α is solved for.
    pub at_least: Option<f64>,
    /// How W/Σw ≥ Q_min stands at the end of each start: `converging`, `met`, `slack` or `infeasible`. Empty without Q_min.
    pub constraint: Vec<&'static str>,
    /// Whether it is met or slack at the end of every start; `None` without Q_min.
    pub converged: Option<bool>,
    /// Whether it is infeasible at the end of some start; `None` without Q_min.
    pub infeasible: Option<bool>,
}

/// Time series of the first start, for the report.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Times of the sampled frames, seconds.
    pub frame_s: Vec<f64>,
    /// Upper bound of Q per frame; `None` where nothing is in view.
    pub bound: Vec<Option<f64>>,
    /// Camera position per frame seen from above, metres: two axes across the world's up.
    pub path_xy: Vec<[f64; 2]>,
    /// Seconds at which `capacity_bytes` is cumulated.
    pub second_s: Vec<f64>,
    /// Bytes that the link could deliver in each second.
    pub capacity_bytes: Vec<f64>,
    /// One a policy, in the order of [`Comparison::policies`].
    pub policies: Vec<PolicySeries>,
}

/// What one policy did over time.
#[derive(Clone, Debug, Default)]
pub struct PolicySeries {
    /// Name, as in [`PolicyOutcome::name`].
    pub name: String,
    /// Q per frame; `None` where nothing is in view.
    pub quality: Vec<Option<f64>>,
    /// Memory in use per frame, bytes.
    pub memory_bytes: Vec<u64>,
    /// Bytes that crossed the link in each second.
    pub used_bytes: Vec<f64>,
    /// Arrivals on the map.
    pub arrivals: Vec<Arrival>,
}

/// A representation that became usable: the footprint of its node seen from above.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// When it could be shown, seconds.
    pub at_s: f64,
    /// Middle of the footprint, metres, in the axes of [`Series::path_xy`].
    pub centre: [f64; 2],
    /// Half its sides, metres.
    pub half: [f64; 2],
    /// Depth of its node in the tree; the root is 0.
    pub depth: u32,
}
