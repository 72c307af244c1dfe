//! Playing a path in the window.

use foresight_scheduler::view::View;
use foresight_traces::flight::TICKS_PER_SECOND;

/// A path that is played, or stands.
#[derive(Clone, Debug)]
pub(super) struct Player {
    views: Vec<View>,
    /// Seconds into the path.
    at_s: f64,
    plays: bool,
}

impl Player {
    /// At the beginning of a path, 60 views a second, and playing.
    pub(super) fn new(views: Vec<View>) -> Player {
        let plays = !views.is_empty();
        Player { views, at_s: 0.0, plays }
    }

    /// Whether it plays.
    pub(super) fn plays(&self) -> bool {
        self.plays
    }

    /// Plays or stops; at the end it begins again.
    pub(super) fn toggle(&mut self) {
        self.plays = !self.plays && !self.views.is_empty();
        if self.plays && self.at_s >= self.length_s() {
            self.at_s = 0.0;
        }
    }

    /// Stops: the camera is moved by hand.
    pub(super) fn stop(&mut self) {
        self.plays = false;
    }

    /// Seconds into the path, and of all of it.
    pub(super) fn progress(&self) -> (f64, f64) {
        (self.at_s, self.length_s())
    }

    fn length_s(&self) -> f64 {
        self.views.len().saturating_sub(1) as f64 / TICKS_PER_SECOND as f64
    }

    /// Goes on by `dt` seconds; the view there, and whether it was the last.
    pub(super) fn step(&mut self, dt: f64) -> Option<(View, bool)> {
        if !self.plays {
            return None;
        }
        let view = *self.views.get((self.at_s * TICKS_PER_SECOND as f64) as usize).or(self.views.last())?;
        let is_last = self.at_s >= self.length_s();
        if is_last {
            self.plays = false;
        } else {
            self.at_s = (self.at_s + dt.clamp(0.0, 10.0)).min(self.length_s());
        }
        Some((view, is_last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    #[test]
    fn a_path_is_played_once_and_again_when_asked() {
        let view =
            |x| View { position: DVec3::new(x, 0.0, 0.0), orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [4, 3] };
        let mut player = Player::new((0..121).map(|i| view(f64::from(i))).collect());
        let played = |player: &mut Player| -> Vec<f64> {
            std::iter::from_fn(|| player.step(0.5)).map(|(view, _)| view.position.x).collect()
        };
        assert_eq!(played(&mut player), [0.0, 30.0, 60.0, 90.0, 120.0]);
        assert_eq!((player.plays(), player.progress()), (false, (2.0, 2.0)));
        player.toggle();
        assert_eq!(player.step(0.1).unwrap().0.position.x, 0.0);
        player.stop();
        assert_eq!(player.step(0.1), None);
        let mut none = Player::new(Vec::new());
        none.toggle();
        assert!(!none.plays());
    }
}
