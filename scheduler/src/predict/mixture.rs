//! A mixture that is believed as far as it has been right: the camera goes on, keeps turning, or the head returns.
//!
//! Every component predicts; a second later its error is known. Belief and spread of each follow by online expectation
//! maximisation: with residual e_i of component i, responsibility ∝ w_i·N(e_i; 0, σ_i²), and both w and σ² move towards
//! what was seen with a memory of some twenty seconds.

use super::constant_turn::turned_displacement;
use super::kalman::Kalman;
use super::motion::{Motion, moved, rotation_vector};
use super::{PredictedPath, Predictor, are_ahead};
use crate::units::Time;
use crate::view::View;
use glam::{DQuat, DVec3};
use std::collections::VecDeque;

const COMPONENTS: usize = 3;
/// How far ahead predictions are judged, seconds.
const JUDGED_AHEAD_S: f64 = 1.0;
/// Spacing of the predictions that are judged, seconds.
const SPACING_S: f64 = 0.25;
/// Share of the old belief that a judgement leaves.
const KEPT: f64 = 0.99;
/// Components below this belief are not worth their evaluation.
const LEAST_WEIGHT: f64 = 0.05;
/// Metres of error in position that count like a radian of error in direction.
const METRES_PER_RADIAN: f64 = 20.0;
/// Nodes of the three-point Gauss–Hermite rule, in standard deviations; its weights are 1/6, 2/3, 1/6.
const GAUSS_HERMITE_NODE: f64 = 1.732_050_807_568_877_2;
/// Greatest spread of the direction, radians.
const SPREAD_MAX: f64 = 0.6;
/// Least variance of an error, rad².
const LEAST_VARIANCE: f64 = 1e-4;
/// How long the head's usual direction remembers, seconds.
const USUAL_S: f64 = 6.0;
/// How fast a turned head comes back, seconds.
const RETURN_S: f64 = 1.5;

/// The mixture.
#[derive(Clone, Debug)]
pub struct Mixture {
    motion: Motion,
    kalman: Kalman,
    /// Where the camera usually looks, a slow average.
    usual: Option<(Time, DQuat)>,
    weight: [f64; COMPONENTS],
    variance: [f64; COMPONENTS],
    pending: VecDeque<(Time, [View; COMPONENTS])>,
    /// Predictions judged so far.
    judged: u32,
}

impl Default for Mixture {
    fn default() -> Mixture {
        Mixture {
            motion: Motion::default(),
            kalman: Kalman::default(),
            usual: None,
            weight: [0.6, 0.1, 0.3],
            variance: [0.1; COMPONENTS],
            pending: VecDeque::new(),
            judged: 0,
        }
    }
}

impl Mixture {
    /// Belief in: goes on, keeps turning, head returns.
    pub fn weights(&self) -> [f64; COMPONENTS] {
        self.weight
    }

    fn component(&self, which: usize, now: Time, offsets: &[f64]) -> Vec<View> {
        let Some((seen, view)) = self.motion.latest() else { return Vec::new() };
        let lag = now.since(*seen).secs();
        let (velocity, rate) = (self.motion.velocity(), self.motion.rotation_rate());
        match which {
            0 => self.kalman.predict(now, offsets).pop().map(|p| p.views).unwrap_or_default(),
            1 => offsets
                .iter()
                .map(|u| moved(view, view.position + turned_displacement(velocity, rate, lag + u), rate * (lag + u)))
                .collect(),
            _ => {
                let usual = self.usual.map_or(view.orientation, |(_, q)| q);
                let back = rotation_vector(usual * view.orientation.conjugate());
                offsets
                    .iter()
                    .map(|u| {
                        let share = -libm::expm1(-(lag + u) / RETURN_S);
                        moved(view, view.position + velocity * (lag + u), back * share)
                    })
                    .collect()
            }
        }
    }

    fn judge(&mut self, view: &View, now: Time) {
        while let Some((due, predicted)) = self.pending.front() {
            if *due > now {
                return;
            }
            let mut likelihood = [0.0; COMPONENTS];
            let mut squared = [0.0; COMPONENTS];
            for i in 0..COMPONENTS {
                let angle = rotation_vector(view.orientation * predicted[i].orientation.conjugate()).length();
                let metres = view.position.distance(predicted[i].position) / METRES_PER_RADIAN;
                squared[i] = (angle * angle + metres * metres).min(10.0);
                likelihood[i] =
                    self.weight[i] * libm::exp(-0.5 * squared[i] / self.variance[i]) / self.variance[i].sqrt();
            }
            let total: f64 = likelihood.iter().sum();
            // The first judgements are averaged evenly, so that what was assumed at the start is soon forgotten.
            self.judged += 1;
            let kept = KEPT.min(1.0 - 1.0 / f64::from(self.judged + 1));
            for i in 0..COMPONENTS {
                let responsibility = if total > 0.0 { likelihood[i] / total } else { 1.0 / COMPONENTS as f64 };
                self.weight[i] = kept * self.weight[i] + (1.0 - kept) * responsibility;
                let step = (1.0 - kept) * responsibility / self.weight[i].max(1e-3);
                self.variance[i] =
                    (self.variance[i] + step.min(1.0) * (squared[i] - self.variance[i])).max(LEAST_VARIANCE);
            }
            self.pending.pop_front();
        }
    }
}

impl Predictor for Mixture {
    fn observe(&mut self, view: &View, now: Time) {
        let teleported = self.motion.observe(view, now);
        self.kalman.observe(view, now);
        if teleported {
            self.usual = None;
            self.pending.clear();
        }
        self.usual = Some(match self.usual {
            None => (now, view.orientation),
            Some((before, usual)) => {
                let share = -libm::expm1(-now.since(before).secs() / USUAL_S);
                (now, usual.slerp(view.orientation, share).normalize())
            }
        });
        self.judge(view, now);
        let due = now + Time::from_secs(JUDGED_AHEAD_S);
        let spaced = self.pending.back().is_none_or(|(last, _)| due.since(*last).secs() >= SPACING_S);
        if spaced {
            let ahead = [JUDGED_AHEAD_S];
            let one = |which| self.component(which, now, &ahead).pop().unwrap_or(*view);
            let predicted = [one(0), one(1), one(2)];
            self.pending.push_back((due, predicted));
        }
    }

    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath> {
        if self.motion.latest().is_none() || !are_ahead(offsets) {
            return Vec::new();
        }
        let believed: f64 = self.weight.iter().filter(|w| **w >= LEAST_WEIGHT).sum();
        let likeliest = (0..COMPONENTS).fold(0, |best, i| if self.weight[i] > self.weight[best] { i } else { best });
        let mut paths = Vec::new();
        for i in (0..COMPONENTS).filter(|&i| self.weight[i] >= LEAST_WEIGHT) {
            let weight = self.weight[i] / believed;
            let views = self.component(i, now, offsets);
            if i != likeliest {
                paths.push(PredictedPath { weight, views });
                continue;
            }
            for side in [-1.0, 1.0] {
                let aside = views.iter().zip(offsets).map(|(view, u)| {
                    let spread = (self.variance[i] * u / JUDGED_AHEAD_S).sqrt().min(SPREAD_MAX);
                    moved(view, view.position, view.orientation * DVec3::Y * (side * GAUSS_HERMITE_NODE * spread))
                });
                paths.push(PredictedPath { weight: weight * (1.0 / 6.0), views: aside.collect() });
            }
            paths.push(PredictedPath { weight: weight * (2.0 / 3.0), views });
        }
        paths
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(turn_rate: impl Fn(f64) -> f64) -> Mixture {
        let mut mixture = Mixture::default();
        let mut view = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [16, 9] };
        let mut yaw = 0.0;
        for tick in 0..3600u64 {
            let t = tick as f64 / 60.0;
            yaw += turn_rate(t) / 60.0;
            view.orientation = DQuat::from_rotation_y(yaw);
            view.position += view.forward() * (2.0 / 60.0);
            mixture.observe(&view, Time(tick * 16_666_667));
        }
        mixture
    }

    #[test]
    fn belief_follows_the_evidence() {
        let turning = drive(|_| 0.6).weights();
        assert!(turning[1] > 0.6, "{turning:?}");
        let straight = drive(|_| 0.0).weights();
        assert!(straight[1] < 0.8 && straight.iter().sum::<f64>() - 1.0 < 1e-9, "{straight:?}");
    }
}
