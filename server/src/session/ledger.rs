//! What came of a session's requests, for metrics and the log.

use super::metrics::SessionMetrics;
use foresight_scheduler::lod_tree::RepId;
use foresight_wire::message::{ClientMessage, ServerMessage};
use std::collections::BTreeMap;

/// Longest time between two estimates over which a quality is taken to last, seconds.
const QUALITY_LASTS_S: f64 = 5.0;

/// What came of a session's requests.
pub(super) struct Ledger {
    metrics: SessionMetrics,
    /// Wire bytes of each request told and not over; bounded by the client's memory.
    pending: BTreeMap<u32, u64>,
    figures: Figures,
    /// Time of the last estimate, and the quality then.
    quality: Option<(u64, f64)>,
    /// Something was completed since this was last asked.
    received: bool,
}

/// Counts of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Figures {
    pub(super) requests: u64,
    pub(super) completed: u64,
    pub(super) cancelled: u64,
    pub(super) failed: u64,
    pub(super) discards: u64,
    pub(super) completed_bytes: u64,
    pub(super) wasted_bytes: u64,
}

impl Ledger {
    pub(super) fn new(metrics: SessionMetrics) -> Ledger {
        Ledger { metrics, pending: BTreeMap::new(), figures: Figures::default(), quality: None, received: false }
    }

    /// The session has answered this.
    pub(super) fn answered(&mut self, answers: &[ServerMessage]) {
        for answer in answers {
            match answer {
                ServerMessage::Fetch(fetch) => {
                    self.metrics.requests.inc();
                    self.metrics.requested_bytes.inc_by(fetch.wire_bytes);
                    self.figures.requests += 1;
                    if self.pending.insert(fetch.rep, fetch.wire_bytes).is_none() {
                        self.metrics.requests_pending.inc();
                    }
                }
                ServerMessage::Cancel { rep } => self.cancelled(*rep),
                ServerMessage::Discard { .. } => {
                    self.metrics.discards.inc();
                    self.figures.discards += 1;
                }
                ServerMessage::Estimates(estimates) => {
                    let Some(quality) = estimates.quality else {
                        self.quality = None;
                        continue;
                    };
                    if let Some((t_ns, before)) = self.quality {
                        let seconds = (estimates.t_ns.saturating_sub(t_ns) as f64 * 1e-9).min(QUALITY_LASTS_S);
                        self.metrics.quality_seconds.inc_by(seconds * (quality + before) / 2.0);
                        let bytes = self.metrics.completed_bytes.get();
                        if bytes > 0 {
                            self.metrics.benefit_per_byte.set(self.metrics.quality_seconds.get() / bytes as f64);
                        }
                    }
                    self.quality = Some((estimates.t_ns, quality));
                }
                ServerMessage::Error(_) => {
                    self.metrics.errors_told.inc();
                }
                ServerMessage::Welcome(_) | ServerMessage::Wait { .. } | ServerMessage::Switch { .. } => {}
            }
        }
    }

    /// The client has said this; taken in before what the session answers to it.
    pub(super) fn reported(&mut self, messages: &[ClientMessage]) {
        for message in messages {
            match message {
                ClientMessage::Completed(event) => {
                    self.received = true;
                    self.completed(event.rep);
                }
                ClientMessage::Failed(failure) => {
                    if let Some(bytes) = self.over(failure.rep) {
                        self.metrics.requests_failed.inc();
                        self.figures.failed += 1;
                        self.wasted(bytes);
                    }
                }
                ClientMessage::Dropped(event) => self.cancelled(event.rep),
                _ => {}
            }
        }
    }

    fn completed(&mut self, rep: u32) {
        if let Some(bytes) = self.over(rep) {
            self.metrics.requests_completed.inc();
            self.metrics.completed_bytes.inc_by(bytes);
            self.figures.completed += 1;
            self.figures.completed_bytes += bytes;
        }
    }

    fn cancelled(&mut self, rep: u32) {
        if let Some(bytes) = self.over(rep) {
            self.metrics.requests_cancelled.inc();
            self.figures.cancelled += 1;
            self.wasted(bytes);
        }
    }

    fn wasted(&mut self, bytes: u64) {
        self.metrics.wasted_bytes.inc_by(bytes);
        self.figures.wasted_bytes += bytes;
    }

    fn over(&mut self, rep: u32) -> Option<u64> {
        let bytes = self.pending.remove(&rep)?;
        self.metrics.requests_pending.dec();
        Some(bytes)
    }

    /// After a break: what the client holds was completed, what the session no longer has under way was not.
    pub(super) fn resumed(&mut self, resident: &[u32], under_way: impl Fn(RepId) -> bool) {
        for rep in resident {
            self.completed(*rep);
        }
        let lost: Vec<u32> = self.pending.keys().copied().filter(|rep| !under_way(RepId(*rep))).collect();
        lost.into_iter().for_each(|rep| self.cancelled(rep));
    }

    /// Whether anything was completed since this was last asked.
    pub(super) fn take_received(&mut self) -> bool {
        std::mem::take(&mut self.received)
    }

    /// Nothing is pending any more; gives the counts.
    pub(super) fn end(&mut self) -> Figures {
        let pending = i64::try_from(self.pending.len()).unwrap_or(i64::MAX);
        self.metrics.requests_pending.dec_by(pending);
        self.pending.clear();
        self.figures
    }
}
