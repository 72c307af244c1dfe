//! What is known of each camera of a client: how it moves, and where it will be.

use super::{ForesightSettings, worst};
use crate::benefit::cut::Region;
use crate::predict::motion::Motion;
use crate::predict::{PredictedPath, Predictor};
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use glam::DVec3;

/// A camera.
pub(super) struct Camera {
    /// Its share among the cameras; they sum to 1.
    share: f64,
    /// The latest view; `None` before the first.
    view: Option<View>,
    predictor: Box<dyn Predictor>,
    motion: Motion,
}

/// What lies ahead of all cameras.
pub(super) struct Ahead {
    /// The first path of each camera, in order, then the rest; weighted by the cameras' shares.
    pub(super) paths: Vec<PredictedPath>,
    /// The worst cases, weighted by the cameras' shares.
    pub(super) worst: Vec<(f64, View, Region)>,
}

/// What the time ahead is sampled by.
pub(super) struct Sampling<'a> {
    pub(super) settings: &'a ForesightSettings,
    pub(super) now: Time,
    /// Middles of the intervals, seconds from now.
    pub(super) middles: &'a [f64],
    /// ε, seconds.
    pub(super) epsilon: f64,
    /// Corners of the path announced.
    pub(super) track: &'a [DVec3],
}

impl Camera {
    pub(super) fn new(predictor: Box<dyn Predictor>) -> Camera {
        Camera { share: 1.0, view: None, predictor, motion: Motion::default() }
    }

    /// It is at `view`, and counts by `share`; true if it has teleported.
    pub(super) fn observe(&mut self, share: f64, view: &View, now: Time) -> bool {
        (self.share, self.view) = (share, Some(*view));
        let has_teleported = self.motion.observe(view, now);
        self.predictor.observe(view, now);
        has_teleported
    }

    /// Where it will go has been announced; true if what was sampled no longer holds.
    pub(super) fn announce_path(&mut self, path: &[(Time, View)]) -> bool {
        self.predictor.announce_path(path)
    }

    /// The paths ahead from its latest view, and what is reachable if they fail.
    fn look_ahead(&self, state: &ClientState, sampling: &Sampling) -> Option<Ahead> {
        let view = self.view?;
        let s = sampling.settings;
        let mut paths = self.predictor.predict(sampling.now, sampling.middles);
        if paths.is_empty() {
            paths.push(PredictedPath { weight: 1.0, views: vec![view; sampling.middles.len()] });
        }
        for path in &mut paths {
            path.weight *= self.share;
            // A predictor of one's own may go astray.
            for astray in path.views.iter_mut().filter(|view| view.check().is_err()) {
                *astray = view;
            }
        }
        let (tree, plan, speeds) = (state.tree, state.planned(), self.motion.percentile());
        let (region, worst_views) = worst::sampled(s, tree, plan, &view, speeds, sampling.epsilon, sampling.track);
        let worst = match worst_views {
            None => vec![(self.share, view, region)],
            Some(views) => views.iter().map(|&(w, view)| (self.share * w, view, Region::Frustum)).collect(),
        };
        Some(Ahead { paths, worst })
    }
}

/// The paths ahead of all cameras, and what is reachable if they fail; the first camera's first.
pub(super) fn look_ahead(cameras: &[Camera], state: &ClientState, sampling: &Sampling) -> Ahead {
    let mut all = Ahead { paths: Vec::new(), worst: Vec::new() };
    let mut rest = Vec::new();
    for mut ahead in cameras.iter().filter_map(|camera| camera.look_ahead(state, sampling)) {
        rest.extend(ahead.paths.drain(1..));
        all.paths.append(&mut ahead.paths);
        all.worst.append(&mut ahead.worst);
    }
    all.paths.append(&mut rest);
    all
}
