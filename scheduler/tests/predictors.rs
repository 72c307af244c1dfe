//! Every predictor on inputs that no camera should give: the answer stays a weighted set of proper views.

use foresight_scheduler::predict::motion::{Motion, rotation_vector};
use foresight_scheduler::predict::{PredictedPath, Predictor, PredictorKind};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const TICK: u64 = 16_666_667;
const HOUR: u64 = 3_600_000_000_000;
const OFFSETS: [f64; 5] = [0.0, 1e-9, 0.125, 4.0, 3600.0];

fn view(position: DVec3, orientation: DQuat) -> View {
    View { position, orientation, fov_y: 1.0, viewport: [1920, 1080] }
}

fn each() -> impl Iterator<Item = (&'static str, Box<dyn Predictor>)> {
    PredictorKind::ALL.into_iter().map(|(name, kind)| (name, kind.build()))
}

fn check(name: &str, paths: &[PredictedPath], offsets: &[f64]) -> Result<(), String> {
    let belief: f64 = paths.iter().map(|p| p.weight).sum();
    if paths.is_empty() || (belief - 1.0).abs() > 1e-9 || paths.iter().any(|p| p.weight < 0.0) {
        return Err(format!("{name}: {} paths with a belief of {belief}", paths.len()));
    }
    for path in paths {
        if path.views.len() != offsets.len() {
            return Err(format!("{name}: {} views for {} offsets", path.views.len(), offsets.len()));
        }
        for view in &path.views {
            view.check().map_err(|e| format!("{name}: {e}"))?;
            // Stricter than the check: a rotation that grows or shrinks would do so again and again.
            let length = view.orientation.length();
            if (length - 1.0).abs() > 1e-12 {
                return Err(format!("{name}: an orientation of length {length}"));
            }
        }
    }
    Ok(())
}

/// Feeds `views` (nanoseconds since the one before, view) to every predictor, and asks after each at once and later.
fn feed(views: &[(u64, View)], announced: bool) -> Result<(), String> {
    for (name, mut predictor) in each() {
        let mut now = Time::ZERO;
        if announced {
            let mut at = Time::ZERO;
            let path: Vec<(Time, View)> = views
                .iter()
                .map(|&(passed, view)| {
                    at += Time(passed);
                    (at, view)
                })
                .collect();
            predictor.announce_path(&path);
        }
        for (passed, view) in views {
            now += Time(*passed);
            predictor.observe(view, now);
            for lag in [0, 1, TICK, HOUR] {
                check(name, &predictor.predict(now + Time(lag), &OFFSETS), &OFFSETS)?;
            }
        }
    }
    Ok(())
}

#[test]
fn before_the_first_view_nothing_is_predicted() {
    for (name, predictor) in each() {
        assert!(predictor.predict(Time::ZERO, &OFFSETS).is_empty(), "{name}");
    }
}

#[test]
fn two_views_a_nanosecond_apart() {
    let a = view(DVec3::ZERO, DQuat::IDENTITY);
    let b = view(DVec3::splat(5.0), DQuat::from_rotation_y(3.0));
    feed(&[(0, a), (1, b), (1, a), (1, b)], false).unwrap();
    feed(&[(0, a), (1, b), (1, a), (1, b)], true).unwrap();
}

#[test]
fn two_views_at_one_time() {
    let a = view(DVec3::ZERO, DQuat::IDENTITY);
    let b = view(DVec3::X, DQuat::from_rotation_x(1.0));
    feed(&[(0, a), (0, b), (0, a), (TICK, b), (0, a)], false).unwrap();
    feed(&[(0, a), (0, b), (0, a), (TICK, b), (0, a)], true).unwrap();
}

#[test]
fn an_hours_pause() {
    let step = |i: u64| view(DVec3::X * 0.1 * i as f64, DQuat::from_rotation_y(0.05 * i as f64));
    let views: Vec<_> = (0..120).map(|i| (if i == 60 { HOUR } else { TICK }, step(i))).collect();
    feed(&views, false).unwrap();
}

#[test]
fn half_a_turn_between_two_ticks() {
    let flip = |i: u64| {
        view(DVec3::ZERO, if i.is_multiple_of(2) { DQuat::IDENTITY } else { DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0) })
    };
    let views: Vec<_> = (0..120).map(|i| (TICK, flip(i))).collect();
    feed(&views, false).unwrap();
    feed(&views, true).unwrap();
}

/// q and −q are one orientation: a recording that alternates between them stands still.
#[test]
fn alternating_signs_are_no_rotation() {
    let q = DQuat::from_rotation_y(2.0) * DQuat::from_rotation_x(0.3);
    for (name, mut predictor) in each() {
        let mut now = Time::ZERO;
        for i in 0..180u64 {
            now = Time(i * TICK);
            predictor.observe(&view(DVec3::ONE, if i.is_multiple_of(2) { q } else { -q }), now);
        }
        // The mixture also looks to the sides of what it believes most.
        let likeliest = predictor.predict(now, &OFFSETS).into_iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
        if let Some(path) = likeliest {
            for view in path.views {
                let turned = rotation_vector(view.orientation * q.conjugate()).length();
                assert!(turned < 1e-6, "{name}: turned by {turned}");
                assert!(view.position.distance(DVec3::ONE) < 1e-6, "{name}: {}", view.position);
            }
        }
    }
}

/// After a jump of 10⁷ m the camera is where it is, not on its way on.
#[test]
fn a_jump_is_not_a_velocity() {
    let far = DVec3::new(1e7, -1e7, 1e7);
    for (name, mut predictor) in each() {
        for i in 0..120u64 {
            let at = DVec3::X * (i as f64 / 60.0) + if i < 60 { DVec3::ZERO } else { far };
            predictor.observe(&view(at, DQuat::IDENTITY), Time(i * TICK));
        }
        for path in predictor.predict(Time(119 * TICK), &[0.0, 4.0]) {
            for view in &path.views {
                let off = view.position.distance(far);
                assert!(off < 20.0, "{name}: {off} m from where the camera is");
            }
        }
        let paths = predictor.predict(Time(119 * TICK), &OFFSETS);
        check(name, &paths, &OFFSETS).unwrap();
    }
}

#[test]
fn an_announcement_out_of_order_is_put_in_order() {
    let mut predictor = PredictorKind::KnownPath.build();
    let at = |x: f64| view(DVec3::X * x, DQuat::IDENTITY);
    predictor.announce_path(&[(Time(3 * HOUR), at(3.0)), (Time(HOUR), at(1.0)), (Time(2 * HOUR), at(2.0))]);
    predictor.observe(&at(9.0), Time::ZERO);
    let paths = predictor.predict(Time(0), &[0.0, 3600.0, 5400.0, 9000.0, 1e9]);
    let x: Vec<f64> = paths[0].views.iter().map(|v| v.position.x).collect();
    assert_eq!(x, [1.0, 1.0, 1.5, 2.5, 3.0]);
}

fn cases() -> ProptestConfig {
    let full = std::env::var_os("FORESIGHT_FULL").is_some();
    ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(if full { 10_000 } else { 300 }) }
}

fn stiff_view() -> impl Strategy<Value = (u64, View)> {
    let passed = prop_oneof![Just(0), Just(1), Just(TICK), Just(HOUR), 0..10 * TICK, Just(10_000 * HOUR)];
    let coordinate = prop_oneof![Just(0.0), -10.0..10.0f64, -1e7..1e7f64, Just(6.4e6), -1e-9..1e-9f64];
    let turn = prop_oneof![Just(0.0), Just(core::f64::consts::PI), -4.0..4.0f64, -1e-9..1e-9f64];
    (passed, prop::array::uniform3(coordinate), prop::array::uniform3(turn), any::<bool>()).prop_map(
        |(passed, position, [x, y, z], negated)| {
            let q = DQuat::from_rotation_y(y) * DQuat::from_rotation_x(x) * DQuat::from_rotation_z(z);
            let q = q.normalize();
            (passed, view(DVec3::from(position), if negated { -q } else { q }))
        },
    )
}

proptest! {
    #![proptest_config(cases())]

    #[test]
    fn whatever_is_seen_a_proper_view_is_predicted(views in prop::collection::vec(stiff_view(), 1..60), announced in any::<bool>()) {
        prop_assert_eq!(feed(&views, announced), Ok(()));
    }

    /// Speeds and their percentiles are finite too, and no less than nothing.
    #[test]
    fn speeds_are_finite(views in prop::collection::vec(stiff_view(), 1..60)) {
        let (mut motion, mut now) = (Motion::default(), Time::ZERO);
        for (passed, view) in views {
            now += Time(passed);
            motion.observe(&view, now);
            let speeds = motion.percentile();
            prop_assert!(motion.velocity().is_finite() && motion.rotation_rate().is_finite());
            prop_assert!((0.0..f64::INFINITY).contains(&speeds.linear) && (0.0..f64::INFINITY).contains(&speeds.angular));
        }
    }
}
