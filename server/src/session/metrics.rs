//! What is counted of sessions.

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};
use std::sync::atomic::{AtomicI64, AtomicU64};

/// Why something ended or was refused.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct ReasonLabel {
    /// One of a few fixed words.
    pub reason: &'static str,
}

/// What is counted of sessions. Names in `/metrics` begin with `foresight_`.
#[derive(Clone, Debug)]
#[expect(missing_docs, reason = "each is described where it is registered")]
pub struct SessionMetrics {
    pub active: Gauge,
    pub connected: Gauge,
    pub opened: Counter,
    pub resumed: Counter,
    pub ended: Family<ReasonLabel, Counter>,
    pub refused: Family<ReasonLabel, Counter>,
    pub connections_closed: Family<ReasonLabel, Counter>,
    pub frames: Counter,
    pub frame_bytes: Counter,
    pub frames_merged: Counter,
    pub frames_malformed: Counter,
    pub errors_told: Counter,
    pub requests_pending: Gauge,
    pub requests: Counter,
    pub requests_completed: Counter,
    pub requests_cancelled: Counter,
    pub requests_failed: Counter,
    pub discards: Counter,
    pub requested_bytes: Counter,
    pub completed_bytes: Counter,
    pub wasted_bytes: Counter,
    pub quality_seconds: Counter<f64, AtomicU64>,
    pub benefit_per_byte: Gauge<f64, AtomicU64>,
    pub memory_bytes: Gauge,
    pub view_to_decision: Histogram,
    pub decision: Histogram,
    pub waiting: Gauge,
    pub panics: Counter,
    pub driving: Gauge,
    pub recordings: Counter,
    pub recording_bytes: Counter,
    pub recordings_cut_short: Family<ReasonLabel, Counter>,
    pub database_up: Gauge<i64, AtomicI64>,
    pub database_writes: Counter,
    pub database_errors: Family<ReasonLabel, Counter>,
    pub database_drops: Counter,
}

/// 0.25 ms to 8.2 s, each twice the one before.
fn seconds() -> Histogram {
    Histogram::new(exponential_buckets(0.000_25, 2.0, 16))
}

impl Default for SessionMetrics {
    fn default() -> SessionMetrics {
        SessionMetrics {
            active: Gauge::default(),
            connected: Gauge::default(),
            opened: Counter::default(),
            resumed: Counter::default(),
            ended: Family::default(),
            refused: Family::default(),
            connections_closed: Family::default(),
            frames: Counter::default(),
            frame_bytes: Counter::default(),
            frames_merged: Counter::default(),
            frames_malformed: Counter::default(),
            errors_told: Counter::default(),
            requests_pending: Gauge::default(),
            requests: Counter::default(),
            requests_completed: Counter::default(),
            requests_cancelled: Counter::default(),
            requests_failed: Counter::default(),
            discards: Counter::default(),
            requested_bytes: Counter::default(),
            completed_bytes: Counter::default(),
            wasted_bytes: Counter::default(),
            quality_seconds: Counter::default(),
            benefit_per_byte: Gauge::default(),
            memory_bytes: Gauge::default(),
            view_to_decision: seconds(),
            decision: seconds(),
            waiting: Gauge::default(),
            panics: Counter::default(),
            driving: Gauge::default(),
            recordings: Counter::default(),
            recording_bytes: Counter::default(),
            recordings_cut_short: Family::default(),
            database_up: Gauge::default(),
            database_writes: Counter::default(),
            database_errors: Family::default(),
            database_drops: Counter::default(),
        }
    }
}

impl SessionMetrics {
    /// Adds all of them to a registry. Reasons that deserve an alarm are there from the start, at 0, so that the first
    /// occurrence is an increase.
    pub fn register(&self, registry: &mut Registry) {
        let families = [
            (&self.ended, &["bye", "deleted", "fault", "memory", "not_resumed", "shutdown"][..]),
            (&self.refused, &["hello", "no_hello", "sessions", "sessions_of_address", "shutdown", "world"]),
            (&self.connections_closed, &["idle", "malformed", "rate", "slow", "stuck", "too_large"]),
            (&self.recordings_cut_short, &["disk", "limit", "queue_full"]),
            (&self.database_errors, &["damaged", "full", "gone", "locked", "no_answer", "read_only", "refused"]),
        ];
        for (family, reasons) in families {
            for reason in reasons {
                drop(family.get_or_create(&ReasonLabel { reason }));
            }
        }
        let m = self.clone();
        registry.register("sessions_active", "Sessions held, with or without a connection", m.active);
        registry.register("sessions_connected", "Sessions whose answers somebody reads", m.connected);
        registry.register("sessions_opened", "Sessions begun", m.opened);
        registry.register("sessions_resumed", "Sessions that went on after a break of their connection", m.resumed);
        registry.register("sessions_ended", "Sessions ended, by reason", m.ended);
        registry.register("sessions_refused", "Sessions and connections not accepted, by reason", m.refused);
        registry.register("connections_closed", "Connections of sessions closed, by reason", m.connections_closed);
        registry.register("frames", "Frames received from clients", m.frames);
        registry.register_with_unit("frame", "Bytes of frames received from clients", Unit::Bytes, m.frame_bytes);
        registry.register("frames_merged", "Frames merged into later ones because decisions lagged", m.frames_merged);
        registry.register("frames_malformed", "Frames that were no list of messages", m.frames_malformed);
        registry.register("errors_told", "Errors told to clients", m.errors_told);
        registry.register("requests_pending", "Requests told to clients and not over", m.requests_pending);
        registry.register("requests", "Requests told to clients", m.requests);
        registry.register("requests_completed", "Requests whose content clients can show", m.requests_completed);
        registry.register("requests_cancelled", "Requests cancelled, or aborted by clients", m.requests_cancelled);
        registry.register("requests_failed", "Requests that failed", m.requests_failed);
        registry.register("discards", "Representations that clients were told to free", m.discards);
        registry.register_with_unit("requested", "Wire bytes of requests told", Unit::Bytes, m.requested_bytes);
        registry.register_with_unit("completed", "Wire bytes of completed requests", Unit::Bytes, m.completed_bytes);
        registry.register_with_unit(
            "wasted",
            "Wire bytes of requests that were cancelled, aborted or failed, each counted whole",
            Unit::Bytes,
            m.wasted_bytes,
        );
        registry.register(
            "quality_seconds",
            "Quality of the view (0 to 1) times seconds, over sessions",
            m.quality_seconds,
        );
        registry.register(
            "benefit_per_byte",
            "Quality seconds per completed byte, since the start",
            m.benefit_per_byte,
        );
        registry.register_with_unit("session_memory", "Memory of all sessions, estimated", Unit::Bytes, m.memory_bytes);
        registry.register_with_unit(
            "view_to_decision",
            "From a view's receipt until its answer is handed to the socket, or nothing is found to be said",
            Unit::Seconds,
            m.view_to_decision,
        );
        registry.register_with_unit("decision", "Computing time of a frame or tick", Unit::Seconds, m.decision);
        registry.register("sessions_waiting", "Sessions that wait for their turn on a decision thread", m.waiting);
        registry.register("session_panics", "Sessions ended by a fault of the server", m.panics);
        registry.register("driving", "1 if clients are told what to do, 0 if the kill switch is off", m.driving);
        registry.register("recordings", "Recordings of sessions begun", m.recordings);
        registry.register_with_unit("recording", "Bytes recorded", Unit::Bytes, m.recording_bytes);
        registry.register("recordings_cut_short", "Recordings that lack their end, by reason", m.recordings_cut_short);
        registry.register(
            "database_up",
            "1 if the database took the last write or answered the last question",
            m.database_up,
        );
        registry.register("database_writes", "Link estimates written", m.database_writes);
        registry.register("database_errors", "Failures of the database, by reason", m.database_errors);
        registry.register("database_drops", "Link estimates lost because too many waited", m.database_drops);
    }

    pub(super) fn refused(&self, reason: &'static str) {
        self.refused.get_or_create(&ReasonLabel { reason }).inc();
    }
}
