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
