//! The added-benefit integral against its reference in double-double: the enclosure holds, on ordinary candidates and on
//! stiff and extreme ones.

use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::benefit::element::ELEMENTS;
use foresight_scheduler::estimate::{Certified, Outcome};
use foresight_scheduler::integral::{AddedBenefit, Facet, Form, IntegralError, Leg, Method, Target, integrate};
use foresight_scheduler::view::View;
use foresight_sim::accuracy::reference::reference;
use glam::{DQuat, DVec3};

/// Random numbers from a seed (SplitMix64).
struct SplitMix64(u64);

impl SplitMix64 {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn within(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * random.unit()
}

fn log(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    libm::exp(within(random, libm::log(low), libm::log(high)))
}

fn vector(random: &mut SplitMix64, size: f64) -> DVec3 {
    DVec3::new(within(random, -size, size), within(random, -size, size), within(random, -size, size))
}

/// A candidate such as a scheduler meets: a camera that walks, drives or flies, a box or a group somewhere ahead.
fn candidate(random: &mut SplitMix64) -> AddedBenefit {
    let orientation = DQuat::from_scaled_axis(vector(random, 2.0));
    let fov_y = within(random, 0.3, 1.6);
    let start = View { position: vector(random, 100.0), orientation, fov_y, viewport: [1920, 1080] };
    let velocity = vector(random, 1.0) * log(random, 0.01, 100.0);
    let rotation = if random.unit() < 0.4 { DVec3::ZERO } else { vector(random, 1.0) * log(random, 0.001, 3.0) };
    let from_s = within(random, 0.0, 2.0);
    let leg = Leg::new(&start, velocity, rotation, from_s, from_s + log(random, 0.01, 2.0)).unwrap();
    let size = log(random, 0.1, 30.0);
    let half = DVec3::new(random.unit(), random.unit(), random.unit()) * size;
    let far = log(random, 1.0, 100.0) * size;
    let aside = vector(random, 0.7) * far;
    let centre = start.position + orientation * DVec3::new(aside.x, aside.y, -far);
    let target = if random.unit() < 0.5 {
        Target::leaf(centre, half, log(random, 0.1, 10.0)).unwrap()
    } else {
        Target::group(centre, half, DVec3::new(random.unit(), random.unit(), random.unit()) * size * size).unwrap()
    };
    let before = if random.unit() < 0.3 { f64::INFINITY } else { log(random, 1e-3, 10.0) * size };
    let after = if random.unit() < 0.1 { 0.0 } else { before.min(10.0 * size) * within(random, 0.01, 0.9) };
    let centre_falloff = if random.unit() < 0.2 { within(random, 0.0, 4.0) } else { 0.0 };
    let attenuation = if random.unit() < 0.2 { within(random, 0.0, 2.0) } else { 0.0 };
    let cut = CutSettings { centre_falloff, ..CutSettings::default() };
    AddedBenefit { leg, target, after, before, arrival_s: from_s, cut, attenuation }
}

fn enclosed(benefit: &AddedBenefit, tolerance: f64, evaluations_max: u32) -> Certified {
    match integrate(benefit, &Method::Enclosure { tolerance, floor: 1e-12, evaluations_max }).unwrap() {
        Outcome::Certified(certified) => certified,
        Outcome::Estimate(_) => unreachable!("an enclosure is certified"),
    }
}

/// The bounds hold, up to what the reference itself may be off by.
fn holds(benefit: &AddedBenefit, certified: &Certified) -> Result<(), String> {
    let truth = reference(benefit).unwrap();
    if certified.lower - truth.error <= truth.value && truth.value <= certified.upper + truth.error {
        return Ok(());
    }
    Err(format!("{certified:?}\n{truth:?}\n{benefit:?}"))
}

#[test]
fn bounds_hold_over_ten_thousand_random_candidates() {
    let mut random = SplitMix64(7);
    for i in 0..10_000 {
        let benefit = candidate(&mut random);
        let (tolerance, evaluations_max) = if i % 2 == 0 { (1e-3, 300) } else { (1e-6, 2000) };
        let certified = enclosed(&benefit, tolerance, evaluations_max);
        holds(&benefit, &certified).unwrap_or_else(|error| panic!("{i}: {error}"));
    }
}

/// The same with one element of a surface in mind.
fn candidate_by_element(random: &mut SplitMix64) -> AddedBenefit {
    let benefit = candidate(random);
    let mut surface = [0.0f32; ELEMENTS];
    for _ in 0..1 + (random.unit() * 5.0) as usize {
        surface[(random.unit() * ELEMENTS as f64) as usize % ELEMENTS] += random.unit() as f32;
    }
    let some = surface.iter().position(|area| *area > 0.0).unwrap_or(0);
    AddedBenefit { target: benefit.target.with_facet(Facet { surface, element: some as u8 }).unwrap(), ..benefit }
}

#[test]
fn bounds_hold_and_methods_agree_by_element() {
    let mut random = SplitMix64(13);
    let split = Method::GaussLegendre { nodes: 8, panels: 4, split: true };
    let (mut errors, mut seen, mut shared) = (Vec::new(), 0, 0);
    for i in 0..400 {
        let benefit = candidate_by_element(&mut random);
        let certified = enclosed(&benefit, if i % 2 == 0 { 1e-3 } else { 1e-6 }, 2000);
        holds(&benefit, &certified).unwrap_or_else(|error| panic!("{i}: {error}"));
        let no_closed_form = integrate(&benefit, &Method::ClosedForm);
        assert!(matches!(no_closed_form, Err(IntegralError::NoClosedForm(_))), "{no_closed_form:?}");
        let truth = reference(&benefit).unwrap().value;
        let whole = AddedBenefit { target: whole(&benefit.target), ..benefit };
        let of_whole = reference(&whole).unwrap().value;
        assert!(truth <= of_whole * (1.0 + 1e-9), "{truth} of {of_whole}");
        seen += usize::from(truth > 0.0);
        shared += usize::from(truth > 0.01 * of_whole && truth < 0.99 * of_whole);
        if truth > 0.0 {
            for method in [Method::Sampled, split] {
                errors.push((integrate(&benefit, &method).unwrap().value() - truth).abs() / of_whole);
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    assert!(seen > 100 && shared > 40, "{seen} {shared}");
    assert!(errors[errors.len() * 99 / 100] <= 1e-3, "{:e}", errors[errors.len() * 99 / 100]);
}

/// All of its surface.
fn whole(target: &Target) -> Target {
    match target.form() {
        Form::Leaf => Target::leaf(target.centre(), target.half(), target.importance()).unwrap(),
        _ => Target::group(target.centre(), target.half(), target.face_areas()).unwrap(),
    }
}

#[test]
fn the_default_is_within_a_thousandth_at_the_999th_permille() {
    let mut random = SplitMix64(11);
    let benefits: Vec<AddedBenefit> = (0..4000).map(|_| candidate(&mut random)).collect();
    let truths: Vec<f64> = benefits.iter().map(|benefit| enclosed(benefit, 1e-6, 5000).value).collect();
    let best = truths.iter().copied().fold(0.0, f64::max);
    let mut errors: Vec<f64> = benefits
        .iter()
        .zip(&truths)
        .map(|(benefit, truth)| {
            let value = integrate(benefit, &Method::Sampled).unwrap().value();
            (value - truth).abs() / truth.max(1e-4 * best)
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors[3995] <= 1e-3, "{:e}", errors[3995]);
}

// Stiff and extreme ones, by name.

fn view(position: DVec3) -> View {
    View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1920, 1080] }
}

/// From `position` along −z.
fn moving(position: DVec3, velocity: DVec3, rotation: DVec3, seconds: f64) -> Leg {
    Leg::new(&view(position), velocity, rotation, 0.0, seconds).unwrap()
}

fn still(seconds: f64) -> Leg {
    moving(DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, seconds)
}

fn benefit(leg: Leg, target: Target) -> AddedBenefit {
    let cut = CutSettings::default();
    AddedBenefit { leg, target, after: 0.01, before: 0.3, arrival_s: leg.from_s(), cut, attenuation: 0.0 }
}

fn leaf(centre: DVec3, half: DVec3) -> Target {
    Target::leaf(centre, half, 1.0).unwrap()
}

/// A group as wide as its box, with the areas of one.
fn group(centre: DVec3, half: DVec3) -> Target {
    Target::group(centre, half, 4.0 * DVec3::new(half.y * half.z, half.z * half.x, half.x * half.y)).unwrap()
}

/// The bounds hold, and are at most `width` wide relative to the truth.
fn stiff(benefit: &AddedBenefit, width: f64) -> f64 {
    let mut gap = f64::INFINITY;
    for evaluations_max in [1, 30, 3000] {
        let certified = enclosed(benefit, 1e-6, evaluations_max);
        holds(benefit, &certified).unwrap_or_else(|error| panic!("{error}"));
        gap = certified.gap();
    }
    let truth = reference(benefit).unwrap();
    assert!(gap <= width * truth.value.abs() + 1e-12, "{gap:e} wide\n{truth:?}\n{benefit:?}");
    truth.value
}

/// Skimming a tile of 200 m at a height, over its edge.
fn skimming(height: f64) -> AddedBenefit {
    let leg = moving(DVec3::new(0.0, height, 0.0), DVec3::new(0.3, 0.0, -20.0), DVec3::new(0.0, 0.2, 0.0), 2.0);
    benefit(leg, leaf(DVec3::new(0.0, -1.0, -120.0), DVec3::new(100.0, 1.0, 100.0)))
}

#[test]
fn skimming_a_surface_at_one_centimetre() {
    assert!(stiff(&skimming(1e-2), 1e-3) > 0.0);
}

#[test]
fn skimming_a_surface_at_one_micrometre() {
    assert!(stiff(&skimming(1e-6), 1e-3) > 0.0);
    let cut = CutSettings { near: 1e-9, ..CutSettings::default() };
    stiff(&AddedBenefit { cut, ..skimming(1e-6) }, 1e-3);
}

#[test]
fn a_nanometre_beside_ten_thousand_kilometres() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.1, 0.0, -0.5), DVec3::new(0.0, 0.1, 0.0), 1.0);
    for (half, at) in [(1e-9, 2.0), (1e-9, 1e3), (1e7, 1e7 + 3.0), (1e7, 3e7)] {
        let centre = DVec3::new(0.0, 0.0, -at);
        stiff(&benefit(leg, leaf(centre, DVec3::splat(half))), 1.0);
        stiff(&benefit(leg, group(centre, DVec3::splat(half))), 1.0);
    }
}

#[test]
fn a_world_at_the_radius_of_the_earth() {
    far_from_the_origin(6.4e6);
}

#[test]
fn a_world_at_the_distance_of_the_sun() {
    far_from_the_origin(1.5e11);
}

/// What counts is where things are from the eye: moving the world changes nothing that the doubles still hold.
fn far_from_the_origin(away: f64) {
    let at = DVec3::new(away, -away, 0.5 * away);
    let leg = moving(at, DVec3::new(1.0, 0.0, -3.0), DVec3::new(0.0, 0.3, 0.0), 1.0);
    let near = moving(DVec3::ZERO, DVec3::new(1.0, 0.0, -3.0), DVec3::new(0.0, 0.3, 0.0), 1.0);
    let (offset, half) = (DVec3::new(2.0, 1.0, -16.0), DVec3::new(1.0, 2.0, 0.5));
    for of in [leaf, group] {
        let value = stiff(&benefit(leg, of(at + offset, half)), 1e-5);
        let home = stiff(&benefit(near, of(offset, half)), 1e-5);
        assert!((value - home).abs() <= 1e-12 * home, "{value} {home}");
    }
}

#[test]
fn a_camera_that_stands_still() {
    for target in [leaf, group].map(|of| of(DVec3::new(1.0, 1.0, -9.0), DVec3::ONE)) {
        stiff(&benefit(still(3.0), target), 1e-9);
    }
}

#[test]
fn a_camera_that_creeps_at_a_micrometre_a_second() {
    let leg = moving(DVec3::ZERO, DVec3::new(1e-6, 0.0, 0.0), DVec3::ZERO, 4.0);
    for target in [leaf, group].map(|of| of(DVec3::new(4.9, 1.0, -9.0), DVec3::ONE)) {
        stiff(&benefit(leg, target), 1e-6);
    }
}

#[test]
fn a_camera_that_passes_at_ten_kilometres_a_second() {
    let leg = moving(DVec3::new(-2e4, 0.0, 0.0), DVec3::new(1e4, 0.0, -1.0), DVec3::ZERO, 4.0);
    for target in [leaf, group].map(|of| of(DVec3::new(0.0, 1.0, -60.0), DVec3::splat(3.0))) {
        stiff(&benefit(leg, target), 1e-2);
    }
}

#[test]
fn a_spin_of_fifty_radians_a_second() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.0, 0.0, -1.0), DVec3::new(3.0, 50.0, 1.0), 0.5);
    for target in [leaf, group].map(|of| of(DVec3::new(1.0, 1.0, -9.0), DVec3::ONE)) {
        assert!(stiff(&benefit(leg, target), 0.1) > 0.0);
    }
}

#[test]
fn events_a_nanosecond_apart() {
    // 10⁻⁵ m wide, carried through a plane of the frustum at 10⁴ m/s.
    let leg = moving(DVec3::new(-40.0, 0.0, 0.0), DVec3::new(1e4, 0.0, 0.0), DVec3::ZERO, 8e-3);
    for target in [leaf, group].map(|of| of(DVec3::new(0.0, 0.0, -20.0), DVec3::splat(5e-6))) {
        stiff(&benefit(leg, target), 1e-2);
    }
}

#[test]
fn a_path_that_grazes_the_frustum() {
    // A pitch forth and back would touch twice; a turn about the view's own right touches the top plane where it is
    // tangent to the box, as does a box whose corner slides along the plane.
    let tan = libm::tan(0.5);
    for off in [-1e-6, -1e-12, 0.0, 1e-12, 1e-6] {
        let corner = DVec3::new(0.0, 10.0 * tan + off, -10.0);
        let half = DVec3::splat(0.25);
        let slide = moving(DVec3::ZERO, DVec3::new(0.3, 0.1 * tan, -0.1), DVec3::ZERO, 1.0);
        let roll = Leg::new(
            &View { orientation: DQuat::from_rotation_y(-0.1), ..view(DVec3::ZERO) },
            DVec3::ZERO,
            DVec3::new(0.0, 0.2, 0.0),
            0.0,
            1.0,
        )
        .unwrap();
        for leg in [slide, roll] {
            for target in [leaf, group].map(|of| of(corner + half * DVec3::new(0.0, 1.0, 1.0), half)) {
                stiff(&benefit(leg, target), 1.0);
            }
        }
    }
}

#[test]
fn a_horizon_of_a_nanosecond() {
    let start = view(DVec3::ZERO);
    let leg = Leg::new(&start, DVec3::new(3.0, 0.0, -2.0), DVec3::new(0.0, 1.0, 0.0), 100.0, 100.0 + 1e-9).unwrap();
    for target in [leaf, group].map(|of| of(DVec3::new(1.0, 1.0, -9.0), DVec3::ONE)) {
        assert!(stiff(&benefit(leg, target), 1e-6) > 0.0);
    }
}

#[test]
fn a_horizon_of_a_day() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.01, 0.0, -0.5), DVec3::ZERO, 1e5);
    for target in [leaf, group].map(|of| of(DVec3::new(1000.0, 1.0, -3e4), DVec3::splat(10.0))) {
        stiff(&benefit(leg, target), 1e-2);
    }
}

#[test]
fn boxes_without_a_volume() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.5, 0.25, -2.0), DVec3::new(0.0, 0.2, 0.0), 1.0);
    for half in [DVec3::ZERO, DVec3::X, DVec3::new(1.0, 0.0, 1.0), DVec3::new(1.0, 1.0, 0.0)] {
        for centre in [DVec3::new(0.5, 0.25, -9.0), DVec3::new(0.5, 0.125, -0.5), DVec3::new(4.0, 0.0, -7.0)] {
            for target in [leaf, group].map(|of| of(centre, half)) {
                stiff(&benefit(leg, target), 1.0);
            }
        }
    }
}

#[test]
fn a_tile_seen_edge_on() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.5, 0.0, -2.0), DVec3::ZERO, 1.0);
    let value = stiff(&benefit(leg, leaf(DVec3::new(0.0, 0.0, -20.0), DVec3::new(5.0, 0.0, 5.0))), 1.0);
    assert_eq!(value, 0.0);
}

#[test]
fn importance_of_nothing_of_next_to_nothing_and_of_all() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.5, 0.25, -2.0), DVec3::new(0.0, 0.2, 0.0), 1.0);
    for importance in [0.0, 5e-324, 1e-310, 1e300] {
        let target = Target::leaf(DVec3::new(0.5, 0.25, -9.0), DVec3::ONE, importance).unwrap();
        let value = stiff(&benefit(leg, target), 1e-6);
        assert!(value.is_finite() && (value == 0.0) == (importance < 1e-320), "{importance:e}: {value:e}");
    }
}

#[test]
fn an_eye_inside_the_box() {
    let target = leaf(DVec3::new(0.0, 0.0, -3.0), DVec3::splat(4.0));
    let inside = moving(DVec3::ZERO, DVec3::new(0.5, 0.25, -1.0), DVec3::new(0.0, 0.2, 0.0), 1.0);
    let out = moving(DVec3::ZERO, DVec3::new(0.5, 0.25, -9.0), DVec3::new(0.0, 0.2, 0.0), 1.0);
    let through = moving(DVec3::new(0.0, 0.0, 9.0), DVec3::new(0.5, 0.25, -20.0), DVec3::ZERO, 1.0);
    for (leg, width) in [(inside, 1e-6), (out, 1e-3), (through, 1e-3)] {
        assert!(stiff(&benefit(leg, target), width) > 0.0);
    }
}

#[test]
fn through_the_middle_of_a_group() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.0, 0.0, -10.0), DVec3::ZERO, 2.0);
    stiff(&benefit(leg, group(DVec3::new(0.0, 0.0, -10.0), DVec3::ONE)), 1e-2);
}

#[test]
fn fields_of_view_of_a_hair_and_of_nearly_all() {
    for fov_y in [1e-3, 3.1] {
        let start = View { fov_y, viewport: [1, 1], ..view(DVec3::ZERO) };
        let leg = Leg::new(&start, DVec3::new(0.1, 0.0, -1.0), DVec3::new(0.0, 1e-4, 0.0), 0.0, 1.0).unwrap();
        for target in [leaf, group].map(|of| of(DVec3::new(0.0, 0.0, -9.0), DVec3::splat(0.5))) {
            stiff(&benefit(leg, target), 1e-3);
        }
    }
}

#[test]
fn errors_one_ulp_apart() {
    let leg = moving(DVec3::ZERO, DVec3::new(0.5, 0.25, -2.0), DVec3::new(0.0, 0.2, 0.0), 1.0);
    for target in [leaf, group].map(|of| of(DVec3::new(0.5, 0.25, -9.0), DVec3::ONE)) {
        let benefit = AddedBenefit { after: 0.3f64.next_down(), ..benefit(leg, target) };
        let truth = reference(&benefit).unwrap().value;
        let Outcome::Certified(bounds) =
            integrate(&benefit, &Method::Enclosure { tolerance: 1e-6, floor: 0.0, evaluations_max: 2000 }).unwrap()
        else {
            unreachable!("an enclosure is certified")
        };
        assert!(bounds.holds(truth) && bounds.lower > 0.0, "{bounds:?} {truth:e}");
    }
}
