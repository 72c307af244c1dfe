//! What holds in every replay, whatever the world, flight, link, memory and policy.

#[path = "../../scheduler/tests/random_tree/mod.rs"]
mod random_tree;

use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::cut::{Cut, CutSettings};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::specification::{PolicySpec, names, rival};
use foresight_scheduler::scheduler::{Action, SchedulerSettings};
use foresight_scheduler::state::{ClientState, Status};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::bound::{CheapestBeneath, FrameBound, Limits};
use foresight_sim::compare::{Memory, Plan, compare};
use foresight_sim::future;
use foresight_sim::outcome::Inputs;
use foresight_sim::replay::{Run, Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, tick_time};
use foresight_traces::link::{LinkTrace, RatePiece, RttPiece};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use random_tree::Tape;
use std::sync::{Arc, Mutex};

/// Relative error of a group's area, which is kept in single precision.
const AREA_ROUNDING: f64 = 1e-6;

fn cases(few: u32) -> ProptestConfig {
    let full = std::env::var_os("FORESIGHT_FULL").is_some();
    ProptestConfig {
        failure_persistence: None,
        max_shrink_iters: 20_000,
        ..ProptestConfig::with_cases(if full { 20 * few } else { few })
    }
}

fn tape() -> impl Strategy<Value = Vec<u16>> {
    prop::collection::vec(any::<u16>(), 0..500)
}

/// A camera that walks, stands, teleports or looks away, for one to three seconds.
fn flight(tape: &mut Tape) -> Flight {
    let ticks = 60 + tape.below(121) as u64;
    let start = tape.view();
    let speed = [0.0, 3.0, 60.0][tape.below(3)];
    let turning = [0.0, 0.5, 6.0][tape.below(3)];
    let teleport_every = [u64::MAX, 40, 7][tape.below(3)];
    let away_from = [u64::MAX, 0, 50][tape.below(3)];
    let mut view = start;
    let views = (0..ticks).map(|tick| {
        view.orientation = (DQuat::from_rotation_y(turning / 60.0) * view.orientation).normalize();
        view.position += view.forward() * (speed / 60.0);
        if tick % teleport_every == teleport_every - 1 {
            view = View { viewport: start.viewport, ..tape.view() };
        }
        // From far outside and outwards nothing is ever seen.
        let away =
            View { position: DVec3::Z * 1e4, orientation: DQuat::from_rotation_y(core::f64::consts::PI), ..view };
        if (away_from..away_from.saturating_add(40)).contains(&tick) { away } else { view }
    });
    Flight { views: views.collect() }
}

/// Constant, stepped with outages, or with opportunities; from 8 kbit/s to 80 Mbit/s; a round trip up to 0.3 s, constant
/// or not; requests that fail never, sometimes, or always.
fn link(tape: &mut Tape) -> LinkTrace {
    let rtt = Time([20_000_000, 0, 100_000_000, 300_000_000][tape.below(4)]);
    let mut rate = || libm::exp(libm::log(8e3) + tape.unit() * libm::log(1e4)) as u64;
    let fastest = rate();
    let rates = [rate(), 0, rate(), 0, fastest];
    let made = match tape.below(3) {
        0 => LinkTrace::constant("constant", fastest, rtt),
        1 => {
            let mut from = Time::ZERO;
            let mut pieces = Vec::new();
            for bits_per_second in rates {
                pieces.push(RatePiece { from, bits_per_second });
                from += Time(1 + tape.below(1000) as u64 * 1_000_000);
            }
            LinkTrace::from_rates("stepped", pieces, from, rtt)
        }
        _ => {
            let mut at = 0;
            let milliseconds: Vec<u64> = (0..1 + tape.below(200))
                .map(|_| {
                    at += [0, 1, 3, 10, 200][tape.below(5)];
                    at
                })
                .collect();
            let last = at.max(1);
            LinkTrace::from_opportunities("opportunities", &[&milliseconds[..], &[last]].concat(), rtt)
        }
    };
    let mut made = made.expect("what was drawn is a link");
    if tape.below(3) == 2 {
        let mut from = Time::ZERO;
        let pieces: Vec<RttPiece> = (0..1 + tape.below(20))
            .map(|_| {
                let piece = RttPiece { from, rtt: Time(tape.below(300) as u64 * 1_000_000) };
                from += Time(1 + tape.below(100) as u64 * 1_000_000);
                piece
            })
            .collect();
        made = made.with_varying_rtt(&pieces, from).expect("times increase");
    }
    let loss = [0.0, 0.0, 0.05, 0.5, 1.0][tape.below(5)];
    made.with_loss(loss, tape.below(1000) as u64).expect("a probability")
}

/// One of the policies with some of its options.
fn specification(tape: &mut Tape) -> PolicySpec {
    let names: Vec<&str> = names().collect();
    let name = names[tape.below(names.len())];
    let options: &[&[&str]] = match rival(name) {
        Some(rival) if rival.error_target_px.is_none() => &[&["", ":parallel=1", ":parallel=3"]],
        Some(_) => &[&["", ":target=1", ":target=64", ":target=0.01"], &["", ":parallel=1", ":parallel=3"]],
        None => &[
            &["", ":alpha=0", ":alpha=1", ":alpha=0.3"],
            &[
                "",
                ":predictor=constant-velocity",
                ":predictor=constant-turn",
                ":predictor=kalman",
                ":predictor=true-path",
                ":predictor=known-path",
            ],
            &["", ":discards=lru"],
            &["", ":arrival=off"],
            &["", ":cover=off"],
            &["", ":horizon=0.01", ":horizon=60"],
            &["", ":samples=1", ":samples=17"],
            &["", ":reuse=0.001", ":reuse=2"],
            &["", ":hysteresis=0", ":hysteresis=3"],
            &["", ":attenuation=1", ":attenuation=100"],
            &["", ":opening=0", ":opening=2"],
            &["", ":falloff=1"],
            &["", ":tolerance=0", ":choice=sampled", ":choice=sampled:grouping=0"],
            &["", ":slack=0", ":slack=10"],
            &["", ":request-cost=0.5"],
        ],
    };
    let mut text = name.to_owned();
    for choices in options {
        text += choices[tape.below(choices.len())];
    }
    PolicySpec::parse_list(&text, 0.7, None).expect("the options exist").remove(0)
}

/// Everything of a replay but the policy.
struct World {
    tree: LodTree,
    flight: Flight,
    cuts: Vec<Cut>,
    link: LinkTrace,
    link_start: Time,
    client: ClientSettings,
    scheduler: SchedulerSettings,
    preloaded: Vec<RepId>,
}

impl World {
    fn new(tape: &mut Tape) -> World {
        let tree = tape.tree(60);
        let flight = flight(tape);
        let opening = [0.15, 0.0, 1.0][tape.below(3)];
        let cuts = flight.cuts(&tree, &CutSettings { opening, ..CutSettings::default() });
        let size = |r: RepId| tree.wire_bytes(r) + tree.decoded_bytes(r);
        let first = reps(&tree).filter(|&r| tree.prerequisite(r).is_none());
        let (smallest, all) = (first.map(size).min().unwrap_or(0), reps(&tree).map(size).sum::<u64>());
        let share = tape.unit();
        let budget = smallest + (share * share * (all - smallest) as f64) as u64;
        let client = ClientSettings {
            decode_rate: [200e6, 1e6, 1e4][tape.below(3)],
            decode_workers: 1 + tape.below(3),
            upload_bytes_per_tick: [8 << 20, 10_000, 1][tape.below(3)],
            announce_s: [0.0, 0.5, 100.0][tape.below(3)],
        };
        let scheduler = SchedulerSettings {
            refinement: [Refinement::Partial, Refinement::Atomic][tape.below(2)],
            rate_guess: [625_000.0, 1.0, 1e9][tape.below(3)],
            ..SchedulerSettings::with_budget(budget)
        };
        let (mut preloaded, mut used) = (Vec::new(), 0);
        let warm = tape.below(4) == 3;
        for rep in reps(&tree).filter(|_| warm) {
            let whole = tree.prerequisite(rep).is_none_or(|p| preloaded.contains(&p));
            if whole && used + tree.decoded_bytes(rep) <= budget {
                used += tree.decoded_bytes(rep);
                preloaded.push(rep);
            }
        }
        let link = link(tape);
        let link_start = Time(tape.below(3000) as u64 * 1_000_000);
        World { tree, flight, cuts, link, link_start, client, scheduler, preloaded }
    }

    fn stage(&self) -> Stage<'_> {
        Stage {
            tree: &self.tree,
            flight: &self.flight,
            cuts: &self.cuts,
            link: &self.link,
            link_start: self.link_start,
            client: self.client,
            scheduler: self.scheduler,
            preloaded: &self.preloaded,
        }
    }

    /// Replays and tells what the scheduler last knew to have arrived without being shown, wire bytes.
    fn replay(&self, spec: &PolicySpec) -> Result<(Run, u64), String> {
        let seen = Arc::new(Mutex::new(Seen::default()));
        let inner = future::build(spec, &self.tree, &self.flight, &self.link, self.link_start);
        let watched = Watched { inner, seen: Arc::clone(&seen) };
        let run = replay(self.stage(), Box::new(watched)).map_err(|e| format!("{}: {e}", spec.label))?;
        let seen = *seen.lock().map_err(|e| e.to_string())?;
        if let Some((at, rep)) = seen.useless {
            return Err(format!("{}: at {} s {rep:?} is kept without what it needs first", spec.label, at.secs()));
        }
        Ok((run, seen.decoding))
    }

    fn deliverable(&self, by: Time) -> u64 {
        self.link.bytes_deliverable(self.link_start, self.link_start + by)
    }
}

fn reps(tree: &LodTree) -> impl Iterator<Item = RepId> + use<> {
    (0..tree.representations() as u32).map(RepId)
}

/// What a policy was asked on.
#[derive(Clone, Copy, Default)]
struct Seen {
    /// Wire bytes of what has arrived and is not shown yet, when last asked.
    decoding: u64,
    /// What was once resident, not to go, and without its prerequisite.
    useless: Option<(Time, RepId)>,
}

/// A policy that is watched.
struct Watched<'a> {
    inner: Box<dyn Policy + 'a>,
    seen: Arc<Mutex<Seen>>,
}

impl Policy for Watched<'_> {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn observe(&mut self, state: &ClientState, view: &View, now: Time) {
        self.inner.observe(state, view, now);
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        let arrived = reps(state.tree).filter(|&r| state.status(r) == Status::Arrived);
        let lacks = |r: RepId| state.tree.prerequisite(r).is_some_and(|p| !state.resident().contains(p));
        let useless = reps(state.tree).find(|&r| state.status(r) == Status::Resident && lacks(r));
        if let Ok(mut seen) = self.seen.lock() {
            seen.decoding = arrived.map(|r| state.tree.wire_bytes(r)).sum();
            seen.useless = seen.useless.or(useless.map(|r| (now, r)));
        }
        self.inner.decide(state, now)
    }

    fn completed(&mut self, state: &ClientState, rep: RepId, now: Time) {
        self.inner.completed(state, rep, now);
    }

    fn failed(&mut self, state: &ClientState, rep: RepId, now: Time) {
        self.inner.failed(state, rep, now);
    }

    fn announce_path(&mut self, path: &[(Time, View)]) {
        self.inner.announce_path(path);
    }
}

proptest! {
    #![proptest_config(cases(4000))]

    /// No refusal, no runaway; memory within the budget; every byte accounted for; every figure finite; no frame above
    /// its bound, not even one of a policy that knows path and link; and the same again.
    #[test]
    fn every_replay_keeps_its_promises(tape in tape()) {
        let mut tape = Tape::new(tape);
        let world = World::new(&mut tape);
        let spec = specification(&mut tape);
        let (run, decoding) = world.replay(&spec).map_err(TestCaseError::fail)?;
        let frames = world.flight.frames();
        prop_assert_eq!((run.frames.len(), run.memory.len(), run.received.len()), (frames, frames, frames));
        prop_assert!(run.memory.iter().all(|&used| used <= world.scheduler.budget));

        let shown: u64 = run.completions.iter().map(|c| world.tree.wire_bytes(c.rep)).sum();
        let accounted = shown + decoding + run.bytes_cancelled + run.bytes_failed + run.bytes_unfinished;
        // Parts of bytes are rounded down for each transfer that did not end.
        let ended_early = world.tree.representations() as u64 * frames as u64 + run.failures;
        let rounded = accounted..=accounted + ended_early;
        prop_assert!(rounded.contains(&run.bytes_fetched), "{} of {}: {}", accounted, run.bytes_fetched, spec.label);
        if run.bytes_cancelled == 0 && run.failures == 0 {
            prop_assert!(run.bytes_fetched - accounted <= world.tree.representations() as u64);
        }
        prop_assert!(run.bytes_fetched <= world.deliverable(world.flight.duration()));
        prop_assert!(world.link.loss() > 0.0 || run.failures == 0);
        prop_assert!(world.link.loss() < 1.0 || run.completions.is_empty(), "{:?}", run.completions);
        prop_assert!(run.bytes_wasted + run.bytes_cancelled + run.bytes_failed <= run.bytes_fetched,
            "{} wasted and {} cancelled of {}: {}", run.bytes_wasted, run.bytes_cancelled, run.bytes_fetched, spec.label);

        let cheapest = CheapestBeneath::new(&world.tree);
        let at_start: u64 = world.preloaded.iter().map(|&r| world.tree.wire_bytes(r)).sum();
        for (frame, quality) in run.frames.iter().enumerate() {
            prop_assert!(quality.benefit.is_finite() && quality.weight.is_finite() && quality.within_target.is_finite());
            prop_assert!(quality.within_target <= quality.weight * (1.0 + AREA_ROUNDING));
            let at = tick_time(frame as u64 * TICKS_PER_FRAME);
            let deliverable = world.deliverable(at);
            prop_assert!(run.received[frame] <= deliverable);
            let problem = FrameBound::new(&world.tree, &cheapest, &world.cuts[frame]);
            prop_assert_eq!(problem.is_some(), quality.mean().is_some());
            if let (Some(mut problem), Some(mean)) = (problem, quality.mean()) {
                let limits = Limits { wire: (at_start + deliverable) as f64, memory: world.scheduler.budget as f64 };
                let bound = problem.bound(limits);
                prop_assert!((0.0..=1.0).contains(&mean));
                prop_assert!(mean <= bound + 1e-9, "frame {frame}: {mean} > {bound}: {}", spec.label);
            }
        }

        let (again, _) = world.replay(&spec).map_err(TestCaseError::fail)?;
        prop_assert_eq!(&run.frames, &again.frames);
        prop_assert_eq!(&run.completions, &again.completions);
        prop_assert_eq!(&run.memory, &again.memory);
        prop_assert_eq!((run.bytes_fetched, run.bytes_wasted, run.evictions), (again.bytes_fetched, again.bytes_wasted, again.evictions));
        prop_assert_eq!((run.failures, run.bytes_failed), (again.failures, again.bytes_failed));
    }
}

/// The document without what depends on the machine's speed.
fn document(world: &World, policies: &[PolicySpec], threads: usize) -> serde_json::Value {
    let plan = Plan {
        tree: &world.tree,
        up: DVec3::Y,
        flight: &world.flight,
        link: &world.link,
        starts: vec![world.link_start, Time::ZERO],
        policies: policies.to_vec(),
        hindsight_targets: vec![4.0],
        memory: Memory::Bytes(world.scheduler.budget),
        scheduler: world.scheduler,
        client: world.client,
        judging: CutSettings::default(),
        warm: !world.preloaded.is_empty(),
        without_bound: false,
        limits: true,
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("two threads can be had");
    let made = pool.install(|| compare(&plan, Inputs::default(), |_, _| {})).expect("the smallest request fits");
    let mut document = serde_json::to_value(made).expect("all keys are strings");
    let listed = document["policies"].as_array_mut().expect("a list of policies");
    for policy in listed {
        let policy = policy.as_object_mut().expect("a policy is an object");
        assert!(policy.remove("decision_ns").is_some());
    }
    document
}

fn all_finite(value: &serde_json::Value) -> bool {
    match value {
        serde_json::Value::Number(number) => number.as_f64().is_some_and(f64::is_finite),
        serde_json::Value::Array(parts) => parts.iter().all(all_finite),
        serde_json::Value::Object(parts) => parts.values().all(all_finite),
        _ => true,
    }
}

proptest! {
    #![proptest_config(cases(60))]

    /// A comparison does not depend on how many threads make it, and stays below its bound.
    #[test]
    fn threads_change_nothing(tape in tape()) {
        let mut tape = Tape::new(tape);
        let world = World::new(&mut tape);
        let mut policies = PolicySpec::parse_list("all", 0.7, None).expect("the policies exist");
        policies.push(specification(&mut tape));
        policies.retain(|policy| !world.tree.has_directions() || policy.tells_directions());
        let one = document(&world, &policies, 1);
        prop_assert!(all_finite(&one));
        prop_assert_eq!(&one, &document(&world, &policies, 2));
        if let Some(bound) = one["upper_bound"]["mean_quality"].as_f64() {
            for policy in one["policies"].as_array().expect("a list of policies") {
                let mean = policy["mean_quality"].as_f64().expect("something is in view, so there is a quality");
                prop_assert!(mean <= bound + 1e-9, "{}: {mean} > {bound}", policy["name"]);
                let within = policy["share_within_16px"].as_f64().expect("something is in view, so there is a share");
                prop_assert!((0.0..=1.0).contains(&within), "{}: {within}", policy["name"]);
            }
        }
    }
}
