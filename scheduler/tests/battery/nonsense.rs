//! NaN, ±∞ and worse in each field of each public entry: refused by name, or answered without NaN.

use crate::session::{Client, at, cube, nine, try_flat};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::{Aabb, LodTreeError};
use foresight_scheduler::policy::RivalSettings;
use foresight_scheduler::policy::foresight::{AlphaRule, Foresight, ForesightSettings};
use foresight_scheduler::predict::motion::Speeds;
use foresight_scheduler::predict::{PredictedPath, Predictor, PredictorKind};
use foresight_scheduler::scheduler::{Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::transfer::TransferEstimate;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::{View, ViewError};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

type Set = fn(&mut ForesightSettings, f64);

/// Every field of the policy's settings that is a number.
const FIELDS: [(&str, Set); 18] = [
    ("alpha", |s, v| s.alpha = v),
    ("alpha_rule.at_least", |s, v| s.alpha_rule = AlphaRule::Solved { at_least: v }),
    ("horizon_s", |s, v| s.horizon_s = v),
    ("reuse_s", |s, v| s.reuse_s = v),
    ("hysteresis", |s, v| s.hysteresis = v),
    ("attenuation", |s, v| s.attenuation = v),
    ("request_cost_s", |s, v| s.request_cost_s = v),
    ("tolerance", |s, v| s.tolerance = v),
    ("grouping", |s, v| s.grouping = v),
    ("slack_s", |s, v| s.slack_s = v),
    ("opening", |s, v| s.cut.opening = v),
    ("near", |s, v| s.cut.near = v),
    ("centre_falloff", |s, v| s.cut.centre_falloff = v),
    ("reach.linear_max", |s, v| s.reach.linear_max = v),
    ("reach.angular_max", |s, v| s.reach.angular_max = v),
    ("reach.stand_off", |s, v| s.reach.stand_off = v),
    ("reach.declared.linear", |s, v| s.reach.declared = Some(Speeds { linear: v, angular: 0.0 })),
    ("reach.declared.angular", |s, v| s.reach.declared = Some(Speeds { linear: 0.0, angular: v })),
];

#[test]
fn every_setting_of_the_policy_is_refused_by_name() {
    for (name, set) in FIELDS {
        for value in NOT_FINITE.into_iter().chain([-1.0]) {
            let mut settings = ForesightSettings::default();
            set(&mut settings, value);
            let error = Foresight::checked("foresight", settings).err().unwrap_or_else(|| panic!("{name} = {value}"));
            assert_eq!(error.field, name);
            assert!(error.to_string().starts_with(&format!("{name} is {value}; expected ")), "{error}");
        }
    }
    let none = ForesightSettings { samples: 0, ..ForesightSettings::default() };
    assert_eq!(none.check().unwrap_err().to_string(), "samples is 0; expected a count from 1 to 4096");
    assert_eq!(ForesightSettings::default().check(), Ok(()));
}

#[test]
fn every_guess_of_the_link_is_refused_by_name() {
    let tree = nine(DVec3::ZERO);
    for value in NOT_FINITE.into_iter().chain([-1.0]) {
        let base = SchedulerSettings::with_budget(1);
        let rate = SchedulerSettings { rate_guess: value, ..base };
        let latency = SchedulerSettings { latency_guess_s: value, ..base };
        for (settings, field) in [(rate, "rate_guess"), (latency, "latency_guess_s")] {
            let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
            let refused = Scheduler::checked(&tree, settings, policy).err();
            assert!(matches!(refused, Some(SchedulerError::Setting(e)) if e.field == field), "{refused:?}");
        }
        assert!(TransferEstimate::checked(value, 0.0).is_err() && TransferEstimate::checked(1.0, value).is_err());
    }
    assert!(TransferEstimate::checked(0.0, 0.0).is_err());
}

#[test]
fn every_setting_of_a_rival_is_refused_by_name() {
    let fine = RivalSettings { error_target_px: 16.0, parallel: 6 };
    assert_eq!(fine.check(), Ok(()));
    for value in NOT_FINITE.into_iter().chain([0.0, -1.0]) {
        let error = RivalSettings { error_target_px: value, ..fine }.check().unwrap_err();
        assert_eq!(error.field, "error_target_px");
    }
    assert_eq!(RivalSettings { parallel: 0, ..fine }.check().unwrap_err().field, "parallel");
}

fn every_bad_view() -> Vec<View> {
    let mut bad = Vec::new();
    for value in NOT_FINITE {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            bad.push(at(DVec3::select(axis.cmpeq(DVec3::ONE), DVec3::splat(value), DVec3::ZERO)));
        }
        for i in 0..4 {
            let mut q = [0.0, 0.0, 0.0, 1.0];
            q[i] = value;
            bad.push(View { orientation: DQuat::from_array(q), ..at(DVec3::ZERO) });
        }
        bad.push(View { fov_y: value, ..at(DVec3::ZERO) });
    }
    bad.push(at(DVec3::X * 1e31));
    bad.push(View { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 1.0 + 1e-5), ..at(DVec3::ZERO) });
    bad.extend([0.0, -1.0, core::f64::consts::PI].map(|fov_y| View { fov_y, ..at(DVec3::ZERO) }));
    bad.extend([[0, 1], [1, 0]].map(|viewport| View { viewport, ..at(DVec3::ZERO) }));
    bad
}

/// A refused view leaves the scheduler as it was.
#[test]
fn every_field_of_a_view_is_refused() {
    let tree = nine(DVec3::ZERO);
    let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), policy);
    for view in every_bad_view() {
        assert!(matches!(scheduler.observe(&view, Time(5)), Err(SchedulerError::View(_))), "{view:?}");
        assert!(matches!(scheduler.announce_path(&[(Time(5), view)]), Err(SchedulerError::View(_))), "{view:?}");
        assert_eq!(scheduler.state().view, None);
    }
    // Time has not passed either.
    assert_eq!(scheduler.observe(&at(DVec3::ZERO), Time::ZERO), Ok(()));
    assert!(matches!(at(DVec3::X * f64::NAN).check(), Err(ViewError::Position(_))));
}

#[test]
fn a_path_that_goes_back_in_time_is_refused() {
    let tree = nine(DVec3::ZERO);
    let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), policy);
    let view = at(DVec3::ZERO);
    let path = [(Time(1), view), (Time(3), view), (Time(2), view)];
    let refused = scheduler.announce_path(&path).unwrap_err();
    assert_eq!(refused, SchedulerError::PathOrder { index: 2, at: Time(2), before: Time(3) });
    assert_eq!(scheduler.announce_path(&path[..2]), Ok(()));
    assert_eq!(scheduler.announce_path(&[(Time(1), view), (Time(1), view)]), Ok(()));
}

#[test]
fn every_field_of_a_world_is_refused_by_name() {
    let fine = cube(DVec3::NEG_Z * 10.0, 1.0);
    for value in NOT_FINITE {
        for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
            let broken = DVec3::select(axis.cmpeq(DVec3::ONE), DVec3::splat(value), DVec3::ZERO);
            for bounds in [Aabb { min: fine.min + broken, ..fine }, Aabb { max: fine.max + broken, ..fine }] {
                let refused = try_flat(&[(bounds, &[(1, 1.0)])], 1.0).unwrap_err();
                assert!(matches!(refused, LodTreeError::Bounds { node: 1, .. }), "{refused}");
            }
        }
        let error = value as f32;
        let refused = try_flat(&[(fine, &[(1, error)])], 1.0).unwrap_err();
        assert!(matches!(refused, LodTreeError::GeometricError { rep: 0, .. }), "{refused}");
        let refused = try_flat(&[(fine, &[(1, 1.0)])], error).unwrap_err();
        assert!(matches!(refused, LodTreeError::Importance { node: 1, .. }), "{refused}");
    }
    assert_eq!(try_flat(&[(fine, &[(0, 1.0)])], 1.0).unwrap_err(), LodTreeError::NoBytes(0));
    let far = Aabb { min: DVec3::splat(1e30), max: DVec3::splat(2e30) };
    assert!(matches!(try_flat(&[(far, &[(1, 1.0)])], 1.0).unwrap_err(), LodTreeError::Bounds { .. }));
}

/// A predictor of one's own that answers NaN is not believed; decisions go on.
#[test]
fn a_predictor_that_answers_nan() {
    struct Astray;
    impl Predictor for Astray {
        fn observe(&mut self, _: &View, _: Time) {}
        fn predict(&self, _: Time, offsets: &[f64]) -> Vec<PredictedPath> {
            let astray = View { orientation: DQuat::from_xyzw(f64::NAN, 0.0, 0.0, 1.0), ..at(DVec3::NAN) };
            vec![PredictedPath { weight: 1.0, views: vec![astray; offsets.len()] }]
        }
    }
    let tree = nine(DVec3::ZERO);
    let policy = Foresight::with_predictor("astray", ForesightSettings::default(), Box::new(Astray));
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), Box::new(policy));
    scheduler.observe(&at(DVec3::ZERO), Time::ZERO).unwrap();
    let astray = scheduler.next(Time::ZERO).unwrap();
    let policy = Foresight::new("foresight", ForesightSettings::default());
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), Box::new(policy));
    scheduler.observe(&at(DVec3::ZERO), Time::ZERO).unwrap();
    assert_eq!(scheduler.next(Time::ZERO).unwrap(), astray);
}

fn cases() -> ProptestConfig {
    let full = std::env::var_os("FORESIGHT_FULL").is_some();
    ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(if full { 4000 } else { 200 }) }
}

/// Any float at all, the awkward ones often.
fn float() -> impl Strategy<Value = f64> {
    let awkward =
        [0.0, -0.0, 5e-324, 1e-308, 1e-30, 1e-9, 1.0, 1e5, 1e12, 1e30, 1e300, f64::MAX, f64::INFINITY, f64::NAN];
    prop_oneof![prop::sample::select(awkward.to_vec()), any::<f64>(), -10.0..10.0f64]
}

proptest! {
    #![proptest_config(cases())]

    /// Settings are refused, or a session runs to its end without a panic, without NaN, in bounded work.
    #[test]
    fn any_settings_are_refused_or_decided_with(values in prop::collection::vec((0..FIELDS.len(), float()), 1..4), rate in float(), latency in float(), budget in any::<u64>()) {
        let mut client = Client { link: (1e6, 0.01), ..Client::default() };
        for (field, value) in values {
            FIELDS[field].1(&mut client.foresight, value);
        }
        client.scheduler = SchedulerSettings { rate_guess: rate, latency_guess_s: latency, ..SchedulerSettings::with_budget(budget) };
        if client.foresight.check().is_ok() && client.scheduler.check().is_ok() {
            let log = client.run(&nine(DVec3::ZERO), 24, |t| at(DVec3::NEG_Z * t));
            prop_assert!(log.fetched.len() < 1000);
        }
    }

    /// A view is refused, or its cut is finite and its weights lie within what a sphere can hold.
    #[test]
    fn any_view_is_refused_or_weighed(p in prop::array::uniform3(float()), q in prop::array::uniform4(float()), unit in any::<bool>(), fov_y in float(), viewport in prop::array::uniform2(any::<u32>()), reach in float(), angle in float()) {
        let q = DQuat::from_array(q);
        let orientation = if unit && q.is_finite() && q.length() > 0.0 { q.normalize() } else { q };
        let view = View { position: DVec3::from_array(p), orientation, fov_y, viewport };
        if view.check().is_ok() {
            let tree = nine(DVec3::ZERO);
            let widened = Region::Reachable { angle: angle.abs(), reach: reach.abs(), stand_off: 0.5 };
            for region in [Region::Frustum, widened] {
                if matches!(region, Region::Reachable { angle, reach, .. } if !angle.is_finite() || !reach.is_finite()) {
                    continue;
                }
                let mut cut = Cut::default();
                cut.make(&tree, &view, region, &CutSettings::default());
                prop_assert!((0.0..=13.0 * 9.0).contains(&cut.total_weight) && (0.0..=1.0).contains(&cut.scale));
                for patch in &cut.patches {
                    prop_assert!(patch.weight.is_finite() && !patch.sharpness.is_nan(), "{:?}", patch);
                }
            }
            for (name, kind) in PredictorKind::ALL {
                let mut predictor = kind.build();
                predictor.observe(&at(DVec3::ZERO), Time::ZERO);
                predictor.observe(&view, Time(1_000_000));
                for path in predictor.predict(Time(1_000_000), &[0.0, 4.0, 1e6]) {
                    prop_assert!(path.weight.is_finite() && path.views.iter().all(|v| v.position.is_finite() && v.orientation.is_finite()), "{}", name);
                }
            }
        }
    }

    /// A box with an error and an importance is refused, or decided on.
    #[test]
    fn any_world_is_refused_or_decided_on(min in prop::array::uniform3(float()), max in prop::array::uniform3(float()), error in float(), importance in float(), wire in any::<u32>()) {
        let bounds = Aabb { min: DVec3::from_array(min), max: DVec3::from_array(max) };
        let reps = [(wire / 4, error as f32)];
        if let Ok(tree) = try_flat(&[(bounds, &reps), (cube(DVec3::NEG_Z * 9.0, 1.0), &[(1000, 0.1)])], importance as f32) {
            let log = Client::default().stand(&tree, 16);
            prop_assert!(log.fetched.len() <= 2, "{:?}", log);
        }
    }

    /// The estimate of the link stays a rate and a latency whatever is reported when.
    #[test]
    fn any_reports_leave_a_rate(rate in float(), latency in float(), reports in prop::collection::vec((0..4u8, any::<u64>(), any::<u64>()), 0..40)) {
        if let Ok(mut estimate) = TransferEstimate::checked(rate, latency) {
            for (what, a, b) in reports {
                match what {
                    0 => estimate.responded(Time(a), Time(b)),
                    1 => estimate.ended(Time(a)),
                    _ => estimate.received(a, Time(b)),
                }
                prop_assert!(estimate.rate() >= 1.0 && estimate.rate().is_finite(), "{}", estimate.rate());
                prop_assert!(estimate.latency_s() >= 0.0 && estimate.latency_s().is_finite());
            }
        }
    }
}
