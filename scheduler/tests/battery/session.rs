//! A client on a link of constant rate that carries one request after the other, and worlds made by hand.

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, RepId, Representation};
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerSettings, Waiting};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};

/// 1/64 s: exact in binary and in nanoseconds.
pub(crate) const TICK: u64 = 15_625_000;

pub(crate) fn at(position: DVec3) -> View {
    View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1920, 1080] }
}

pub(crate) fn rep(wire_bytes: u32, error: f32) -> Representation {
    Representation { wire_bytes, decoded_bytes: 4 * wire_bytes, error, prerequisite: None, direction: None }
}

pub(crate) fn cube(centre: DVec3, half: f64) -> Aabb {
    Aabb { min: centre - DVec3::splat(half), max: centre + DVec3::splat(half) }
}

/// An empty root over a leaf for each entry: its box, its representations (wire bytes, error).
pub(crate) fn flat(leaves: &[(Aabb, &[(u32, f32)])]) -> LodTree {
    try_flat(leaves, 1.0).expect("a world")
}

pub(crate) fn try_flat(leaves: &[(Aabb, &[(u32, f32)])], importance: f32) -> Result<LodTree, LodTreeError> {
    let mut builder = LodTreeBuilder::default();
    builder.open()?;
    for (bounds, reps) in leaves {
        builder.open()?;
        for &(wire_bytes, error) in *reps {
            builder.add(rep(wire_bytes, error))?;
        }
        builder.close(Some(*bounds), importance)?;
    }
    builder.close(None, 1.0)?;
    builder.finish()
}

/// What a session did.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Log {
    /// In order.
    pub(crate) fetched: Vec<u32>,
    pub(crate) discarded: usize,
    /// At the end.
    pub(crate) resident: Vec<u32>,
    pub(crate) waiting: Option<Waiting>,
}

/// A client of a world.
pub(crate) struct Client {
    pub(crate) foresight: ForesightSettings,
    pub(crate) scheduler: SchedulerSettings,
    /// Bytes per second of the true link, and its latency in seconds.
    pub(crate) link: (f64, f64),
    pub(crate) tick: u64,
}

impl Default for Client {
    fn default() -> Client {
        Client {
            foresight: ForesightSettings::default(),
            scheduler: SchedulerSettings::with_budget(1 << 40),
            link: (1e6, 0.05),
            tick: TICK,
        }
    }
}

impl Client {
    /// That many ticks along a path (seconds to view).
    pub(crate) fn run(&self, tree: &LodTree, ticks: u64, path: impl Fn(f64) -> View) -> Log {
        let policy = Foresight::checked("foresight", self.foresight).expect("settings");
        let mut scheduler = Scheduler::checked(tree, self.scheduler, Box::new(policy)).expect("settings");
        let mut log = Log::default();
        // Requests on their way, with when the last byte comes.
        let mut queue: Vec<(RepId, Time)> = Vec::new();
        let (mut link_free, mut received) = (Time::ZERO, 0);
        for tick in 0..ticks {
            let now = Time(tick * self.tick);
            while let Some(&(rep, due)) = queue.first().filter(|(_, due)| *due <= now) {
                queue.remove(0);
                received += tree.wire_bytes(rep);
                scheduler.responded(rep, due).expect("in flight");
                scheduler.progress(0, received, due).expect("in order");
                scheduler.arrived(rep, due).expect("in flight");
                scheduler.completed(rep, due).expect("arrived");
            }
            scheduler.observe(&path(now.secs()), now).expect("a view");
            for asked in 0.. {
                assert!(asked < 100_000, "decisions without end");
                match scheduler.next(now).expect("possible") {
                    Action::Fetch { rep, .. } => {
                        log.fetched.push(rep.0);
                        let begins = link_free.max(now + Time::from_secs(self.link.1));
                        link_free = begins + Time::from_secs(tree.wire_bytes(rep) as f64 / self.link.0);
                        queue.push((rep, link_free));
                    }
                    Action::Cancel(rep) => queue.retain(|(r, _)| *r != rep),
                    Action::Discard(_) => log.discarded += 1,
                    Action::WaitUntil(_) => break,
                }
            }
            assert!(scheduler.state().used_bytes() <= self.scheduler.budget, "more memory than there is");
        }
        log.resident = scheduler.state().residents().map(|r| r.0).collect();
        log.waiting = scheduler.waiting_because();
        log
    }

    /// Standing still at the origin.
    pub(crate) fn stand(&self, tree: &LodTree, ticks: u64) -> Log {
        self.run(tree, ticks, |_| at(DVec3::ZERO))
    }

    pub(crate) fn with(settings: impl FnOnce(&mut ForesightSettings)) -> Client {
        let mut client = Client::default();
        settings(&mut client.foresight);
        client
    }
}

/// Nine objects of two levels: seven ahead, one aside and one behind; no two alike.
pub(crate) fn nine(offset: DVec3) -> LodTree {
    let levels: [&[(u32, f32)]; 9] = [
        &[(2000, 1.0), (20_000, 0.125)],
        &[(2100, 1.125), (21_000, 0.125)],
        &[(2200, 1.25), (22_000, 0.25)],
        &[(2300, 1.375), (23_000, 0.25)],
        &[(2400, 1.5), (24_000, 0.25)],
        &[(2500, 1.625), (25_000, 0.5)],
        &[(2600, 1.75), (26_000, 0.5)],
        &[(2700, 1.875), (27_000, 0.5)],
        &[(2800, 2.0), (28_000, 0.5)],
    ];
    let mut places: Vec<DVec3> =
        (0..7).map(|i| DVec3::new(f64::from(i) * 1.5 - 4.0, 0.25, -12.0 - 4.0 * f64::from(i))).collect();
    places.extend([DVec3::new(40.0, 0.0, 2.0), DVec3::new(1.0, 0.5, 30.0)]);
    let leaves: Vec<_> = places.iter().zip(levels).map(|(place, reps)| (cube(*place + offset, 1.0), reps)).collect();
    flat(&leaves)
}
