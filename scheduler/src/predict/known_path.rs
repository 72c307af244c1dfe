//! The client has said where it goes (`flyTo`, a tour, a recording): the prediction is that path, as far as it was said.

use super::{PredictedPath, Predictor, are_ahead};
use crate::units::Time;
use crate::view::View;

/// The announced path, linear and slerp between its views; before it begins and after it ends, the nearest of its
/// views. Without an announcement, the view stays.
#[derive(Clone, Debug, Default)]
pub struct KnownPath {
    path: Vec<(Time, View)>,
    latest: Option<View>,
}

impl KnownPath {
    fn at(&self, t: Time) -> Option<View> {
        let after = self.path.partition_point(|(at, _)| *at <= t);
        let (Some(before), Some(next)) = (after.checked_sub(1).and_then(|i| self.path.get(i)), self.path.get(after))
        else {
            return if after == 0 { self.path.first() } else { self.path.last() }.map(|(_, v)| *v).or(self.latest);
        };
        let share = t.since(before.0).secs() / next.0.since(before.0).secs();
        Some(View {
            position: before.1.position.lerp(next.1.position, share),
            orientation: before.1.orientation.slerp(next.1.orientation, share).normalize(),
            ..before.1
        })
    }
}

impl Predictor for KnownPath {
    fn observe(&mut self, view: &View, _now: Time) {
        self.latest = Some(*view);
    }

    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath> {
        if !are_ahead(offsets) {
            return Vec::new();
        }
        let views: Option<Vec<View>> = offsets.iter().map(|u| self.at(now + Time::from_secs(*u))).collect();
        views.map(|views| vec![PredictedPath { weight: 1.0, views }]).unwrap_or_default()
    }

    fn announce_path(&mut self, path: &[(Time, View)]) -> bool {
        let mut path = path.to_vec();
        path.sort_by_key(|(t, _)| *t);
        path.dedup_by_key(|(t, _)| *t);
        let before = core::mem::replace(&mut self.path, path);
        // A renewal repeats what is known and goes on from there.
        let (Some(known_to), Some(first)) = (before.last(), self.path.first()) else { return true };
        let repeated = self.path.partition_point(|(t, _)| t <= &known_to.0);
        let start = before.partition_point(|(t, _)| t < &first.0);
        repeated == 0 || self.path[..repeated] != before[start..]
    }
}
