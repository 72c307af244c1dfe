//! A Kalman filter whose velocities fade: what moves now will have slowed down later.
//!
//! Position and rotation are each an integrated Ornstein–Uhlenbeck process per axis: dx = v dt, dv = −v/T dt + σ dW. Its
//! discretisation is exact for any step, so that a pause of an hour is no different from a tick: with e = exp(−Δ/T),
//! x' = x + T(1−e)v, v' = e·v, and the covariance of the noise in closed form.

use super::motion::{moved, rotation_vector};
use super::{PredictedPath, Predictor, are_ahead};
use crate::units::Time;
use crate::view::View;
use glam::{DQuat, DVec3};

/// Constants of one of the two processes.
#[derive(Clone, Copy, Debug)]
struct Process {
    /// T: how long a velocity lasts, seconds.
    lasting: f64,
    /// Stationary variance of the velocity, (unit/s)².
    velocity_variance: f64,
    /// Variance of a measurement, unit².
    measurement_variance: f64,
}

const TRANSLATION: Process = Process { lasting: 4.0, velocity_variance: 25.0, measurement_variance: 1e-4 };
const ROTATION: Process = Process { lasting: 0.5, velocity_variance: 1.0, measurement_variance: 1e-5 };

/// Covariance of (x, v), shared by the three axes, since they are measured alike.
#[derive(Clone, Copy, Debug)]
struct Covariance {
    xx: f64,
    xv: f64,
    vv: f64,
}

impl Process {
    fn start(&self) -> Covariance {
        Covariance { xx: self.measurement_variance, xv: 0.0, vv: self.velocity_variance }
    }

    /// ∫₀^Δ of the velocity per unit of velocity: T(1 − e^(−Δ/T)).
    fn reach(&self, step: f64) -> f64 {
        -self.lasting * libm::expm1(-step / self.lasting)
    }

    /// Covariance after `step` seconds.
    fn propagate(&self, p: Covariance, step: f64) -> Covariance {
        let (t, e) = (self.lasting, libm::exp(-step / self.lasting));
        let g = self.reach(step);
        let s2 = self.velocity_variance;
        // Noise: Q_vv = s²(1−e²), Q_xv = s²·T(1−e)², Q_xx = s²·T(2Δ − T(1−e)(3−e)), with σ² = 2s²/T.
        let q_vv = s2 * (1.0 - e * e);
        let q_xv = s2 * g * g / t;
        let q_xx = (s2 * t * (2.0 * step - g * (3.0 - e))).max(0.0);
        Covariance {
            xx: p.xx + 2.0 * g * p.xv + g * g * p.vv + q_xx,
            xv: e * (p.xv + g * p.vv) + q_xv,
            vv: e * e * p.vv + q_vv,
        }
    }

    /// Gains of x and v for a measurement of x, and the covariance after it.
    fn update(&self, p: Covariance) -> (f64, f64, Covariance) {
        let total = p.xx + self.measurement_variance;
        let (kx, kv) = (p.xx / total, p.xv / total);
        let after = Covariance { xx: (1.0 - kx) * p.xx, xv: (1.0 - kx) * p.xv, vv: (p.vv - kv * p.xv).max(0.0) };
        (kx, kv, after)
    }
}

#[derive(Clone, Debug)]
struct Filter {
    at: Time,
    view: View,
    position: DVec3,
    velocity: DVec3,
    p: Covariance,
    orientation: DQuat,
    /// World space, rad/s.
    rate: DVec3,
    r: Covariance,
}

/// The filter; before the first observation it knows nothing.
#[derive(Clone, Debug, Default)]
pub struct Kalman {
    filter: Option<Filter>,
}

impl Predictor for Kalman {
    fn observe(&mut self, view: &View, now: Time) {
        let fresh = || Filter {
            at: now,
            view: *view,
            position: view.position,
            velocity: DVec3::ZERO,
            p: TRANSLATION.start(),
            orientation: view.orientation,
            rate: DVec3::ZERO,
            r: ROTATION.start(),
        };
        let Some(f) = &mut self.filter else {
            self.filter = Some(fresh());
            return;
        };
        let step = now.since(f.at).secs();
        if step <= 0.0 {
            return;
        }
        let p = TRANSLATION.propagate(f.p, step);
        let expected = f.position + f.velocity * TRANSLATION.reach(step);
        let innovation = view.position - expected;
        // A step that the motion model puts beyond 30 standard deviations is a teleport: begin anew.
        if innovation.length_squared() > 900.0 * 3.0 * (p.xx + TRANSLATION.measurement_variance) + 100.0 {
            *f = fresh();
            return;
        }
        let (kx, kv, p) = TRANSLATION.update(p);
        f.velocity = f.velocity * libm::exp(-step / TRANSLATION.lasting) + innovation * kv;
        f.position = expected + innovation * kx;
        f.p = p;

        let r = ROTATION.propagate(f.r, step);
        let expected = DQuat::from_scaled_axis(f.rate * ROTATION.reach(step)) * f.orientation;
        let innovation = rotation_vector(view.orientation * expected.conjugate());
        let (kx, kv, r) = ROTATION.update(r);
        f.rate = f.rate * libm::exp(-step / ROTATION.lasting) + innovation * kv;
        f.orientation = (DQuat::from_scaled_axis(innovation * kx) * expected).normalize();
        f.r = r;
        f.at = now;
        f.view = *view;
    }

    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath> {
        let Some(f) = self.filter.as_ref().filter(|_| are_ahead(offsets)) else { return Vec::new() };
        let lag = now.since(f.at).secs();
        let from = View { position: f.position, orientation: f.orientation, ..f.view };
        let views = offsets
            .iter()
            .map(|u| {
                let position = f.position + f.velocity * TRANSLATION.reach(lag + u);
                moved(&from, position, f.rate * ROTATION.reach(lag + u))
            })
            .collect();
        vec![PredictedPath { weight: 1.0, views }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two half steps must give what one whole step gives: the sign of an exact discretisation.
    #[test]
    fn propagation_composes() {
        for step in [1e-6, 0.016, 1.0, 3600.0, 1e7] {
            let p = Covariance { xx: 0.3, xv: 0.1, vv: 2.0 };
            let once = TRANSLATION.propagate(p, step);
            let twice = TRANSLATION.propagate(TRANSLATION.propagate(p, step / 2.0), step / 2.0);
            for (a, b) in [(once.xx, twice.xx), (once.xv, twice.xv), (once.vv, twice.vv)] {
                assert!((a - b).abs() <= 1e-9 * a.abs().max(1.0), "{step}: {a} {b}");
            }
        }
    }

    #[test]
    fn follows_uniform_motion() {
        let mut kalman = Kalman::default();
        let mut view = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [16, 9] };
        for tick in 0..600u64 {
            view.position = DVec3::X * (5.0 * tick as f64 / 60.0);
            kalman.observe(&view, Time(tick * 16_666_667));
        }
        let path = kalman.predict(Time(599 * 16_666_667), &[0.0, 0.1]);
        let step = path[0].views[1].position - path[0].views[0].position;
        assert!((step.x - 0.5).abs() < 0.02, "{step}");
    }
}
