//! Cameras that skim, race, spin, stand, or are seen twice in a nanosecond.

use crate::session::{Client, TICK, at, cube, flat, nine};
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder};
use foresight_scheduler::predict::PredictorKind;
use foresight_scheduler::predict::motion::{Motion, rotation_vector};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};

/// A floor of 16 × 16 tiles of 1 m with its top at y = 0, two levels each.
fn floor() -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for i in 0..256 {
        let (x, z) = (f64::from(i % 16) - 8.0, -f64::from(i / 16) - 1.0);
        builder.open().unwrap();
        builder.add(crate::session::rep(2000, 0.5)).unwrap();
        builder.add(crate::session::rep(8000, 0.001)).unwrap();
        let min = DVec3::new(x, -0.5, z);
        builder.close(Some(Aabb { min, max: min + DVec3::new(1.0, 0.5, 1.0) }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// Whatever the height, weights are finite, no tile weighs more than the half space it fills, and what is nearest comes
/// in full detail.
fn skims(height: f64) {
    let tree = floor();
    let eye = DVec3::new(0.5, height, -0.5);
    let mut cut = Cut::default();
    cut.make(&tree, &at(eye), Region::Frustum, &CutSettings::default());
    assert!(!cut.patches.is_empty() && cut.patches.iter().all(|p| p.weight.is_finite() && p.sharpness.is_finite()));
    assert!(cut.patches.iter().all(|p| p.weight <= core::f64::consts::TAU));
    let log = Client::default().run(&tree, 64 * 8, |t| at(eye + DVec3::NEG_Z * 0.5 * t));
    // The tile beneath the eye after 8 s is the fifth in front of the first column's middle.
    let beneath = 4 * 16 + 8;
    assert!(log.resident.contains(&(2 * beneath + 1)), "{:?}", log.resident);
}

#[test]
fn skimming_a_surface_at_a_centimetre() {
    skims(0.01);
}

#[test]
fn skimming_a_surface_at_a_micrometre() {
    skims(1e-6);
}

#[test]
fn standing_and_creeping_decide_alike() {
    let tree = nine(DVec3::ZERO);
    let still = Client::default().stand(&tree, 256);
    let creeping = Client::default().run(&tree, 256, |t| at(DVec3::NEG_Z * 1e-6 * t));
    assert_eq!(still, creeping);
    assert_eq!(still.discarded, 0);
}

/// At 10⁴ m/s what is gone before its bytes could arrive is left, although it looks largest now.
#[test]
fn at_ten_kilometres_a_second_what_is_passed_is_not_fetched() {
    let objects = [
        (cube(DVec3::new(100.0, 0.0, -500.0), 40.0), &[(5000, 1.0)][..]),
        (cube(DVec3::new(500.0, 0.0, -60_000.0), 100.0), &[(5000, 1.0)][..]),
    ];
    let tree = flat(&objects);
    let client = Client::with(|s| {
        s.alpha = 1.0;
        s.cover_first = false;
        s.predictor = PredictorKind::ConstantVelocity;
    });
    // Until the velocity is known, and no longer: after that the near object is behind.
    let path = |t: f64| at(DVec3::new(0.0, 0.0, 10_000.0 - 10_000.0 * t));
    let log = client.run(&tree, 96, path);
    assert!(log.fetched.contains(&1), "{log:?}");
    let slow = client.run(&tree, 8, |t| at(DVec3::new(0.0, 0.0, -1.0 * t)));
    assert_eq!(slow.fetched.first(), Some(&0), "{slow:?}");
}

fn spinning(rate: f64, ticks: u64, step: u64) -> (Motion, Time, DQuat) {
    let mut motion = Motion::default();
    let (mut now, mut orientation) = (Time::ZERO, DQuat::IDENTITY);
    for tick in 0..ticks {
        now = Time(tick * step);
        orientation = DQuat::from_rotation_y(rate * now.secs());
        motion.observe(&View { orientation, ..at(DVec3::ZERO) }, now);
    }
    (motion, now, orientation)
}

/// Over the baseline of 0.2 s it turns by ten radians: more than once around is not mistaken for less.
#[test]
fn a_spin_of_fifty_radians_a_second_is_seen_as_such() {
    let (motion, ..) = spinning(50.0, 240, 4_166_667);
    let rate = motion.rotation_rate();
    assert!((rate - DVec3::Y * 50.0).length() < 1e-6, "{rate}");
    assert!((motion.percentile().angular - 50.0).abs() < 1e-6);
}

#[test]
fn a_spin_of_fifty_radians_a_second_is_predicted() {
    let mut predictor = PredictorKind::ConstantTurn.build();
    let mut now = Time::ZERO;
    for tick in 0..240u64 {
        now = Time(tick * 4_166_667);
        let orientation = DQuat::from_rotation_y(50.0 * now.secs());
        predictor.observe(&View { orientation, ..at(DVec3::ZERO) }, now);
    }
    let ahead = predictor.predict(now, &[0.1])[0].views[0].orientation;
    let truth = DQuat::from_rotation_y(50.0 * (now.secs() + 0.1));
    assert!(rotation_vector(ahead * truth.conjugate()).length() < 1e-6);
}

/// Whoever spins looks everywhere: in the end all around is there, the nearest in full detail.
#[test]
fn a_spin_of_fifty_radians_a_second_brings_all_around() {
    let tree = nine(DVec3::ZERO);
    let log = Client::default()
        .run(&tree, 640, |t| View { orientation: DQuat::from_rotation_y(50.0 * t), ..at(DVec3::ZERO) });
    assert_eq!(log.resident.len(), 18, "{log:?}");
}

/// Two views a nanosecond and a millimetre apart are no 10⁶ m/s.
#[test]
fn jitter_within_a_nanosecond_is_no_velocity() {
    let mut motion = Motion::default();
    motion.observe(&at(DVec3::ZERO), Time(0));
    motion.observe(&at(DVec3::X * 1e-3), Time(1));
    assert_eq!(motion.velocity(), DVec3::ZERO);
    motion.observe(&at(DVec3::X * 1e-3), Time(TICK));
    assert!((motion.velocity().x - 0.064).abs() < 1e-9);
}

/// Ticks a nanosecond apart: decisions are those of one moment.
#[test]
fn events_a_nanosecond_apart_decide_like_one_moment() {
    let tree = nine(DVec3::ZERO);
    let fast = Client { tick: 1, ..Client::default() };
    let log = fast.stand(&tree, 200);
    let once = Client::default().stand(&tree, 1);
    assert_eq!(log.fetched, once.fetched);
    assert!(log.resident.is_empty());
}

/// A box whose face lies in the right plane of the frustum from outside weighs nothing, and comes in continuously.
#[test]
fn grazing_the_frustum_weighs_nothing_and_enters_continuously() {
    let view = View { fov_y: core::f64::consts::FRAC_PI_2, viewport: [1000, 1000], ..at(DVec3::ZERO) };
    let mut last = 0.0;
    for inside in [-1e-3, 0.0, 1e-9, 1e-6, 1e-3, 0.1] {
        // The right plane is x = −z. The corner nearest to it is (9, ·, −9) moved in along x.
        let min = DVec3::new(9.0 - inside, -1.0, -9.0);
        let tree = flat(&[(Aabb { min, max: min + DVec3::new(2.0, 2.0, 0.0) }, &[(1000, 1.0)])]);
        let mut cut = Cut::default();
        cut.make(&tree, &view, Region::Frustum, &CutSettings::default());
        let weight = cut.total_weight;
        // The box is narrowed to f32 upwards, which may let it in by a hair.
        assert!(if inside <= 0.0 { weight < 1e-6 } else { weight <= 0.02 * inside + 1e-6 }, "{inside}: {weight}");
        assert!(weight >= last - 1e-12, "{inside}: {weight} after {last}");
        last = weight;
    }
    assert!(last > 1e-4);
}

/// A path along the edge of the view of an object that is never seen: only the worst case fetches it.
#[test]
fn a_path_grazing_an_object_fetches_it_for_the_worst_case_only() {
    let tree = flat(&[(cube(DVec3::new(0.0, 0.0, 50.0), 1.0), &[(1000, 1.0)])]);
    let only_paths = Client::with(|s| s.alpha = 1.0);
    let only_worst = Client::with(|s| {
        s.alpha = 0.0;
        s.reach.declared = Some(foresight_scheduler::predict::motion::Speeds { linear: 0.0, angular: 1e3 });
        s.reach.angular_max = 1e3;
    });
    assert_eq!(only_paths.stand(&tree, 64).fetched, Vec::<u32>::new());
    assert_eq!(only_worst.stand(&tree, 64).fetched, vec![0]);
}

/// A turn by π between two ticks is one teleport of the view: the coverage is asked for again, nothing is lost.
#[test]
fn a_half_turn_between_two_ticks_keeps_what_is_there() {
    let tree = nine(DVec3::ZERO);
    let turn = |t: f64| View {
        orientation: DQuat::from_rotation_y(if t < 2.0 { 0.0 } else { core::f64::consts::PI }),
        ..at(DVec3::ZERO)
    };
    let log = Client::default().run(&tree, 320, turn);
    assert!(log.resident.contains(&17) && log.discarded == 0, "{log:?}");
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    log.resident.iter().for_each(|&r| assert!(coverage.insert(&tree, foresight_scheduler::lod_tree::RepId(r))));
}
