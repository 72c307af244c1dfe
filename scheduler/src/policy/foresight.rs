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
mod camera;
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
use crate::lod_tree::RepId;
use crate::predict::Predictor;
use crate::scheduler::{Action, Reason};
use crate::select::certified::Certificate;
use crate::setting::SettingError;
use crate::state::{ClientState, Request};
use crate::units::Time;
use crate::view::View;
use alpha::Alpha;
use camera::{Ahead, Camera, Sampling};
use certified::CertifiedChoice;
use context::{Choice, Choose, Context, Discarded, Lookahead};
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
    /// In the order in which the client names them; the first is there from the start.
    cameras: Vec<Camera>,
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
    /// Share of the predicted paths in the gain of the closure chosen last.
    predicted_share: f64,
    /// Why the last fetch was chosen.
    reason: Option<Reason>,
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
            cameras: vec![Camera::new(predictor)],
            track: Vec::new(),
            method: None,
            alpha: Alpha::new(settings.alpha_rule, settings.alpha),
            sampled: None,
            queued_bytes: 0,
            committed: VecDeque::new(),
            covered: false,
            retries: Retries::default(),
            mean_fetch_bytes: 0.0,
            predicted_share: 0.0,
            reason: None,
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

    /// Whether the time ahead has to be sampled anew.
    fn is_due(&self, now: Time) -> bool {
        self.sampled.is_none_or(|t| now.since(t).secs() >= self.settings.reuse_s)
    }

    /// The paths ahead of the cameras at `now`, and what is reachable if they fail.
    fn look_ahead(&mut self, state: &ClientState, now: Time) -> Lookahead {
        let s = self.settings;
        let typical = state.link.latency_s() + self.mean_fetch_bytes / state.link.rate();
        let epsilon = s.reuse_s.max(typical);
        let delta = s.horizon_s.max(4.0 * epsilon);
        let n = s.samples.max(1);
        let bounds: Vec<f64> = (0..=n).map(|i| delta * i as f64 / n as f64).collect();
        let middles: Vec<f64> = bounds.windows(2).map(|w| 0.5 * (w[0] + w[1])).collect();
        let sampling = Sampling { settings: &s, now, middles: &middles, epsilon, track: &self.track };
        let Ahead { paths, worst } = camera::look_ahead(&self.cameras, state, &sampling);
        let (cut, attenuation) = (&s.cut, s.attenuation);
        let prospect = alpha::Sampled { now, paths: &paths, offsets: &middles, worst: &worst, cut, attenuation };
        let alpha = self.alpha.at(state, &prospect);
        let anew = self.sampled.is_none();
        Lookahead { alpha, anew, cameras: self.cameras.len(), paths, bounds, worst }
    }

    /// Samples the time ahead.
    fn sample(&mut self, method: &mut dyn Choose, state: &ClientState, now: Time) {
        let ahead = self.look_ahead(state, now);
        self.sampled = Some(now);
        self.queued_bytes = state.outstanding_bytes();
        method.sample(&self.context(state, true), &ahead);
    }

    fn decide_with(&mut self, method: &mut dyn Choose, state: &ClientState, now: Time) -> Action {
        let wait = Action::WaitUntil(now + Time::from_secs(1.0 / 60.0));
        if state.view.is_none() {
            return wait;
        }
        if let Some(action) = self.committed.pop_front() {
            return action;
        }
        let link = &state.link;
        let full = !state.requests().is_empty()
            && state.outstanding_bytes() as f64 >= link.rate() * (link.latency_s() + self.settings.slack_s);
        let due = self.is_due(now);
        if due {
            self.sample(method, state, now);
            let cx = self.context(state, due);
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
                self.predicted_share = 1.0;
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
        self.predicted_share = choice.predicted_share;
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

impl Foresight {
    /// Made at the first decision, when the client's refinement is known.
    fn take_method(&mut self, state: &ClientState) -> Box<dyn Choose> {
        self.method.take().unwrap_or_else(|| {
            // Branch and bound knows closures by prerequisites, not by sibling groups.
            let bounded = state.planned().refinement() == Refinement::Partial;
            match self.settings.choice {
                ChoiceMethod::Certified if bounded => Box::new(CertifiedChoice::default()),
                _ => Box::new(Sampled::default()),
            }
        })
    }

    /// The plan follows what the client is about to do.
    fn obeyed(&mut self, method: &mut dyn Choose, state: &ClientState, action: &Action, now: Time) {
        let cx = self.context(state, false);
        match action {
            Action::Fetch { rep, discard_on_arrival } => {
                for &doomed in discard_on_arrival {
                    method.removed(&cx, doomed);
                }
                method.added(&cx, *rep);
                let wire = state.tree.wire_bytes(*rep);
                self.mean_fetch_bytes += 0.1 * (wire as f64 - self.mean_fetch_bytes);
                let bytes = state.outstanding_bytes() + wire;
                let seconds = match &self.oracle {
                    Some(oracle) => oracle(now, bytes),
                    None => state.link.latency_s() + bytes as f64 / state.link.rate(),
                };
                let arrival = now + Time::from_secs(seconds);
                self.reason = Some(Reason { predicted_share: self.predicted_share, arrival });
            }
            Action::Discard(rep) => method.removed(&cx, *rep),
            Action::Cancel(_) | Action::WaitUntil(_) => {}
        }
    }

    /// The plan has changed without this policy.
    fn read_anew(&mut self) {
        if let Some(method) = &mut self.method {
            method.forget();
        }
        self.sampled = None;
        self.committed.clear();
    }

    /// What goes while more memory is in use than the budget allows: residents by least loss per byte, and a request
    /// before them if it would lose less per byte of its own, or if the residents alone are too little.
    fn next_to_go(&mut self, method: &mut dyn Choose, state: &ClientState, now: Time) -> Option<Action> {
        if let Some(action) = self.committed.pop_front() {
            return Some(action);
        }
        if self.sampled.is_none() {
            self.sample(method, state, now);
        }
        let cx = self.context(state, false);
        let bytes = state.excess_bytes();
        let resident: u64 = state.residents().map(|rep| state.tree.decoded_bytes(rep)).sum();
        let Discarded { reps, loss } = method.make_room(&cx, bytes);
        let freed: u64 = reps.iter().map(|&rep| state.tree.decoded_bytes(rep)).sum();
        let is_enough = resident >= bytes && freed > 0;
        let requests = state.requests().iter().filter(|r| !state.is_needed(r.rep));
        let mut per_byte = |r: &Request| method.loss(&cx, r.rep) / state.request_bytes(r.rep).max(1) as f64;
        let least = requests.map(|r| (per_byte(r), r.rep)).min_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        if let Some((loss_per_byte, rep)) = least
            && (!is_enough || loss_per_byte < loss / freed as f64)
        {
            // What the request had doomed stays: read the plan anew.
            method.forget();
            self.sampled = None;
            return Some(Action::Cancel(rep));
        }
        self.committed.extend(reps.into_iter().map(Action::Discard));
        self.committed.pop_front()
    }
}

impl Policy for Foresight {
    fn name(&self) -> &str {
        &self.name
    }

    fn observe(&mut self, state: &ClientState, view: &View, now: Time) {
        self.observe_cameras(state, &[(1.0, *view)], now);
    }

    fn observe_cameras(&mut self, state: &ClientState, cameras: &[(f64, View)], now: Time) {
        let is_busy = self.is_due(now);
        self.alpha.observe(state, cameras, now, is_busy);
        let mut is_new = self.cameras.len() != cameras.len();
        let kind = self.settings.predictor;
        self.cameras.resize_with(cameras.len(), || Camera::new(kind.build()));
        for (camera, (share, view)) in self.cameras.iter_mut().zip(cameras) {
            is_new |= camera.observe(*share, view, now);
        }
        if is_new {
            // A teleport, or other cameras: nothing sampled before it holds.
            self.sampled = None;
            self.covered = false;
        }
        if let Some(method) = &mut self.method {
            method.observed();
        }
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        let mut method = self.take_method(state);
        let action = self.decide_with(&mut *method, state, now);
        self.obeyed(&mut *method, state, &action, now);
        self.method = Some(method);
        action
    }

    fn make_room(&mut self, state: &ClientState, now: Time) -> Option<Action> {
        state.view?;
        let mut method = self.take_method(state);
        let action = self.next_to_go(&mut *method, state, now);
        if let Some(action) = &action {
            self.obeyed(&mut *method, state, action, now);
        }
        self.method = Some(method);
        action
    }

    fn dropped(&mut self, state: &ClientState, _rep: RepId, _now: Time) {
        self.read_anew();
        // A client that has lost everything is given something first, as at the start.
        self.covered &= state.planned().iter().next().is_some();
    }

    fn changed(&mut self, _state: &ClientState) {
        self.read_anew();
    }

    fn reason(&self) -> Option<Reason> {
        self.reason
    }

    fn completed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        self.retries.completed(rep);
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, now: Time) {
        self.retries.failed(rep, now);
        self.read_anew();
    }

    fn alpha(&self) -> Option<AlphaReport> {
        Some(self.alpha.report())
    }

    fn announce_path(&mut self, path: &[(Time, View)]) {
        worst::extend_track(&mut self.track, path);
        // The first camera's.
        if self.cameras.first_mut().is_some_and(|camera| camera.announce_path(path)) {
            self.sampled = None;
        }
    }

    fn heap_bytes(&self) -> usize {
        self.alpha.heap_bytes() + self.method.as_ref().map_or(0, |method| method.heap_bytes())
    }

    fn certificate(&self) -> Option<Certificate> {
        self.method.as_ref()?.certificate()
    }
}
