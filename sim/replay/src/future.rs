//! Policies that know the future, which only a simulator can give: the true path, and for `clairvoyant` the true link.

use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::foresight::Foresight;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::predict::{PredictedPath, Predictor, known_path::KnownPath};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::flight::{Flight, tick_time};
use foresight_traces::link::LinkTrace;

/// The policy, for one replay of `flight` over `link` from `start` on.
pub fn build<'a>(
    spec: &PolicySpec,
    tree: &'a LodTree,
    flight: &Flight,
    link: &LinkTrace,
    start: Time,
) -> Box<dyn Policy + 'a> {
    if !spec.knows_the_future() {
        return spec.build(tree);
    }
    let path: Vec<_> = flight.views.iter().enumerate().map(|(i, view)| (tick_time(i as u64), *view)).collect();
    let policy = Foresight::with_predictor(spec.label.clone(), spec.settings, Box::new(TruePath::new(&path)));
    if spec.name() == "clairvoyant" {
        let link = link.shifted(start);
        Box::new(policy.with_oracle(Box::new(move |now, bytes| seconds_until(&link, now, bytes))))
    } else {
        Box::new(policy)
    }
}

/// Predicts the path that is flown, whatever the client announces.
struct TruePath(KnownPath);

impl TruePath {
    fn new(path: &[(Time, View)]) -> TruePath {
        let mut known = KnownPath::default();
        known.announce_path(path);
        TruePath(known)
    }
}

impl Predictor for TruePath {
    fn observe(&mut self, view: &View, now: Time) {
        self.0.observe(view, now);
    }

    fn predict(&self, now: Time, offsets: &[f64]) -> Vec<PredictedPath> {
        self.0.predict(now, offsets)
    }
}

/// Seconds until the link has delivered `bytes` after a request at `now`, at the round trip there; at most an hour. That a
/// request may fail is not known to it.
fn seconds_until(link: &LinkTrace, now: Time, bytes: u64) -> f64 {
    let rtt = link.rtt_at(now);
    let from = now + rtt;
    let (mut low, mut high) = (0u64, 3_600_000_000_000u64);
    // To the millisecond: finer than any decision resolves.
    while high - low > 1_000_000 {
        let middle = low + (high - low) / 2;
        if link.bytes_deliverable(from, from + Time(middle)) >= bytes {
            high = middle;
        } else {
            low = middle;
        }
    }
    rtt.secs() + Time(high).secs()
}
