//! What is required now, and nothing ahead: the viewer without prefetching.

use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::policy::Policy;
use foresight_scheduler::scheduler::Action;
use foresight_scheduler::state::{ClientState, Status};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;

use super::required::required;

/// Requests in flight at once, as \[HIBR\]'s prefetcher is given.
const PARALLEL: usize = 4;
/// Distance after which the required set is worked out anew, metres.
const STEP: f64 = 0.5;

/// Fetches the required set, nearest first.
#[derive(Debug, Default)]
pub struct Demand {
    /// Largest error per metre of distance.
    allowed: f64,
    made_at: Option<glam::DVec3>,
    /// Nearest last.
    queue: Vec<RepId>,
}

impl Demand {
    /// For orthoviews of at most `target_px` pixels a pixel.
    pub fn new(target_px: f64, view: &View) -> Demand {
        Demand { allowed: target_px / view.pixels_per_radian(), ..Demand::default() }
    }
}

impl Policy for Demand {
    fn name(&self) -> &str {
        "demand"
    }

    fn observe(&mut self, state: &ClientState, view: &View, _now: Time) {
        if self.made_at.is_some_and(|at| at.distance(view.position) < STEP) {
            return;
        }
        self.made_at = Some(view.position);
        let mut shown = required(state.tree, view.position, self.allowed);
        shown.sort_by(|a, b| b.distance.total_cmp(&a.distance).then(b.node.cmp(&a.node)));
        self.queue = shown.into_iter().flat_map(|s| s.by).collect();
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        while state.requests().len() < PARALLEL {
            let Some(rep) = self.queue.pop() else { break };
            if state.status(rep) == Status::Absent && state.request_bytes(rep) <= state.free_bytes() {
                return Action::Fetch { rep, discard_on_arrival: Vec::new() };
            }
        }
        Action::WaitUntil(now + Time::from_secs(1.0 / 60.0))
    }
}
