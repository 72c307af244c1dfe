//! `foresight`: the objective of ARCHITECTURE.md with everything in it.
//!
//! Rank every closure by net return per second of link occupancy,
//!
//! ```text
//! G = Σ_terms share(t_a) · w · (a(R∖X ∪ r) − a(R)) ,   ratio = G / (c·M + o)
//! ```
//!
//! with the predicted paths weighing α and the worst case 1 − α; fetch the best while the pipeline has room; when memory
//! is full, grow the discards X by least loss per byte and swap only if the gain exceeds (1+η) times their loss; wait if
//! nothing gains. The time ahead is sampled anew every D seconds (\[ZK\] §6); between, only what a change of the plan touches
//! is evaluated again. What failed is asked for again after a while that doubles
//! with each failure.

mod alpha;
mod certified;
mod closure;
mod context;
mod retry;
mod sampled;
mod settings;
mod worst;

pub use alpha::{ALPHA_MAX, AT_LEAST, AlphaReport, AlphaRule, Constraint};
pub use settings::{ChoiceMethod, Discards, ForesightSettings};

use super::Policy;
use crate::benefit::coverage::Refinement;
use crate::benefit::cut::Region;
use crate::lod_tree::RepId;
use crate::predict::motion::Motion;
use crate::predict::{PredictedPath, Predictor};
use crate::scheduler::Action;
use crate::select::certified::Certificate;
use crate::setting::SettingError;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use alpha::Alpha;
use certified::CertifiedChoice;
use context::{Choice, Choose, Context, Lookahead};
use retry::Retries;
use sampled::Sampled;
use std::collections::VecDeque;

/// When `bytes` more than what is outstanding will have come, seconds from now; the true link, for a simulator to give.
pub type ArrivalOracle = Box<dyn Fn(Time, u64) -> f64 + Send>;

/// The policy.
pub struct Foresight {
    name: String,
    oracle: Option<ArrivalOracle>,
    settings: ForesightSettings,
    predictor: Box<dyn Predictor>,
    motion: Motion,
    /// The path that the client has announced: where a path-bound one can go.
    track: Vec<glam::DVec3>,
    /// Made at the first decision, when the client's refinement is known.
    method: Option<Box<dyn Choose>>,
    alpha: Alpha,
    sampled: Option<Time>,
    /// Outstanding when the objective was sampled.
    queued_bytes: u64,
    /// Rest of a closure that has been begun, and discards that must come first.
    committed: VecDeque<Action>,
    covered: bool,
    retries: Retries,
    mean_fetch_bytes: f64,
}

impl Foresight {
    /// The policy under `name`.
    pub fn new(name: impl Into<String>, settings: ForesightSettings) -> Foresight {
        Foresight::with_predictor(name, settings, settings.predictor.build())
    }

    /// As [`Foresight::new`]; refuses settings that no decision could be made with.
    pub fn checked(name: impl Into<String>, settings: ForesightSettings) -> Result<Foresight, SettingError> {
        settings.check()?;
        Ok(Foresight::new(name, settings))
    }

    /// With a predictor of one's own: the simulator's `clairvoyant` knows the true path.
    pub fn with_predictor(
        name: impl Into<String>,
        settings: ForesightSettings,
        predictor: Box<dyn Predictor>,
    ) -> Foresight {
        Foresight {
            name: name.into(),
            oracle: None,
            settings,
            predictor,
            motion: Motion::default(),
            track: Vec::new(),
            method: None,
            alpha: Alpha::new(settings.alpha_rule, settings.alpha),
            sampled: None,
            queued_bytes: 0,
            committed: VecDeque::new(),
            covered: false,
            retries: Retries::default(),
            mean_fetch_bytes: 0.0,
        }
    }

    /// Takes arrivals from `oracle` instead of the estimates of c and τ.
    pub fn with_oracle(mut self, oracle: ArrivalOracle) -> Foresight {
        self.oracle = Some(oracle);
        self
    }

    fn context<'c, 'a>(&'c self, state: &'c ClientState<'a>, due: bool) -> Context<'c, 'a> {
        Context {
            settings: &self.settings,
            state,
            retries: &self.retries,
            oracle: self.oracle.as_ref(),
            sampled: self.sampled.unwrap_or(Time::ZERO),
            queued_bytes: self.queued_bytes,
            due,
        }
    }

    /// The paths ahead from `view` at `now`, and what is reachable if they fail.
    fn look_ahead(&mut self, state: &ClientState, view: View, now: Time) -> Lookahead {
        let s = self.settings;
        let typical = state.link.latency_s() + self.mean_fetch_bytes / state.link.rate();
        let epsilon = s.reuse_s.max(typical);
        let delta = s.horizon_s.max(4.0 * epsilon);
        let n = s.samples.max(1);
        let bounds: Vec<f64> = (0..=n).map(|i| delta * i as f64 / n as f64).collect();
        let middles: Vec<f64> = bounds.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
        let mut paths = self.predictor.predict(now, &middles);
        if paths.is_empty() {
            paths.push(PredictedPath { weight: 1.0, views: vec![view; n] });
        }
        // A predictor of one's own may go astray.
        for astray in paths.iter_mut().flat_map(|path| &mut path.views).filter(|view| view.check().is_err()) {
            *astray = view;
        }
        let (tree, plan, speeds) = (state.tree, state.planned(), self.motion.percentile());
        let (region, worst_views) = worst::sampled(&s, tree, plan, &view, speeds, epsilon, &self.track);
        let worst: Vec<_> = match &worst_views {
            None => vec![(1.0, view, region)],
            Some(views) => views.iter().map(|&(weight, view)| (weight, view, Region::Frustum)).collect(),
        };
        let (cut, attenuation) = (&s.cut, s.attenuation);
        let prospect = alpha::Sampled { now, paths: &paths, offsets: &middles, worst: &worst, cut, attenuation };
        let alpha = self.alpha.at(state, &prospect);
        let anew = self.sampled.is_none();
        Lookahead { alpha, anew, paths, bounds, view, region, worst_views }
    }

    fn decide_with(&mut self, method: &mut dyn Choose, state: &ClientState, now: Time) -> Action {
        let wait = Action::WaitUntil(now + Time::from_secs(1.0 / 60.0));
        let Some(view) = state.view else { return wait };
        if let Some(action) = self.committed.pop_front() {
            return action;
        }
        let link = &state.link;
        let full = !state.requests().is_empty()
            && state.outstanding_bytes() as f64 >= link.rate() * (link.latency_s() + self.settings.slack_s);
        let due = self.sampled.is_none_or(|t| now.since(t).secs() >= self.settings.reuse_s);
        if due {
            let ahead = self.look_ahead(state, view, now);
            self.sampled = Some(now);
            self.queued_bytes = state.outstanding_bytes();
            let cx = self.context(state, due);
            method.sample(&cx, &ahead);
            if let Some(rep) = method.pointless_request(&cx) {
                // What the request had doomed stays: read the plan anew.
                method.forget();
                self.sampled = None;
                return Action::Cancel(rep);
            }
        }
        method.prepare(&self.context(state, due));
        if full {
            return wait;
        }
        let cx = self.context(state, due);
        if self.settings.cover_first && !self.covered {
            if let Some(rep) = method.cover(&cx) {
                return Action::Fetch { rep, discard_on_arrival: Vec::new() };
            }
            self.covered = true;
        }
        let choice = method.choose(&self.context(state, due));
        choice.map_or(wait, |choice| self.commit(state, choice))
    }

    /// Turns a choice into actions: discards wait for the arrival where memory allows.
    fn commit(&mut self, state: &ClientState, choice: Choice) -> Action {
        let tree = state.tree;
        let mut discards = choice.discards;
        if let [only] = choice.members[..] {
            let handed_over: u64 = discards.iter().map(|&d| tree.decoded_bytes(d)).sum();
            let reserve = tree.wire_bytes(only) + tree.decoded_bytes(only).saturating_sub(handed_over);
            if reserve <= state.free_bytes() {
                return Action::Fetch { rep: only, discard_on_arrival: discards };
            }
        }
        self.committed.extend(discards.drain(..).map(Action::Discard));
        let fetches = choice.members.iter().map(|&rep| Action::Fetch { rep, discard_on_arrival: Vec::new() });
        self.committed.extend(fetches);
        self.committed.pop_front().unwrap_or(Action::WaitUntil(Time::ZERO))
    }
}

impl Policy for Foresight {
    fn name(&self) -> &str {
        &self.name
    }

    fn observe(&mut self, state: &ClientState, view: &View, now: Time) {
        self.alpha.observe(state.tree, view, now);
        if self.motion.observe(view, now) {
            // A teleport: nothing sampled before it holds.
            self.sampled = None;
            self.covered = false;
        }
        self.predictor.observe(view, now);
        if let Some(method) = &mut self.method {
            method.observed();
        }
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        let mut method = self.method.take().unwrap_or_else(|| {
            // Branch and bound knows closures by prerequisites, not by sibling groups.
            let bounded = state.planned().refinement() == Refinement::Partial;
            match self.settings.choice {
                ChoiceMethod::Certified if bounded => Box::new(CertifiedChoice::default()),
                _ => Box::new(Sampled::default()),
            }
        });
        let action = self.decide_with(&mut *method, state, now);
        let cx = self.context(state, false);
        match &action {
            Action::Fetch { rep, discard_on_arrival } => {
                for &doomed in discard_on_arrival {
                    method.removed(&cx, doomed);
                }
                method.added(&cx, *rep);
                let bytes = state.tree.wire_bytes(*rep) as f64;
                self.mean_fetch_bytes += 0.1 * (bytes - self.mean_fetch_bytes);
            }
            Action::Discard(rep) => method.removed(&cx, *rep),
            Action::Cancel(_) | Action::WaitUntil(_) => {}
        }
        self.method = Some(method);
        action
    }

    fn completed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        self.retries.completed(rep);
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, now: Time) {
        self.retries.failed(rep, now);
        if let Some(method) = &mut self.method {
            method.forget();
        }
        self.sampled = None;
        self.committed.clear();
    }

    fn alpha(&self) -> Option<AlphaReport> {
        Some(self.alpha.report())
    }

    fn announce_path(&mut self, path: &[(Time, View)]) {
        worst::extend_track(&mut self.track, path);
        if self.predictor.announce_path(path) {
            self.sampled = None;
        }
    }

    fn certificate(&self) -> Option<Certificate> {
        self.method.as_ref()?.certificate()
    }
}
