//! The camera keeps turning: the velocity and the view turn together at the present rate.

use super::motion::{Motion, moved};
use super::{PredictedPath, Predictor, are_ahead};
use crate::units::Time;
use crate::view::View;
use glam::DVec3;

/// Constant turn rate and speed: with ω the rotation rate, R(u) = exp(ω u), p(t+u) = p + ∫₀ᵘ R(s) v ds in closed form.
#[derive(Clone, Debug, Default)]
pub struct ConstantTurn {
    motion: Motion,
}

/// ∫₀ᵘ exp(ω s) v ds (Rodrigues, integrated); its series where ω·u is small.
pub fn turned_displacement(velocity: DVec3, rate: DVec3, u: f64) -> DVec3 {
    let speed = rate.length();
    let angle = speed * u;
    if angle < 1e-4 {
        return velocity * u + rate.cross(velocity) * (0.5 * u * u);
    }
    let axis = rate / speed;
    let along = axis * axis.dot(velocity);
    let across = velocity - along;
    along * u + across * (libm::sin(angle) / speed) + axis.cross(velocity) * ((1.0 - libm::cos(angle)) / speed)
}

impl Predictor for ConstantTurn {
    fn observe(&mut self, view: &View, now: Time) {
        self.motion.observe(view, now);
    }

    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath> {
        let Some((seen, view)) = self.motion.latest().filter(|_| are_ahead(offsets)) else { return Vec::new() };
        let lag = now.since(*seen).secs();
        let (velocity, rate) = (self.motion.velocity(), self.motion.rotation_rate());
        let views = offsets
            .iter()
            .map(|u| {
                let u = lag + u;
                moved(view, view.position + turned_displacement(velocity, rate, u), rate * u)
            })
            .collect();
        vec![PredictedPath { weight: 1.0, views }]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;

    #[test]
    fn half_a_turn_ends_two_radii_to_the_side() {
        // 1 m/s along x, turning at π/10 rad/s about z: radius 10/π, after 10 s opposite the start.
        let end = turned_displacement(DVec3::X, DVec3::Z * (PI / 10.0), 10.0);
        assert!((end - DVec3::new(0.0, 20.0 / PI, 0.0)).length() < 1e-12);
    }

    #[test]
    fn the_series_meets_the_closed_form() {
        for rate in [0.9e-4, 1.1e-4] {
            let end = turned_displacement(DVec3::X, DVec3::Z * rate, 1.0);
            assert!((end - DVec3::new(1.0, 0.5 * rate, 0.0)).length() < 1e-8);
        }
    }
}
