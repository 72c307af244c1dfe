//! The added-benefit integral: its methods against each other and against closed forms, on ordinary and hostile input.

use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::integral::{AddedBenefit, Leg, Method, Target, integrate};
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};

fn view() -> View {
    View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1920, 1080] }
}

/// A group 20 m ahead and a little aside, passed at 3 m/s for 2 s.
fn passing() -> AddedBenefit {
    AddedBenefit {
        leg: Leg::new(&view(), DVec3::new(3.0, 0.0, -2.0), DVec3::ZERO, 0.0, 2.0).unwrap(),
        target: Target::group(DVec3::new(2.0, 1.0, -20.0), DVec3::splat(0.5), DVec3::new(3.0, 2.0, 1.0)).unwrap(),
        after: 0.01,
        before: 0.3,
        arrival_s: 0.0,
        cut: CutSettings::default(),
        attenuation: 0.0,
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
    ] {
        let outcome = integrate(&benefit, &method).unwrap();
        let error = (outcome.value() - exact).abs() / exact;
        assert!(error <= tolerance, "{method:?}: {error:e} of {exact} in {}", outcome.evaluations());
    }
}

/// Random numbers from a seed (SplitMix64).
struct Tape(u64);

impl Tape {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    fn log(&mut self, low: f64, high: f64) -> f64 {
        libm::exp(self.within(libm::log(low), libm::log(high)))
    }

    fn vector(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.within(-size, size), self.within(-size, size), self.within(-size, size))
    }
}

/// A candidate such as a scheduler meets: a camera that walks, drives or flies, a box or a group somewhere ahead.
fn candidate(tape: &mut Tape) -> AddedBenefit {
    let orientation = DQuat::from_scaled_axis(tape.vector(2.0));
    let start =
        View { position: tape.vector(100.0), orientation, fov_y: tape.within(0.3, 1.6), viewport: [1920, 1080] };
    let speed = tape.log(0.01, 100.0);
    let velocity = tape.vector(1.0) * speed;
    let rotation = if tape.unit() < 0.4 { DVec3::ZERO } else { tape.vector(1.0) * tape.log(0.001, 3.0) };
    let from_s = tape.within(0.0, 2.0);
    let leg = Leg::new(&start, velocity, rotation, from_s, from_s + tape.log(0.01, 2.0)).unwrap();
    let size = tape.log(0.1, 30.0);
    let half = DVec3::new(tape.unit(), tape.unit(), tape.unit()) * size;
    let far = tape.log(1.0, 100.0) * size;
    let aside = tape.vector(0.7) * far;
    let centre = start.position + orientation * DVec3::new(aside.x, aside.y, -far);
    let target = if tape.unit() < 0.5 {
        Target::leaf(centre, half, tape.log(0.1, 10.0)).unwrap()
    } else {
        Target::group(centre, half, DVec3::new(tape.unit(), tape.unit(), tape.unit()) * size * size).unwrap()
    };
    let before = if tape.unit() < 0.3 { f64::INFINITY } else { tape.log(1e-3, 10.0) * size };
    let after = if tape.unit() < 0.1 { 0.0 } else { before.min(10.0 * size) * tape.within(0.01, 0.9) };
    let falloff = if tape.unit() < 0.2 { tape.within(0.0, 4.0) } else { 0.0 };
    let attenuation = if tape.unit() < 0.2 { tape.within(0.0, 2.0) } else { 0.0 };
    let cut = CutSettings { centre_falloff: falloff, ..CutSettings::default() };
    AddedBenefit { leg, target, after, before, arrival_s: from_s, cut, attenuation }
}

#[test]
fn enclosure_holds_fine_quadrature() {
    let mut tape = Tape(1);
    let mut evaluations = Vec::new();
    let mut bad = 0;
    for i in 0..4000 {
        let benefit = candidate(&mut tape);
        let foresight_scheduler::estimate::Outcome::Certified(c) =
            integrate(&benefit, &Method::Enclosure { tolerance: 1e-3, floor: 1e-9, evaluations_max: 3000 }).unwrap()
        else {
            panic!()
        };
        let truth = integrate(&benefit, &Method::GaussLegendre { nodes: 8, panels: 40, split: true }).unwrap();
        let slack = 1e-6 * truth.value().abs() + 1e-14;
        evaluations.push(c.evaluations);
        if !(c.lower - slack <= truth.value() && truth.value() <= c.upper + slack) {
            bad += 1;
            if bad < 10 {
                println!("{i}: {c:?} {truth:?} {benefit:?}");
            }
        }
        if c.gap() > 1.01e-3 * c.value.max(1e-9) && evaluations.len() % 50 == 0 {
            println!("{i}: wide {c:?} {:?}", benefit.target.form());
        }
    }
    evaluations.sort();
    println!(
        "evals p50 {} p90 {} p99 {} max {}",
        evaluations[2000], evaluations[3600], evaluations[3960], evaluations[3999]
    );
    assert_eq!(bad, 0);
}
