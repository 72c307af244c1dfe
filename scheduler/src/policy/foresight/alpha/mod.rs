//! α, the trust in the prediction: set, solved for, or adapted; and how well it does.
//!
//! W/Σw is the quality that the worst case leaves of what is resident: of the union of what is reachable as it stands; of
//! single worst views, that of the one with the largest deficit, 1 + W/Σw.

mod ascent;
mod measured;
mod pool;

use crate::benefit::cut::{Cut, CutSettings, Region};
use crate::predict::PredictedPath;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use ascent::Ascent;
use measured::Measured;
use pool::Pool;

/// Quality of the worst case that [`AlphaRule::Solved`] asks for unless told otherwise.
pub const AT_LEAST: f64 = 0.6;

/// Largest α that is solved for or adapted to. At α = 1 a client whose predicted paths are served has nothing to fetch,
/// and what it has off them is worth nothing to it; this little keeps the worst case as what comes next.
pub const ALPHA_MAX: f64 = 0.98;

/// Longest time that one sampling stands for, seconds: what came before a pause says nothing about the pause.
const STEP_S_MAX: f64 = 1.0;

/// Seconds within which the next observation counts as soon: what can wait for it then does, so that no single one has all
/// of the work.
const SOON_S: f64 = 0.1;
/// Seconds between measurements of W/Σw where nothing but the report depends on them.
const REPORT_EVERY_S: f64 = 1.0;
/// Least opening angle of the cuts by which W/Σw is measured where nothing but the report depends on it.
const REPORT_OPENING_MIN: f64 = 0.8;

/// Where α comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaRule {
    /// As set.
    #[default]
    Fixed,
    /// As set, and W/Σw is measured at every sampling.
    Watched,
    /// Follows the multiplier of W/Σw ≥ `at_least` by dual ascent, from the one of no constraint ([`ALPHA_MAX`]) on.
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
    observed: Option<Time>,
    /// Whether the last observation has left its work to this one.
    has_waited: bool,
    /// Seconds for which no worst case has been measured yet.
    unmeasured_s: f64,
    /// The worst case whose quality is being measured.
    measured: Option<Measured>,
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
    /// Begins at `alpha`, unless it is solved for.
    pub(super) fn new(rule: AlphaRule, alpha: f64) -> Alpha {
        let alpha = if alpha.is_nan() { 0.0 } else { alpha.clamp(0.0, 1.0) };
        let (alpha, target) = match rule {
            AlphaRule::Solved { at_least } => (ALPHA_MAX, Some(at_least)),
            _ => (alpha, None),
        };
        Alpha {
            rule,
            alpha,
            sampled: None,
            observed: None,
            has_waited: false,
            unmeasured_s: 0.0,
            measured: None,
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
        self.session.add_alpha(self.alpha, seconds);
        let is_solved = matches!(self.rule, AlphaRule::Solved { .. });
        // What is measured next stands for all the time since what was measured last.
        self.unmeasured_s += seconds;
        if self.measured.is_none() && (is_solved || self.unmeasured_s >= REPORT_EVERY_S) {
            let seconds = core::mem::take(&mut self.unmeasured_s);
            let opening = sampled.cut.opening.max(if is_solved { 0.0 } else { REPORT_OPENING_MIN });
            let memory = core::mem::take(&mut self.cut);
            self.measured = Some(Measured::new(sampled, opening, self.alpha, seconds, memory));
        }
        match self.rule {
            AlphaRule::Fixed | AlphaRule::Watched => {}
            AlphaRule::Solved { .. } => {
                self.measure(state, false);
                self.alpha = self.ascent.alpha();
            }
            AlphaRule::Adapted => {
                self.pool.remember(sampled);
                self.alpha = self.pool.alpha();
            }
        }
        self.alpha
    }

    /// The cameras, with their shares, are where they are: what was predicted for now is judged. Where the next observation
    /// is likely to come soon, it has what this one leaves: all, once, if this one `is_busy`, and otherwise all but a part.
    pub(super) fn observe(&mut self, state: &ClientState, cameras: &[(f64, View)], now: Time, is_busy: bool) {
        let is_next_soon = self.observed.is_some_and(|before| now.since(before).secs() <= SOON_S);
        self.observed = Some(now);
        self.has_waited = is_busy && is_next_soon && !self.has_waited;
        if self.has_waited {
            return;
        }
        let is_adapted = self.rule == AlphaRule::Adapted;
        let has_judged = is_adapted && self.pool.judge(state.tree, cameras, now, is_next_soon);
        if !has_judged || !is_next_soon {
            self.measure(state, is_next_soon);
        }
    }

    /// Measures the quality of the worst case that was sampled last, a part of it if `is_part`.
    fn measure(&mut self, state: &ClientState, is_part: bool) {
        let Some(mut measured) = self.measured.take() else { return };
        while !measured.step(state.tree, state.resident()) {
            if is_part {
                self.measured = Some(measured);
                return;
            }
        }
        let (alpha, seconds) = (measured.alpha, measured.seconds);
        let quality;
        (quality, self.cut) = measured.finish();
        self.session.add_quality(quality, seconds);
        self.ascent.update(alpha, quality, seconds);
    }

    /// Bytes of its cuts.
    pub(super) fn heap_bytes(&self) -> usize {
        self.cut.heap_bytes() + self.pool.heap_bytes()
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
}

impl Means {
    fn add_alpha(&mut self, alpha: f64, seconds: f64) {
        self.seconds += seconds;
        self.alpha += seconds * alpha;
    }

    fn add_quality(&mut self, quality: Option<f64>, seconds: f64) {
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
