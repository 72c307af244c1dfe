//! Requests that fail, round trips that vary, and paths that are announced: what each policy makes of them.

use foresight_index::generate::city::{CityParams, city};
use foresight_scheduler::benefit::cut::{Cut, CutSettings};
use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::policy::specification::{PolicySpec, names};
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::future;
use foresight_sim::replay::{Run, Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::Flight;
use foresight_traces::link::{LinkTrace, RttPiece};
use foresight_traces::path::CameraPath;
use foresight_traces::path::turn::turn;
use glam::DVec3;

const BUDGET: u64 = 64 << 20;

struct Scene {
    tree: LodTree,
    flight: Flight,
    cuts: Vec<Cut>,
}

impl Scene {
    /// A small city with a camera that drives into it, turns around, and drives back.
    fn new(speed: f64, seconds: f64) -> Scene {
        let params = CityParams { blocks_x: 6, blocks_y: 6, seed: 3, ..CityParams::default() };
        let tree = city(&params).expect("a small city").tree;
        let path: CameraPath = turn(speed, seconds).expect("a made path");
        let flight = Flight::sample(seconds, |t| {
            let (position, orientation) = path.at(t);
            let position = position + DVec3::new(-200.0, 5.0, 20.0);
            View { position, orientation, fov_y: 1.0, viewport: [1280, 720] }
        });
        let cuts = flight.cuts(&tree, &CutSettings::default());
        Scene { tree, flight, cuts }
    }

    fn replay(&self, policy: &str, link: &LinkTrace, announce_s: f64) -> Run {
        let stage = Stage {
            tree: &self.tree,
            flight: &self.flight,
            cuts: &self.cuts,
            link,
            link_start: Time::ZERO,
            client: ClientSettings { announce_s, ..ClientSettings::default() },
            scheduler: SchedulerSettings::with_budget(BUDGET),
            preloaded: &[],
        };
        let spec = PolicySpec::parse_list(policy, 0.7, None).expect("the policy exists").remove(0);
        let policy = future::build(&spec, &self.tree, &self.flight, link, Time::ZERO);
        replay(stage, policy).unwrap_or_else(|error| panic!("{}: {error}", spec.label))
    }
}

fn link(loss: f64) -> LinkTrace {
    let link = LinkTrace::constant("constant", 8_000_000, Time(40_000_000)).expect("a link");
    link.with_loss(loss, 7).expect("a probability")
}

fn mean(run: &Run) -> f64 {
    let qualities: Vec<f64> = run.frames.iter().filter_map(|frame| frame.mean()).collect();
    assert!(!qualities.is_empty());
    qualities.iter().sum::<f64>() / qualities.len() as f64
}

fn same(a: &Run, b: &Run) -> bool {
    a.frames == b.frames && a.completions == b.completions && a.bytes_fetched == b.bytes_fetched
}

#[test]
fn a_path_announced_to_its_end_is_the_true_path() {
    let scene = Scene::new(30.0, 12.0);
    let truth = scene.replay("foresight:predictor=true-path", &link(0.0), 0.0);
    let announced = scene.replay("foresight:predictor=known-path", &link(0.0), 100.0);
    assert!(same(&truth, &announced), "{} and {}", mean(&truth), mean(&announced));
    let unannounced = scene.replay("foresight:predictor=known-path", &link(0.0), 0.0);
    assert!(!same(&truth, &unannounced));
    // So is one that reaches beyond every horizon, however often it is renewed.
    let short = ":horizon=1:samples=3";
    let truth = scene.replay(&format!("foresight:predictor=true-path{short}"), &link(0.0), 0.0);
    let announced = scene.replay(&format!("foresight:predictor=known-path{short}"), &link(0.0), 8.0);
    assert!(same(&truth, &announced), "{} and {}", mean(&truth), mean(&announced));
}

#[test]
fn who_does_not_listen_is_not_disturbed_by_announcements() {
    let scene = Scene::new(30.0, 6.0);
    // `two-phase` takes an announced path for its track.
    for name in names().filter(|name| *name != "two-phase") {
        let (quiet, told) = (scene.replay(name, &link(0.0), 0.0), scene.replay(name, &link(0.0), 1.5));
        assert!(same(&quiet, &told), "{name}: {} and {}", mean(&quiet), mean(&told));
    }
}

#[test]
fn every_policy_goes_on_when_requests_fail() {
    let scene = Scene::new(0.0, 30.0);
    for name in names() {
        let whole = scene.replay(name, &link(0.0), 0.0);
        let lossy = scene.replay(name, &link(0.3), 0.0);
        println!("{name}: {} without, {} with {} failures", mean(&whole), mean(&lossy), lossy.failures);
        assert!(whole.failures == 0 && lossy.failures > 0 && lossy.bytes_failed > 0, "{name}");
        // Foresight and its kin ask again: the end is what it is without failures. A rival may never ask again for what
        // failed, as its file says, but it goes on with the rest.
        let last = |run: &Run| run.frames.last().and_then(|frame| frame.mean()).unwrap_or(0.0);
        let asks_again = ["foresight", "added-benefit", "clairvoyant"].contains(&name);
        assert!(!asks_again || last(&lossy) >= 0.99 * last(&whole), "{name}: {} of {}", last(&lossy), last(&whole));
        assert!(!lossy.completions.is_empty(), "{name}");
        let nothing = scene.replay(name, &link(1.0), 0.0);
        assert!(nothing.completions.is_empty() && nothing.failures > 0, "{name}");
    }
}

#[test]
fn failures_are_seeded_and_the_same_for_all() {
    let scene = Scene::new(10.0, 5.0);
    let with = |link: LinkTrace| scene.replay("foresight", &link, 0.0);
    assert!(same(&with(link(0.3)), &with(link(0.3))));
    assert!(!same(&with(link(0.3)), &with(link(0.3).with_loss_seed(8))));
    assert!(same(&with(link(0.0)), &with(link(0.0).with_loss_seed(8))));
    // Of many requests the share asked for fails, anywhere in their transfer.
    let link = link(0.2);
    let breaks: Vec<u64> = (0..10_000).filter_map(|rep| link.breaks_after(rep, 1, 1000)).collect();
    assert!((1800..2200).contains(&breaks.len()), "{}", breaks.len());
    let mean = breaks.iter().sum::<u64>() as f64 / breaks.len() as f64;
    assert!((mean - 500.0).abs() < 30.0 && breaks.iter().all(|&b| b < 1000), "{mean}");
    let always = link.with_loss(1.0, 7).expect("a probability");
    assert_ne!(always.breaks_after(4, 1, u64::MAX), always.breaks_after(4, 2, u64::MAX));
}

#[test]
fn a_round_trip_that_varies_only_in_name_changes_nothing() {
    let scene = Scene::new(30.0, 6.0);
    let constant = link(0.0);
    let rtt = Time(40_000_000);
    let pieces = [RttPiece { from: Time::ZERO, rtt }, RttPiece { from: Time(500_000_000), rtt }];
    let varying = constant.with_varying_rtt(&pieces, Time(1_000_000_000)).expect("pieces");
    assert_eq!((varying.hash(), varying.rtt_range()), (constant.hash(), (rtt, rtt)));
    // A hair above it at a moment when nothing is asked for is a series, and yet the same.
    let never = RttPiece { from: Time(999_999_999), rtt: Time(40_000_001) };
    let pieces = [pieces[0], never];
    let varying = constant.with_varying_rtt(&pieces, Time(1_000_000_000)).expect("pieces");
    assert_ne!(varying.hash(), constant.hash());
    for name in names() {
        let (a, b) = (scene.replay(name, &constant, 0.0), scene.replay(name, &varying, 0.0));
        assert!(same(&a, &b), "{name}: {} and {}", mean(&a), mean(&b));
    }
}
