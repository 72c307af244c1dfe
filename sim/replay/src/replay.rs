//! The discrete-event simulator: one policy, one flight, one link.
//!
//! A [`Simulation`] ticks 60 times a second; at every second tick the frame is judged by what can be shown.

pub use crate::simulation::ReplayError;
use crate::simulation::{Conditions, Simulation};
use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::benefit::quality::Quality;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::foresight::AlphaReport;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, TICKS_PER_SECOND, tick_time};
use foresight_traces::link::LinkTrace;

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

impl<'a> Stage<'a> {
    /// Without the flight.
    pub fn conditions(&self) -> Conditions<'a> {
        Conditions {
            tree: self.tree,
            link: self.link,
            link_start: self.link_start,
            client: self.client,
            scheduler: self.scheduler,
            preloaded: self.preloaded,
        }
    }
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
    /// Time that such ticks took the scheduler, by the clock that was given.
    pub decision_nanos: Vec<u64>,
    /// What each of these decisions may have missed, and whether it was cut short; empty of a policy that proves nothing.
    pub regrets: Vec<(f64, bool)>,
    /// What became of α, for a policy that has one.
    pub alpha: Option<AlphaReport>,
}

/// Once a second the path ahead, as far as a client announces it, until its end is known.
#[derive(Clone, Debug)]
pub struct Announcer<'a> {
    views: &'a [View],
    seconds: f64,
    /// Up to which tick the path is announced.
    announced: usize,
}

impl<'a> Announcer<'a> {
    /// Of a client that announces `seconds` ahead; 0 for one that does not.
    pub fn new(views: &'a [View], seconds: f64) -> Announcer<'a> {
        Announcer { views, seconds, announced: 0 }
    }

    /// What is announced at a tick.
    pub fn at(&mut self, tick: usize) -> Option<Vec<(Time, View)>> {
        let due = (tick as u64).is_multiple_of(TICKS_PER_SECOND);
        if self.seconds <= 0.0 || !due || self.announced == self.views.len() {
            return None;
        }
        let ahead = libm::ceil(self.seconds * TICKS_PER_SECOND as f64) as usize;
        self.announced = tick.saturating_add(ahead).saturating_add(1).min(self.views.len());
        Some((tick..self.announced).map(|t| (tick_time(t as u64), self.views[t])).collect())
    }
}

/// Replays `policy` over the stage. `clock` is asked before and after the decisions of a tick, and answers in nanoseconds;
/// nothing of it reaches a decision.
///
/// # Errors
/// As [`Simulation`]'s.
pub fn replay<'a>(stage: Stage<'a>, policy: Box<dyn Policy + 'a>, clock: &dyn Fn() -> u64) -> Result<Run, ReplayError> {
    let mut simulation = Simulation::new(stage.conditions(), policy)?;
    let mut announcer = Announcer::new(&stage.flight.views, stage.client.announce_s);
    let mut run = Run::default();
    for (tick, view) in stage.flight.views.iter().enumerate() {
        let now = tick_time(tick as u64);
        simulation.advance(now)?;
        if let Some(path) = announcer.at(tick) {
            simulation.announce(&path, now)?;
        }
        let begun = clock();
        let done = simulation.decide(view, now)?;
        let nanos = clock().saturating_sub(begun);
        run.completions.extend(done.completed.iter().map(|&rep| Completion { at: now, rep }));
        run.requests.extend(done.requested.iter().map(|&rep| Request { at: now, rep }));
        if done.actions > 0 {
            run.decisions += 1;
            run.decision_nanos.push(nanos);
            run.regrets.extend(simulation.scheduler().certificate().map(|c| (c.regret, c.cut_short)));
        }
        if (tick as u64).is_multiple_of(TICKS_PER_FRAME) {
            run.frames.push(simulation.judge(&stage.cuts[tick / TICKS_PER_FRAME as usize]));
            run.memory.push(simulation.used_bytes());
            run.received.push(simulation.received_bytes());
        }
    }
    let counts = simulation.finish();
    Ok(Run {
        bytes_fetched: simulation.delivered_bytes(),
        bytes_unfinished: simulation.in_flight().map(|(_, bytes)| bytes).sum(),
        bytes_wasted: counts.bytes_wasted,
        cancellations: counts.cancellations,
        bytes_cancelled: counts.bytes_cancelled,
        bytes_failed: counts.bytes_failed,
        failures: counts.failures,
        evictions: counts.evictions,
        alpha: simulation.scheduler().alpha(),
        ..run
    })
}
