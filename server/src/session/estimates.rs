//! Link estimates that outlive sessions: one thread that owns the database, and a bounded queue before it.
//!
//! Whatever happens to the database, sessions go on: a question that is not answered in time has no answer, observations
//! wait in a bounded list, the connection is tried again after a time that doubles up to half a minute.

use super::metrics::{ReasonLabel, SessionMetrics};
use crate::clock;
use foresight_index::sessions::{Location, Observation, SessionStore, SessionStoreError};
use foresight_wire::message::LinkGuess;
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Questions and observations before the thread.
const QUEUE_MAX: usize = 1024;
/// Observations that wait while the database does not take them.
const WAITING_MAX: usize = 4096;
/// How long the database may take over a statement.
const PATIENCE: Duration = Duration::from_secs(1);
/// How long a session's beginning waits for what is known of its link.
const GUESS_WITHIN: Duration = Duration::from_millis(250);
/// Between two writes.
const BATCH_EVERY: Duration = Duration::from_secs(1);
/// First pause after a failure, and longest.
const PAUSE_MIN: Duration = Duration::from_millis(500);
const PAUSE_MAX: Duration = Duration::from_secs(30);
/// Longest name of a client under which something is kept, bytes.
pub(super) const CLIENT_BYTES_MAX: usize = 128;

enum Ask {
    Guess { client: String, answer: oneshot::Sender<Option<LinkGuess>> },
    Observe(Observation),
    Flush(oneshot::Sender<()>),
}

/// The way to the thread that owns the database.
pub(super) struct Estimates {
    queue: Option<SyncSender<Ask>>,
    state: Arc<Mutex<State>>,
    metrics: SessionMetrics,
    thread: Option<JoinHandle<()>>,
}

/// How the database is.
#[derive(Clone, Debug, Default)]
struct State {
    /// What is wrong with it.
    fault: Option<String>,
}

impl Estimates {
    /// Starts the thread, which opens the database.
    pub(super) fn start(location: Location, metrics: SessionMetrics) -> std::io::Result<Estimates> {
        let (queue, asked) = sync_channel(QUEUE_MAX);
        let state = Arc::new(Mutex::new(State::default()));
        let mut writer = Writer {
            location,
            store: None,
            state: state.clone(),
            metrics: metrics.clone(),
            waiting: BTreeMap::new(),
            pause: PAUSE_MIN,
            not_before: clock::now(),
            written: clock::now(),
        };
        let thread = std::thread::Builder::new().name("estimates".to_owned()).spawn(move || writer.run(&asked))?;
        Ok(Estimates { queue: Some(queue), state, metrics, thread: Some(thread) })
    }

    /// What is wrong with the database, if anything.
    pub(super) fn fault(&self) -> Option<String> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).fault.clone()
    }

    /// What is known of a client's link, if the database says so soon.
    pub(super) async fn guess(&self, client: &str) -> Option<LinkGuess> {
        if client.len() > CLIENT_BYTES_MAX || self.fault().is_some() {
            return None;
        }
        let (answer, answered) = oneshot::channel();
        self.queue.as_ref()?.try_send(Ask::Guess { client: client.to_owned(), answer }).ok()?;
        tokio::time::timeout(GUESS_WITHIN, answered).await.ok()?.ok()?
    }

    /// Keeps an observation, sooner or later.
    pub(super) fn observe(&self, observation: Observation) {
        let full = self.queue.as_ref().is_none_or(|queue| queue.try_send(Ask::Observe(observation)).is_err());
        if full {
            self.metrics.database_drops.inc();
        }
    }

    /// Writes what waits, once; returns when it has been tried.
    pub(super) async fn flush(&self) {
        let (done, flushed) = oneshot::channel();
        let mut ask = Ask::Flush(done);
        while let Some(Err(TrySendError::Full(again))) = self.queue.as_ref().map(|queue| queue.try_send(ask)) {
            ask = again;
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        let _ = flushed.await;
    }
}

impl Drop for Estimates {
    fn drop(&mut self) {
        self.queue = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Writer {
    location: Location,
    store: Option<SessionStore>,
    state: Arc<Mutex<State>>,
    metrics: SessionMetrics,
    /// Observations not yet written, in the order in which they came.
    waiting: BTreeMap<u64, Observation>,
    pause: Duration,
    not_before: Instant,
    written: Instant,
}

impl Writer {
    fn run(&mut self, asked: &Receiver<Ask>) {
        self.open();
        let mut count = 0;
        loop {
            match asked.recv_timeout(BATCH_EVERY) {
                Ok(Ask::Guess { client, answer }) => {
                    let _ = answer.send(self.guess(&client));
                }
                Ok(Ask::Observe(observation)) => {
                    count += 1;
                    self.waiting.insert(count, observation);
                    if self.waiting.len() > WAITING_MAX {
                        self.waiting.pop_first();
                        self.metrics.database_drops.inc();
                    }
                }
                Ok(Ask::Flush(done)) => {
                    self.write();
                    let _ = done.send(());
                    continue;
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return self.write(),
            }
            let now = clock::now();
            if now >= self.not_before && now.saturating_duration_since(self.written) >= BATCH_EVERY {
                self.write();
            }
        }
    }

    fn open(&mut self) -> bool {
        match SessionStore::open(&self.location, PATIENCE) {
            Ok(store) => {
                self.store = Some(store);
                if self.waiting.is_empty() {
                    self.well();
                }
                true
            }
            Err(error) => {
                self.ill(&error);
                false
            }
        }
    }

    fn guess(&mut self, client: &str) -> Option<LinkGuess> {
        match self.store.as_mut()?.estimate(client) {
            Ok(estimate) => estimate
                .filter(|e| e.rate.is_finite() && e.rate > 0.0 && e.latency_s.is_finite() && e.latency_s >= 0.0)
                .map(|e| LinkGuess { rate: e.rate, latency_s: e.latency_s }),
            Err(error) => {
                self.ill(&error);
                None
            }
        }
    }

    /// Writes what waits. Where nothing waits and the database was ill, it is looked at again.
    fn write(&mut self) {
        self.written = clock::now();
        let ill = self.state.lock().unwrap_or_else(PoisonError::into_inner).fault.is_some();
        if (self.waiting.is_empty() && !ill) || (self.store.is_none() && !self.open()) {
            return;
        }
        let Some(store) = &mut self.store else { return };
        let batch: Vec<Observation> = self.waiting.values().cloned().collect();
        match store.observe(&batch) {
            Ok(()) => {
                self.waiting.clear();
                self.metrics.database_writes.inc_by(batch.len() as u64);
                self.well();
            }
            Err(error) => self.ill(&error),
        }
    }

    fn well(&mut self) {
        self.pause = PAUSE_MIN;
        self.metrics.database_up.set(1);
        let fault = self.state.lock().unwrap_or_else(PoisonError::into_inner).fault.take();
        if fault.is_some() {
            tracing::info!(database = %self.location, "the database is back");
        }
    }

    fn ill(&mut self, error: &SessionStoreError) {
        let reason = reason(error);
        self.metrics.database_up.set(0);
        self.metrics.database_errors.get_or_create(&ReasonLabel { reason }).inc();
        // What a connection remembers of the file may be what is wrong.
        self.store = None;
        self.not_before = clock::now() + self.pause;
        self.pause = (self.pause * 2).min(PAUSE_MAX);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if state.fault.is_none() {
            tracing::warn!(reason, error = ?error.to_string(), "link estimates are not kept until the database is back");
        }
        state.fault = Some(format!("database: {reason}"));
    }
}

fn reason(error: &SessionStoreError) -> &'static str {
    match error {
        SessionStoreError::WithoutPostgres { .. } => "not_built",
        SessionStoreError::Newer { .. } => "newer",
        SessionStoreError::Locked { .. } => "locked",
        SessionStoreError::Gone { .. } => "gone",
        SessionStoreError::Full { .. } => "full",
        SessionStoreError::ReadOnly { .. } => "read_only",
        SessionStoreError::Damaged { .. } => "damaged",
        SessionStoreError::NoAnswer { .. } => "no_answer",
        SessionStoreError::Database { .. } => "refused",
        SessionStoreError::Migration { .. } => "migration",
    }
}
