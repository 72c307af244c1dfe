//! The worst case on stiff and extreme inputs: bounds hold, answers are finite, work is bounded.

use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::estimate::Certified;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::predict::motion::Speeds;
use foresight_scheduler::view::View;
use foresight_scheduler::worst_case::max_min::{SampledViews, Stretch, saturate};
use foresight_scheduler::worst_case::minimum::{Minimum, MinimumSettings, certified, sampled, worst_views};
use foresight_scheduler::worst_case::neighbourhood::{Neighbourhood, NeighbourhoodKind};
use foresight_scheduler::worst_case::target::Targets;
use foresight_scheduler::worst_case::union::{self, UnionSettings};
use foresight_scheduler::worst_case::{Reach, WorstCaseError};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const BUDGET: u32 = 20_000;

fn view_at(position: DVec3) -> View {
    View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1280, 720] }
}

/// Boxes with their importance, in one group; every box has a representation, every other is resident.
fn world(boxes: &[(DVec3, DVec3, f32)]) -> (LodTree, Coverage) {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for &(centre, half, importance) in boxes {
        builder.open().unwrap();
        let rep =
            Representation { wire_bytes: 100, decoded_bytes: 100, error: 0.05, prerequisite: None, direction: None };
        builder.add(rep).unwrap();
        builder.close(Some(Aabb { min: centre - half, max: centre + half }), importance).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    let tree = builder.finish().unwrap();
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    for rep in (0..tree.representations() as u32).step_by(2).map(RepId) {
        coverage.insert(&tree, rep);
    }
    (tree, coverage)
}

/// A few boxes ahead of and behind `eye`.
fn around(eye: DVec3, size: f64) -> (LodTree, Coverage) {
    let boxes: Vec<_> = (0..8)
        .map(|i| {
            let turn = DQuat::from_rotation_y(0.7 * f64::from(i));
            (eye + turn * DVec3::new(0.0, 0.0, -(4.0 + f64::from(i)) * size), DVec3::splat(size), 1.0)
        })
        .collect();
    world(&boxes)
}

fn is_sound(found: &Certified) {
    assert!(found.lower.is_finite() && found.upper.is_finite(), "{found:?}");
    assert!(found.lower <= found.value && found.value <= found.upper, "{found:?}");
}

/// Both readings: bounds sound, within the frustum, and no dense sample beyond them. Hands back what was found.
fn check(tree: &LodTree, coverage: &Coverage, neighbourhood: &Neighbourhood) -> (Certified, Minimum) {
    let union = union::worth(tree, neighbourhood, coverage, &UnionSettings::default()).unwrap();
    is_sound(&union);
    let cut = CutSettings { opening: 0.0, ..CutSettings::default() };
    let targets = Targets::new(tree, neighbourhood, coverage, &cut).unwrap();
    let settings = MinimumSettings { evaluations_max: BUDGET, samples: 16, tolerance: 0.01 };
    let found = certified(&targets, neighbourhood, &settings).unwrap();
    is_sound(&found.worth);
    assert!(union.lower >= 0.0 && union.upper <= targets.solid_angle() * 1.001);
    assert!(found.worth.lower >= -targets.solid_angle() * 1.001 && found.worth.upper <= 0.0);
    for view in neighbourhood.covering(500, targets.radians_per_metre()).views {
        let deficit = targets.at(&view).deficit;
        assert!(deficit.is_finite() && -deficit >= found.worth.lower - 1e-12, "{deficit} {found:?} {view:?}");
    }
    let rep = RepId(1.min(tree.representations() as u32 - 1));
    is_sound(&union::gain(tree, neighbourhood, coverage, rep, &UnionSettings::default()).unwrap());
    (union, found)
}

fn free(eye: DVec3, reach: f64, angle: f64) -> Neighbourhood {
    Neighbourhood::free(view_at(eye), reach, angle).unwrap().with_stand_off(0.5)
}

#[test]
fn every_direction_can_be_reached() {
    let (tree, coverage) = around(DVec3::ZERO, 1.0);
    let (all, _) = check(&tree, &coverage, &free(DVec3::ZERO, 0.5, core::f64::consts::PI));
    for angle in [3.2, 10.0, 1e9, f64::MAX] {
        assert_eq!(check(&tree, &coverage, &free(DVec3::ZERO, 0.5, angle)).0, all);
    }
    // Everything counts then: more than what is seen without turning.
    assert!(all.lower > check(&tree, &coverage, &free(DVec3::ZERO, 0.5, 0.0)).0.upper);
}

#[test]
fn nothing_moves_and_nothing_turns() {
    let (tree, coverage) = around(DVec3::ZERO, 1.0);
    let (_, found) = check(&tree, &coverage, &free(DVec3::ZERO, 0.0, 0.0));
    assert!(found.gap() < 1e-6 && found.worth.evaluations < 200, "{found:?}");
}

#[test]
fn from_a_nanosecond_to_a_day() {
    let (tree, coverage) = around(DVec3::ZERO, 1.0);
    for epsilon in [1e-9, 1e-3, 1.0, 1e5] {
        for linear in [0.0, 1e-6, 1.0, 1e4] {
            for angular in [0.0, 1e-6, 50.0] {
                for (_, kind) in NeighbourhoodKind::ALL {
                    let track = [DVec3::new(0.0, 0.0, 50.0), DVec3::ZERO, DVec3::new(0.0, 1e-7, -30.0)];
                    let made = Reach::default().neighbourhood(
                        kind,
                        &view_at(DVec3::ZERO),
                        &tree,
                        Speeds { linear, angular },
                        epsilon,
                        &track,
                    );
                    check(&tree, &coverage, &made.unwrap());
                }
            }
        }
    }
}

#[test]
fn skimming_a_surface() {
    for height in [1e-2, 1e-6, 1e-9, 0.0] {
        let half = DVec3::new(1e3, 1.0, 1e3);
        let (tree, coverage) =
            world(&[(DVec3::new(0.0, -1.0 - height, 0.0), half, 1.0), (DVec3::new(0.0, 0.0, -30.0), DVec3::ONE, 1.0)]);
        for reach in [0.0, 1e-7, 1e-3, 1.0] {
            check(&tree, &coverage, &free(DVec3::ZERO, reach, 0.1));
            let walking = Neighbourhood::walking(view_at(DVec3::ZERO), reach, 0.1, DVec3::Y, 0.1 * height, 1.0);
            check(&tree, &coverage, &walking.unwrap());
        }
    }
}

#[test]
fn far_from_the_origin() {
    for eye in [DVec3::new(6.4e6, 0.0, 0.0), DVec3::new(0.0, 1.5e11, -1.5e11), DVec3::splat(1e14)] {
        for size in [1.0, 1e3] {
            let (tree, coverage) = around(eye, size);
            let (_, far) = check(&tree, &coverage, &free(eye, 0.3 * size, 0.2));
            let (tree, coverage) = around(DVec3::ZERO, size);
            let (_, here) = check(&tree, &coverage, &free(DVec3::ZERO, 0.3 * size, 0.2));
            let slack = if eye.length() < 1e7 { 1e-6 } else { 0.3 * here.weight };
            assert!((far.worth.value - here.worth.value).abs() <= slack, "{far:?} {here:?}");
        }
    }
}

#[test]
fn boxes_without_volume_and_eyes_within_boxes() {
    let flat = [DVec3::ZERO, DVec3::new(1.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 1e-300, 0.0)];
    for half in flat {
        let ahead = DVec3::new(0.0, 0.0, -5.0);
        for eye in [DVec3::ZERO, ahead, ahead + DVec3::new(0.3, 0.0, 0.0)] {
            let (tree, coverage) = world(&[(ahead, half, 1.0), (DVec3::new(1.0, 1.0, -9.0), half, 1.0)]);
            check(&tree, &coverage, &free(eye, 0.5, 0.3));
        }
    }
    // Within: it fills the view, whatever is done.
    let (tree, coverage) = world(&[(DVec3::ZERO, DVec3::splat(50.0), 1.0)]);
    let (_, found) = check(&tree, &coverage, &free(DVec3::ZERO, 1.0, 0.5));
    assert!(found.gap() <= 0.01, "{found:?}");
}

#[test]
fn an_eye_where_the_faces_of_tiles_meet() {
    // As on a path along the middle of a terrain: within four boxes at once, or one step aside within two.
    let tile = |x: f64, z: f64| (DVec3::new(5.0 * x, 0.0, 5.0 * z), DVec3::new(5.0, 3.0, 5.0), 1.0);
    let (tree, coverage) = world(&[tile(-1.0, -1.0), tile(-1.0, 1.0), tile(1.0, -1.0), tile(1.0, 1.0)]);
    for eye in [DVec3::ZERO, DVec3::new(0.0, 0.0, 2.0), DVec3::new(5e-324, 0.0, 2.0), DVec3::new(0.0, 3.0, 0.0)] {
        let (union, _) = check(&tree, &coverage, &free(eye, 0.4, 0.2));
        assert!(union.gap() <= 1e-9, "{eye}: {union:?}");
    }
}

#[test]
fn a_wall_that_fills_every_reachable_view() {
    // Bounds of a few boxes of views are enough: nothing that they could turn to shows less of it.
    let (tree, coverage) = world(&[(DVec3::new(0.0, 0.0, -6.0), DVec3::new(80.0, 80.0, 4.0), 1.0)]);
    let targets =
        Targets::new(&tree, &free(DVec3::ZERO, 0.3, 0.2), &coverage, &CutSettings::default()).expect("legal settings");
    let settings = MinimumSettings { evaluations_max: 50, samples: 1, tolerance: 0.0 };
    let found = certified(&targets, &free(DVec3::ZERO, 0.3, 0.2), &settings).expect("legal settings");
    assert!(found.gap() <= 0.01, "{found:?}");
}

#[test]
fn importance_of_nothing_and_of_everything() {
    for importance in [0.0, f32::from_bits(1), 1e-30, 1e30] {
        let (a, b) = (DVec3::new(0.0, 0.0, -9.0), DVec3::new(3.0, 0.0, -9.0));
        let (tree, coverage) =
            world(&[(a, DVec3::ONE, importance), (b, DVec3::ONE, importance), (-a, DVec3::ONE, 1.0)]);
        let (union, found) = check(&tree, &coverage, &free(DVec3::ZERO, 1.0, 0.3));
        if importance == 0.0 {
            assert_eq!(found.worth.value, 0.0);
            assert_eq!(union.value, 0.0);
        }
    }
    // 10³⁰⁰ is no single-precision number: the tree refuses what it would become.
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    let bounds = Aabb { min: DVec3::ZERO, max: DVec3::ONE };
    assert!(builder.close(Some(bounds), f32::INFINITY).is_err());
}

#[test]
fn a_million_coincident_objects() {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for group in 0..1000 {
        builder.open().unwrap();
        for _ in 0..1000 {
            builder.open().unwrap();
            if group == 0 {
                let rep =
                    Representation { wire_bytes: 1, decoded_bytes: 1, error: 0.1, prerequisite: None, direction: None };
                builder.add(rep).unwrap();
            }
            let bounds = Aabb { min: DVec3::new(-1.0, -1.0, -21.0), max: DVec3::new(1.0, 1.0, -19.0) };
            builder.close(Some(bounds), 1.0).unwrap();
        }
        builder.close(None, 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    let tree = builder.finish().unwrap();
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    coverage.insert(&tree, RepId(0));
    let neighbourhood = free(DVec3::ZERO, 1.0, 0.2);
    let settings = UnionSettings { evaluations_max: 100_000, ..UnionSettings::default() };
    let found = union::worth(&tree, &neighbourhood, &coverage, &settings).unwrap();
    is_sound(&found);
    assert!(found.evaluations <= 101_001);
    let targets =
        Targets::new(&tree, &neighbourhood, &coverage, &CutSettings { opening: 1.0, ..CutSettings::default() })
            .unwrap();
    let found = certified(&targets, &neighbourhood, &MinimumSettings { evaluations_max: BUDGET, ..Default::default() })
        .unwrap();
    is_sound(&found.worth);
    // What is shown is one of a million: the deficit is the whole frustum's.
    assert!(found.gap() <= 0.1 && (found.worth.value + targets.solid_angle()).abs() < 0.01, "{found:?}");
}

#[test]
fn a_narrow_and_a_wide_view() {
    let (tree, coverage) = around(DVec3::ZERO, 1.0);
    for fov_y in [1e-6, 0.01, 2.5, 3.1, core::f64::consts::PI - 1e-6] {
        for viewport in [[1, 1], [10_000, 1], [1, 10_000]] {
            let view = View { fov_y, viewport, ..view_at(DVec3::ZERO) };
            for (reach, angle) in [(0.0, 0.0), (0.5, 0.3), (2.0, 4.0)] {
                check(&tree, &coverage, &Neighbourhood::free(view, reach, angle).unwrap());
            }
        }
    }
}

#[test]
fn a_speed_limit_that_grows_with_emptiness() {
    let (tree, _) = around(DVec3::ZERO, 1.0);
    let reach = Reach { clearance_rate: Some(0.5), ..Reach::default() };
    let farthest = |eye: DVec3| {
        let made = reach.neighbourhood(
            NeighbourhoodKind::Free,
            &view_at(eye),
            &tree,
            Speeds { linear: 1e4, angular: 0.0 },
            0.1,
            &[],
        );
        made.unwrap().farthest()
    };
    // The nearest box ends 3 m ahead; it is touched a metre nearer.
    let exact = 3.0 * libm::expm1(0.05);
    assert!((farthest(DVec3::ZERO) - exact).abs() < 1e-9);
    assert!(farthest(DVec3::new(0.0, 0.0, -4.0)) < 1e-12);
    assert!(farthest(DVec3::new(0.0, 1e4, 0.0)) > 100.0 * exact);
}

#[test]
fn refuses_with_field_and_value() {
    let view = view_at(DVec3::ZERO);
    let message = |e: WorstCaseError| e.to_string();
    let refused = [
        message(Neighbourhood::free(view, f64::NAN, 0.0).unwrap_err()),
        message(Neighbourhood::free(view, 1.0, -1.0).unwrap_err()),
        message(Neighbourhood::free(view_at(DVec3::splat(1e20)), 1.0, 1.0).unwrap_err()),
        message(Neighbourhood::walking(view, 1.0, 1.0, DVec3::new(0.0, 2.0, 0.0), 0.5, 1.0).unwrap_err()),
        message(Neighbourhood::walking(view, 1.0, 1.0, DVec3::Y, f64::INFINITY, 1.0).unwrap_err()),
        message(Neighbourhood::orbiting(view, DVec3::ZERO, DVec3::Y, 1.0, 1.0).unwrap_err()),
        message(Neighbourhood::path_bound(view, &[DVec3::ZERO], 1.0, 1.0).unwrap_err()),
        message(Neighbourhood::path_bound(view, &[DVec3::splat(9.0), DVec3::splat(12.0)], 1.0, 1.0).unwrap_err()),
    ];
    let expected = [
        "reach is NaN",
        "angle is -1",
        "coordinates of at most 1e15 m",
        "length of up is 2",
        "step is inf",
        "orbit about where it is",
        "at least two",
        "is on its path",
    ];
    for (message, part) in refused.iter().zip(expected) {
        assert!(message.contains(part), "{message}; expected {part}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    /// Arbitrary floats at every entry: refused, or answered with finite bounds in bounded work.
    #[test]
    fn arbitrary_floats_are_refused_or_answered(raw in prop::collection::vec(any::<f64>(), 24), mild in prop::collection::vec(-9.0..9.0f64, 24), pick in any::<u32>()) {
        // Each number is wild or mild, by a bit.
        let x = |i: usize| if pick >> i & 1 != 0 { raw[i] } else { mild[i] };
        let (tree, coverage) = around(DVec3::ZERO, 1.0);
        let view = View { position: DVec3::new(x(0), x(1), x(2)), fov_y: x(3), ..view_at(DVec3::ZERO) };
        let track = [DVec3::new(x(4), x(5), x(6)), DVec3::new(x(7), x(8), x(9)), DVec3::ZERO];
        let made = [
            Neighbourhood::free(view, x(10), x(11)),
            Neighbourhood::walking(view, x(10), x(11), DVec3::Y, x(12), x(13)),
            Neighbourhood::orbiting(view, track[0], DVec3::Y, x(10), x(11)),
            Neighbourhood::path_bound(view, &track, x(10), x(11)),
            Reach { linear_max: x(14), angular_max: x(15), stand_off: x(16), clearance_rate: Some(x(17)), ..Reach::default() }
                .neighbourhood(NeighbourhoodKind::Free, &view, &tree, Speeds { linear: x(18), angular: x(19) }, x(20), &[]),
        ];
        for neighbourhood in made.into_iter().flatten() {
            let cut = CutSettings { opening: x(21), near: x(22), centre_falloff: 0.0 };
            let union_settings = UnionSettings { tolerance: x(21), evaluations_max: 1000, near: x(22) };
            if let Ok(found) = union::worth(&tree, &neighbourhood, &coverage, &union_settings) {
                is_sound(&found);
            }
            let Ok(targets) = Targets::new(&tree, &neighbourhood, &coverage, &cut) else { continue };
            let settings = MinimumSettings { tolerance: x(23), evaluations_max: 2000, samples: 9 };
            if let Ok(found) = certified(&targets, &neighbourhood, &settings) {
                is_sound(&found.worth);
                prop_assert!(found.worth.evaluations < 4000);
            }
            let estimate = sampled(&targets, &neighbourhood, 8).unwrap();
            prop_assert!(estimate.value.is_finite() && estimate.error_estimate.is_finite());
            let worst = worst_views(&targets, &neighbourhood, 8, 3, x(20));
            prop_assert!(worst.iter().all(|(w, v)| w.is_finite() && v.check().is_ok()), "{:?}", worst);
        }
        let elements = (0..4).map(|i| (x(i), vec![RepId(i as u32)])).collect();
        if let Ok(mut family) = SampledViews::new(&tree, &[view], coverage, elements, &CutSettings::default()) {
            let missing = family.deficits();
            if let Ok(found) = saturate(&mut family, &missing, x(5), x(6), Stretch::Guaranteed) {
                prop_assert!(found.deficit.is_finite() && found.cost.is_finite());
            }
        }
    }
}
