//! Counters of the HTTP side in the form that Prometheus reads.

use std::time::Instant;

use axum::http::StatusCode;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::{Histogram, exponential_buckets};
use prometheus_client::registry::{Registry, Unit};

use crate::clock;

/// Status of a response.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct StatusLabel {
    status: u16,
}

/// One of a few fixed words.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
pub struct ReasonLabel {
    reason: &'static str,
}

/// The counters, and the registry that others add theirs to.
#[expect(missing_docs, reason = "each is described where it is registered")]
pub struct Metrics {
    registry: Registry,
    responses: Family<StatusLabel, Counter>,
    content: Family<StatusLabel, Counter>,
    pub requests_active: Gauge,
    pub requests_refused: Family<ReasonLabel, Counter>,
    pub connections_active: Gauge,
    pub connections_closed: Family<ReasonLabel, Counter>,
    pub revalidations_hit: Counter,
    pub revalidations_missed: Counter,
    pub store_hits: Counter,
    pub store_misses: Counter,
    pub bodies_active: Gauge,
    pub bodies_completed: Counter,
    pub bodies_cancelled: Counter,
    pub bodies_failed: Counter,
    pub sent_bytes: Counter,
    pub cancelled_bytes: Counter,
    pub head_seconds: Histogram,
    pub body_seconds: Histogram,
    pub body_size: Histogram,
}

/// 0.1 ms to 52 s, each twice the one before.
fn seconds() -> Histogram {
    Histogram::new(exponential_buckets(0.000_1, 2.0, 20))
}

impl Default for Metrics {
    fn default() -> Metrics {
        Metrics::new(|_| {})
    }
}

impl Metrics {
    /// With what `others` registers besides.
    pub fn new(others: impl FnOnce(&mut Registry)) -> Metrics {
        let mut metrics = Metrics {
            registry: Registry::default(),
            responses: Family::default(),
            content: Family::default(),
            requests_active: Gauge::default(),
            requests_refused: Family::default(),
            connections_active: Gauge::default(),
            connections_closed: Family::default(),
            revalidations_hit: Counter::default(),
            revalidations_missed: Counter::default(),
            store_hits: Counter::default(),
            store_misses: Counter::default(),
            bodies_active: Gauge::default(),
            bodies_completed: Counter::default(),
            bodies_cancelled: Counter::default(),
            bodies_failed: Counter::default(),
            sent_bytes: Counter::default(),
            cancelled_bytes: Counter::default(),
            head_seconds: seconds(),
            body_seconds: seconds(),
            body_size: Histogram::new(exponential_buckets(1024.0, 4.0, 10)),
        };
        let mut registry = Registry::with_prefix("foresight");
        metrics.register(&mut registry);
        others(&mut registry);
        metrics.registry = registry;
        metrics
    }

    fn register(&self, registry: &mut Registry) {
        let m = self;
        registry.register("http_responses", "Responses, by status", m.responses.clone());
        registry.register("content_responses", "Responses on content of worlds, by status", m.content.clone());
        registry.register(
            "http_requests_active",
            "Requests being answered, bodies not counted",
            m.requests_active.clone(),
        );
        registry.register("http_requests_refused", "Requests not answered, by reason", m.requests_refused.clone());
        registry.register("http_connections_active", "Connections that are open", m.connections_active.clone());
        registry.register(
            "http_connections_closed",
            "Connections closed by the server, by reason",
            m.connections_closed.clone(),
        );
        registry.register(
            "revalidations_hit",
            "Conditional requests answered without content",
            m.revalidations_hit.clone(),
        );
        registry.register(
            "revalidations_missed",
            "Conditional requests answered with content",
            m.revalidations_missed.clone(),
        );
        registry.register("store_hits", "Files found in memory", m.store_hits.clone());
        registry.register("store_misses", "Files opened on the disk", m.store_misses.clone());
        registry.register(
            "content_active",
            "Contents on their way, those sent at once not counted",
            m.bodies_active.clone(),
        );
        registry.register("content_completed", "Contents sent to their end", m.bodies_completed.clone());
        registry.register("content_cancelled", "Contents whose client went away", m.bodies_cancelled.clone());
        registry.register("content_failed", "Contents broken off by the disk or the link", m.bodies_failed.clone());
        registry.register_with_unit("content_sent", "Bytes of contents sent", Unit::Bytes, m.sent_bytes.clone());
        registry.register_with_unit(
            "content_cancelled",
            "Bytes sent of contents whose client went away",
            Unit::Bytes,
            m.cancelled_bytes.clone(),
        );
        registry.register_with_unit(
            "http_head",
            "From a request to the head of its response",
            Unit::Seconds,
            m.head_seconds.clone(),
        );
        registry.register_with_unit(
            "content",
            "From a request to the last byte handed over",
            Unit::Seconds,
            m.body_seconds.clone(),
        );
        registry.register_with_unit("content_size", "Sizes of contents asked for", Unit::Bytes, m.body_size.clone());
    }

    /// Counts a response, whose request came at `asked_at`.
    pub(super) fn responded(&self, status: StatusCode, asked_at: Instant) {
        self.responses.get_or_create(&StatusLabel { status: status.as_u16() }).inc();
        self.head_seconds.observe(clock::now().saturating_duration_since(asked_at).as_secs_f64());
    }

    /// Counts a response on content of a world.
    pub(super) fn content(&self, status: StatusCode, conditional: bool) {
        self.content.get_or_create(&StatusLabel { status: status.as_u16() }).inc();
        match status {
            StatusCode::NOT_MODIFIED => drop(self.revalidations_hit.inc()),
            StatusCode::OK if conditional => drop(self.revalidations_missed.inc()),
            _ => {}
        }
    }

    pub(super) fn sent(&self, bytes: u64) {
        self.sent_bytes.inc_by(bytes);
    }

    /// Counts a content that was sent to its end.
    pub(super) fn completed(&self, asked_at: Instant) {
        self.bodies_completed.inc();
        self.body_seconds.observe(clock::now().saturating_duration_since(asked_at).as_secs_f64());
    }

    pub(super) fn refused(&self, reason: &'static str) {
        self.requests_refused.get_or_create(&ReasonLabel { reason }).inc();
    }

    pub(super) fn closed(&self, reason: &'static str) {
        self.connections_closed.get_or_create(&ReasonLabel { reason }).inc();
    }

    /// All of them as text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string fails only if a metric's own encoding does.
        if prometheus_client::encoding::text::encode(&mut text, &self.registry).is_err() {
            text.clear();
        }
        text
    }
}
