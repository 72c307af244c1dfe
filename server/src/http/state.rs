//! What all requests share.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use foresight_traces::link::LinkTrace;
use prometheus_client::registry::Registry;
use tokio::sync::Semaphore;

use super::limits::Limits;
use super::metrics::Metrics;
use super::priority::Turns;
use super::problem::Problem;
use super::shaping::Links;
use super::store::Store;
use super::worlds::{HostedWorld, Worlds};

/// What all requests share.
pub struct AppState {
    /// The worlds.
    pub worlds: Worlds,
    /// Links of the sessions, if responses are shaped.
    pub links: Option<Links>,
    /// Counters.
    pub metrics: Arc<Metrics>,
    /// Limits.
    pub limits: Limits,
    ready: AtomicBool,
    degraded: OnceLock<Box<dyn Fn() -> Option<String> + Send + Sync>>,
    pub(super) store: Store,
    pub(super) turns: Arc<Turns>,
    pub(super) requests: Arc<Semaphore>,
    pub(super) bodies: Arc<Semaphore>,
    pub(super) connections: Arc<Semaphore>,
}

impl AppState {
    /// With a link for each of at most `sessions_max` sessions if there is one; `others` registers further metrics.
    pub fn new(
        worlds: Worlds,
        link: Option<LinkTrace>,
        sessions_max: usize,
        limits: Limits,
        others: impl FnOnce(&mut Registry),
    ) -> AppState {
        AppState {
            worlds,
            links: link.map(|trace| Links::new(trace, sessions_max)),
            metrics: Arc::new(Metrics::new(others)),
            ready: AtomicBool::new(true),
            degraded: OnceLock::new(),
            store: Store::new(limits.store_bytes),
            turns: Turns::new(limits.reads),
            requests: Arc::new(Semaphore::new(limits.requests)),
            bodies: Arc::new(Semaphore::new(limits.bodies)),
            connections: Arc::new(Semaphore::new(limits.connections)),
            limits,
        }
    }

    /// The world of this name.
    ///
    /// # Errors
    /// 404.
    pub fn world(&self, name: &str) -> Result<&'static HostedWorld, Problem> {
        self.worlds
            .get(name)
            .ok_or_else(|| Problem::not_found("no world of this name; GET /worlds lists those that there are"))
    }

    /// Whether new clients are welcome; not any more once the server is ending.
    pub fn is_ready(&self) -> bool {
        self.ready.load(Ordering::Relaxed)
    }

    /// What is not as it should be, though the server goes on.
    pub fn degraded(&self) -> Option<String> {
        self.degraded.get().and_then(|degraded| degraded())
    }

    /// Who knows what is not as it should be; once.
    pub fn tell_degraded(&self, degraded: impl Fn() -> Option<String> + Send + Sync + 'static) {
        let _ = self.degraded.set(Box::new(degraded));
    }

    /// Tells load balancers to send nobody any more.
    pub fn set_ready(&self, ready: bool) {
        self.ready.store(ready, Ordering::Relaxed);
    }
}
