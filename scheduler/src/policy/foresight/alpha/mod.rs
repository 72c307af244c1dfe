//! α, the trust in the prediction: set, solved for, or adapted; and how well it does.
//!
//! W/Σw is the quality that the worst case leaves of what is resident: of the union of what is reachable as it stands; of
//! single worst views, that of the one with the largest deficit, 1 + W/Σw.

mod ascent;
mod pool;

use crate::benefit::coverage::Coverage;
use crate::benefit::cut::{Cut, CutSettings, Region};
use crate::benefit::quality::evaluate;
use crate::lod_tree::LodTree;
use crate::predict::PredictedPath;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use crate::worst_case::union_cut;
use ascent::Ascent;
use pool::Pool;

/// Quality of the worst case that [`AlphaRule::Solved`] asks for unless told otherwise.
pub const AT_LEAST: f64 = 0.6;

/// Largest α that is solved for or adapted to. At α = 1 a client whose predicted paths are served has nothing to fetch,
/// and what it has off them is worth nothing to it; this little keeps the worst case as what comes next.
pub const ALPHA_MAX: f64 = 0.98;

/// Longest time that one sampling stands for, seconds: what came before a pause says nothing about the pause.
const STEP_S_MAX: f64 = 1.0;

/// Where α comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaRule {
    /// As set.
    #[default]
    Fixed,
    /// As set, and W/Σw is measured at every sampling.
    Watched,
    /// Starts as set and follows the multiplier of W/Σw ≥ `at_least` by dual ascent.
    Solved {
        /// Q_min ∈ [0, 1].
        at_least: f64,
    },
    /// Starts as set and follows how well the predicted paths explain what is then seen, against the worst case.
    Adapted,
}

/// How the constraint W/Σw ≥ Q_min stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Constraint {
    /// Neither settled nor given up: so it begins.
    Converging,
    /// The running mean is within the tolerance of Q_min.
    Met,
    /// The running mean is above Q_min although α = [`ALPHA_MAX`]: the constraint costs nothing.
    Slack,
    /// The running mean stays below Q_min although α = 0.
    Infeasible,
}

impl Constraint {
    /// The word for it.
    pub fn name(self) -> &'static str {
        match self {
            Constraint::Converging => "converging",
            Constraint::Met => "met",
            Constraint::Slack => "slack",
            Constraint::Infeasible => "infeasible",
        }
    }
}

/// What became of α so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlphaReport {
    /// Now.
    pub alpha: f64,
    /// Mean over the session.
    pub mean_alpha: f64,
    /// Running mean, with a memory of [`AlphaReport::MEMORY_S`].
    pub settled_alpha: f64,
    /// Standard deviation about that mean: the oscillation of the multiplier 1 − α.
    pub oscillation: f64,
    /// Mean of W/Σw over the session; `None` if nothing was ever reachable.
    pub mean_worst_quality: Option<f64>,
    /// Running mean of W/Σw, with the same memory.
    pub settled_worst_quality: Option<f64>,
    /// Q_min, where α is solved for.
    pub target: Option<f64>,
    /// How the constraint stands, where there is one.
    pub constraint: Option<Constraint>,
}

impl AlphaReport {
    /// Memory of the running means, seconds.
    pub const MEMORY_S: f64 = 30.0;
    /// The constraint holds if the running mean is at most this below Q_min, and is met with equality within the same.
    pub const TOLERANCE: f64 = 0.02;
}

/// What the policy samples the objective from.
pub(super) struct Sampled<'a> {
    pub now: Time,
    /// A view at each of `offsets` on each path.
    pub paths: &'a [PredictedPath],
    /// Seconds from now, ascending.
    pub offsets: &'a [f64],
    /// The worst case as weighted regions: one a camera for the union, worst views otherwise. Weights sum to 1.
    pub worst: &'a [(f64, View, Region)],
    pub cut: &'a CutSettings,
    /// Attenuation rate, 1/s.
    pub attenuation: f64,
}

/// α of one client.
pub(super) struct Alpha {
    rule: AlphaRule,
    alpha: f64,
    sampled: Option<Time>,
    session: Means,
    ascent: Ascent,
    pool: Pool,
    cut: Cut,
}

/// Time-weighted means over a session.
#[derive(Clone, Copy, Debug, Default)]
struct Means {
    seconds: f64,
    alpha: f64,
    quality_seconds: f64,
    quality: f64,
}

impl Alpha {
    /// Begins at `alpha`.
    pub(super) fn new(rule: AlphaRule, alpha: f64) -> Alpha {
        let alpha = if alpha.is_nan() { 0.0 } else { alpha.clamp(0.0, 1.0) };
        let target = match rule {
            AlphaRule::Solved { at_least } => Some(at_least),
            _ => None,
        };
        Alpha {
            rule,
            alpha,
            sampled: None,
            session: Means::default(),
            ascent: Ascent::new(target, alpha),
            pool: Pool::new(alpha),
            cut: Cut::default(),
        }
    }

    /// α for the sampling at `sampled.now`.
    pub(super) fn at(&mut self, state: &ClientState, sampled: &Sampled) -> f64 {
        if self.rule == AlphaRule::Fixed {
            return self.alpha;
        }
        let seconds = self.sampled.map_or(0.0, |before| sampled.now.since(before).secs().min(STEP_S_MAX));
        self.sampled = Some(sampled.now);
        let quality = self.worst_quality(state.tree, state.resident(), sampled);
        self.session.add(self.alpha, quality, seconds);
        self.ascent.update(self.alpha, quality, seconds);
        match self.rule {
            AlphaRule::Fixed | AlphaRule::Watched => {}
            AlphaRule::Solved { .. } => self.alpha = self.ascent.alpha(),
            AlphaRule::Adapted => {
                self.pool.remember(sampled);
                self.alpha = self.pool.alpha();
            }
        }
        self.alpha
    }

    /// The cameras, with their shares, are where they are: what was predicted for now is judged.
    pub(super) fn observe(&mut self, tree: &LodTree, cameras: &[(f64, View)], now: Time) {
        if self.rule == AlphaRule::Adapted {
            self.pool.judge(tree, cameras, now);
        }
    }

    /// What became of it.
    pub(super) fn report(&self) -> AlphaReport {
        let (mean_alpha, mean_worst_quality) = self.session.both().unwrap_or((self.alpha, None));
        let settled = self.ascent.settled();
        AlphaReport {
            alpha: self.alpha,
            mean_alpha,
            settled_alpha: settled.map_or(self.alpha, |s| s.alpha),
            oscillation: settled.map_or(0.0, |s| s.oscillation),
            mean_worst_quality,
            settled_worst_quality: settled.and_then(|s| s.quality),
            target: self.ascent.target(),
            constraint: self.ascent.constraint(),
        }
    }

    /// Quality of what is resident in the region with the largest deficit; `None` if nothing is in any.
    fn worst_quality(&mut self, tree: &LodTree, resident: &Coverage, sampled: &Sampled) -> Option<f64> {
        let mut largest: Option<(f64, f64)> = None;
        for (_, view, region) in sampled.worst {
            union_cut(&mut self.cut, tree, view, *region, sampled.cut);
            let quality = evaluate(tree, &self.cut, resident, |_| {});
            let deficit = (quality.weight - quality.benefit) * self.cut.scale;
            if let Some(mean) = quality.mean()
                && largest.is_none_or(|(most, _)| deficit > most)
            {
                largest = Some((deficit, mean));
            }
        }
        largest.map(|(_, mean)| mean)
    }
}

impl Means {
    fn add(&mut self, alpha: f64, quality: Option<f64>, seconds: f64) {
        self.seconds += seconds;
        self.alpha += seconds * alpha;
        if let Some(quality) = quality {
            self.quality_seconds += seconds;
            self.quality += seconds * quality;
        }
    }

    fn both(&self) -> Option<(f64, Option<f64>)> {
        let quality = (self.quality_seconds > 0.0).then(|| self.quality / self.quality_seconds);
        (self.seconds > 0.0).then(|| (self.alpha / self.seconds, quality))
    }
}
