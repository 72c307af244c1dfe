//! Where the camera will be: each predictor turns the views seen so far into a weighted set of paths.

pub mod constant_turn;
pub mod constant_velocity;
pub mod kalman;
pub mod known_path;
pub mod mixture;
pub mod motion;

use crate::units::Time;
use crate::view::View;

/// A predicted path: views at the offsets asked for, and how much it is believed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PredictedPath {
    /// Share of the belief; the paths of a prediction sum to 1.
    pub weight: f64,
    /// One view an offset.
    pub views: Vec<View>,
}

/// Predicts the camera. Views arrive in order of time and have passed [`View::check`].
pub trait Predictor: Send {
    /// The camera is at `view`.
    fn observe(&mut self, view: &View, now: Time);

    /// Paths at `now + offsets` (seconds, ascending, not negative); at least one, weights summing to 1. Empty before
    /// the first observation, and where an offset is not a number from 0 to 10⁹.
    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath>;

    /// The client has said where it will go. Whether predictions of what was already announced have changed: what was
    /// sampled along them no longer holds.
    fn announce_path(&mut self, _path: &[(Time, View)]) -> bool {
        false
    }
}

/// Whether a prediction can be made that far ahead.
fn are_ahead(offsets: &[f64]) -> bool {
    offsets.iter().all(|u| (0.0..=1e9).contains(u))
}

/// The predictors by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PredictorKind {
    /// [`constant_velocity::ConstantVelocity`].
    ConstantVelocity,
    /// [`constant_turn::ConstantTurn`].
    ConstantTurn,
    /// [`kalman::Kalman`].
    Kalman,
    /// [`mixture::Mixture`].
    #[default]
    Mixture,
    /// [`known_path::KnownPath`].
    KnownPath,
}

impl PredictorKind {
    /// Every predictor with the name it is asked for.
    pub const ALL: [(&'static str, PredictorKind); 5] = [
        ("constant-velocity", PredictorKind::ConstantVelocity),
        ("constant-turn", PredictorKind::ConstantTurn),
        ("kalman", PredictorKind::Kalman),
        ("mixture", PredictorKind::Mixture),
        ("known-path", PredictorKind::KnownPath),
    ];

    /// A fresh predictor.
    pub fn build(self) -> Box<dyn Predictor> {
        match self {
            PredictorKind::ConstantVelocity => Box::new(constant_velocity::ConstantVelocity::default()),
            PredictorKind::ConstantTurn => Box::new(constant_turn::ConstantTurn::default()),
            PredictorKind::Kalman => Box::new(kalman::Kalman::default()),
            PredictorKind::Mixture => Box::new(mixture::Mixture::default()),
            PredictorKind::KnownPath => Box::new(known_path::KnownPath::default()),
        }
    }
}
