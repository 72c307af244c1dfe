//! What a client does by itself, and what changes under it: drops, another budget, several cameras, another policy.

#[path = "../random_tree/mod.rs"]
mod random_tree;

mod budget;
mod cameras;
mod dropped;
mod reason;

use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerSettings};
use foresight_scheduler::state::Status;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};

/// 60 Hz.
const TICK: Time = Time(16_666_667);

fn at(position: DVec3) -> View {
    View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1000, 1000] }
}

fn foresight(change: impl FnOnce(&mut ForesightSettings)) -> Box<dyn Policy> {
    let mut settings = ForesightSettings::default();
    change(&mut settings);
    Box::new(Foresight::checked("foresight", settings).expect("settings"))
}

/// A leaf of two metres at each place, each with representations of so many wire bytes and that error; as many bytes
/// decoded.
fn leaves(places: &[DVec3], levels: &[(u32, f32)]) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for &place in places {
        builder.open().unwrap();
        for &(bytes, error) in levels {
            let rep =
                Representation { wire_bytes: bytes, decoded_bytes: bytes, error, prerequisite: None, direction: None };
            builder.add(rep).unwrap();
        }
        builder.close(Some(Aabb { min: place - 1.0, max: place + 1.0 }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// A client on a link that carries one request after the other.
struct Client<'a> {
    scheduler: Scheduler<'a>,
    now: Time,
    bytes_per_tick: u64,
    in_flight: Vec<(RepId, u64)>,
    decoding: Vec<RepId>,
    total: u64,
    /// Everything that was decided, waits left out.
    log: Vec<(Time, Action)>,
}

impl<'a> Client<'a> {
    fn new(tree: &'a LodTree, budget: u64, policy: Box<dyn Policy + 'a>) -> Client<'a> {
        Client::with(tree, budget, Refinement::Partial, policy)
    }

    fn with(tree: &'a LodTree, budget: u64, refinement: Refinement, policy: Box<dyn Policy + 'a>) -> Client<'a> {
        let settings = SchedulerSettings { refinement, ..SchedulerSettings::with_budget(budget) };
        Client {
            scheduler: Scheduler::checked(tree, settings, policy).expect("settings"),
            now: Time::ZERO,
            bytes_per_tick: 10_000,
            in_flight: Vec::new(),
            decoding: Vec::new(),
            total: 0,
            log: Vec::new(),
        }
    }

    /// Obeys until the scheduler waits. While too much is in use nothing is fetched, and in the end only what is being
    /// decoded can be too much.
    fn obey(&mut self) {
        for asked in 0.. {
            assert!(asked < 100_000, "decisions without end");
            let before = self.scheduler.state().excess_bytes();
            let action = self.scheduler.next(self.now).expect("possible");
            match &action {
                Action::Fetch { rep, .. } => {
                    assert_eq!(before, 0, "fetched beyond the budget");
                    self.in_flight.push((*rep, self.scheduler.state().tree.wire_bytes(*rep)));
                }
                Action::Cancel(rep) => self.in_flight.retain(|(r, _)| r != rep),
                Action::Discard(_) => {}
                Action::WaitUntil(_) => break,
            }
            self.log.push((self.now, action));
        }
        assert!(self.scheduler.state().excess_bytes() == 0 || !self.decoding.is_empty(), "beyond the budget");
    }

    /// The link moves on by a tick, and what arrived before is decoded.
    fn transfer(&mut self) {
        self.now += TICK;
        for rep in core::mem::take(&mut self.decoding) {
            self.scheduler.completed(rep, self.now).expect("arrived");
        }
        let mut left = self.bytes_per_tick;
        let mut in_flight = 0;
        while let Some((rep, missing)) = self.in_flight.first_mut() {
            let wire = self.scheduler.state().tree.wire_bytes(*rep);
            if *missing == wire {
                self.scheduler.responded(*rep, self.now).expect("in flight");
            }
            let sent = left.min(*missing);
            (*missing, left) = (*missing - sent, left - sent);
            self.total += sent;
            if *missing > 0 {
                in_flight = wire - *missing;
                break;
            }
            let rep = *rep;
            self.in_flight.remove(0);
            self.scheduler.arrived(rep, self.now).expect("in flight");
            self.decoding.push(rep);
        }
        self.scheduler.progress(in_flight, self.total, self.now).expect("in order");
    }

    fn ticks(&mut self, count: usize, mut observe: impl FnMut(&mut Scheduler, Time)) {
        for _ in 0..count {
            self.transfer();
            observe(&mut self.scheduler, self.now);
            self.obey();
        }
    }

    /// The client lets go of `rep` and of whatever needs it, in order of id from `rep` on, or the other way round.
    fn lets_go(&mut self, rep: RepId, dependents_first: bool) {
        let state = self.scheduler.state();
        let tree = state.tree;
        let needs = |r: RepId| core::iter::successors(Some(r), |&p| tree.prerequisite(p)).any(|p| p == rep);
        let held = |r: RepId| state.status(r) != Status::Absent;
        let mut gone: Vec<RepId> =
            (rep.0..tree.representations() as u32).map(RepId).filter(|&r| held(r) && needs(r)).collect();
        if dependents_first {
            gone.reverse();
        }
        for rep in gone {
            self.in_flight.retain(|(r, _)| *r != rep);
            self.decoding.retain(|r| *r != rep);
            self.scheduler.dropped(rep, self.now).expect("held");
        }
    }

    fn status(&self, rep: u32) -> Status {
        self.scheduler.state().status(RepId(rep))
    }

    fn fetched(&self) -> Vec<u32> {
        self.log
            .iter()
            .filter_map(|(_, a)| if let Action::Fetch { rep, .. } = a { Some(rep.0) } else { None })
            .collect()
    }
}
