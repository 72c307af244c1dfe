//! A client behind a link of constant rate, and worlds to try it on.

use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, NodeId, RepId, Representation};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerSettings};
use foresight_scheduler::state::Status;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};

/// 60 Hz.
const TICK: Time = Time(16_666_667);

/// Looks along −z with 90°, so that an error of g metres at distance d is 500 g/d pixels.
pub(crate) fn view_at(x: f64, y: f64, z: f64) -> View {
    View {
        position: DVec3::new(x, y, z),
        orientation: DQuat::IDENTITY,
        fov_y: core::f64::consts::FRAC_PI_2,
        viewport: [1000, 1000],
    }
}

pub(crate) fn turned(view: View, yaw: f64) -> View {
    View { orientation: DQuat::from_rotation_y(yaw), ..view }
}

pub(crate) fn rep(kilobytes: u32, error: f32) -> Representation {
    let bytes = 1000 * kilobytes;
    Representation { wire_bytes: bytes, decoded_bytes: bytes, error, prerequisite: None, direction: None }
}

pub(crate) fn cube(centre: [f64; 3], half: f64) -> Aabb {
    let centre = DVec3::from_array(centre);
    Aabb { min: centre - half, max: centre + half }
}

/// A root with `coarse`, and a leaf with one representation per entry of `leaves` (middle of a 2 m cube, kB, error).
pub(crate) fn two_levels(coarse: Option<Representation>, leaves: &[([f64; 3], u32, f32)]) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    if let Some(coarse) = coarse {
        builder.add(coarse).unwrap();
    }
    for &(centre, kilobytes, error) in leaves {
        builder.open().unwrap();
        builder.add(rep(kilobytes, error)).unwrap();
        builder.close(Some(cube(centre, 1.0)), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// An empty root, and beneath it a leaf for each entry (middle of a 2 m cube, errors of its levels of detail), 1 kB each.
pub(crate) fn chains(leaves: &[([f64; 3], &[f32])]) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for &(centre, errors) in leaves {
        builder.open().unwrap();
        for &error in errors {
            builder.add(rep(1, error)).unwrap();
        }
        builder.close(Some(cube(centre, 1.0)), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// An empty root, and beneath it an empty node for each group of leaves (middle of a 2 m cube, kB) without error.
pub(crate) fn groups(groups: &[&[([f64; 3], u32)]]) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for group in groups {
        builder.open().unwrap();
        for &(centre, kilobytes) in *group {
            builder.open().unwrap();
            builder.add(rep(kilobytes, 0.0)).unwrap();
            builder.close(Some(cube(centre, 1.0)), 1.0).unwrap();
        }
        builder.close(None, 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// xorshift64*.
pub(crate) struct Dice(pub(crate) u64);

impl Dice {
    pub(crate) fn below(&mut self, n: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) % n
    }
}

/// Up to `depth` levels with 1 to 4 children; nodes own up to three representations, some of which need another first
/// or show one direction only.
pub(crate) fn random_tree(seed: u64, depth: u32) -> LodTree {
    let (mut dice, mut builder) = (Dice(seed | 1), LodTreeBuilder::default());
    grow(&mut builder, &mut dice, depth, DVec3::new(0.0, 0.0, -60.0), 50.0, None);
    builder.finish().unwrap()
}

fn grow(b: &mut LodTreeBuilder, dice: &mut Dice, depth: u32, centre: DVec3, half: f64, mut above: Option<RepId>) {
    b.open().unwrap();
    let leaf = depth == 0 || dice.below(5) == 0;
    let directed = dice.below(6) == 0;
    for i in 0..dice.below(4) {
        let error = if dice.below(4) == 0 { 0.0 } else { half as f32 / (1 << (i + dice.below(5))) as f32 };
        let prerequisite = above.filter(|_| dice.below(3) == 0);
        let direction = directed.then_some(i as u8);
        let kilobytes = 1 + dice.below(40) as u32;
        above = Some(b.add(Representation { prerequisite, direction, ..rep(kilobytes, error) }).unwrap());
    }
    if !leaf {
        for _ in 0..1 + dice.below(4) {
            let corner = DVec3::from_array([0; 3].map(|_| dice.below(3) as f64 - 1.0));
            grow(b, dice, depth - 1, centre + 0.5 * half * corner, 0.5 * half, above);
        }
    }
    b.close(leaf.then_some(cube(centre.to_array(), half)), 1.0).unwrap();
}

/// A replay.
pub(crate) struct Session<'a> {
    pub(crate) scheduler: Scheduler<'a>,
    pub(crate) now: Time,
    /// What the scheduler answered in the latest tick, without the waiting.
    pub(crate) actions: Vec<Action>,
    bytes_per_tick: u64,
    in_flight: Vec<(RepId, u64)>,
    decoding: Vec<RepId>,
    total: u64,
    fails: Option<Dice>,
}

impl<'a> Session<'a> {
    pub(crate) fn new(
        tree: &'a LodTree,
        budget: u64,
        policy: Box<dyn Policy + 'a>,
        bytes_per_tick: u64,
    ) -> Session<'a> {
        Session::with_settings(tree, SchedulerSettings::with_budget(budget), policy, bytes_per_tick)
    }

    /// Where children replace their parent together.
    pub(crate) fn atomic(
        tree: &'a LodTree,
        budget: u64,
        policy: Box<dyn Policy + 'a>,
        bytes_per_tick: u64,
    ) -> Session<'a> {
        let settings = SchedulerSettings { refinement: Refinement::Atomic, ..SchedulerSettings::with_budget(budget) };
        Session::with_settings(tree, settings, policy, bytes_per_tick)
    }

    fn with_settings(
        tree: &'a LodTree,
        settings: SchedulerSettings,
        policy: Box<dyn Policy + 'a>,
        bytes_per_tick: u64,
    ) -> Session<'a> {
        Session {
            scheduler: Scheduler::new(tree, settings, policy),
            now: Time::ZERO,
            actions: Vec::new(),
            bytes_per_tick,
            in_flight: Vec::new(),
            decoding: Vec::new(),
            total: 0,
            fails: None,
        }
    }

    /// One in eight transfers fails from now on.
    pub(crate) fn with_failures(mut self, seed: u64) -> Session<'a> {
        self.fails = Some(Dice(seed | 1));
        self
    }

    /// Obeys until the scheduler waits; checks memory, prerequisites, and that nothing is undone at once.
    fn obey(&mut self) {
        loop {
            let action = self.scheduler.next(self.now).unwrap();
            let state = self.scheduler.state();
            assert!(state.used_bytes() <= state.budget);
            match &action {
                Action::Fetch { rep, .. } => {
                    if let Some(needed) = state.tree.prerequisite(*rep) {
                        assert_ne!(state.status(needed), Status::Absent, "{rep:?} before {needed:?}");
                    }
                    assert!(!self.actions.contains(&Action::Discard(*rep)));
                    self.in_flight.push((*rep, state.tree.wire_bytes(*rep)));
                }
                Action::Cancel(rep) => self.in_flight.retain(|(r, _)| r != rep),
                Action::Discard(rep) => {
                    assert!(!self.actions.iter().any(|a| matches!(a, Action::Fetch { rep: r, .. } if r == rep)));
                }
                Action::WaitUntil(time) => {
                    assert!(*time > self.now);
                    return;
                }
            }
            self.actions.push(action);
            assert!(self.actions.len() <= 2 * state.tree.representations() + 1, "no end");
        }
    }

    /// `rep` failed, and with it whatever on its way needs it.
    fn fail(&mut self, rep: RepId) {
        self.scheduler.failed(rep, self.now).unwrap();
        let tree = self.scheduler.state().tree;
        let needs =
            |r: RepId| core::iter::successors(tree.prerequisite(r), |&p| tree.prerequisite(p)).any(|p| p == rep);
        let failing: Vec<RepId> =
            self.in_flight.iter().map(|t| t.0).chain(self.decoding.iter().copied()).filter(|&r| needs(r)).collect();
        for &dependent in &failing {
            self.scheduler.failed(dependent, self.now).unwrap();
        }
        self.in_flight.retain(|t| !failing.contains(&t.0));
        self.decoding.retain(|r| !failing.contains(r));
    }

    /// A request on its way fails.
    pub(crate) fn fail_request(&mut self, rep: u32) {
        self.in_flight.retain(|t| t.0 != RepId(rep));
        self.fail(RepId(rep));
    }

    /// One tick: the link moves on, decoders finish, the camera is seen, and the scheduler obeyed.
    pub(crate) fn tick(&mut self, view: &View) {
        self.actions.clear();
        for rep in core::mem::take(&mut self.decoding) {
            self.scheduler.completed(rep, self.now).unwrap();
        }
        let mut left = self.bytes_per_tick;
        while let Some((rep, missing)) = self.in_flight.first_mut() {
            let sent = left.min(*missing);
            (*missing, left) = (*missing - sent, left - sent);
            self.total += sent;
            if *missing > 0 {
                break;
            }
            let rep = *rep;
            self.in_flight.remove(0);
            self.scheduler.responded(rep, self.now).unwrap();
            if self.fails.as_mut().is_some_and(|dice| dice.below(8) == 0) {
                self.fail(rep);
            } else {
                self.scheduler.arrived(rep, self.now).unwrap();
                self.decoding.push(rep);
            }
        }
        self.scheduler.progress(0, self.total, self.now).unwrap();
        self.scheduler.observe(view, self.now).unwrap();
        self.obey();
        self.now += TICK;
    }

    pub(crate) fn ticks(&mut self, count: usize, view: &View) {
        for _ in 0..count {
            self.tick(view);
        }
    }

    /// What the latest tick requested, in order.
    pub(crate) fn fetched(&self) -> Vec<u32> {
        let fetch = |a: &Action| if let Action::Fetch { rep, .. } = a { Some(rep.0) } else { None };
        self.actions.iter().filter_map(fetch).collect()
    }

    /// What the latest tick discarded, in order.
    pub(crate) fn discarded(&self) -> Vec<u32> {
        let discard = |a: &Action| if let Action::Discard(rep) = a { Some(rep.0) } else { None };
        self.actions.iter().filter_map(discard).collect()
    }

    /// What the latest tick aborted, in order.
    pub(crate) fn cancelled(&self) -> Vec<u32> {
        let cancel = |a: &Action| if let Action::Cancel(rep) = a { Some(rep.0) } else { None };
        self.actions.iter().filter_map(cancel).collect()
    }

    pub(crate) fn resident(&self, rep: u32) -> bool {
        self.scheduler.state().status(RepId(rep)) == Status::Resident
    }

    /// Every leaf in the frustum is shown at ≤ `target` pixels, or with the finest that there is at or above it.
    pub(crate) fn assert_sharp(&self, view: &View, target: f64) {
        let state = self.scheduler.state();
        let (tree, frustum) = (state.tree, Frustum::new(view));
        for leaf in (0..tree.nodes() as u32).map(NodeId).filter(|&n| tree.is_leaf(n)) {
            if frustum.side(tree.centre(leaf) - view.position, tree.half(leaf)) == Side::Outside {
                continue;
            }
            let path = || tree.ancestors(leaf).flat_map(|n| tree.own(n));
            let Some(deepest) = tree.ancestors(leaf).find(|&n| tree.own(n).len() > 0) else { continue };
            let finest = tree.own(deepest).min_by(|&a, &b| tree.error(a).total_cmp(&tree.error(b))).unwrap();
            let meets = |r: RepId| {
                let n = tree.node_of(r);
                let to_box = ((tree.centre(n) - view.position).abs() - tree.half(n)).max(DVec3::ZERO);
                tree.error(r) * frustum.pixels_per_radian <= target * to_box.length()
            };
            let shown =
                |r: RepId| state.status(r) == Status::Resident && (meets(r) || tree.error(r) <= tree.error(finest));
            assert!(path().any(shown), "leaf {leaf:?}: {:?}", path().map(|r| (r, state.status(r))).collect::<Vec<_>>());
        }
    }
}
