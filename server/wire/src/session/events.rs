//! What the client reports about representations and bytes.

use super::{Answers, Session, report};
use crate::message::{ErrorCode, Event, Mode, Progress, ServerMessage};
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::state::Status;
use foresight_scheduler::units::Time;
use std::collections::BTreeSet;

/// Most bytes that a client may claim to have received: all integers up to it are exact in JSON.
const RECEIVED_MAX: u64 = 1 << 53;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Responded,
    Arrived,
    Completed,
    Failed,
    Dropped,
}

impl Kind {
    fn word(self) -> &'static str {
        match self {
            Kind::Responded => "responded",
            Kind::Arrived => "arrived",
            Kind::Completed => "completed",
            Kind::Failed => "failed",
            Kind::Dropped => "dropped",
        }
    }
}

impl Session<'_> {
    /// Whether the client fetches by its own rules too.
    pub(super) fn fetches_by_itself(&self) -> bool {
        self.mode != Mode::Drive || !self.driving
    }

    pub(super) fn event(&mut self, kind: Kind, event: &Event, answers: &mut Answers) {
        let (rep, count) = (RepId(event.rep), self.world.tree.representations());
        if rep.index() >= count {
            let message = format!("representation {} was reported {}; the world has {count}", rep.0, kind.word());
            return answers.error(ErrorCode::Event, message);
        }
        let now = self.event_time(event.t_ns, answers);
        let status = self.scheduler.state().status(rep);
        if let Some(spoken_of) = &mut self.resuming {
            spoken_of.insert(rep.0);
        }
        match (kind, status) {
            // Said once more after a break.
            (Kind::Responded | Kind::Arrived, Status::Arrived) if self.resuming.is_some() => {}
            (Kind::Responded, Status::InFlight) => {
                let outcome = self.scheduler.responded(rep, now);
                report(outcome, ErrorCode::Event, answers);
            }
            (Kind::Arrived, Status::InFlight) => self.arrived(rep, now, answers),
            (Kind::Completed, Status::InFlight) => {
                // A client that does not tell arrivals apart.
                self.arrived(rep, now, answers);
                self.completed(rep, now, answers);
            }
            (Kind::Completed, Status::Arrived) => self.completed(rep, now, answers),
            (Kind::Failed, Status::InFlight | Status::Arrived) => {
                self.doomed.remove(&rep.0);
                let outcome = self.scheduler.failed(rep, now);
                report(outcome, ErrorCode::Event, answers);
                self.give_up_what_needs(rep, now, answers);
            }
            (Kind::Dropped, Status::InFlight | Status::Arrived | Status::Resident | Status::Doomed) => {
                self.dropped(rep, now, answers);
                self.give_up_what_needs(rep, now, answers);
            }
            _ => self.unexpected(kind, rep, status, now, answers),
        }
        if matches!(kind, Kind::Failed | Kind::Dropped) {
            // It knows.
            answers.given_up.remove(&rep.0);
        }
    }

    pub(super) fn arrived(&mut self, rep: RepId, now: Time, answers: &mut Answers) {
        self.doomed.remove(&rep.0);
        let outcome = self.scheduler.arrived(rep, now);
        report(outcome, ErrorCode::Event, answers);
    }

    pub(super) fn completed(&mut self, rep: RepId, now: Time, answers: &mut Answers) {
        let outcome = self.scheduler.completed(rep, now);
        report(outcome, ErrorCode::Event, answers);
    }

    pub(super) fn dropped(&mut self, rep: RepId, now: Time, answers: &mut Answers) {
        self.doomed.remove(&rep.0);
        let outcome = self.scheduler.dropped(rep, now);
        report(outcome, ErrorCode::Event, answers);
    }

    /// An event of something that is elsewhere than the event supposes.
    fn unexpected(&mut self, kind: Kind, rep: RepId, status: Status, now: Time, answers: &mut Answers) {
        let has_crossed = self.let_go.contains(rep);
        if kind == Kind::Arrived && status == Status::Absent {
            for gone in self.let_go.take_doomed(rep) {
                if self.scheduler.state().status(gone) == Status::Resident {
                    self.dropped(gone, now, answers);
                    self.give_up_what_needs(gone, now, answers);
                }
            }
        }
        if self.fetches_by_itself() {
            let counts = kind == Kind::Completed || kind == Kind::Arrived && self.mode == Mode::Warm;
            if counts && status == Status::Absent {
                self.adopt(rep);
            }
            return;
        }
        if !has_crossed {
            let message = format!("representation {} was reported {}, but it is {status:?}", rep.0, kind.word());
            answers.error(ErrorCode::Event, message);
        }
        // It holds what it should not.
        match (kind, status) {
            (Kind::Responded | Kind::Arrived, Status::Absent) => answers.push(ServerMessage::Cancel { rep: rep.0 }),
            (Kind::Completed, Status::Absent) => answers.push(ServerMessage::Discard { rep: rep.0 }),
            _ => {}
        }
    }

    /// What the client has by its own doing counts as resident if it fits; whether it does.
    pub(super) fn adopt(&mut self, rep: RepId) -> bool {
        let state = self.scheduler.state();
        let is_usable = state.status(rep) == Status::Absent && state.has_prerequisite(rep);
        is_usable && self.scheduler.preload(rep).is_ok()
    }

    /// Gives up what needs `gone`, and all that needs that.
    pub(super) fn give_up_what_needs(&mut self, gone: RepId, now: Time, answers: &mut Answers) {
        let tree = self.world.tree;
        if !tree.has_prerequisites() {
            return;
        }
        // What is needed first has the lower id: one pass in order finds all that hangs on it.
        let state = self.scheduler.state();
        let held: BTreeSet<RepId> =
            state.planned().iter().chain(state.resident().iter()).filter(|r| *r > gone).collect();
        let mut lost = BTreeSet::from([gone]);
        for rep in held {
            if !tree.prerequisite(rep).is_some_and(|p| lost.contains(&p)) {
                continue;
            }
            lost.insert(rep);
            let can_be_shown = matches!(self.scheduler.state().status(rep), Status::Resident | Status::Doomed);
            self.dropped(rep, now, answers);
            self.let_go.insert(rep, now, Vec::new());
            answers.given_up.insert(rep.0, can_be_shown);
        }
    }

    pub(super) fn progress(&mut self, progress: &Progress, answers: &mut Answers) {
        let (total, in_flight) = (progress.total_bytes, progress.in_flight_bytes);
        if total > RECEIVED_MAX || in_flight > total {
            let message = format!(
                "{total} bytes received in all, {in_flight} of them of requests under way; expected at most {RECEIVED_MAX}, and no more under way than in all"
            );
            return answers.error(ErrorCode::Value, message);
        }
        if total < self.received {
            // It has begun to count anew.
            self.received_before = self.received_before.saturating_add(self.received);
        }
        self.received = total;
        let now = self.event_time(progress.t_ns, answers);
        let outcome = self.scheduler.progress(in_flight, self.received_before.saturating_add(total), now);
        report(outcome, ErrorCode::Event, answers);
    }

    /// After the events of a frame: what follows from them is said.
    pub(super) fn settle(&mut self, answers: &mut Answers) {
        if let Some(spoken_of) = self.resuming.take() {
            let now = self.clock.latest();
            let planned = self.scheduler.state().planned();
            let over: Vec<RepId> = planned.iter().filter(|r| !spoken_of.contains(&r.0)).collect();
            // What needs another has the higher id.
            for rep in over.into_iter().rev() {
                if matches!(self.scheduler.state().status(rep), Status::InFlight | Status::Arrived) {
                    self.dropped(rep, now, answers);
                    // It may arrive all the same before the client has let go of it.
                    self.let_go.insert(rep, now, Vec::new());
                    self.give_up_what_needs(rep, now, answers);
                }
            }
        }
        if self.fetches_by_itself() {
            answers.given_up.clear();
        }
        for (rep, can_be_shown) in core::mem::take(&mut answers.given_up) {
            answers.push(if can_be_shown { ServerMessage::Discard { rep } } else { ServerMessage::Cancel { rep } });
        }
    }
}
