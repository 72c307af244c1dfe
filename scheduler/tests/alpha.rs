//! α solved for and adapted, on a ring of towers around a camera that turns or jumps.

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::policy::foresight::{
    ALPHA_MAX, AlphaReport, AlphaRule, Constraint, Foresight, ForesightSettings,
};
use foresight_scheduler::predict::PredictorKind;
use foresight_scheduler::predict::motion::Speeds;
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerSettings};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_scheduler::worst_case::Reach;
use glam::{DQuat, DVec3};
use proptest::prelude::*;

/// 60 Hz.
const TICK: Time = Time(16_666_667);
const TOWERS: u32 = 24;

/// Towers 5 m wide and 16 m high, 20 m away all around, 100 kB each, without error.
fn ring() -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for i in 0..TOWERS {
        let angle = core::f64::consts::TAU * f64::from(i) / f64::from(TOWERS);
        let centre = DVec3::new(20.0 * libm::sin(angle), 0.0, 20.0 * libm::cos(angle));
        builder.open().unwrap();
        let bytes = 100_000;
        let rep =
            Representation { wire_bytes: bytes, decoded_bytes: bytes, error: 0.0, prerequisite: None, direction: None };
        builder.add(rep).unwrap();
        let half = DVec3::new(2.5, 8.0, 2.5);
        builder.close(Some(Aabb { min: centre - half, max: centre + half }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

fn looking(yaw: f64) -> View {
    View { position: DVec3::ZERO, orientation: DQuat::from_rotation_y(yaw), fov_y: 0.8, viewport: [1000, 1000] }
}

/// A client that could turn anywhere within a moment.
fn settings(alpha_rule: AlphaRule, predictor: PredictorKind) -> ForesightSettings {
    let declared = Some(Speeds { linear: 0.0, angular: 50.0 });
    ForesightSettings {
        alpha_rule,
        predictor,
        reach: Reach { declared, ..Reach::default() },
        ..ForesightSettings::default()
    }
}

/// α after each second of a session along `yaw`, and what is reported at its end. Nothing that is asked for ever comes;
/// `preloaded` is there from the start.
fn session(
    settings: ForesightSettings,
    seconds: u64,
    preloaded: u32,
    announced: bool,
    yaw: impl Fn(f64) -> f64,
) -> (Vec<f64>, AlphaReport) {
    let tree = ring();
    let policy = Foresight::new("foresight", settings);
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), Box::new(policy));
    for rep in 0..preloaded {
        scheduler.preload(RepId(rep)).unwrap();
    }
    let ticks = 60 * seconds;
    let at = |tick: u64| Time(tick * TICK.0);
    if announced {
        let path: Vec<_> = (0..ticks + 600).map(|t| (at(t), looking(yaw(at(t).secs())))).collect();
        scheduler.announce_path(&path).unwrap();
    }
    let mut alphas = Vec::new();
    for tick in 0..ticks {
        let now = at(tick);
        scheduler.observe(&looking(yaw(now.secs())), now).unwrap();
        while !matches!(scheduler.next(now).unwrap(), Action::WaitUntil(_)) {}
        if tick % 60 == 0 {
            alphas.push(scheduler.alpha().unwrap().alpha);
        }
    }
    (alphas, scheduler.alpha().unwrap())
}

/// Looks somewhere else every half second: a hash of the half second's number.
fn jumping(seconds: f64) -> f64 {
    let number = (2.0 * seconds) as u64;
    let hash = (number.wrapping_add(1)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    core::f64::consts::TAU * ((hash >> 40) as f64 / (1u64 << 24) as f64)
}

#[test]
fn a_known_path_is_trusted_and_jumps_are_not() {
    let (_, known) = session(settings(AlphaRule::Adapted, PredictorKind::KnownPath), 40, 0, true, |t| 0.5 * t);
    assert!(known.alpha > 0.9, "{known:?}");
    let (_, blind) = session(settings(AlphaRule::Adapted, PredictorKind::ConstantVelocity), 40, 0, false, jumping);
    assert!(blind.alpha < 0.4, "{blind:?}");
    // From then on known, it is trusted again; and what was trusted fails.
    let turned = |t: f64| if t < 40.0 { jumping(t) } else { 0.5 * t };
    let (alphas, _) = session(settings(AlphaRule::Adapted, PredictorKind::Mixture), 100, 0, false, turned);
    assert!(alphas[39] < 0.6 && alphas[99] > alphas[39] + 0.2, "{alphas:?}");
}

#[test]
fn what_never_comes_is_infeasible_and_what_is_all_there_is_slack() {
    let solved = settings(AlphaRule::Solved { at_least: 0.6 }, PredictorKind::Mixture);
    let (alphas, poor) = session(solved, 90, 0, false, |t| 0.5 * t);
    assert_eq!((alphas[89], poor.constraint), (0.0, Some(Constraint::Infeasible)), "{alphas:?}");
    assert_eq!((poor.mean_worst_quality, poor.target), (Some(0.0), Some(0.6)));
    let (alphas, rich) = session(solved, 60, TOWERS, false, |t| 0.5 * t);
    assert_eq!((alphas[59], rich.constraint), (ALPHA_MAX, Some(Constraint::Slack)));
    assert!(rich.mean_worst_quality.is_some_and(|q| q > 0.999));
    // Half of the ring is there, and half is asked for.
    let half = settings(AlphaRule::Solved { at_least: 0.5 }, PredictorKind::Mixture);
    let (_, half) = session(half, 120, TOWERS / 2, false, |t| 0.5 * t);
    assert_eq!(half.constraint, Some(Constraint::Met), "{half:?}");
}

#[test]
fn a_watched_alpha_stays_and_a_fixed_one_says_nothing_of_the_worst_case() {
    let (alphas, watched) = session(settings(AlphaRule::Watched, PredictorKind::Mixture), 5, TOWERS, false, jumping);
    assert!(alphas.iter().all(|a| *a == 0.7) && watched.mean_worst_quality.is_some());
    let (_, fixed) = session(settings(AlphaRule::Fixed, PredictorKind::Mixture), 5, TOWERS, false, jumping);
    assert_eq!((fixed.alpha, fixed.mean_worst_quality, fixed.constraint), (0.7, None, None));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(24) })]
    /// Whatever the camera does, α is in [0, 1], and the same session gives the same α.
    #[test]
    fn alpha_is_a_share_and_repeats(
        alpha in prop::sample::select(vec![0.0, 0.7, 1.0, 1.0 - f64::EPSILON]),
        at_least in prop::option::of(0.0..=1.0f64),
        yaws in prop::collection::vec(-1e3..1e3f64, 1..8),
        preloaded in 0..TOWERS,
    ) {
        let rule = at_least.map_or(AlphaRule::Adapted, |at_least| AlphaRule::Solved { at_least });
        let settings = ForesightSettings { alpha, ..settings(rule, PredictorKind::Mixture) };
        let run = || session(settings, 8, preloaded, false, |t| yaws[t as usize % yaws.len()]);
        let (alphas, report) = run();
        prop_assert!(alphas.iter().all(|a| (0.0..=1.0).contains(a)), "{alphas:?}");
        prop_assert!(report.oscillation.is_finite() && (0.0..=1.0).contains(&report.mean_alpha));
        prop_assert_eq!((alphas, report), run());
    }
}
