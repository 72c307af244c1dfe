//! One client, one policy, one link, one view at a time.
//!
//! Events are ordered in integer nanoseconds. Transfers share the link by processor sharing; what has arrived is decoded
//! and uploaded; at every tick the scheduler observes the true view and is asked what to do. Ticks are whatever the
//! caller makes them; budgets per tick, those of uploads, count for each.

use foresight_scheduler::benefit::coverage::Coverage;
use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::benefit::quality::{Quality, evaluate};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::state::Status;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::client::{ClientSettings, Pipeline};
use foresight_traces::link::LinkTrace;
use foresight_traces::link::shared::SharedLink;
use std::collections::{BTreeMap, BTreeSet};

/// Actions that a policy may take in one tick before it is called runaway.
const ACTIONS_PER_TICK_MAX: usize = 100_000;

/// What a client is given once.
#[derive(Clone, Copy)]
pub struct Conditions<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// The link.
    pub link: &'a LinkTrace,
    /// Where in the link time zero is.
    pub link_start: Time,
    /// What the client can do. What it announces is up to the caller: [`Simulation::announce`].
    pub client: ClientSettings,
    /// Memory and refinement.
    pub scheduler: SchedulerSettings,
    /// Resident from the start.
    pub preloaded: &'a [RepId],
}

/// Why a simulation stopped.
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

/// What has happened since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes of what was never the best of anything in a judged view.
    pub bytes_wasted: u64,
    /// Requests that were cancelled.
    pub cancellations: u64,
    /// Of the bytes that crossed the link, those of requests that were cancelled.
    pub bytes_cancelled: u64,
    /// Bytes of requests that failed, or that were given up because what they need first failed.
    pub bytes_failed: u64,
    /// Such requests.
    pub failures: u64,
    /// Discards.
    pub evictions: u64,
}

/// What happened in one tick.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tick {
    /// What can be shown from now on, in order.
    pub completed: Vec<RepId>,
    /// What is gone from memory, in order.
    pub discarded: Vec<RepId>,
    /// What was requested, in order.
    pub requested: Vec<RepId>,
    /// Actions that the policy took.
    pub actions: usize,
}

/// A request under way.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    id: u64,
    rep: RepId,
    /// It breaks off at its end on the link.
    fails: bool,
}

/// The state of a client between ticks.
pub struct Simulation<'a> {
    tree: &'a LodTree,
    budget: u64,
    scheduler: Scheduler<'a>,
    link: SharedLink,
    pipeline: Pipeline,
    transfers: Vec<Transfer>,
    /// Transfers that have not had their first byte, by the time when it comes, then by id.
    joining: BTreeMap<(Time, u64), RepId>,
    next_id: u64,
    /// How often each was requested, on a link on which requests fail.
    attempts: BTreeMap<RepId, u64>,
    /// Simulator's own account of memory, independent of the scheduler's.
    held: u64,
    /// Whether each was the best of something in view since it was last fetched, or was there from the start.
    was_best: Vec<bool>,
    received: u64,
    counts: Counts,
    tick: Tick,
    arrivals: Vec<(u64, Time)>,
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

impl Failure {
    fn at(self, now: Time) -> ReplayError {
        match self {
            Failure::Scheduler(source) => ReplayError::Scheduler { at_s: now.secs(), source },
            Failure::Runaway => ReplayError::Runaway { at_s: now.secs() },
        }
    }
}

impl<'a> Simulation<'a> {
    /// A client with nothing but what is preloaded.
    ///
    /// # Errors
    /// Settings that the scheduler refuses, and preloaded representations that do not fit.
    pub fn new(conditions: Conditions<'a>, policy: Box<dyn Policy + 'a>) -> Result<Simulation<'a>, ReplayError> {
        let tree = conditions.tree;
        let refused = |source| ReplayError::Scheduler { at_s: 0.0, source };
        let mut simulation = Simulation {
            tree,
            budget: conditions.scheduler.budget,
            scheduler: Scheduler::checked(tree, conditions.scheduler, policy).map_err(refused)?,
            link: SharedLink::new(conditions.link, conditions.link_start),
            pipeline: Pipeline::new(conditions.client),
            transfers: Vec::new(),
            joining: BTreeMap::new(),
            next_id: 0,
            attempts: BTreeMap::new(),
            held: 0,
            was_best: vec![false; tree.representations()],
            received: 0,
            counts: Counts::default(),
            tick: Tick::default(),
            arrivals: Vec::new(),
        };
        for &rep in conditions.preloaded {
            simulation.scheduler.preload(rep).map_err(refused)?;
            simulation.held += tree.decoded_bytes(rep);
            simulation.was_best[rep.index()] = true;
        }
        Ok(simulation)
    }

    /// [`Simulation::advance`] and [`Simulation::decide`]: everything that a tick is for a client that announces nothing.
    ///
    /// # Errors
    /// As theirs.
    pub fn tick(&mut self, view: &View, now: Time) -> Result<&Tick, ReplayError> {
        self.advance(now)?;
        self.decide(view, now)
    }

    /// Begins a tick: lets the link carry until `now`, decodes and uploads.
    ///
    /// # Errors
    /// A time before the last one.
    pub fn advance(&mut self, now: Time) -> Result<(), ReplayError> {
        self.tick.completed.clear();
        self.tick.discarded.clear();
        self.tick.requested.clear();
        self.tick.actions = 0;
        self.carry(now).map_err(|failure| failure.at(now))
    }

    fn carry(&mut self, now: Time) -> Result<(), Failure> {
        self.receive(now)?;
        self.show(now)?;
        let in_flight: u64 = self.transfers.iter().map(|t| self.link.delivered(t.id)).sum();
        self.received = self.link.total_delivered();
        self.scheduler.progress(in_flight, self.received, now)?;
        Ok(())
    }

    /// Tells the scheduler the path ahead.
    ///
    /// # Errors
    /// Views that the scheduler refuses.
    pub fn announce(&mut self, path: &[(Time, View)], now: Time) -> Result<(), ReplayError> {
        self.scheduler.announce_path(path).map_err(|source| Failure::Scheduler(source).at(now))
    }

    /// Ends a tick: the scheduler observes the view and is asked what to do until it waits.
    ///
    /// # Errors
    /// A view that the scheduler refuses, a policy that does not come to rest, a memory budget exceeded.
    pub fn decide(&mut self, view: &View, now: Time) -> Result<&Tick, ReplayError> {
        self.act(view, now).map_err(|failure| failure.at(now))?;
        let (used, budget) = (self.held, self.budget);
        if used > budget {
            return Err(ReplayError::Budget { at_s: now.secs(), used, budget });
        }
        Ok(&self.tick)
    }

    fn act(&mut self, view: &View, now: Time) -> Result<(), Failure> {
        self.scheduler.observe(view, now)?;
        loop {
            match self.scheduler.next(now)? {
                Action::WaitUntil(_) => return Ok(()),
                Action::Fetch { rep, .. } => self.fetch(rep, now),
                Action::Cancel(rep) => self.cancel(rep, now),
                Action::Discard(rep) => self.discard(rep),
            }
            self.tick.actions += 1;
            if self.tick.actions > ACTIONS_PER_TICK_MAX {
                return Err(Failure::Runaway);
            }
        }
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
                self.counts.bytes_failed += self.link.delivered(id);
                self.held -= self.tree.wire_bytes(rep);
                self.fail(rep, at)?;
                continue;
            }
            for doomed in self.scheduler.arrived(rep, at)? {
                self.discard(doomed);
            }
            self.held += self.tree.decoded_bytes(rep);
            self.pipeline.arrived(rep, self.tree.decoded_bytes(rep), at);
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
        self.counts.failures += 1;
        self.scheduler.failed(rep, at)?;
        let tree = self.tree;
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
                self.counts.bytes_failed += tree.wire_bytes(rep);
            } else if let Some(place) = self.transfers.iter().position(|t| t.rep == rep) {
                let transfer = self.transfers.remove(place);
                self.counts.bytes_failed += self.link.cancel(transfer.id, self.link.now());
            }
            self.counts.failures += 1;
            self.scheduler.failed(rep, at)?;
        }
        Ok(())
    }

    /// Uploads what is decoded.
    fn show(&mut self, now: Time) -> Result<(), Failure> {
        let tree = self.tree;
        loop {
            let shown = self.tick.completed.len();
            let state = self.scheduler.state();
            // Prerequisites shown in this very tick count: an upload keeps the order of arrival.
            let ready = |rep: RepId| {
                tree.prerequisite(rep).is_none_or(|p| matches!(state.status(p), Status::Resident | Status::Doomed))
            };
            let completed = &mut self.tick.completed;
            self.pipeline.upload(now, ready, |rep| completed.push(rep));
            for &rep in &completed[shown..] {
                self.scheduler.completed(rep, now)?;
                self.held -= tree.wire_bytes(rep);
                self.was_best[rep.index()] = false;
            }
            if completed.len() == shown || !tree.has_prerequisites() {
                return Ok(());
            }
        }
    }

    fn fetch(&mut self, rep: RepId, now: Time) {
        let id = self.next_id;
        self.next_id += 1;
        let bytes = self.tree.wire_bytes(rep);
        let breaks_after = self.breaks_after(rep, bytes);
        // The moment at which the link lets it join.
        let joins = now + self.link.trace().rtt_at(now);
        self.link.start(id, breaks_after.unwrap_or(bytes), now);
        self.held += bytes;
        self.transfers.push(Transfer { id, rep, fails: breaks_after.is_some() });
        self.joining.insert((joins, id), rep);
        self.tick.requested.push(rep);
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
            self.counts.cancellations += 1;
            self.counts.bytes_cancelled += self.link.cancel(transfer.id, now);
            self.held -= self.tree.wire_bytes(rep);
        }
    }

    fn discard(&mut self, rep: RepId) {
        self.counts.evictions += 1;
        self.held -= self.tree.decoded_bytes(rep);
        self.charge_if_wasted(rep);
        self.tick.discarded.push(rep);
    }

    fn charge_if_wasted(&mut self, rep: RepId) {
        if !self.was_best[rep.index()] {
            self.counts.bytes_wasted += self.tree.wire_bytes(rep);
        }
    }

    /// Judges a view, by its cut with κ = 1, by what can be shown.
    pub fn judge(&mut self, cut: &Cut) -> Quality {
        let (tree, was_best) = (self.tree, &mut self.was_best);
        let resident = self.scheduler.state().resident();
        evaluate(tree, cut, resident, |part| {
            if let Some(owner) = part.owner {
                for rep in tree.own(owner) {
                    if resident.contains(rep) && part.is_by(tree, rep) {
                        was_best[rep.index()] = true;
                    }
                }
            }
        })
    }

    /// Ends the client: what is resident and was never the best of anything is counted as wasted too.
    pub fn finish(&mut self) -> Counts {
        let left: Vec<RepId> = self.resident().iter().collect();
        for rep in left {
            self.charge_if_wasted(rep);
            self.was_best[rep.index()] = true;
        }
        self.counts
    }

    /// What can be shown.
    pub fn resident(&self) -> &Coverage {
        self.scheduler.state().resident()
    }

    /// The scheduler: its state, its estimates and its reasons.
    pub fn scheduler(&self) -> &Scheduler<'a> {
        &self.scheduler
    }

    /// Bytes of memory in use, reserved ones included.
    pub fn used_bytes(&self) -> u64 {
        self.scheduler.state().used_bytes()
    }

    /// Bytes that had crossed the link when the last tick began.
    pub fn received_bytes(&self) -> u64 {
        self.received
    }

    /// Bytes that have crossed the link.
    pub fn delivered_bytes(&self) -> u64 {
        self.link.total_delivered()
    }

    /// What is on its way, in order of request, with the bytes of it that have come.
    pub fn in_flight(&self) -> impl Iterator<Item = (RepId, u64)> + '_ {
        self.transfers.iter().map(|t| (t.rep, self.link.delivered(t.id)))
    }

    /// Since the start.
    pub fn counts(&self) -> Counts {
        self.counts
    }
}
