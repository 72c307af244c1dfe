//! The added-benefit integral: closed forms, orders of convergence, what it shares with the cuts, refusals, and arbitrary
//! floats. Its bounds are held against a reference in double-double by the simulator's tests.

use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::estimate::Outcome;
use foresight_scheduler::integral::{
    AddedBenefit, IntegralError, Leg, Method, Sampler, Target, accuracy_gain, events, gain, integrate,
};
use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, Representation};
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};
use proptest::prelude::*;

const CERTIFIED: Method = Method::Enclosure { tolerance: 1e-6, floor: 0.0, evaluations_max: 2000 };

/// From the origin along −z, 90° high and wide.
fn view() -> View {
    View {
        position: DVec3::ZERO,
        orientation: DQuat::IDENTITY,
        fov_y: core::f64::consts::FRAC_PI_2,
        viewport: [1000, 1000],
    }
}

fn benefit(leg: Leg, target: Target) -> AddedBenefit {
    let cut = CutSettings::default();
    AddedBenefit { leg, target, after: 0.01, before: 0.3, arrival_s: 0.0, cut, attenuation: 0.0 }
}

/// A group 20 m ahead and a little aside, passed at 3 m/s for 2 s.
fn passing() -> AddedBenefit {
    let leg = Leg::new(&view(), DVec3::new(3.0, 0.0, -2.0), DVec3::ZERO, 0.0, 2.0).unwrap();
    benefit(leg, Target::group(DVec3::new(2.0, 1.0, -20.0), DVec3::splat(0.5), DVec3::new(3.0, 2.0, 1.0)).unwrap())
}

fn certified(benefit: &AddedBenefit) -> foresight_scheduler::estimate::Certified {
    match integrate(benefit, &CERTIFIED).unwrap() {
        Outcome::Certified(certified) => certified,
        Outcome::Estimate(_) => unreachable!("an enclosure is certified"),
    }
}

#[test]
fn methods_agree_with_the_closed_form() {
    let benefit = passing();
    let exact = integrate(&benefit, &Method::ClosedForm).unwrap().value();
    for (method, tolerance) in [
        (Method::Trapezoid { intervals: 100, split: true }, 1e-5),
        (Method::GaussLegendre { nodes: 5, panels: 2, split: true }, 1e-10),
        (Method::GaussKronrod { tolerance: 1e-9, evaluations_max: 1000 }, 1e-6),
        (Method::Sampled, 1e-3),
        (CERTIFIED, 1e-6),
    ] {
        let outcome = integrate(&benefit, &method).unwrap();
        let error = (outcome.value() - exact).abs() / exact;
        assert!(error <= tolerance, "{method:?}: {error:e} of {exact} in {}", outcome.evaluations());
    }
}

#[test]
fn a_group_straight_ahead_has_the_textbook_integral() {
    // Towards a group of area S at distance d₀, with g₁ = 0 and nothing before: ∫ S/d² = S/v·(1/d₁ − 1/d₀).
    let leg = Leg::new(&view(), DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, 1.0, 3.0).unwrap();
    let target = Target::group(DVec3::new(0.0, 0.0, -20.0), DVec3::splat(0.1), DVec3::new(0.0, 0.0, 3.0)).unwrap();
    let benefit = AddedBenefit { after: 0.0, before: f64::INFINITY, ..benefit(leg, target) };
    let exact = 3.0 / 4.0 * (1.0 / 12.0 - 1.0 / 20.0);
    let value = integrate(&benefit, &Method::ClosedForm).unwrap().value();
    assert!((value - exact).abs() < 1e-15 * exact.abs() * 10.0, "{value} {exact}");
    assert!(certified(&benefit).holds(exact));
}

#[test]
fn a_leaf_seen_from_a_still_camera_is_its_solid_angle() {
    // The front face of a cube whose middle is two half sides away fills a sixth of the sphere: the whole view.
    let leg = Leg::new(&view(), DVec3::ZERO, DVec3::ZERO, 0.0, 3.0).unwrap();
    let target = Target::leaf(DVec3::new(0.0, 0.0, -2.0), DVec3::ONE, 5.0).unwrap();
    let benefit = AddedBenefit { after: 0.0, before: f64::INFINITY, ..benefit(leg, target) };
    let exact = 3.0 * 5.0 * 4.0 * core::f64::consts::PI / 6.0;
    let bounds = certified(&benefit);
    assert!(bounds.holds(exact) && bounds.gap() < 1e-6 * exact, "{bounds:?} {exact}");
    assert!((integrate(&benefit, &Method::Sampled).unwrap().value() - exact).abs() < 1e-12 * exact);
}

#[test]
fn rules_converge_at_their_orders() {
    let benefit = passing();
    let exact = integrate(&benefit, &Method::ClosedForm).unwrap().value();
    let error = |method| (integrate(&benefit, &method).unwrap().value() - exact).abs();
    let trapezoid = |intervals| error(Method::Trapezoid { intervals, split: true });
    let factor = trapezoid(16) / trapezoid(32);
    assert!((3.9..4.1).contains(&factor), "trapezoid {factor}");
    for (nodes, order) in [(1, 4.0), (2, 16.0), (3, 64.0)] {
        let by = |panels| error(Method::GaussLegendre { nodes, panels, split: true });
        let factor = by(2) / by(4);
        assert!((0.8 * order..1.25 * order).contains(&factor), "{nodes} nodes: {factor}");
    }
}

#[test]
fn splitting_restores_the_order_that_a_kink_destroys() {
    // A turn brings a leaf into view.
    let leg = Leg::new(&view(), DVec3::X, DVec3::new(0.0, -0.9, 0.0), 0.0, 1.0).unwrap();
    let benefit = benefit(leg, Target::leaf(DVec3::new(12.0, 0.0, -9.0), DVec3::splat(0.4), 1.0).unwrap());
    let bounds = certified(&benefit);
    let error = |split, panels| {
        let method = Method::GaussLegendre { nodes: 4, panels, split };
        (integrate(&benefit, &method).unwrap().value() - bounds.value).abs() / bounds.value
    };
    assert!(error(true, 2) < 1e-6 && error(false, 8) > 1e-4, "{} {}", error(true, 2), error(false, 8));
}

#[test]
fn events_are_where_geometry_puts_them() {
    // Sideways at 1 m/s: the planes through the sides of a 90° view meet the box at x = ±(d ± half) − …
    let leg = Leg::new(&view(), DVec3::X, DVec3::ZERO, 0.0, 40.0).unwrap();
    let target = Target::leaf(DVec3::new(20.0, 0.0, -10.0), DVec3::new(1.0, 0.5, 2.0), 1.0).unwrap();
    let found = events(&leg, &target, &CutSettings::default(), 0.0, 40.0);
    // In at x − 1 = 10 + 2, inside at x + 1 = 10 − 2, face planes at 19 and 21, and out again.
    for expected in [7.0, 13.0, 19.0, 21.0, 27.0, 33.0] {
        assert!(found.times.iter().any(|t| (t - expected).abs() < 1e-12), "{expected}: {:?}", found.times);
    }
    assert_eq!(found.times.len(), 6);
}

#[test]
fn a_turn_finds_the_same_events_as_its_angles() {
    let leg = Leg::new(&view(), DVec3::ZERO, DVec3::new(0.0, -1.0, 0.0), 0.0, 3.0).unwrap();
    let target = Target::leaf(DVec3::new(10.0, 0.0, 0.0), DVec3::ZERO, 1.0).unwrap();
    let found = events(&leg, &target, &CutSettings::default(), 0.0, 3.0);
    for quarter in [1.0, 3.0] {
        let expected = quarter * core::f64::consts::FRAC_PI_4;
        assert!(found.times.iter().any(|t| (t - expected).abs() < 1e-12), "{expected}: {:?}", found.times);
    }
}

#[test]
fn weights_are_those_of_the_cuts() -> Result<(), LodTreeError> {
    let mut builder = LodTreeBuilder::default();
    builder.open()?;
    for i in 0..40 {
        builder.open()?;
        builder.add(Representation {
            wire_bytes: 1,
            decoded_bytes: 1,
            error: 1.0,
            prerequisite: None,
            direction: None,
        })?;
        let at = DVec3::new(f64::from(i % 7) * 9.0 - 30.0, f64::from(i % 3), -4.0 - 9.0 * f64::from(i / 7));
        let size = DVec3::new(2.0, 3.0 + f64::from(i % 4), 4.0);
        builder.close(Some(Aabb { min: at, max: at + size }), (1 + i % 5) as f32)?;
    }
    builder.close(None, 1.0)?;
    let tree = builder.finish()?;
    let settings = CutSettings { centre_falloff: 0.7, ..CutSettings::default() };
    let leg = Leg::new(&view(), DVec3::new(1.0, 0.5, -2.0), DVec3::new(0.1, 0.4, 0.05), 0.0, 2.0).unwrap();
    let (mut far, mut near) = (0, 0);
    for step in 0..20 {
        let u = 0.1 * f64::from(step);
        let mut cut = Cut::default();
        cut.make(&tree, &leg.view(u), Region::Frustum, &settings);
        for patch in &cut.patches {
            let matches = [false, true].map(|far| {
                let seen = Target::of(&tree, patch.node, far).seen(&leg, &settings, u);
                (seen.weight - patch.weight).abs() < 1e-9 * patch.weight
                    && (seen.sharpness - patch.sharpness).abs() < 1e-9 * patch.sharpness
            });
            near += usize::from(matches[0]);
            far += usize::from(matches[1]);
            assert!(matches[0] || matches[1], "{patch:?} at {u}");
        }
    }
    assert!(far > 20 && near > 20, "{far} {near}");
    Ok(())
}

#[test]
fn legs_end_at_their_views_by_the_shorter_way() {
    let a = View { orientation: DQuat::from_rotation_y(0.3), ..view() };
    let b = View {
        position: DVec3::new(5.0, 1.0, 2.0),
        orientation: DQuat::from_rotation_y(0.3) * DQuat::from_rotation_x(3.0),
        ..view()
    };
    for b in [b, View { orientation: -b.orientation, ..b }] {
        let leg = Leg::between(&a, &b, 1.0, 3.0).unwrap();
        assert!((leg.rate() - 1.5).abs() < 1e-12, "{}", leg.rate());
        let end = leg.view(3.0);
        assert!(end.position.distance(b.position) < 1e-12);
        assert!(end.orientation.dot(b.orientation).abs() > 1.0 - 1e-12);
        assert!(leg.frustum(3.0).forward.distance(b.forward()) < 1e-12);
    }
    let still = Leg::between(&a, &b, 2.0, 2.0).unwrap();
    assert_eq!((still.view(2.0).position, still.rate()), (a.position, 0.0));
    assert_eq!(integrate(&AddedBenefit { leg: still, ..passing() }, &CERTIFIED).unwrap().value(), 0.0);
}

#[test]
fn what_arrives_later_counts_from_then_on() {
    let whole = passing();
    let after = AddedBenefit { arrival_s: 0.7, ..whole };
    let leg = Leg::new(&view(), DVec3::new(3.0, 0.0, -2.0), DVec3::ZERO, 0.0, 0.7).unwrap();
    let first = AddedBenefit { leg, ..whole };
    let value = |benefit: &AddedBenefit| integrate(benefit, &Method::ClosedForm).unwrap().value();
    assert!((value(&first) + value(&after) - value(&whole)).abs() < 1e-13 * value(&whole));
    let rest = AddedBenefit { leg: whole.leg.after(0.7), ..whole };
    assert!((value(&rest) - value(&after)).abs() < 1e-13 * value(&whole));
    assert_eq!(value(&AddedBenefit { arrival_s: 9.0, ..whole }), 0.0);
}

#[test]
fn nodes_serve_every_pair_of_errors_and_tile_the_leg() {
    let whole = passing();
    let sampler = Sampler::new(&whole.leg, &whole.cut, 0.0).unwrap();
    let mut nodes = Vec::new();
    sampler.sample(&whole.target, &mut nodes);
    assert_eq!((nodes[0].from_s, nodes.last().map(|n| n.to_s)), (0.0, Some(2.0)));
    assert!(nodes.windows(2).all(|pair| pair[0].to_s == pair[1].from_s));
    for (after, before) in [(0.0, f64::INFINITY), (0.1, 0.2), (0.2, 0.1), (1e-3, 10.0)] {
        let exact = integrate(&AddedBenefit { after, before, ..whole }, &Method::ClosedForm).unwrap().value();
        assert!((gain(&nodes, after, before) - exact).abs() < 1e-3 * exact.abs(), "{after} {before}");
    }
}

#[test]
fn a_loss_is_the_gain_turned_round() {
    let gained = passing();
    let lost = AddedBenefit { after: gained.before, before: gained.after, ..gained };
    for method in [Method::ClosedForm, Method::Sampled, CERTIFIED] {
        let (a, b) = (integrate(&gained, &method).unwrap().value(), integrate(&lost, &method).unwrap().value());
        assert!((a + b).abs() <= 1e-12 * a, "{method:?}");
    }
    assert!(certified(&lost).upper < 0.0);
}

#[test]
fn one_ulp_of_an_error_is_told() {
    let better = 0.3f64.next_down();
    let bounds = certified(&AddedBenefit { after: better, ..passing() });
    assert!(bounds.lower > 0.0 && bounds.gap() < 1e-6 * bounds.value, "{bounds:?}");
    assert!(accuracy_gain(better, 0.3, 1e-40) > 0.0);
}

#[test]
fn the_closed_form_says_where_there_is_none() {
    let none =
        |benefit: AddedBenefit| matches!(integrate(&benefit, &Method::ClosedForm), Err(IntegralError::NoClosedForm(_)));
    let ahead = passing();
    assert!(none(AddedBenefit { attenuation: 0.1, ..ahead }));
    assert!(none(AddedBenefit { target: Target::leaf(ahead.target.centre(), DVec3::ONE, 1.0).unwrap(), ..ahead }));
    let across = Target::group(DVec3::new(20.0, 0.0, -20.0), DVec3::ONE, DVec3::ONE).unwrap();
    assert!(none(AddedBenefit { target: across, ..ahead }));
    assert!(none(AddedBenefit { cut: CutSettings { centre_falloff: 1.0, ..ahead.cut }, ..ahead }));
}

#[test]
fn what_no_method_can_integrate_is_refused_by_name() {
    let field = |result: Result<(), IntegralError>| match result {
        Err(IntegralError::Number { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    let ok = passing();
    let leg = |velocity, rotation, from, to| Leg::new(&view(), velocity, rotation, from, to).map(|_| ());
    let z = DVec3::ZERO;
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(field(leg(DVec3::new(0.0, bad, 0.0), z, 0.0, 1.0)), "velocity");
        assert_eq!(field(leg(z, DVec3::new(0.0, bad, 0.0), 0.0, 1.0)), "rotation");
        assert_eq!(field(leg(z, z, bad, 1.0)), "from_s");
        assert_eq!(field(leg(z, z, 0.0, bad)), "to_s");
        assert_eq!(field(Target::leaf(DVec3::new(bad, 0.0, 0.0), z, 1.0).map(|_| ())), "centre");
        assert_eq!(field(Target::leaf(z, DVec3::new(0.0, bad, 0.0), 1.0).map(|_| ())), "half side");
        assert_eq!(field(Target::leaf(z, z, bad).map(|_| ())), "importance");
        assert_eq!(field(Target::group(z, z, DVec3::splat(bad)).map(|_| ())), "face area");
        assert_eq!(field(AddedBenefit { arrival_s: bad, ..ok }.check()), "arrival_s");
        assert_eq!(field(AddedBenefit { attenuation: bad, ..ok }.check()), "attenuation");
        assert_eq!(field(AddedBenefit { cut: CutSettings { near: bad, ..ok.cut }, ..ok }.check()), "near");
        let cut = CutSettings { centre_falloff: bad, ..ok.cut };
        assert_eq!(field(AddedBenefit { cut, ..ok }.check()), "centre_falloff");
        assert_eq!(field(Sampler::new(&ok.leg, &cut, 0.0).map(|_| ())), "centre_falloff");
        assert_eq!(field(Sampler::new(&ok.leg, &ok.cut, bad).map(|_| ())), "attenuation");
        let method = Method::GaussKronrod { tolerance: bad, evaluations_max: 100 };
        assert_eq!(field(integrate(&ok, &method).map(|_| ())), "tolerance");
    }
    assert_eq!(field(leg(z, z, 2.0, 1.0)), "to_s");
    assert_eq!(field(Target::leaf(z, DVec3::splat(-1.0), 1.0).map(|_| ())), "half side");
    assert_eq!(field(AddedBenefit { after: f64::NAN, ..ok }.check()), "after");
    assert_eq!(field(AddedBenefit { before: -1.0, ..ok }.check()), "before");
    assert_eq!(field(AddedBenefit { cut: CutSettings { near: 0.0, ..ok.cut }, ..ok }.check()), "near");
    assert!(matches!(
        Leg::new(&View { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..view() }, z, z, 0.0, 1.0),
        Err(IntegralError::View(_))
    ));
    for method in [
        Method::Trapezoid { intervals: 0, split: false },
        Method::GaussLegendre { nodes: 9, panels: 1, split: false },
        Method::GaussLegendre { nodes: 1, panels: 0, split: true },
        Method::GaussKronrod { tolerance: 0.0, evaluations_max: 14 },
        Method::Enclosure { tolerance: 0.1, floor: -1.0, evaluations_max: 10 },
        Method::Enclosure { tolerance: 0.1, floor: 0.0, evaluations_max: 0 },
    ] {
        assert!(matches!(integrate(&ok, &method), Err(IntegralError::Number { .. })), "{method:?}");
    }
}

#[test]
fn a_spin_of_a_day_is_bounded_work() {
    let leg = Leg::new(&view(), DVec3::ZERO, DVec3::new(3.0, 50.0, 1.0), 0.0, 86_400.0).unwrap();
    let benefit = benefit(leg, Target::leaf(DVec3::new(1.0, 0.0, -9.0), DVec3::ONE, 1.0).unwrap());
    for method in [CERTIFIED, Method::Sampled, Method::GaussKronrod { tolerance: 1e-9, evaluations_max: 2000 }] {
        let outcome = integrate(&benefit, &method).unwrap();
        assert!(outcome.value().is_finite() && outcome.evaluations() < 40_000, "{method:?} {outcome:?}");
    }
}

#[test]
fn a_spin_before_areas_beyond_every_world_overflows_into_an_open_bound() {
    let narrow = View { fov_y: 1e-9, ..view() };
    let leg = Leg::new(&narrow, DVec3::ZERO, DVec3::new(0.0, 68.4, -99.5), 66.6, 140.6).unwrap();
    let wide = Target::group(DVec3::new(0.0, -94.0, 0.0), DVec3::ZERO, DVec3::new(5e181, 0.0, 0.0)).unwrap();
    let outcome = integrate(&benefit(leg, wide), &CERTIFIED).unwrap();
    let Outcome::Certified(bounds) = outcome else { panic!("{outcome:?}") };
    assert!(bounds.value.is_finite() && bounds.lower <= bounds.value && bounds.value <= bounds.upper, "{bounds:?}");
}

/// Floats as they come: ordinary, tiny, huge, special.
fn float() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -100.0..100.0f64, 1 => any::<f64>(), 1 => prop_oneof![Just(0.0), Just(1e-300), Just(1e30), Just(1e-9)]]
}

fn vector() -> impl Strategy<Value = DVec3> {
    [float(), float(), float()].prop_map(DVec3::from_array)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    /// Whatever the floats: refused, or a finite answer in bounded work, and bounds in order.
    #[test]
    fn arbitrary_floats_are_refused_or_answered(
        position in vector(), turn in vector(), fov in float(), velocity in vector(), rotation in vector(),
        centre in vector(), half in vector(), size in vector(), times in [float(), float(), float()],
        errors in [float(), float()], settings in [float(), float(), float()], is_leaf in any::<bool>(),
    ) {
        let orientation = DQuat::from_scaled_axis(turn);
        let start = View { position, orientation, fov_y: fov, viewport: [640, 480] };
        let leg = Leg::new(&start, velocity, rotation, times[0].abs(), times[0].abs() + times[1].abs());
        let target = if is_leaf { Target::leaf(centre, half.abs(), size.x) } else { Target::group(centre, half.abs(), size.abs()) };
        let (Ok(leg), Ok(target)) = (leg, target) else { return Ok(()) };
        let cut = CutSettings { opening: 0.1, near: settings[0].abs(), centre_falloff: settings[1].abs() };
        let benefit = AddedBenefit {
            leg, target, after: errors[0].abs(), before: errors[1].abs(), arrival_s: times[2].abs(), cut,
            attenuation: settings[2].abs(),
        };
        for method in [
            Method::Sampled,
            Method::Trapezoid { intervals: 10, split: true },
            Method::GaussLegendre { nodes: 3, panels: 2, split: true },
            Method::GaussKronrod { tolerance: 1e-6, evaluations_max: 200 },
            Method::ClosedForm,
            Method::Enclosure { tolerance: 1e-3, floor: 1e-12, evaluations_max: 100 },
        ] {
            match integrate(&benefit, &method) {
                Err(error) => prop_assert!(!error.to_string().is_empty()),
                Ok(outcome) => {
                    prop_assert!(outcome.value().is_finite(), "{method:?} {outcome:?} {benefit:?}");
                    prop_assert!(outcome.evaluations() < 200_000);
                    if let Outcome::Certified(c) = outcome {
                        prop_assert!(c.lower <= c.value && c.value <= c.upper, "{c:?} {benefit:?}");
                    }
                }
            }
        }
    }
}
