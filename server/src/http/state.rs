//! What all requests share.

use super::metrics::Metrics;
use super::problem::Problem;
use super::store::Store;
use super::worlds::{HostedWorld, Worlds};

/// What all requests share.
pub struct AppState {
    /// The worlds.
    pub worlds: Worlds,
    /// Files of worlds in memory.
    pub store: Store,
    /// Counters.
    pub metrics: Metrics,
}

impl AppState {
    /// The world of this name.
    ///
    /// # Errors
    /// 404.
    pub fn world(&self, name: &str) -> Result<&'static HostedWorld, Problem> {
        self.worlds
            .get(name)
            .ok_or_else(|| Problem::not_found("no world of this name; GET /worlds lists those that there are"))
    }
}
