//! Moments of a replay, kept so that every estimator can be asked about the same.

use crate::replay::{ReplayError, Stage, replay};
use foresight_scheduler::benefit::coverage::Coverage;
use foresight_scheduler::benefit::cut::{Cut, Region};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::predict::motion::Motion;
use foresight_scheduler::predict::{PredictedPath, Predictor};
use foresight_scheduler::scheduler::{Action, SchedulerSettings};
use foresight_scheduler::state::ClientState;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, tick_time};
use foresight_traces::link::LinkTrace;
use std::sync::{Arc, Mutex};

/// A world, a flight and a link on which situations are captured.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// Names the rows.
    pub name: &'a str,
    /// The world.
    pub tree: &'a LodTree,
    /// The camera.
    pub flight: &'a Flight,
    /// The link.
    pub link: &'a LinkTrace,
    /// Memory budget, bytes.
    pub memory: u64,
}

/// What a decision is made from.
#[derive(Clone, Debug)]
pub struct Situation {
    /// When.
    pub at: Time,
    /// Where the camera is.
    pub view: View,
    /// What is resident or under way.
    pub planned: Coverage,
    /// Ends of the intervals of [t, t+δ], seconds from now, ascending from 0 to δ.
    pub bounds: Vec<f64>,
    /// The predicted paths, a view at the middle of each interval: what decisions sample.
    pub middles: Vec<PredictedPath>,
    /// The same paths, a view at the end of each interval: the ends of their legs.
    pub ends: Vec<PredictedPath>,
    /// As `bounds` and `middles`, with eight times as many intervals: a fine quadrature.
    pub fine: (Vec<f64>, Vec<PredictedPath>),
    /// Seconds until the first byte of a request made now would have come.
    pub first_byte_s: f64,
    /// Seconds until a typical request made now would have come.
    pub arrival_s: f64,
    /// ε, seconds.
    pub epsilon_s: f64,
    /// What is reachable within ε.
    pub region: Region,
    /// Bytes a second of busy link.
    pub rate: f64,
    /// Memory left, bytes.
    pub free_bytes: u64,
}

/// Intervals of the fine quadrature for each of those that decisions use.
const FINER: usize = 8;

/// Replays `foresight` and keeps `count` situations at equal spacing; the first lies one spacing after the start, so that
/// there is motion to predict from.
///
/// # Errors
/// The replay fails: its budget is below what can be used.
pub fn capture(source: &Source, settings: &ForesightSettings, count: usize) -> Result<Vec<Situation>, ReplayError> {
    let ticks = source.flight.views.len();
    let due = (1..=count).map(|i| tick_time((i * ticks / (count + 1)) as u64)).collect();
    let kept = Arc::new(Mutex::new(Vec::new()));
    let probe = Probe {
        inner: Foresight::new("foresight", *settings),
        settings: *settings,
        predictor: settings.predictor.build(),
        motion: Motion::default(),
        due,
        kept: kept.clone(),
        mean_fetch_bytes: 0.0,
    };
    // Nothing is judged: the frames' cuts stay empty.
    let cuts = vec![Cut::default(); source.flight.frames()];
    let stage = Stage {
        tree: source.tree,
        flight: source.flight,
        cuts: &cuts,
        link: source.link,
        link_start: Time::ZERO,
        client: ClientSettings::default(),
        scheduler: SchedulerSettings::with_budget(source.memory),
        preloaded: &[],
    };
    replay(stage, Box::new(probe))?;
    // The replay has dropped its policy, the only other owner.
    let kept = Arc::into_inner(kept).and_then(|kept| kept.into_inner().ok());
    Ok(kept.unwrap_or_default())
}

/// `foresight`, and beside it the predictor and the motion by which its situations can be told.
struct Probe {
    inner: Foresight,
    settings: ForesightSettings,
    predictor: Box<dyn Predictor>,
    motion: Motion,
    /// When to keep a situation, in order of time.
    due: Vec<Time>,
    kept: Arc<Mutex<Vec<Situation>>>,
    mean_fetch_bytes: f64,
}

impl Probe {
    fn keep(&mut self, state: &ClientState, now: Time) {
        let Some(view) = state.view else { return };
        let s = &self.settings;
        let typical = state.link.latency_s() + self.mean_fetch_bytes / state.link.rate();
        let epsilon_s = s.reuse_s.max(typical);
        let delta_s = s.horizon_s.max(4.0 * epsilon_s);
        let n = s.samples.max(1);
        let bounds: Vec<f64> = (0..=n).map(|i| delta_s * i as f64 / n as f64).collect();
        let predict = |offsets: &[f64]| {
            let paths = self.predictor.predict(now, offsets);
            if paths.is_empty() { vec![PredictedPath { weight: 1.0, views: vec![view; offsets.len()] }] } else { paths }
        };
        let middles = predict(&bounds.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect::<Vec<_>>());
        let ends = predict(&bounds[1..]);
        let fine: Vec<f64> = (0..=FINER * n).map(|i| delta_s * i as f64 / (FINER * n) as f64).collect();
        let fine_middles = predict(&fine.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect::<Vec<_>>());
        let queued = state.outstanding_bytes() as f64 + self.mean_fetch_bytes;
        let situation = Situation {
            at: now,
            view,
            planned: state.planned().clone(),
            bounds,
            middles,
            ends,
            fine: (fine, fine_middles),
            first_byte_s: state.link.latency_s() + state.outstanding_bytes() as f64 / state.link.rate(),
            arrival_s: (state.link.latency_s() + queued / state.link.rate()).min(0.9 * delta_s),
            epsilon_s,
            region: s.reach.region(self.motion.percentile(), epsilon_s),
            rate: state.link.rate(),
            free_bytes: state.free_bytes(),
        };
        if let Ok(mut kept) = self.kept.lock() {
            kept.push(situation);
        }
    }
}

impl Policy for Probe {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn observe(&mut self, state: &ClientState, view: &View, now: Time) {
        self.motion.observe(view, now);
        self.predictor.observe(view, now);
        self.inner.observe(state, view, now);
        if self.due.first().is_some_and(|due| now >= *due) {
            self.due.remove(0);
            self.keep(state, now);
        }
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        let action = self.inner.decide(state, now);
        if let Action::Fetch { rep, .. } = &action {
            let bytes = state.tree.wire_bytes(*rep) as f64;
            self.mean_fetch_bytes += 0.1 * (bytes - self.mean_fetch_bytes);
        }
        action
    }

    fn completed(&mut self, state: &ClientState, rep: RepId, now: Time) {
        self.inner.completed(state, rep, now);
    }

    fn failed(&mut self, state: &ClientState, rep: RepId, now: Time) {
        self.inner.failed(state, rep, now);
    }
}
