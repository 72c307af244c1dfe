//! Worlds far out, of every size at once, of equals, deep, flat, empty of volume, or without weight.

use crate::session::{Client, at, cube, flat, nine, rep, try_flat};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::{Aabb, DEPTH_MAX, LodTree, LodTreeBuilder, LodTreeError, RepId};
use foresight_scheduler::policy::foresight::{ChoiceMethod, Foresight, ForesightSettings};
use foresight_scheduler::predict::PredictorKind;
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerSettings};
use foresight_scheduler::units::Time;
use glam::DVec3;

/// Coordinates in steps of 1/8 m are exact there, so every difference is: the same decisions, not only similar ones.
fn decides_alike_at(offset: DVec3) {
    let here = Client::default().run(&nine(DVec3::ZERO), 320, |t| at(DVec3::NEG_Z * t));
    let there = Client::default().run(&nine(offset), 320, |t| at(offset + DVec3::NEG_Z * t));
    assert!(here.resident.len() >= 14, "{here:?}");
    assert_eq!(here, there);
}

#[test]
fn a_planet_away_from_the_origin() {
    decides_alike_at(DVec3::new(6_400_000.0, -6_400_000.0, 6_400_000.0));
}

#[test]
fn an_astronomical_unit_away_from_the_origin() {
    decides_alike_at(DVec3::new(150_000_000_000.0, 0.0, -150_000_000_000.0));
}

/// A nanometre beside ten thousand kilometres: weights are the solid angles, whatever the size.
#[test]
fn nanometres_beside_ten_thousand_kilometres() {
    let (small, large) = (1e-9, 1e7);
    let leaves = [
        (cube(DVec3::new(0.0, 0.0, -10.0), small), &[(1000, 1e-9)][..]),
        (cube(DVec3::new(0.0, 0.0, -5e7), large), &[(1000, 1e6)][..]),
    ];
    let tree = flat(&leaves);
    let mut cut = Cut::default();
    cut.make(&tree, &at(DVec3::ZERO), Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    let face = (2.0 * small) * (2.0 * small) / (10.0 * 10.0);
    let weight = cut.patches[0].weight;
    assert!((weight / face - 1.0).abs() < 1e-3, "{weight} for {face}");
    // The near face of the large cube at 4·10⁷ m: 4·asin(1/17) (Ω of a square, half side over distance 1/4).
    let exact = 4.0 * libm::asin(1.0 / 17.0);
    let second = cut.patches[1].weight;
    assert!((second / exact - 1.0).abs() < 1e-6, "{second} for {exact}");
    let log = Client::default().stand(&tree, 64);
    assert_eq!(log.fetched[0], 1);
}

#[test]
fn of_equals_the_lowest_id_comes_first() {
    let one = (cube(DVec3::new(0.0, 0.0, -10.0), 1.0), &[(1000, 1.0)][..]);
    let tree = flat(&[one; 16]);
    let log = Client::default().stand(&tree, 128);
    assert_eq!(log.fetched, (0..16).collect::<Vec<u32>>());
}

#[test]
fn an_ulp_less_error_comes_first() {
    let bounds = cube(DVec3::new(0.0, 0.0, -10.0), 1.0);
    let (more, less) = (0.5f32, 0.5f32.next_down());
    let tree = flat(&[(bounds, &[(1000, more)]), (bounds, &[(1000, less)])]);
    let client = Client::with(|s| {
        s.cover_first = false;
        s.tolerance = 0.0;
    });
    assert_eq!(client.stand(&tree, 64).fetched, [1, 0]);
}

#[test]
fn a_byte_less_comes_first_and_an_equal_one_after_its_id() {
    let bounds = cube(DVec3::new(0.0, 0.0, -10.0), 1.0);
    let tree = flat(&[(bounds, &[(1_000_001, 0.5)]), (bounds, &[(1_000_000, 0.5)]), (bounds, &[(1_000_000, 0.5)])]);
    let client = Client::with(|s| {
        s.cover_first = false;
        s.tolerance = 0.0;
    });
    assert_eq!(client.stand(&tree, 512).fetched, [1, 2, 0]);
}

#[test]
fn a_box_without_volume_but_with_a_face_is_shown() {
    let plate = Aabb { min: DVec3::new(-1.0, -1.0, -10.0), max: DVec3::new(1.0, 1.0, -10.0) };
    let tree = flat(&[(plate, &[(1000, 0.1)])]);
    let mut cut = Cut::default();
    cut.make(&tree, &at(DVec3::ZERO), Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    // Ω of a square of half side 1 at distance 10: 4·asin(1/101).
    assert!((cut.total_weight - 4.0 * libm::asin(1.0 / 101.0)).abs() < 1e-9, "{}", cut.total_weight);
    assert_eq!(Client::default().stand(&tree, 32).fetched, [0]);
}

#[test]
fn a_point_weighs_nothing_and_is_not_fetched() {
    let point = Aabb { min: DVec3::new(0.0, 0.0, -10.0), max: DVec3::new(0.0, 0.0, -10.0) };
    let log = Client::default().stand(&flat(&[(point, &[(1000, 0.1)])]), 32);
    assert_eq!(log.fetched, Vec::<u32>::new());
}

/// The eye is within the box, closed as it is: it fills the view, like any box around the eye.
#[test]
fn a_point_at_the_eye_fills_the_view() {
    let point = Aabb { min: DVec3::ZERO, max: DVec3::ZERO };
    let tree = flat(&[(point, &[(1000, 0.1)]), (cube(DVec3::NEG_Z * 9.0, 1.0), &[(1000, 0.1)])]);
    let mut cut = Cut::default();
    cut.make(&tree, &at(DVec3::ZERO), Region::Frustum, &CutSettings::default());
    assert!(cut.patches.iter().all(|p| p.weight.is_finite() && p.sharpness.is_finite()));
    let log = Client::default().stand(&tree, 32);
    assert_eq!(log.resident, [0, 1]);
}

#[test]
fn an_inverted_box_is_refused_with_its_corners() {
    let inverted = Aabb { min: DVec3::ONE, max: -DVec3::ONE };
    let error = try_flat(&[(inverted, &[(1000, 0.1)])], 1.0).unwrap_err();
    assert_eq!(error, LodTreeError::Bounds { node: 1, min: DVec3::ONE, max: -DVec3::ONE });
    assert!(error.to_string().contains("[1, 1, 1] to [-1, -1, -1]"), "{error}");
}

/// `groups` × `members` objects in one place.
fn coincident(groups: usize, members: usize) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for _ in 0..groups {
        builder.open().unwrap();
        for _ in 0..members {
            builder.open().unwrap();
            builder.add(rep(1000, 0.5)).unwrap();
            builder.close(Some(cube(DVec3::NEG_Z * 20.0, 1.0)), 1.0).unwrap();
        }
        builder.close(None, 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// The first decisions; what is small is looked at once nothing larger is left, some samplings later.
fn takes_the_lowest_ids(tree: &LodTree, choice: ChoiceMethod) {
    let settings = ForesightSettings {
        alpha: 1.0,
        samples: 1,
        cover_first: false,
        choice,
        tolerance: 0.0,
        predictor: PredictorKind::ConstantVelocity,
        ..ForesightSettings::default()
    };
    let policy = Foresight::new("foresight", settings);
    let mut scheduler = Scheduler::new(tree, SchedulerSettings::with_budget(1 << 40), Box::new(policy));
    let mut fetched = Vec::new();
    for sampling in 0..20 {
        let now = Time::from_secs(0.25 * f64::from(sampling));
        scheduler.observe(&at(DVec3::ZERO), now).unwrap();
        while let (true, Action::Fetch { rep, .. }) = (fetched.len() < 3, scheduler.next(now).unwrap()) {
            fetched.push(rep.0);
        }
        if fetched.len() == 3 {
            break;
        }
    }
    assert_eq!(fetched, [0, 1, 2]);
}

/// Each gains less than a millionth of the view, and all gain alike.
#[test]
fn a_million_coincident_objects() {
    takes_the_lowest_ids(&coincident(1000, 1000), ChoiceMethod::Sampled);
}

#[test]
fn a_thousand_coincident_objects_certified() {
    takes_the_lowest_ids(&coincident(10, 100), ChoiceMethod::Certified);
}

/// `levels` nodes, each the only child of the one above, each finer and in the same place.
fn chain(levels: usize) -> Result<LodTree, LodTreeError> {
    let mut builder = LodTreeBuilder::default();
    for level in 0..levels {
        builder.open()?;
        builder.add(rep(1000, 2.0 / (1.0 + level as f32)))?;
    }
    for _ in 0..levels {
        builder.close(Some(cube(DVec3::NEG_Z * 10.0, 1.0)), 1.0)?;
    }
    builder.finish()
}

#[test]
fn a_tree_a_hundred_thousand_deep_is_refused() {
    assert_eq!(chain(100_000).unwrap_err(), LodTreeError::TooDeep);
    assert!(LodTreeError::TooDeep.to_string().contains("1000 levels"));
}

/// The finest of a thousand levels gains most for the same bytes, the last few within a millionth of each other; once
/// it is there, no other gains anything.
#[test]
fn a_thousand_levels_are_decided_on() {
    let tree = chain(DEPTH_MAX).unwrap();
    let client = Client::with(|s| {
        s.cover_first = false;
        s.tolerance = 0.0;
    });
    let log = client.stand(&tree, 64);
    assert!(log.fetched.len() <= 3 && log.fetched[0] >= 990, "{log:?}");
    assert!(log.resident.contains(&(DEPTH_MAX as u32 - 1)), "{log:?}");
}

#[test]
fn importance_of_nothing_is_not_fetched() {
    let object = [(cube(DVec3::NEG_Z * 10.0, 1.0), &[(1000, 0.5)][..])];
    assert_eq!(Client::default().stand(&try_flat(&object, 0.0).unwrap(), 32).fetched, Vec::<u32>::new());
}

/// Importance scales all weights alike: what is chosen first does not change, down to the least normal number.
#[test]
fn importance_scales_out_down_to_the_least() {
    let near = (cube(DVec3::new(1.0, 0.0, -10.0), 1.0), &[(1000, 0.5)][..]);
    let far = (cube(DVec3::new(-2.0, 0.0, -20.0), 1.0), &[(1000, 0.5)][..]);
    for importance in [1.0, 1e-30, f32::MIN_POSITIVE, 1e30] {
        let tree = try_flat(&[far, near], importance).unwrap();
        let log = Client::default().stand(&tree, 64);
        assert_eq!(log.fetched.first(), Some(&1), "{importance}");
    }
    // A subnormal importance is accepted; what it weighs may vanish, but is never negative or NaN.
    let tree = try_flat(&[far, near], f32::from_bits(1)).unwrap();
    let mut cut = Cut::default();
    cut.make(&tree, &at(DVec3::ZERO), Region::Frustum, &CutSettings::default());
    assert!(cut.total_weight >= 0.0 && cut.total_weight < 1e-40);
}

#[test]
fn importance_beyond_a_float_is_refused_by_name() {
    let object = [(cube(DVec3::NEG_Z * 10.0, 1.0), &[(1000, 0.5)][..])];
    let error = try_flat(&object, 1e300f64 as f32).unwrap_err();
    assert_eq!(error.to_string(), "node 1 has the importance inf; expected a finite number ≥ 0");
}
