//! Counters in the form that Prometheus reads.

use axum::http::StatusCode;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::registry::Registry;

/// Status of a response.
#[derive(Clone, Debug, PartialEq, Eq, Hash, EncodeLabelSet)]
struct StatusLabel {
    status: u16,
}

/// The counters.
pub struct Metrics {
    registry: Registry,
    content: Family<StatusLabel, Counter>,
    /// Files found in memory.
    pub store_hits: Counter,
    /// Files read from the disk.
    pub store_misses: Counter,
}

impl Default for Metrics {
    fn default() -> Metrics {
        let mut registry = Registry::with_prefix("foresight");
        let metrics = Metrics {
            content: Family::default(),
            store_hits: Counter::default(),
            store_misses: Counter::default(),
            registry: Registry::default(),
        };
        registry.register("content_responses", "Responses with content of worlds, by status", metrics.content.clone());
        registry.register("store_hits", "Files served from memory", metrics.store_hits.clone());
        registry.register("store_misses", "Files read from the disk", metrics.store_misses.clone());
        Metrics { registry, ..metrics }
    }
}

impl Metrics {
    /// Counts a response with content.
    pub(super) fn content(&self, status: StatusCode) {
        self.content.get_or_create(&StatusLabel { status: status.as_u16() }).inc();
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
