//! The simulator against what can be worked out by hand.

use foresight_replay::simulation::Simulation;
use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::specification::{PolicySpec, names};
use foresight_scheduler::scheduler::{Action, SchedulerSettings};
use foresight_scheduler::state::{ClientState, Status};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::future;
use foresight_sim::replay::{Run, Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, tick_time};
use foresight_traces::link::{LinkTrace, RatePiece};
use glam::{DQuat, DVec3};
use std::collections::BTreeSet;

const MILLISECOND: Time = Time(1_000_000);

/// `n` leaves beside each other, 20 m ahead, each with one representation.
fn row(n: usize, wire_bytes: u32, decoded_bytes: u32, error: f32) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for i in 0..n {
        builder.open().unwrap();
        let rep = Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: None };
        builder.add(rep).unwrap();
        let min = DVec3::new(3.0 * i as f64 - 1.0, -1.0, -22.0);
        builder.close(Some(Aabb { min, max: min + DVec3::splat(2.0) }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

fn still(seconds: f64) -> Flight {
    let view = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1600, 900] };
    Flight::sample(seconds, |_| view)
}

fn run<'a>(
    tree: &'a LodTree,
    flight: &Flight,
    link: &LinkTrace,
    client: ClientSettings,
    policy: Box<dyn Policy + 'a>,
) -> Run {
    let cuts = flight.cuts(tree, &CutSettings { opening: 0.0, ..CutSettings::default() });
    let scheduler = SchedulerSettings::with_budget(1 << 30);
    let link_start = Time::ZERO;
    replay(Stage { tree, flight, cuts: &cuts, link, link_start, client, scheduler, preloaded: &[] }, policy).unwrap()
}

fn named<'a>(name: &str, tree: &'a LodTree, flight: &Flight, link: &LinkTrace) -> Box<dyn Policy + 'a> {
    future::build(&PolicySpec::parse_list(name, 0.7, None).unwrap()[0], tree, flight, link, Time::ZERO)
}

/// The first tick at or after a time.
fn tick_after(at: Time) -> Time {
    (0..).map(tick_time).find(|&tick| tick >= at).expect("ticks go on")
}

/// Asks for everything at once.
struct Everything;

impl Policy for Everything {
    fn name(&self) -> &str {
        "everything"
    }

    fn observe(&mut self, _state: &ClientState, _view: &View, _now: Time) {}

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        let reps = (0..state.tree.representations() as u32).map(RepId);
        let absent = reps.into_iter().find(|&r| state.status(r) == Status::Absent);
        absent.map_or(Action::WaitUntil(now), |rep| Action::Fetch { rep, discard_on_arrival: Vec::new() })
    }
}

/// One leaf, one representation of M bytes: asked for at the first tick, its last byte comes at τ + c·M, it is decoded
/// in m/rate, and it is shown at the first tick then. Before, the quality is 0; after, 1/(1 + (g·k/(48·d))²).
#[test]
fn one_transfer_takes_latency_and_bytes() {
    let (error, wire, decoded) = (0.5f32, 123_457u32, 400_001u32);
    let tree = row(1, wire, decoded, error);
    let flight = still(3.0);
    for (rate, rtt) in [(1_000_000u64, Time(60_000_000)), (8_000_000, Time(0)), (999_983, Time(123_456_789))] {
        let link = LinkTrace::constant("constant", rate, rtt).unwrap();
        let nanos = (u128::from(wire) * 8 * 1_000_000_000).div_ceil(u128::from(rate));
        let arrived = rtt + Time(nanos as u64);
        for decode_rate in [200e6, 1e6] {
            let client = ClientSettings { decode_rate, ..ClientSettings::default() };
            let shown = tick_after(arrived + Time::from_secs(f64::from(decoded) / decode_rate));
            let pixels_per_metre = 900.0 / (2.0 * libm::tan(0.5)) / 20.0;
            let off = f64::from(error) * pixels_per_metre / HALF_ACCURACY_PX;
            let after = 1.0 / (1.0 + off * off);
            for name in names() {
                let run = run(&tree, &flight, &link, client, named(name, &tree, &flight, &link));
                assert_eq!(run.completions.len(), 1, "{name}");
                assert_eq!(run.completions[0].at, shown, "{name} at {rate} bit/s");
                assert_eq!((run.bytes_fetched, run.bytes_unfinished), (u64::from(wire), 0), "{name}");
                assert_eq!((run.bytes_wasted, run.bytes_cancelled, run.evictions), (0, 0, 0), "{name}");
                for (frame, quality) in run.frames.iter().enumerate() {
                    let at = tick_time(frame as u64 * TICKS_PER_FRAME);
                    let expected = if at < shown { 0.0 } else { after };
                    assert!((quality.mean().unwrap() - expected).abs() < 1e-7, "{name} at {at:?}");
                }
            }
        }
    }
}

/// n equal transfers begun together share the link and end together, at τ + c·n·M.
#[test]
fn equal_transfers_end_together() {
    let (wire, rate, rtt) = (10_000u64, 2_000_000u64, Time(40_000_000));
    for n in [1u64, 2, 3, 7, 25] {
        let tree = row(n as usize, wire as u32, 100, 0.1);
        let flight = still(4.0);
        let link = LinkTrace::constant("constant", rate, rtt).unwrap();
        let run = run(&tree, &flight, &link, ClientSettings::default(), Box::new(Everything));
        assert_eq!(run.completions.len() as u64, n);
        let arrived = rtt + Time(n * wire * 8 * 1_000_000_000 / rate);
        // A worker decodes 100 bytes in half a microsecond, so thirteen in a row are done before the next tick.
        let shown = tick_after(arrived + Time(500 * n.div_ceil(2)));
        assert!(run.completions.iter().all(|c| c.at == shown), "{n}");
        assert_eq!(run.bytes_fetched, n * wire);
    }
}

/// Halfway through an outage the bytes are those that came before it, and nothing comes until it ends.
#[test]
fn an_outage_delays_by_its_length() {
    // 100 kB/s for 0.5 s, nothing for 1 s, then again: 80 kB need 0.8 s of link.
    let on = |from: u64, bits_per_second: u64| RatePiece { from: Time(from * MILLISECOND.0), bits_per_second };
    let pieces = vec![on(0, 800_000), on(500, 0), on(1500, 800_000)];
    let link = LinkTrace::from_rates("outage", pieces, Time(10_000 * MILLISECOND.0), Time(0)).unwrap();
    let tree = row(1, 80_000, 0, 0.1);
    let flight = still(2.5);
    let run = run(&tree, &flight, &link, ClientSettings::default(), Box::new(Everything));
    assert_eq!(run.completions.iter().map(|c| c.at).collect::<Vec<_>>(), [tick_after(Time(1800 * MILLISECOND.0))]);
    for (frame, &received) in run.received.iter().enumerate() {
        let at = tick_time(frame as u64 * TICKS_PER_FRAME).secs();
        let busy = at.min(0.5) + (at - 1.5).clamp(0.0, 0.3);
        assert!((received as f64 - 100_000.0 * busy).abs() < 1.0, "{at}: {received}");
    }
}

/// What is larger than a tick's upload takes as many ticks as it has budgets.
#[test]
fn large_uploads_take_several_ticks() {
    let tree = row(1, 1000, 950, 0.1);
    let flight = still(2.0);
    let link = LinkTrace::constant("constant", 8_000_000, Time(0)).unwrap();
    let client = ClientSettings { upload_bytes_per_tick: 100, ..ClientSettings::default() };
    let run = run(&tree, &flight, &link, client, Box::new(Everything));
    // Arrived after 1 ms and decoded at once: the first tick uploads 100 bytes, the tenth the last 50.
    assert_eq!(run.completions.iter().map(|c| c.at).collect::<Vec<_>>(), [tick_time(10)]);
}

/// What is not in view is wasted, whole; what is cut off at the end is unfinished.
#[test]
fn bytes_are_charged_where_they_belong() {
    let tree = row(2, 50_000, 1000, 0.1);
    // Turned around: nothing is ever in view.
    let mut flight = still(1.0);
    for view in &mut flight.views {
        view.orientation = DQuat::from_rotation_y(core::f64::consts::PI);
    }
    // 62.5 kB by the last tick at 59/60 s, shared: neither of both is whole. Then 1 MB/s: both are.
    let slow = LinkTrace::constant("slow", 500_000, Time(0)).unwrap();
    let ended = run(&tree, &flight, &slow, ClientSettings::default(), Box::new(Everything));
    let delivered = slow.bytes_deliverable(Time::ZERO, tick_time(59));
    assert_eq!(ended.bytes_fetched, delivered);
    assert!(delivered - ended.bytes_unfinished <= 2 && ended.bytes_wasted == 0);
    let fast = LinkTrace::constant("fast", 8_000_000, Time(0)).unwrap();
    let ended = run(&tree, &flight, &fast, ClientSettings::default(), Box::new(Everything));
    assert_eq!((ended.bytes_fetched, ended.bytes_unfinished, ended.bytes_wasted), (100_000, 0, 100_000));
    assert!(ended.frames.iter().all(|q| q.mean().is_none()));
}

/// Driven one view at a time, a client does what the replay says, and its ticks tell what comes and what goes.
#[test]
fn one_view_at_a_time_is_the_whole_replay() {
    let tree = row(12, 40_000, 300_000, 0.5);
    let look = |t: f64| View {
        position: DVec3::new(4.0 * t, 0.0, 0.0),
        orientation: DQuat::IDENTITY,
        fov_y: 0.6,
        viewport: [800, 600],
    };
    let flight = Flight::sample(8.0, look);
    let link = LinkTrace::constant("8 Mbit/s", 8_000_000, Time(20_000_000)).unwrap();
    let cuts = flight.cuts(&tree, &CutSettings::default());
    let stage = Stage {
        tree: &tree,
        flight: &flight,
        cuts: &cuts,
        link: &link,
        link_start: Time::ZERO,
        client: ClientSettings::default(),
        scheduler: SchedulerSettings::with_budget(1_500_000),
        preloaded: &[],
    };
    let whole = replay(stage, named("foresight", &tree, &flight, &link)).unwrap();
    let mut simulation = Simulation::new(stage.conditions(), named("foresight", &tree, &flight, &link)).unwrap();
    let (mut frames, mut requests, mut here) = (Vec::new(), Vec::new(), BTreeSet::new());
    for (tick, view) in flight.views.iter().enumerate() {
        let done = simulation.tick(view, tick_time(tick as u64)).unwrap();
        here.extend(done.completed.iter().copied());
        requests.extend(done.requested.iter().copied());
        for gone in done.discarded.clone() {
            assert!(here.remove(&gone), "{gone:?} was discarded and never shown");
        }
        assert!(simulation.resident().iter().eq(here.iter().copied()), "tick {tick}");
        if (tick as u64).is_multiple_of(TICKS_PER_FRAME) {
            frames.push(simulation.judge(&cuts[tick / TICKS_PER_FRAME as usize]));
        }
    }
    assert!(!whole.completions.is_empty() && whole.evictions > 0, "{whole:?}");
    assert_eq!(frames, whole.frames);
    assert!(requests.into_iter().eq(whole.requests.iter().map(|r| r.rep)));
    assert_eq!((simulation.counts().evictions, simulation.delivered_bytes()), (whole.evictions, whole.bytes_fetched));
}
