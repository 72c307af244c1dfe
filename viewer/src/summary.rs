//! What a flight came to.

use crate::statistics::{Histogram, Percentiles};
use serde::Serialize;
use std::collections::BTreeMap;

/// Version of the documents that `--json` prints.
pub const SCHEMA_VERSION: u32 = 1;

/// Of one session.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Name of the world.
    pub world: String,
    /// Hash of its content.
    pub identity: String,
    /// The policy with its options.
    pub policy: String,
    /// The server's name of the last session.
    pub session: String,
    /// Length of the flight, seconds.
    pub duration_s: f64,
    /// Views that were sent.
    pub views: u64,
    /// Bytes of bodies that came.
    pub bytes_received: u64,
    /// Requests that were made.
    pub requests: u64,
    /// What could be shown.
    pub completed: u64,
    /// Requests that the server had aborted.
    pub cancelled: u64,
    /// What the server had freed.
    pub discarded: u64,
    /// What failed, by what it was.
    pub failed: BTreeMap<String, u64>,
    /// What was freed because no session knew of it any more.
    pub dropped: u64,
    /// What was requested again after it had been shown, and had not been freed: should be none.
    pub fetched_while_resident: u64,
    /// How often the session's socket was opened again.
    pub reconnections: u64,
    /// Of these, how often the session went on.
    pub resumed: u64,
    /// Wrong messages that the server has named.
    pub errors: Vec<String>,
    /// Memory budget, bytes.
    pub memory_budget: u64,
    /// The most that was in use, bytes.
    pub memory_max: u64,
    /// Largest delay of a tick, milliseconds.
    pub tick_late_ms_max: f64,
    /// Ticks that were left out because they had passed.
    pub ticks_skipped: u64,
    /// From a view's frame to what was decided on it, milliseconds, of those views of which the server says so: one a second.
    pub view_to_decision_ms: Percentiles,
    /// Mean of the server's estimates of the quality; `None` if there was none.
    pub mean_quality: Option<f64>,
    /// The server's last estimate of the link, bytes/s and seconds.
    pub link: Option<(f64, f64)>,
}

impl Summary {
    /// Whether memory stayed within its budget.
    pub fn within_budget(&self) -> bool {
        self.memory_max <= self.memory_budget
    }
}

/// Of many sessions.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CrowdSummary {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Sessions at a time.
    pub clients: u64,
    /// Sessions that were begun.
    pub sessions: u64,
    /// Sessions that ended with an error.
    pub broken: u64,
    /// The first errors, and what the server found wrong.
    pub errors: Vec<String>,
    /// Views that were sent.
    pub views: u64,
    /// Views per second, over all.
    pub views_per_second: f64,
    /// Ticks that were left out because they had passed: the clients themselves were too slow.
    pub ticks_skipped: u64,
    /// Requests that were made.
    pub requests: u64,
    /// What could be shown.
    pub completed: u64,
    /// What failed.
    pub failed: u64,
    /// Bytes of bodies that came.
    pub bytes_received: u64,
    /// How often a socket was opened again.
    pub reconnections: u64,
    /// Sessions whose memory exceeded its budget: should be none.
    pub over_budget: u64,
    /// From a view's frame to what was decided on it, milliseconds, of those views of which the server says so: one a second.
    pub view_to_decision_ms: Percentiles,
}

/// Counts sessions together.
#[derive(Debug, Default)]
pub struct Tally {
    summary: CrowdSummary,
    latencies: Histogram,
}

/// Errors that are kept.
const ERRORS_MAX: usize = 10;

impl Tally {
    /// Adds a session that has ended.
    pub fn add(&mut self, summary: &Summary, latencies: &Histogram) {
        let total = &mut self.summary;
        total.sessions += 1;
        total.views += summary.views;
        total.ticks_skipped += summary.ticks_skipped;
        total.requests += summary.requests;
        total.completed += summary.completed;
        total.failed += summary.failed.values().sum::<u64>();
        total.bytes_received += summary.bytes_received;
        total.reconnections += summary.reconnections;
        total.over_budget += u64::from(!summary.within_budget());
        self.latencies.merge(latencies);
        for error in &summary.errors {
            self.keep(error);
        }
    }

    /// Adds a session that could not be flown.
    pub fn broken(&mut self, error: &str) {
        self.summary.sessions += 1;
        self.summary.broken += 1;
        self.keep(error);
    }

    fn keep(&mut self, error: &str) {
        if self.summary.errors.len() < ERRORS_MAX {
            self.summary.errors.push(error.to_owned());
        }
    }

    /// What came of `clients` at a time in `seconds`.
    pub fn finish(mut self, clients: u64, seconds: f64) -> CrowdSummary {
        self.summary.schema_version = SCHEMA_VERSION;
        self.summary.clients = clients;
        self.summary.views_per_second = self.summary.views as f64 / seconds;
        self.summary.view_to_decision_ms = self.latencies.percentiles();
        self.summary
    }
}
