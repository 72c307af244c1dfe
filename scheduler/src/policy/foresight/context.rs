//! What a choice is made from, and what comes out of it.

use super::{ArrivalOracle, ForesightSettings, Retries};
use crate::benefit::cut::Region;
use crate::lod_tree::RepId;
use crate::predict::PredictedPath;
use crate::select::certified::Certificate;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;

/// What holds during one decision.
#[derive(Clone, Copy)]
pub(super) struct Context<'c, 'a> {
    pub(super) settings: &'c ForesightSettings,
    pub(super) state: &'c ClientState<'a>,
    pub(super) retries: &'c Retries,
    pub(super) oracle: Option<&'c ArrivalOracle>,
    /// When the objective was sampled, and what was outstanding then.
    pub(super) sampled: Time,
    pub(super) queued_bytes: u64,
    /// Whether it has been sampled for this very decision.
    pub(super) due: bool,
}

impl Context<'_, '_> {
    /// Seconds from the horizon's start until a closure of `bytes` requested there would be here. One moment for all
    /// candidates of a sampling: what is ranked together is compared alike, and gains between samplings change only
    /// where the plan has changed.
    pub(super) fn arrival(&self, bytes: u64) -> f64 {
        if !self.settings.gains_from_arrival {
            return 0.0;
        }
        let bytes = self.queued_bytes + bytes;
        match self.oracle {
            Some(oracle) => oracle(self.sampled, bytes),
            None => self.state.link.latency_s() + bytes as f64 / self.state.link.rate(),
        }
    }

    /// Seconds of link that the closure occupies, c·M + o.
    pub(super) fn cost(&self, members: &[RepId]) -> f64 {
        let bytes: u64 = members.iter().map(|&m| self.state.tree.wire_bytes(m)).sum();
        bytes as f64 / self.state.link.rate() + self.settings.request_cost_s * members.len() as f64
    }

    /// Whether `rep` may be requested: what is doomed can be asked for again only when it is gone, what failed only after
    /// a while.
    pub(super) fn may_fetch(&self, rep: RepId) -> bool {
        self.state.status(rep) == Status::Absent && self.retries.allow(rep, self.sampled)
    }
}

/// The time ahead, as the objective samples it.
pub(super) struct Lookahead {
    /// α for this sampling.
    pub(super) alpha: f64,
    /// Whether nothing sampled before holds any more.
    pub(super) anew: bool,
    /// As many of the paths, from the first on, are each camera's first.
    pub(super) cameras: usize,
    /// A view an interval, at its middle.
    pub(super) paths: Vec<PredictedPath>,
    /// Ends of the intervals, seconds, ascending from 0.
    pub(super) bounds: Vec<f64>,
    /// The worst case: what is reachable from the present views, or under `minimum` the worst reachable views; the
    /// weights sum to 1.
    pub(super) worst: Vec<(f64, View, Region)>,
}

/// A closure chosen, with what has to go for it.
#[derive(Clone, Debug)]
pub(super) struct Choice {
    pub(super) ratio: f64,
    pub(super) gain: f64,
    pub(super) rep: RepId,
    pub(super) members: Vec<RepId>,
    pub(super) discards: Vec<RepId>,
    /// Share of the predicted paths in the closure's gain.
    pub(super) predicted_share: f64,
}

/// Share of the predicted paths in a gain of which the worst case has `worst`.
pub(super) fn predicted_share(gain: f64, worst: f64) -> f64 {
    let share = 1.0 - worst / gain;
    if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
}

/// Residents that go together.
#[derive(Clone, Debug, Default)]
pub(super) struct Discarded {
    pub(super) reps: Vec<RepId>,
    /// ΔJ lost with all of them.
    pub(super) loss: f64,
}

/// A way to choose. It keeps the planned set as the policy's own actions have left it.
pub(super) trait Choose: Send {
    /// Looks ahead anew.
    fn sample(&mut self, cx: &Context, ahead: &Lookahead);
    /// Once an observation, before anything is chosen: goes on with what can be found out ahead of need.
    fn prepare(&mut self, _cx: &Context) {}
    /// Something is planned or discarded by an action of this policy.
    fn added(&mut self, cx: &Context, rep: RepId);
    fn removed(&mut self, cx: &Context, rep: RepId);
    /// The camera has moved: what follows is a new decision.
    fn observed(&mut self) {}
    /// The planned set has changed otherwise: it has to be read anew. The next call is [`Choose::sample`].
    fn forget(&mut self);
    /// At the start: the coarsest representation of what weighs most and is covered by nothing.
    fn cover(&mut self, cx: &Context) -> Option<RepId>;
    /// A request that has lost its point: nothing gained by it any more, or far less than by the best candidate.
    fn pointless_request(&mut self, cx: &Context) -> Option<RepId>;
    /// Residents to discard until `bytes` are freed, by least loss per byte, whatever that loses; those found so far
    /// where something needs the rest first.
    fn make_room(&mut self, cx: &Context, bytes: u64) -> Discarded;
    /// What is lost with a planned representation alone.
    fn loss(&mut self, cx: &Context, rep: RepId) -> f64;
    /// The best closure that gains, with its discards.
    fn choose(&mut self, cx: &Context) -> Option<Choice>;
    /// Bytes of its tables.
    fn heap_bytes(&self) -> usize {
        0
    }
    /// What is proven about the last choice.
    fn certificate(&self) -> Option<Certificate> {
        None
    }
}

/// The first request for which `is_pointless` holds, of those that take longer than a reuse period and that nothing
/// needs; it is told the seconds that are left. What ends within a reuse period is not worth the bytes already charged.
pub(super) fn first_pointless(cx: &Context, mut is_pointless: impl FnMut(RepId, f64) -> bool) -> Option<RepId> {
    let state = cx.state;
    let asked: u64 = state.requests().iter().map(|r| state.tree.wire_bytes(r.rep)).sum();
    let left = state.outstanding_bytes() as f64 / asked.max(1) as f64;
    state.requests().iter().map(|r| r.rep).find(|&rep| {
        let seconds = left * state.tree.wire_bytes(rep) as f64 / state.link.rate();
        seconds > cx.settings.reuse_s && !state.is_needed(rep) && is_pointless(rep, seconds)
    })
}
