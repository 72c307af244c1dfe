//! The camera goes on as it moves now and keeps looking where it looks.

use super::motion::{Motion, moved};
use super::{PredictedPath, Predictor, are_ahead};
use crate::units::Time;
use crate::view::View;
use glam::DVec3;

/// p(t+u) = p + v·u, orientation held: the prediction of \[ZK\]'s predecessors.
#[derive(Clone, Debug, Default)]
pub struct ConstantVelocity {
    motion: Motion,
}

impl Predictor for ConstantVelocity {
    fn observe(&mut self, view: &View, now: Time) {
        self.motion.observe(view, now);
    }

    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath> {
        let Some((seen, view)) = self.motion.latest().filter(|_| are_ahead(offsets)) else { return Vec::new() };
        let lag = now.since(*seen).secs();
        let velocity = self.motion.velocity();
        let views = offsets.iter().map(|u| moved(view, view.position + velocity * (lag + u), DVec3::ZERO)).collect();
        vec![PredictedPath { weight: 1.0, views }]
    }
}
