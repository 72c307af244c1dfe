//! Decisions of the scheduler itself as the world grows: observing at 30 Hz and deciding until there is nothing left to do,
//! over a simulated link and client, with a clock beside it.

use super::outcome::{Percentiles, ScaleRow};
use crate::stopwatch::{Stopwatch, percentiles};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::select::certified::Certificate;
use foresight_scheduler::state::Status;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::client::{ClientSettings, Pipeline};
use foresight_traces::link::LinkTrace;
use foresight_traces::link::shared::SharedLink;
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// Views a second.
pub const RATE: u64 = 30;
/// Ticks before the clock starts: the first covers are made, memory fills.
const WARM_UP: u64 = 4 * RATE;
/// Ticks between half turns.
const TURN_EVERY: u64 = RATE;
/// Ticks after a half turn that count as right after it.
const AFTER_TURN: u64 = 3;
/// Actions that one tick may hold before it is called runaway.
const ACTIONS_PER_TICK_MAX: usize = 100_000;
/// Memory that never fills, and memory that is full after a few seconds, bytes.
const MEMORY: (u64, u64) = (4 << 30, 24 << 20);

/// What the camera does and what memory there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Straight on at 15 m/s with a slow look around; memory never fills.
    Moving,
    /// The same with memory full.
    MemoryFull,
    /// Half a turn at once every second; the ticks right after one are timed.
    Turn180,
}

impl Motion {
    /// Every one, in the order of the rows.
    pub const ALL: [Motion; 3] = [Motion::Moving, Motion::MemoryFull, Motion::Turn180];

    /// As in the document.
    pub fn name(self) -> &'static str {
        match self {
            Motion::Moving => "moving",
            Motion::MemoryFull => "memory-full",
            Motion::Turn180 => "turn-180",
        }
    }

    fn memory(self) -> u64 {
        if self == Motion::MemoryFull { MEMORY.1 } else { MEMORY.0 }
    }

    fn is_timed(self, tick: u64) -> bool {
        tick >= WARM_UP && (self != Motion::Turn180 || tick % TURN_EVERY < AFTER_TURN)
    }

    /// 2 m above the ground of a city whose middle is the origin, z up.
    fn view(self, tick: u64) -> View {
        let time = tick as f64 / RATE as f64;
        let turned = if self == Motion::Turn180 { (tick / TURN_EVERY) as f64 * PI } else { 0.0 };
        let yaw = 0.3 * libm::sin(0.4 * time) + turned;
        let position = DVec3::new(15.0 * time, 3.0 * libm::sin(0.2 * time), 2.0);
        // Camera −z becomes +x of the world, camera +y becomes +z.
        let level = DQuat::from_xyzw(0.5, -0.5, -0.5, 0.5);
        View { position, orientation: DQuat::from_rotation_z(yaw) * level, fov_y: PI / 3.0, viewport: [1920, 1080] }
    }
}

/// Drives `policy` through `motion` for `ticks` timed ticks.
///
/// # Errors
/// The scheduler refuses an event or an action.
pub fn decisions<'a>(
    tree: &'a LodTree,
    motion: Motion,
    link: &LinkTrace,
    ticks: u64,
    policy: Box<dyn Policy + 'a>,
) -> Result<ScaleRow, SchedulerError> {
    let settings = SchedulerSettings::with_budget(motion.memory());
    let mut drive = Drive {
        tree,
        scheduler: Scheduler::checked(tree, settings, policy)?,
        link: SharedLink::new(link, Time::ZERO),
        pipeline: Pipeline::new(ClientSettings::default()),
        transfers: BTreeMap::new(),
        joining: BTreeMap::new(),
        next_id: 0,
        proves: false,
        latest: Certificate::default(),
        opened: 0,
        action_nanos: Vec::new(),
    };
    let mut opened = 0;
    let (mut nanos, mut action_nanos) = (Vec::new(), Vec::new());
    let mut actions = 0;
    let mut tick = 0;
    while (nanos.len() as u64) < ticks {
        let now = Time(tick * 1_000_000_000 / RATE);
        drive.receive(now)?;
        let is_timed = motion.is_timed(tick);
        let watch = Stopwatch::start();
        drive.scheduler.observe(&motion.view(tick), now)?;
        drive.action_nanos.clear();
        let acted = drive.obey(watch, now)?;
        if is_timed {
            nanos.push(watch.nanos());
            action_nanos.append(&mut drive.action_nanos);
            opened += drive.opened;
            actions += acted as u64;
        }
        tick += 1;
    }
    let decisions = nanos.len() as u64;
    let (p, of_actions) = (percentiles(&mut nanos), percentiles(&mut action_nanos));
    Ok(ScaleRow {
        representations: tree.representations() as u64,
        situation: motion.name(),
        decision_ns: Percentiles { p50: p.p50, p99: p.p99 },
        action_ns: Percentiles { p50: of_actions.p50, p99: of_actions.p99 },
        nodes_opened: drive.proves.then(|| opened as f64 / decisions.max(1) as f64),
        decisions,
        actions,
        bytes_per_representation: tree.heap_bytes() as f64 / tree.representations().max(1) as f64,
        session_bytes: drive.scheduler.heap_bytes() as u64,
    })
}

/// A client and its link.
struct Drive<'a> {
    tree: &'a LodTree,
    scheduler: Scheduler<'a>,
    link: SharedLink,
    pipeline: Pipeline,
    transfers: BTreeMap<u64, RepId>,
    /// Transfers that have not had their first byte, by the time when it comes.
    joining: BTreeMap<(Time, u64), RepId>,
    next_id: u64,
    /// Whether the policy proves what it chooses.
    proves: bool,
    latest: Certificate,
    /// Nodes opened for the choices of this tick.
    opened: u64,
    /// How long each answer of this tick took, the first with what was observed before it.
    action_nanos: Vec<u64>,
}

impl Drive<'_> {
    fn respond(&mut self, until: Time) -> Result<(), SchedulerError> {
        while let Some(first) = self.joining.first_entry().filter(|first| first.key().0 <= until) {
            let ((joins, id), rep) = first.remove_entry();
            if self.transfers.contains_key(&id) {
                self.scheduler.responded(rep, joins)?;
            }
        }
        Ok(())
    }

    fn receive(&mut self, now: Time) -> Result<(), SchedulerError> {
        let mut arrivals = Vec::new();
        self.link.advance(now, &mut arrivals);
        for (id, at) in arrivals {
            self.respond(at)?;
            if let Some(rep) = self.transfers.remove(&id) {
                self.scheduler.arrived(rep, at)?;
                self.pipeline.arrived(rep, self.tree.decoded_bytes(rep), at);
            }
        }
        self.respond(now)?;
        loop {
            let mut shown = Vec::new();
            let state = self.scheduler.state();
            let tree = self.tree;
            let ready = |rep: RepId| {
                tree.prerequisite(rep).is_none_or(|p| matches!(state.status(p), Status::Resident | Status::Doomed))
            };
            self.pipeline.upload(now, ready, |rep| shown.push(rep));
            if shown.is_empty() {
                break;
            }
            for rep in shown {
                self.scheduler.completed(rep, now)?;
            }
        }
        let in_flight = self.transfers.keys().map(|&id| self.link.delivered(id)).sum();
        self.scheduler.progress(in_flight, self.link.total_delivered(), now)
    }

    /// Does what the scheduler says until it says to wait; how many actions that were. `watch` has run since the observation.
    fn obey(&mut self, mut watch: Stopwatch, now: Time) -> Result<usize, SchedulerError> {
        self.opened = 0;
        for acted in 0..ACTIONS_PER_TICK_MAX {
            let action = self.scheduler.next(now)?;
            self.action_nanos.push(watch.nanos());
            // A certificate stays until the next choice.
            if let Some(certificate) = self.scheduler.certificate().filter(|c| *c != self.latest) {
                self.proves = true;
                self.opened += certificate.nodes_opened;
                self.latest = certificate;
            }
            match action {
                Action::WaitUntil(_) => return Ok(acted),
                Action::Fetch { rep, .. } => {
                    let id = self.next_id;
                    self.next_id += 1;
                    self.link.start(id, self.tree.wire_bytes(rep), now);
                    self.transfers.insert(id, rep);
                    self.joining.insert((now + self.link.trace().rtt_at(now), id), rep);
                }
                Action::Cancel(rep) => {
                    let id = self.transfers.iter().find(|(_, r)| **r == rep).map(|(id, _)| *id);
                    if let Some(id) = id {
                        self.transfers.remove(&id);
                        self.link.cancel(id, now);
                    }
                }
                Action::Discard(_) => {}
            }
            watch = Stopwatch::start();
        }
        Ok(ACTIONS_PER_TICK_MAX)
    }
}
