//! The discrete-event simulator: one policy, one flight, one link.
//!
//! Events are ordered in integer nanoseconds. Transfers share the link by processor sharing; what has arrived is decoded
//! and uploaded; at every tick (60 Hz) the scheduler observes the true view and is asked what to do; at every second
//! tick the frame is judged by what can be shown.

use crate::stopwatch::Stopwatch;
use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::benefit::quality::{Quality, evaluate};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::foresight::AlphaReport;
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::state::Status;
use foresight_scheduler::units::Time;
use foresight_traces::client::{ClientSettings, Pipeline};
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, TICKS_PER_SECOND, tick_time};
use foresight_traces::link::LinkTrace;
use foresight_traces::link::shared::SharedLink;
use std::collections::{BTreeMap, BTreeSet};

/// Actions that a policy may take in one tick before it is called runaway.
const ACTIONS_PER_TICK_MAX: usize = 100_000;

/// Everything that a replay needs and no policy changes.
#[derive(Clone, Copy)]
pub struct Stage<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// The camera.
    pub flight: &'a Flight,
    /// One a sampled frame.
    pub cuts: &'a [Cut],
    /// The link.
    pub link: &'a LinkTrace,
    /// Where in the link the replay starts.
    pub link_start: Time,
    /// What the client can do.
    pub client: ClientSettings,
    /// Memory and refinement.
    pub scheduler: SchedulerSettings,
    /// Resident from the start.
    pub preloaded: &'a [RepId],
}

/// Why a replay stopped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReplayError {
    /// The scheduler refused an event or an action.
    #[error("at {at_s:.3} s: {source}")]
    Scheduler {
        /// When.
        at_s: f64,
        /// What.
        #[source]
        source: SchedulerError,
    },
    /// A policy never came to rest.
    #[error("at {at_s:.3} s: the policy took more than {ACTIONS_PER_TICK_MAX} actions in one tick")]
    Runaway {
        /// When.
        at_s: f64,
    },
    /// The memory budget was exceeded: a bug, found by the simulator's own account.
    #[error("at {at_s:.3} s: {used} bytes are in use, the budget is {budget}")]
    Budget {
        /// When.
        at_s: f64,
        /// By the simulator's account.
        used: u64,
        /// As set.
        budget: u64,
    },
}

/// What can be shown from when on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Completion {
    /// When.
    pub at: Time,
    /// What.
    pub rep: RepId,
}

/// A request as the policy made it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Request {
    /// When.
    pub at: Time,
    /// For what.
    pub rep: RepId,
}

/// What one replay yielded.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// One a sampled frame.
    pub frames: Vec<Quality>,
    /// Memory in use at each sampled frame, bytes.
    pub memory: Vec<u64>,
    /// Bytes that had crossed the link at each sampled frame.
    pub received: Vec<u64>,
    /// Requests in order, cancelled ones included.
    pub requests: Vec<Request>,
    /// Completions in order.
    pub completions: Vec<Completion>,
    /// Bytes that crossed the link.
    pub bytes_fetched: u64,
    /// Of these, bytes of what was never the best of anything in view.
    pub bytes_wasted: u64,
    /// Requests that were cancelled.
    pub cancellations: u64,
    /// Of the bytes that crossed the link, those of requests that were cancelled.
    pub bytes_cancelled: u64,
    /// Of these, bytes of requests that failed, or that were given up because what they need first failed.
    pub bytes_failed: u64,
    /// Such requests.
    pub failures: u64,
    /// Bytes of requests still under way at the end.
    pub bytes_unfinished: u64,
    /// Discards.
    pub evictions: u64,
    /// Ticks at which the policy did something.
    pub decisions: u64,
    /// Real time that such ticks took the scheduler.
    pub decision_nanos: Vec<u64>,
    /// What each of these decisions may have missed, and whether it was cut short; empty of a policy that proves nothing.
    pub regrets: Vec<(f64, bool)>,
    /// What became of α, for a policy that has one.
    pub alpha: Option<AlphaReport>,
}

/// A request under way.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    id: u64,
    rep: RepId,
    /// It breaks off at its end on the link.
    fails: bool,
}

/// The state of one replay between ticks.
struct Replay<'a> {
    stage: Stage<'a>,
    scheduler: Scheduler<'a>,
    link: SharedLink,
    pipeline: Pipeline,
    transfers: Vec<Transfer>,
    /// Transfers that have not had their first byte, by the time when it comes, then by id.
    joining: BTreeMap<(Time, u64), RepId>,
    next_id: u64,
    /// How often each was requested, on a link on which requests fail.
    attempts: BTreeMap<RepId, u64>,
    /// Up to which tick the client has announced its path.
    announced: usize,
    /// Simulator's own account of memory, independent of the scheduler's.
    held: u64,
    /// Whether each was the best of something in view since it was last fetched, or was there from the start.
    was_best: Vec<bool>,
    run: Run,
    arrivals: Vec<(u64, Time)>,
}

/// Replays `policy` over the stage.
pub fn replay<'a>(stage: Stage<'a>, policy: Box<dyn Policy + 'a>) -> Result<Run, ReplayError> {
    let mut replay = Replay {
        stage,
        scheduler: Scheduler::checked(stage.tree, stage.scheduler, policy)
            .map_err(|source| ReplayError::Scheduler { at_s: 0.0, source })?,
        link: SharedLink::new(stage.link, stage.link_start),
        pipeline: Pipeline::new(stage.client),
        transfers: Vec::new(),
        joining: BTreeMap::new(),
        next_id: 0,
        attempts: BTreeMap::new(),
        announced: 0,
        held: 0,
        was_best: vec![false; stage.tree.representations()],
        run: Run::default(),
        arrivals: Vec::new(),
    };
    for &rep in stage.preloaded {
        replay.scheduler.preload(rep).map_err(|source| ReplayError::Scheduler { at_s: 0.0, source })?;
        replay.held += stage.tree.decoded_bytes(rep);
        replay.was_best[rep.index()] = true;
    }
    for tick in 0..stage.flight.views.len() as u64 {
        let now = tick_time(tick);
        replay.tick(tick, now).map_err(|e| match e {
            Failure::Scheduler(source) => ReplayError::Scheduler { at_s: now.secs(), source },
            Failure::Runaway => ReplayError::Runaway { at_s: now.secs() },
        })?;
        let (used, budget) = (replay.held, stage.scheduler.budget);
        if used > budget {
            return Err(ReplayError::Budget { at_s: now.secs(), used, budget });
        }
    }
    Ok(replay.finish())
}

enum Failure {
    Scheduler(SchedulerError),
    Runaway,
}

impl From<SchedulerError> for Failure {
    fn from(error: SchedulerError) -> Failure {
        Failure::Scheduler(error)
    }
}

impl Replay<'_> {
    fn tick(&mut self, tick: u64, now: Time) -> Result<(), Failure> {
        self.receive(now)?;
        self.show(now)?;
        let in_flight: u64 = self.transfers.iter().map(|t| self.link.delivered(t.id)).sum();
        let total = self.link.total_delivered();
        self.scheduler.progress(in_flight, total, now)?;

        self.announce(tick as usize)?;
        let watch = Stopwatch::start();
        self.scheduler.observe(&self.stage.flight.views[tick as usize], now)?;
        let mut acted = 0;
        loop {
            match self.scheduler.next(now)? {
                Action::WaitUntil(_) => break,
                Action::Fetch { rep, .. } => self.fetch(rep, now),
                Action::Cancel(rep) => self.cancel(rep, now),
                Action::Discard(rep) => self.discard(rep),
            }
            acted += 1;
            if acted > ACTIONS_PER_TICK_MAX {
                return Err(Failure::Runaway);
            }
        }
        if acted > 0 {
            self.run.decisions += 1;
            self.run.decision_nanos.push(watch.nanos());
            self.run.regrets.extend(self.scheduler.certificate().map(|c| (c.regret, c.cut_short)));
        }
        if tick.is_multiple_of(TICKS_PER_FRAME) {
            self.judge((tick / TICKS_PER_FRAME) as usize, total);
        }
        Ok(())
    }

    /// First and last bytes up to `now`, in order of time.
    fn receive(&mut self, now: Time) -> Result<(), Failure> {
        self.arrivals.clear();
        self.link.advance(now, &mut self.arrivals);
        let arrivals = core::mem::take(&mut self.arrivals);
        for &(id, at) in &arrivals {
            self.respond(at)?;
            let Some(place) = self.transfers.iter().position(|t| t.id == id) else { continue };
            let Transfer { rep, fails, .. } = self.transfers.remove(place);
            if fails {
                self.run.bytes_failed += self.link.delivered(id);
                self.held -= self.stage.tree.wire_bytes(rep);
                self.fail(rep, at)?;
                continue;
            }
            for doomed in self.scheduler.arrived(rep, at)? {
                self.discard(doomed);
            }
            self.held += self.stage.tree.decoded_bytes(rep);
            self.pipeline.arrived(rep, self.stage.tree.decoded_bytes(rep), at);
        }
        self.arrivals = arrivals;
        self.respond(now)
    }

    fn respond(&mut self, until: Time) -> Result<(), Failure> {
        while let Some(first) = self.joining.first_entry().filter(|first| first.key().0 <= until) {
            let ((joins, id), rep) = first.remove_entry();
            // Cancelled ones are gone from the list of transfers.
            if self.transfers.iter().any(|t| t.id == id) {
                self.scheduler.responded(rep, joins)?;
            }
        }
        Ok(())
    }

    /// Reports a transfer that broke off, and gives up what needs it and is on its way or waits to be shown.
    fn fail(&mut self, rep: RepId, at: Time) -> Result<(), Failure> {
        self.run.failures += 1;
        self.scheduler.failed(rep, at)?;
        let tree = self.stage.tree;
        if !tree.has_prerequisites() {
            return Ok(());
        }
        // What is needed first has the lower id: one pass in order finds all that hangs on it.
        let under_way: BTreeSet<RepId> = self.transfers.iter().map(|t| t.rep).chain(self.pipeline.waiting()).collect();
        let mut lost = BTreeSet::from([rep]);
        for rep in under_way {
            if !tree.prerequisite(rep).is_some_and(|p| lost.contains(&p)) {
                continue;
            }
            lost.insert(rep);
            self.held -= tree.wire_bytes(rep);
            if self.pipeline.give_up(rep) {
                self.held -= tree.decoded_bytes(rep);
                self.run.bytes_failed += tree.wire_bytes(rep);
            } else if let Some(place) = self.transfers.iter().position(|t| t.rep == rep) {
                let transfer = self.transfers.remove(place);
                self.run.bytes_failed += self.link.cancel(transfer.id, self.link.now());
            }
            self.run.failures += 1;
            self.scheduler.failed(rep, at)?;
        }
        Ok(())
    }

    /// Once a second tells the scheduler the path ahead, as far as this client announces it, until its end is known.
    fn announce(&mut self, tick: usize) -> Result<(), Failure> {
        let views = &self.stage.flight.views;
        let seconds = self.stage.client.announce_s;
        if seconds <= 0.0 || !(tick as u64).is_multiple_of(TICKS_PER_SECOND) || self.announced == views.len() {
            return Ok(());
        }
        let ahead = libm::ceil(seconds * TICKS_PER_SECOND as f64) as usize;
        self.announced = tick.saturating_add(ahead).saturating_add(1).min(views.len());
        let path: Vec<_> = (tick..self.announced).map(|t| (tick_time(t as u64), views[t])).collect();
        self.scheduler.announce_path(&path)?;
        Ok(())
    }

    /// Uploads what is decoded.
    fn show(&mut self, now: Time) -> Result<(), Failure> {
        let tree = self.stage.tree;
        loop {
            let mut completed = Vec::new();
            let state = self.scheduler.state();
            // Prerequisites shown in this very tick count: an upload keeps the order of arrival.
            let ready = |rep: RepId| {
                tree.prerequisite(rep).is_none_or(|p| matches!(state.status(p), Status::Resident | Status::Doomed))
            };
            self.pipeline.upload(now, ready, |rep| completed.push(rep));
            for &rep in &completed {
                self.scheduler.completed(rep, now)?;
                self.held -= tree.wire_bytes(rep);
                self.was_best[rep.index()] = false;
                self.run.completions.push(Completion { at: now, rep });
            }
            if completed.is_empty() || !tree.has_prerequisites() {
                return Ok(());
            }
        }
    }

    fn fetch(&mut self, rep: RepId, now: Time) {
        let id = self.next_id;
        self.next_id += 1;
        let bytes = self.stage.tree.wire_bytes(rep);
        let breaks_after = self.breaks_after(rep, bytes);
        // The moment at which the link lets it join.
        let joins = now + self.link.trace().rtt_at(now);
        self.link.start(id, breaks_after.unwrap_or(bytes), now);
        self.held += bytes;
        self.transfers.push(Transfer { id, rep, fails: breaks_after.is_some() });
        self.joining.insert((joins, id), rep);
        self.run.requests.push(Request { at: now, rep });
    }

    fn breaks_after(&mut self, rep: RepId, bytes: u64) -> Option<u64> {
        let trace = self.link.trace();
        if trace.loss() <= 0.0 {
            return None;
        }
        let attempts = self.attempts.entry(rep).or_default();
        *attempts += 1;
        trace.breaks_after(u64::from(rep.0), *attempts, bytes)
    }

    fn cancel(&mut self, rep: RepId, now: Time) {
        if let Some(place) = self.transfers.iter().position(|t| t.rep == rep) {
            let transfer = self.transfers.remove(place);
            self.run.cancellations += 1;
            self.run.bytes_cancelled += self.link.cancel(transfer.id, now);
            self.held -= self.stage.tree.wire_bytes(rep);
        }
    }

    fn discard(&mut self, rep: RepId) {
        self.run.evictions += 1;
        self.held -= self.stage.tree.decoded_bytes(rep);
        self.charge_if_wasted(rep);
    }

    fn charge_if_wasted(&mut self, rep: RepId) {
        if !self.was_best[rep.index()] {
            self.run.bytes_wasted += self.stage.tree.wire_bytes(rep);
        }
    }

    /// Judges the frame by what can be shown.
    fn judge(&mut self, frame: usize, received: u64) {
        let cut = &self.stage.cuts[frame];
        let tree = self.stage.tree;
        let resident = self.scheduler.state().resident();
        let was_best = &mut self.was_best;
        let quality = evaluate(tree, cut, resident, |part| {
            if let Some(owner) = part.owner {
                for rep in tree.own(owner) {
                    if resident.contains(rep) && part.is_by(tree, rep) {
                        was_best[rep.index()] = true;
                    }
                }
            }
        });
        self.run.frames.push(quality);
        self.run.memory.push(self.scheduler.state().used_bytes());
        self.run.received.push(received);
    }

    fn finish(mut self) -> Run {
        self.run.bytes_unfinished = self.transfers.iter().map(|t| self.link.delivered(t.id)).sum();
        self.run.bytes_fetched = self.link.total_delivered();
        self.run.alpha = self.scheduler.alpha();
        let left: Vec<RepId> = self.scheduler.state().resident().iter().collect();
        for rep in left {
            self.charge_if_wasted(rep);
        }
        self.run
    }
}
