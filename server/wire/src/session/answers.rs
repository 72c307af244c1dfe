//! What the session says, and when it says nothing.

use super::{Mode, SHADOW_NS, Session};
use crate::message::{Certificate, Error, ErrorCode, Estimates, Fetch, ServerMessage};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::scheduler::{Action, Waiting};
use foresight_scheduler::units::Time;
use std::collections::BTreeMap;

/// Least time between two messages of estimates, ns.
const ESTIMATES_NS: u64 = 1_000_000_000;
/// Opening angle of the cut by which the quality is estimated: as coarse as that of decisions.
const OPENING: f64 = 0.3;

/// The answers to one input.
#[derive(Debug)]
pub(super) struct Answers {
    out: Vec<ServerMessage>,
    errors: usize,
    errors_max: usize,
    /// What was given up because what it needs is gone, and whether it could be shown.
    pub(super) given_up: BTreeMap<u32, bool>,
}

impl Answers {
    pub(super) fn new(errors_max: usize) -> Answers {
        Answers { out: Vec::new(), errors: 0, errors_max: errors_max.max(1), given_up: BTreeMap::new() }
    }

    pub(super) fn push(&mut self, message: ServerMessage) {
        self.out.push(message);
    }

    /// Before everything else.
    pub(super) fn push_first(&mut self, message: ServerMessage) {
        self.out.insert(0, message);
    }

    pub(super) fn error(&mut self, code: ErrorCode, message: impl Into<String>) {
        self.errors += 1;
        if self.errors <= self.errors_max {
            self.out.push(ServerMessage::Error(Error { code, message: message.into(), fatal: false }));
        }
    }

    pub(super) fn finish(mut self) -> Vec<ServerMessage> {
        if let more @ 1.. = self.errors.saturating_sub(self.errors_max) {
            let message = format!("{more} more errors of this frame; expected none");
            self.out.push(ServerMessage::Error(Error { code: ErrorCode::Limit, message, fatal: false }));
        }
        self.out
    }
}

/// What was said before, so that only news is said.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Said {
    waiting: Option<Waiting>,
    /// Why a client that holds nothing waits, with the budget for which that was found out: it takes time.
    empty: Option<(u64, Waiting)>,
    estimated: Option<Time>,
}

impl Session<'_> {
    /// Says why there is nothing to do, if that is news.
    pub(super) fn say_wait(&mut self, answers: &mut Answers) {
        let state = self.scheduler.state();
        let (budget, is_empty) = (state.budget, state.view.is_some() && state.used_bytes() == 0);
        let waiting = match self.said.empty {
            Some((of, waiting)) if is_empty && of == budget => Some(waiting),
            _ => self.scheduler.waiting_because(),
        };
        self.said.empty = waiting.filter(|_| is_empty).map(|waiting| (budget, waiting));
        if waiting != self.said.waiting {
            self.said.waiting = waiting;
            let until_ns = self.clock.on_client(self.until);
            answers.push(ServerMessage::Wait { until_ns, because: waiting.map(|waiting| waiting.to_string()) });
        }
    }

    /// As to a client that knows nothing yet.
    pub(super) fn say_anew(&mut self) {
        self.said.waiting = None;
        self.said.estimated = None;
    }

    pub(super) fn word_fetch(&self, rep: RepId, discard_on_arrival: &[RepId], now: Time) -> ServerMessage {
        let (tree, state) = (self.world.tree, self.scheduler.state());
        let reason = self.scheduler.reason();
        let predicted_share = reason.map(|reason| reason.predicted_share).filter(|share| share.is_finite());
        // The request itself is among what is outstanding.
        let by_link = || {
            let link = &state.link;
            now + Time::from_secs(link.latency_s() + state.outstanding_bytes() as f64 / link.rate())
        };
        let deadline = reason.map_or_else(by_link, |reason| reason.arrival);
        ServerMessage::Fetch(Fetch {
            rep: rep.0,
            uri: (self.world.uri)(rep),
            wire_bytes: tree.wire_bytes(rep),
            decoded_bytes: tree.decoded_bytes(rep),
            urgency: self.urgency(rep, predicted_share),
            deadline_ns: self.clock.on_client(deadline),
            predicted_share,
            after: tree.prerequisite(rep).map(|first| first.0),
            discard_on_arrival: discard_on_arrival.iter().map(|rep| rep.0).collect(),
        })
    }

    /// RFC 9218 urgency of a fetch. In view now: 0 where nothing is shown yet, 1 where something better comes, 2 if more
    /// than half of the gain is the worst case's. Not in view: 3, the default of the RFC, if all of the gain lies on the
    /// predicted path, to 7 if all is the worst case's; 5 where the policy cannot say.
    fn urgency(&self, rep: RepId, predicted_share: Option<f64>) -> u8 {
        let (tree, state) = (self.world.tree, self.scheduler.state());
        let node = tree.node_of(rep);
        let (centre, half) = (tree.centre(node), tree.half(node));
        let is_seen = state.cameras().iter().any(|(_, view)| {
            let frustum = Frustum::new(view);
            frustum.side(centre - frustum.eye, half) != Side::Outside
        });
        let is_first =
            || !tree.ancestors(node).flat_map(|n| tree.own(n)).any(|r| r != rep && state.planned().contains(r));
        match (is_seen, predicted_share) {
            (true, _) if is_first() => 0,
            (true, share) if share.is_none_or(|share| share >= 0.5) => 1,
            (true, _) => 2,
            (false, share) => 3 + libm::round(4.0 * (1.0 - share.unwrap_or(0.5).clamp(0.0, 1.0))) as u8,
        }
    }

    /// Says what the scheduler believes, once a second while there is a view.
    pub(super) fn estimate(&mut self, answers: &mut Answers) {
        let now = self.clock.latest();
        let is_due = self.said.estimated.is_none_or(|last| now.since(last).0 >= ESTIMATES_NS);
        if !is_due || self.scheduler.state().view.is_none() {
            return;
        }
        self.said.estimated = Some(now);
        let state = self.scheduler.state();
        let certificate = self.scheduler.certificate().filter(|certificate| certificate.regret.is_finite());
        answers.push(ServerMessage::Estimates(Estimates {
            t_ns: self.clock.on_client(now),
            rate: state.link.rate(),
            latency_s: state.link.latency_s(),
            used_bytes: state.used_bytes(),
            quality: self.quality(),
            alpha: self.scheduler.alpha().map(|report| report.alpha).filter(|alpha| alpha.is_finite()),
            certificate: certificate.map(|c| Certificate { regret: c.regret, cut_short: c.cut_short }),
        }));
    }

    /// Q of the present views by what is resident, each by its share; `None` where nothing is in view.
    pub fn quality(&self) -> Option<f64> {
        let (tree, state) = (self.world.tree, self.scheduler.state());
        let settings = CutSettings { opening: OPENING, ..CutSettings::default() };
        let mut cut = Cut::default();
        let (mut sum, mut shares) = (0.0, 0.0);
        for (share, view) in state.cameras() {
            cut.make(tree, view, Region::Frustum, &settings);
            if let Some(quality) = evaluate(tree, &cut, state.resident(), |_| {}).mean() {
                sum += share * quality;
                shares += share;
            }
        }
        (shares > 0.0).then(|| sum / shares)
    }

    /// Decides by what the client holds, and takes it back; true, so that the next decision is not put off.
    pub(super) fn decide_in_shadow(&mut self, now: Time) -> bool {
        if self.shadowed.is_some_and(|last| now.since(last).0 < SHADOW_NS) {
            return true;
        }
        self.shadowed = Some(now);
        let (mut fetched, mut discarded) = (Vec::new(), Vec::new());
        for _ in 0..self.limits.actions_max {
            let Ok(action) = self.scheduler.next(now) else { break };
            let message = match &action {
                Action::Fetch { rep, discard_on_arrival } => {
                    fetched.push(*rep);
                    self.word_fetch(*rep, discard_on_arrival, now)
                }
                Action::Discard(rep) => {
                    discarded.push(*rep);
                    ServerMessage::Discard { rep: rep.0 }
                }
                Action::Cancel(rep) => {
                    fetched.retain(|fetched| fetched != rep);
                    self.doomed.remove(&rep.0);
                    ServerMessage::Cancel { rep: rep.0 }
                }
                Action::WaitUntil(until) => {
                    self.until = *until;
                    break;
                }
            };
            self.unsent.push(message);
        }
        // What needs another has been fetched after it.
        for rep in fetched.into_iter().rev() {
            // It is on its way: the scheduler has just said so.
            drop(self.scheduler.dropped(rep, now));
        }
        // The last to go needed those before, or nothing did.
        for rep in discarded.into_iter().rev() {
            self.adopt(rep);
        }
        debug_assert_eq!(self.mode, Mode::Shadow);
        true
    }
}
