//! The state machine that the simulator and the sidecar both drive. No I/O and no clock: it is told what happened and
//! when, and asked what to do next.

use crate::benefit::coverage::Refinement;
use crate::excess::Excess;
use crate::lod_tree::{LodTree, RepId};
use crate::policy::Policy;
use crate::policy::foresight::AlphaReport;
use crate::select::certified::Certificate;
use crate::setting::SettingError;
use crate::state::{ClientState, Status, smallest_closure};
use crate::transfer::{TransferEstimate, check_guesses};
use crate::units::Time;
use crate::view::{View, ViewError};

/// What the client shall do.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Request a representation. Its memory is reserved from now on.
    Fetch {
        /// What to request.
        rep: RepId,
        /// Residents that go when the last byte has come: until then they stay visible.
        discard_on_arrival: Vec<RepId>,
    },
    /// Abort the request; the bytes received so far are charged.
    Cancel(RepId),
    /// Free a resident representation.
    Discard(RepId),
    /// Nothing to do before this time, or before something happens.
    WaitUntil(Time),
}

/// Why something is fetched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reason {
    /// Share of the closure's gain that the predicted paths have, from 0 to 1; the rest is the worst case's. The gain
    /// is counted before what its discards lose.
    pub predicted_share: f64,
    /// When it is expected to be here, by the estimates of the link: after what has been requested before it. The gain
    /// is counted from about then on; what comes much later gains less than it was chosen for.
    pub arrival: Time,
}

/// Cameras of one client at most.
pub const CAMERAS_MAX: usize = 16;

/// What a scheduler is given once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SchedulerSettings {
    /// Memory for everything, bytes.
    pub budget: u64,
    /// When children count.
    pub refinement: Refinement,
    /// First guess of the link's rate, bytes/s.
    pub rate_guess: f64,
    /// First guess of the latency, seconds.
    pub latency_guess_s: f64,
}

impl SchedulerSettings {
    /// With the default guesses: 5 Mbit/s and 60 ms.
    pub fn with_budget(budget: u64) -> SchedulerSettings {
        SchedulerSettings { budget, refinement: Refinement::Partial, rate_guess: 625_000.0, latency_guess_s: 0.06 }
    }

    /// Refuses guesses that are not finite or have the wrong sign, naming the field.
    pub fn check(&self) -> Result<(), SettingError> {
        check_guesses(self.rate_guess, self.latency_guess_s)
    }
}

/// Why a scheduler waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waiting {
    /// No view has been observed.
    NoView,
    /// What was requested is on its way.
    Transfers,
    /// Nothing is resident, and the budget is below the smallest closure that could be shown.
    Budget {
        /// Bytes given.
        budget: u64,
        /// Bytes that the smallest takes while it is on its way; `None` in a world without representations.
        least: Option<u64>,
    },
    /// Nothing that fits gains enough.
    NothingGains,
}

impl core::fmt::Display for Waiting {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Waiting::NoView => write!(f, "no view has been observed"),
            Waiting::Transfers => write!(f, "what was requested is on its way"),
            Waiting::Budget { budget, least: Some(least) } => {
                write!(f, "the memory budget is {budget} bytes; expected at least {least}, the smallest usable closure")
            }
            Waiting::Budget { least: None, .. } => write!(f, "the world has no representation"),
            Waiting::NothingGains => write!(f, "nothing that fits gains enough"),
        }
    }
}

/// What cannot be done.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SchedulerError {
    /// The view has no finite meaning.
    #[error(transparent)]
    View(#[from] ViewError),
    /// A setting has no meaning.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// No camera, or more than [`CAMERAS_MAX`].
    #[error("{0} cameras were given; expected 1 to {CAMERAS_MAX}")]
    Cameras(usize),
    /// A camera that counts for nothing, or for more than a number can say.
    #[error("the weight of camera {index} is {weight}; expected a number from 1e-9 to 1e9")]
    CameraWeight {
        /// Place among the cameras, from 0.
        index: usize,
        /// As given.
        weight: f64,
    },
    /// An announced path goes back in time.
    #[error("view {index} of the announced path is at {at:?}, after one at {before:?}; expected times in order")]
    PathOrder {
        /// Place in the path, from 0.
        index: usize,
        /// Its time.
        at: Time,
        /// Time of the view before it.
        before: Time,
    },
    /// Time went backwards.
    #[error("an event at {now:?} came after one at {latest:?}; expected times in order")]
    Time {
        /// Time of the event.
        now: Time,
        /// Latest time seen.
        latest: Time,
    },
    /// The client reports on something it was not asked to do.
    #[error("representation {rep} was reported {event}, but it is {status:?}")]
    Unexpected {
        /// The representation.
        rep: u32,
        /// What was reported.
        event: &'static str,
        /// Where it is.
        status: Status,
    },
    /// An id beyond the tree.
    #[error("representation {rep} does not exist: the world has {count}")]
    NoSuchRepresentation {
        /// As given.
        rep: u32,
        /// Number of representations.
        count: usize,
    },
    /// A policy asked for something impossible: a bug in the policy, refused before it does harm.
    #[error(
        "policy {policy} asked for {what} of representation {rep}, which is {status:?}; {free} bytes of memory are free"
    )]
    Policy {
        /// Its name.
        policy: String,
        /// The action.
        what: &'static str,
        /// On what.
        rep: u32,
        /// Where it is.
        status: Status,
        /// Free memory.
        free: u64,
    },
}

/// How soon to ask again where only decoding can free memory.
const TICK: Time = Time(16_666_667);

/// The scheduler: a client's state and a policy.
pub struct Scheduler<'a> {
    state: ClientState<'a>,
    policy: Box<dyn Policy + 'a>,
    latest: Time,
    waits: bool,
    reason: Option<Reason>,
    excess: Excess,
}

impl<'a> Scheduler<'a> {
    /// A scheduler for one client of a world; refuses settings without meaning.
    pub fn checked(
        tree: &'a LodTree,
        settings: SchedulerSettings,
        policy: Box<dyn Policy + 'a>,
    ) -> Result<Scheduler<'a>, SchedulerError> {
        settings.check()?;
        Ok(Scheduler::new(tree, settings, policy))
    }

    /// As [`Scheduler::checked`], for settings that have passed [`SchedulerSettings::check`].
    pub fn new(tree: &'a LodTree, settings: SchedulerSettings, policy: Box<dyn Policy + 'a>) -> Scheduler<'a> {
        let link = TransferEstimate::new(settings.rate_guess, settings.latency_guess_s);
        Scheduler {
            state: ClientState::new(tree, settings.budget, settings.refinement, link),
            policy,
            latest: Time::ZERO,
            waits: false,
            reason: None,
            excess: Excess::default(),
        }
    }

    /// What is known about the client.
    pub fn state(&self) -> &ClientState<'a> {
        &self.state
    }

    /// Bytes that the session occupies beside the shared world, with what the policy says that it keeps.
    pub fn heap_bytes(&self) -> usize {
        self.state.heap_bytes() + self.policy.heap_bytes()
    }

    /// What became of α so far, for a policy that has one.
    pub fn alpha(&self) -> Option<AlphaReport> {
        self.policy.alpha()
    }

    fn pass(&mut self, now: Time) -> Result<(), SchedulerError> {
        if now < self.latest {
            return Err(SchedulerError::Time { now, latest: self.latest });
        }
        self.latest = now;
        Ok(())
    }

    fn expect(&self, rep: RepId, event: &'static str, allowed: &[Status]) -> Result<(), SchedulerError> {
        if rep.index() >= self.state.tree.representations() {
            return Err(SchedulerError::NoSuchRepresentation { rep: rep.0, count: self.state.tree.representations() });
        }
        let status = self.state.status(rep);
        if allowed.contains(&status) { Ok(()) } else { Err(SchedulerError::Unexpected { rep: rep.0, event, status }) }
    }

    /// Marks a representation as resident: before the session starts, or later, if the client has it by its own doing.
    /// Refused if it does not fit.
    pub fn preload(&mut self, rep: RepId) -> Result<(), SchedulerError> {
        self.expect(rep, "preloaded", &[Status::Absent])?;
        if self.state.tree.decoded_bytes(rep) > self.state.free_bytes() {
            return Err(self.refusal("preload", rep));
        }
        self.state.place(rep);
        self.policy.changed(&self.state);
        Ok(())
    }

    /// The camera is at `view` at `now`.
    pub fn observe(&mut self, view: &View, now: Time) -> Result<(), SchedulerError> {
        view.check()?;
        self.pass(now)?;
        self.state.view = Some(*view);
        self.state.cameras.clear();
        self.state.cameras.push((1.0, *view));
        self.policy.observe(&self.state, view, now);
        Ok(())
    }

    /// Several cameras with their weights are where they are at `now`: they share the link and the memory, and each
    /// counts by its share of the sum of the weights. A camera is known again by its place in the list. One camera is
    /// as [`Scheduler::observe`], whatever its weight. `foresight` and `added-benefit` weigh all cameras; the rivals
    /// follow the one of the largest weight, the first of equals ([`Policy::observe_cameras`]).
    pub fn observe_cameras(&mut self, cameras: &[(f64, View)], now: Time) -> Result<(), SchedulerError> {
        if cameras.is_empty() || cameras.len() > CAMERAS_MAX {
            return Err(SchedulerError::Cameras(cameras.len()));
        }
        let mut largest = 0;
        for (index, (weight, view)) in cameras.iter().enumerate() {
            if !(1e-9..=1e9).contains(weight) {
                return Err(SchedulerError::CameraWeight { index, weight: *weight });
            }
            view.check()?;
            if *weight > cameras[largest].0 {
                largest = index;
            }
        }
        if let [(_, only)] = cameras {
            return self.observe(only, now);
        }
        self.pass(now)?;
        let whole: f64 = cameras.iter().map(|(weight, _)| weight).sum();
        self.state.view = Some(cameras[largest].1);
        self.state.cameras.clear();
        self.state.cameras.extend(cameras.iter().map(|&(weight, view)| (weight / whole, view)));
        self.policy.observe_cameras(&self.state, &self.state.cameras, now);
        Ok(())
    }

    /// The client may use so many bytes from now on. Where that is less than it uses, [`Scheduler::next`] answers with
    /// cancellations and discards until it fits; only what is being decoded, and what that needs first, cannot be
    /// given up before it is resident, and nothing is fetched until then.
    pub fn set_budget(&mut self, bytes: u64) {
        self.state.budget = bytes;
        self.excess = Excess::default();
        self.policy.changed(&self.state);
    }

    /// Another policy decides from now on, about the same client. It learns where the cameras are; what it does not
    /// learn are the views before and the path announced.
    pub fn set_policy(&mut self, policy: Box<dyn Policy + 'a>) {
        self.policy = policy;
        (self.waits, self.reason) = (false, None);
        match &self.state.cameras[..] {
            [] => {}
            [(_, only)] => self.policy.observe(&self.state, only, self.latest),
            cameras => self.policy.observe_cameras(&self.state, cameras, self.latest),
        }
    }

    /// Tells where the camera will be: a `flyTo` or a recorded tour, as (time, view) in order.
    pub fn announce_path(&mut self, path: &[(Time, View)]) -> Result<(), SchedulerError> {
        for (index, (at, view)) in path.iter().enumerate() {
            view.check()?;
            if let Some(&(before, _)) = index.checked_sub(1).map(|before| &path[before])
                && before > *at
            {
                return Err(SchedulerError::PathOrder { index, at: *at, before });
            }
        }
        self.policy.announce_path(path);
        Ok(())
    }

    /// The first byte of `rep` came at `now`.
    pub fn responded(&mut self, rep: RepId, now: Time) -> Result<(), SchedulerError> {
        self.expect(rep, "responding", &[Status::InFlight])?;
        self.pass(now)?;
        self.state.responded(rep, now);
        Ok(())
    }

    /// `total` bytes have been received in the session; `in_flight` of them belong to requests still on their way.
    pub fn progress(&mut self, in_flight: u64, total: u64, now: Time) -> Result<(), SchedulerError> {
        self.pass(now)?;
        self.state.received(in_flight, total, now);
        Ok(())
    }

    /// The last byte of `rep` came at `now`; it will be decoded. Returns the discards that waited for this arrival: the
    /// client frees them before it decodes.
    pub fn arrived(&mut self, rep: RepId, now: Time) -> Result<Vec<RepId>, SchedulerError> {
        self.expect(rep, "arrived", &[Status::InFlight])?;
        self.pass(now)?;
        let Some(request) = self.state.end_request(rep, now) else { return Ok(Vec::new()) };
        self.state.arrive(&request);
        Ok(request.discard_on_arrival)
    }

    /// `rep` can be shown from `now` on. A client decodes a representation after its prerequisite.
    pub fn completed(&mut self, rep: RepId, now: Time) -> Result<(), SchedulerError> {
        self.expect(rep, "completed", &[Status::Arrived])?;
        self.pass(now)?;
        self.state.complete(rep);
        self.policy.completed(&self.state, rep, now);
        Ok(())
    }

    /// `rep` could not be fetched or decoded. What needs it can be shown no more and must be reported as failed too.
    pub fn failed(&mut self, rep: RepId, now: Time) -> Result<(), SchedulerError> {
        self.expect(rep, "failed", &[Status::InFlight, Status::Arrived])?;
        self.pass(now)?;
        match self.state.end_request(rep, now) {
            Some(request) => self.state.abandon(&request),
            None => self.state.drop_arrived(rep),
        }
        self.policy.failed(&self.state, rep, now);
        Ok(())
    }

    /// The client has let go of `rep` by itself: it has aborted the request or the decoding, or freed what was resident.
    /// What the request had doomed stays; a doomed one that is freed before its time is no longer waited for. It may be
    /// asked for again at once: nothing is held against it. What needs it can be shown no more, and has to be reported
    /// as dropped too, before or after it; until then that counts as there and keeps its memory.
    pub fn dropped(&mut self, rep: RepId, now: Time) -> Result<(), SchedulerError> {
        let held = [Status::InFlight, Status::Arrived, Status::Resident, Status::Doomed];
        self.expect(rep, "dropped", &held)?;
        self.pass(now)?;
        match self.state.status(rep) {
            Status::Resident => self.state.discard(rep),
            Status::Doomed => self.state.drop_doomed(rep),
            Status::Absent | Status::InFlight | Status::Arrived => match self.state.end_request(rep, now) {
                Some(request) => self.state.abandon(&request),
                None => self.state.drop_arrived(rep),
            },
        }
        self.policy.dropped(&self.state, rep, now);
        Ok(())
    }

    /// What to do now. Ask again after obeying, until the answer is `WaitUntil`.
    pub fn next(&mut self, now: Time) -> Result<Action, SchedulerError> {
        self.pass(now)?;
        let (action, is_own) = self.ask(now);
        self.waits = matches!(action, Action::WaitUntil(_));
        match &action {
            Action::Fetch { rep, discard_on_arrival } => {
                self.expect(*rep, "fetched", &[Status::Absent]).map_err(|_| self.refusal("a fetch", *rep))?;
                if !self.state.has_prerequisite(*rep) {
                    return Err(self.refusal("a fetch before its prerequisite", *rep));
                }
                let mut handed_over = 0;
                for (i, &doomed) in discard_on_arrival.iter().enumerate() {
                    let twice = discard_on_arrival[..i].contains(&doomed);
                    if self.state.status(doomed) != Status::Resident || self.state.is_needed(doomed) || twice {
                        return Err(self.refusal("a discard on arrival", doomed));
                    }
                    handed_over += self.state.tree.decoded_bytes(doomed);
                }
                let wire = self.state.tree.wire_bytes(*rep);
                let decoded = self.state.tree.decoded_bytes(*rep);
                if wire + decoded.saturating_sub(handed_over) > self.state.free_bytes() {
                    return Err(self.refusal("a fetch", *rep));
                }
                self.state.request(*rep, discard_on_arrival.clone(), now);
                self.reason = self.policy.reason();
            }
            Action::Cancel(rep) => {
                if self.state.is_needed(*rep) {
                    return Err(self.refusal("a cancellation", *rep));
                }
                let request = self.state.end_request(*rep, now).ok_or_else(|| self.refusal("a cancellation", *rep))?;
                self.state.abandon(&request);
            }
            Action::Discard(rep) => {
                if self.state.status(*rep) != Status::Resident || self.state.is_needed(*rep) {
                    return Err(self.refusal("a discard", *rep));
                }
                self.state.discard(*rep);
            }
            Action::WaitUntil(_) => {}
        }
        if let (false, Action::Cancel(rep) | Action::Discard(rep)) = (is_own, &action) {
            self.policy.dropped(&self.state, *rep, now);
        }
        Ok(action)
    }

    /// The next action, and whether it is the policy's own.
    fn ask(&mut self, now: Time) -> (Action, bool) {
        if self.state.excess_bytes() == 0 {
            return (self.policy.decide(&self.state, now), true);
        }
        match self.policy.make_room(&self.state, now) {
            Some(action) => (action, true),
            None => (self.excess.next(&self.state).unwrap_or(Action::WaitUntil(now + TICK)), false),
        }
    }

    /// Why the last fetch was chosen, where the policy can say.
    pub fn reason(&self) -> Option<Reason> {
        self.reason
    }

    /// Why the last answer was to wait; `None` if it was not. Takes time in the size of the world where nothing is
    /// resident.
    pub fn waiting_because(&self) -> Option<Waiting> {
        if !self.waits {
            return None;
        }
        let state = &self.state;
        if state.view.is_none() {
            return Some(Waiting::NoView);
        }
        if !state.requests().is_empty() || state.excess_bytes() > 0 {
            return Some(Waiting::Transfers);
        }
        if state.used_bytes() == 0 {
            let least = smallest_closure(state.tree, state.planned().refinement());
            if least.is_none_or(|least| least > state.budget) {
                return Some(Waiting::Budget { budget: state.budget, least });
            }
        }
        Some(Waiting::NothingGains)
    }

    /// What is proven about the policy's last choice, if it proves something.
    pub fn certificate(&self) -> Option<Certificate> {
        self.policy.certificate()
    }

    fn refusal(&self, what: &'static str, rep: RepId) -> SchedulerError {
        SchedulerError::Policy {
            policy: self.policy.name().to_owned(),
            what,
            rep: rep.0,
            status: self.state.status(rep),
            free: self.state.free_bytes(),
        }
    }
}
