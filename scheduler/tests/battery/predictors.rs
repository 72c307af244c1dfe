//! Predictors on stiff cameras.

use crate::session::at;
use foresight_scheduler::predict::{Predictor, PredictorKind};
use foresight_scheduler::units::Time;
use glam::DVec3;

const FRAME: u64 = 16_666_667;
const YEAR: u64 = 31_557_600_000_000_000;

/// Greatest distance of any predicted view from `truth`, over all paths.
fn off(predictor: &dyn Predictor, now: Time, offset: f64, truth: DVec3) -> f64 {
    let paths = predictor.predict(now, &[offset]);
    paths.iter().map(|path| path.views[0].position.distance(truth)).fold(0.0, f64::max)
}

/// A camera on a critically damped spring of 10 kHz, x = 1 − (1 + ωt)·exp(−ωt) after each step of its target, seen at
/// 60 Hz: between two frames it has long settled. A second after the last step it is predicted where it is.
#[test]
fn a_critically_damped_spring_of_ten_kilohertz() {
    let omega = core::f64::consts::TAU * 1e4;
    for (name, kind) in PredictorKind::ALL {
        let mut predictor = kind.build();
        let mut now = Time::ZERO;
        for frame in 0..240u64 {
            now = Time(frame * FRAME);
            let t = now.secs() - 1.0;
            let x = if t <= 0.0 { 0.0 } else { 1.0 - (1.0 + omega * t) * libm::exp(-omega * t) };
            predictor.observe(&at(DVec3::X * x), now);
        }
        let settled = off(&*predictor, now, 0.0, DVec3::X);
        let later = off(&*predictor, now, 1.0, DVec3::X);
        assert!(settled < 1e-2 && later < 0.1, "{name}: {settled} m off, {later} m after a second");
    }
}

/// While the target jumps to and fro at every frame, no prediction runs away farther than the spring ever did times the
/// seconds ahead at its greatest mean speed.
#[test]
fn a_stiff_camera_that_shakes_does_not_run_away() {
    for (name, kind) in PredictorKind::ALL {
        let mut predictor = kind.build();
        let mut now = Time::ZERO;
        for frame in 0..600u64 {
            now = Time(frame * FRAME);
            predictor.observe(&at(DVec3::X * f64::from((frame % 2) as u32)), now);
        }
        // 1 m in a frame is 60 m/s.
        assert!(off(&*predictor, now, 1.0, DVec3::X * 0.5) < 61.0, "{name}");
    }
}

/// Fed ten years apart, everything is where it was seen last: a velocity over ten years is none.
#[test]
fn a_filter_fed_ten_years_apart() {
    for (name, kind) in PredictorKind::ALL {
        let mut predictor = kind.build();
        predictor.observe(&at(DVec3::ZERO), Time::ZERO);
        predictor.observe(&at(DVec3::X * 3.0), Time(10 * YEAR));
        let off = off(&*predictor, Time(10 * YEAR), 4.0, DVec3::X * 3.0);
        assert!(off < 0.05, "{name}: {off} m");
    }
}

/// The same view once more at the same instant changes nothing.
#[test]
fn a_filter_fed_twice_at_one_instant() {
    for (name, kind) in PredictorKind::ALL {
        let (mut once, mut twice) = (kind.build(), kind.build());
        for frame in 0..60u64 {
            let (view, now) = (at(DVec3::X * 0.1 * frame as f64), Time(frame * FRAME));
            once.observe(&view, now);
            twice.observe(&view, now);
            twice.observe(&view, now);
        }
        let now = Time(59 * FRAME);
        assert_eq!(once.predict(now, &[0.0, 1.0]), twice.predict(now, &[0.0, 1.0]), "{name}");
    }
}

/// Offsets that are no time ahead are answered by nothing, not by NaN.
#[test]
fn offsets_that_are_no_time_ahead() {
    for (name, kind) in PredictorKind::ALL {
        let mut predictor = kind.build();
        predictor.observe(&at(DVec3::ZERO), Time::ZERO);
        predictor.observe(&at(DVec3::X), Time(FRAME));
        for offset in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1e-9, 1e300] {
            assert!(predictor.predict(Time(FRAME), &[0.0, offset]).is_empty(), "{name}: {offset}");
        }
    }
}

/// At the end of time predictions are still views.
#[test]
fn the_end_of_time() {
    for (name, kind) in PredictorKind::ALL {
        let mut predictor = kind.build();
        predictor.observe(&at(DVec3::ZERO), Time(u64::MAX - 1));
        predictor.observe(&at(DVec3::X), Time::NEVER);
        let paths = predictor.predict(Time::NEVER, &[0.0, 1e9]);
        assert!(!paths.is_empty() && paths.iter().flat_map(|p| &p.views).all(|v| v.check().is_ok()), "{name}");
    }
}
