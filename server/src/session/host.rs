//! Which sessions there are, who may open one, and the switch that all of them obey.

use super::estimates::Estimates;
use super::mailbox::{Handle, Item, Thread};
use super::metrics::SessionMetrics;
use super::outgoing::Outgoing;
use super::recorder::Recorder;
use super::worker::Worker;
use crate::clock;
use crate::config::Config;
use crate::http::shaping::Links;
use crate::http::state::AppState;
use crate::http::worlds::HostedWorld;
use foresight_scheduler::lod_tree::RepId;
use foresight_wire::message::{Error, ErrorCode, Hello};
use foresight_wire::session::{SessionLimits, SessionWorld};
use std::collections::{BTreeMap, BTreeSet};
use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Frames of a client that may wait for its session, in units of the largest.
const ROOM_FRAMES: usize = 2;

/// Hosts sessions: connections hand them over, decision threads work on them.
pub struct Host {
    pub(super) config: Config,
    pub(super) limits: SessionLimits,
    pub(super) metrics: SessionMetrics,
    pub(super) recorder: Option<Recorder>,
    pub(super) estimates: Option<Estimates>,
    worlds: BTreeMap<&'static str, (&'static HostedWorld, SessionWorld<'static>)>,
    threads: Vec<Arc<Thread>>,
    workers: Mutex<Vec<JoinHandle<()>>>,
    sessions: Mutex<Sessions>,
    switch: Mutex<Switch>,
    stopping: AtomicBool,
    /// Connections by WebSocket.
    sockets: AtomicUsize,
    http: Arc<AppState>,
}

#[derive(Debug, Default)]
struct Sessions {
    by_id: BTreeMap<String, Arc<Handle>>,
    /// How many each address has.
    of_address: BTreeMap<IpAddr, usize>,
    /// Connections that have not said hello, of each address; limited like sessions, but apart from them: those who come
    /// back to a session find the way in also when no other is to be had.
    strangers: BTreeMap<IpAddr, usize>,
    begun: u64,
}

/// Which clients are told what to do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Switch {
    /// Any at all.
    pub(super) driving: bool,
    /// Not those of these worlds.
    pub(super) not_driven: BTreeSet<String>,
}

/// Why sessions cannot be hosted.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// A world that is to be left alone is not there.
    #[error("not_driven names the world `{0}`, which is not served; expected one of those given by --world")]
    NoWorld(String),
    /// The folder for recordings cannot be used.
    #[error("recordings: {}: {source}", .folder.display())]
    Recordings {
        /// The folder.
        folder: std::path::PathBuf,
        /// Why not.
        #[source]
        source: std::io::Error,
    },
    /// No thread can be started.
    #[error("a thread cannot be started: {0}")]
    Thread(#[from] std::io::Error),
}

fn refusal(code: ErrorCode, message: impl Into<String>) -> Error {
    Error { code, message: message.into(), fatal: true }
}

/// 128 bits from the operating system, hexadecimal: what cannot be guessed is all that it takes to resume a session.
fn new_id() -> Option<String> {
    let mut bits = [0_u8; 16];
    getrandom::fill(&mut bits).ok()?;
    Some(bits.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// The first messages that a connection may send before it has a session, and the limit that it counts against.
#[derive(Debug)]
pub(super) struct Stranger {
    host: Arc<Host>,
    address: IpAddr,
}

/// A WebSocket.
pub(super) struct Socket(Arc<Host>);

impl Drop for Socket {
    fn drop(&mut self) {
        self.0.sockets.fetch_sub(1, Ordering::Relaxed);
    }
}

impl std::fmt::Debug for Host {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Host").field("config", &self.config).finish_non_exhaustive()
    }
}

impl Drop for Stranger {
    fn drop(&mut self) {
        leave(&mut self.host.sessions().strangers, self.address);
    }
}

/// One less of an address.
fn leave(of_address: &mut BTreeMap<IpAddr, usize>, address: IpAddr) {
    if let Some(count) = of_address.get_mut(&address) {
        *count -= 1;
        if *count == 0 {
            of_address.remove(&address);
        }
    }
}

impl Host {
    /// Starts the decision threads.
    ///
    /// # Errors
    /// A configuration that does not fit the worlds, a folder that cannot be used, no threads.
    pub fn start(config: Config, http: Arc<AppState>, metrics: SessionMetrics) -> Result<Arc<Host>, HostError> {
        let worlds = &http.worlds;
        let missing = config.not_driven.iter().find(|name| worlds.get(name).is_none());
        if let Some(name) = missing {
            return Err(HostError::NoWorld(name.clone()));
        }
        let limits = SessionLimits {
            memory_bytes_max: config.client_memory_max.0,
            policy: config.policy.0.clone(),
            ..SessionLimits::default()
        };
        let recorder = match &config.record {
            Some(folder) => Some(
                Recorder::start(folder, config.record_bytes_max.0, metrics.clone())
                    .map_err(|source| HostError::Recordings { folder: folder.clone(), source })?,
            ),
            None => None,
        };
        let estimates =
            config.database.clone().map(|location| Estimates::start(location, metrics.clone())).transpose()?;
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads: Vec<Arc<Thread>> =
            (0..config.decision_threads(cores)).map(|_| Arc::new(Thread::new(metrics.waiting.clone()))).collect();
        metrics.driving.set(i64::from(config.driving));
        let host = Arc::new(Host {
            limits,
            recorder,
            estimates,
            worlds: http.worlds.iter().map(|world| (world.name(), (world, session_world(world)))).collect(),
            threads,
            workers: Mutex::default(),
            sessions: Mutex::default(),
            switch: Mutex::new(Switch {
                driving: config.driving,
                not_driven: config.not_driven.iter().cloned().collect(),
            }),
            stopping: AtomicBool::new(false),
            sockets: AtomicUsize::new(0),
            http,
            metrics,
            config,
        });
        for (number, thread) in host.threads.iter().enumerate() {
            let mut worker = Worker::new(host.clone(), thread.clone());
            let named = std::thread::Builder::new().name(format!("decide-{number}"));
            let worker = named.spawn(move || worker.run())?;
            host.workers.lock().unwrap_or_else(PoisonError::into_inner).push(worker);
        }
        Ok(host)
    }

    fn sessions(&self) -> MutexGuard<'_, Sessions> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Admits a connection that has not said hello yet.
    pub(super) fn stranger(self: &Arc<Host>, address: IpAddr) -> Result<Stranger, Error> {
        self.must_run()?;
        let mut sessions = self.sessions();
        self.must_have_room(sessions.strangers.values().sum(), &sessions.strangers, address)?;
        *sessions.strangers.entry(address).or_default() += 1;
        Ok(Stranger { host: self.clone(), address })
    }

    fn must_run(&self) -> Result<(), Error> {
        if self.stopping.load(Ordering::Relaxed) {
            self.metrics.refused("shutdown");
            return Err(refusal(ErrorCode::Shutdown, "the server is shutting down"));
        }
        Ok(())
    }

    fn must_have_room(&self, all: usize, of_address: &BTreeMap<IpAddr, usize>, address: IpAddr) -> Result<(), Error> {
        let most = self.config.sessions_max.count();
        if all >= most {
            self.metrics.refused("sessions");
            return Err(refusal(
                ErrorCode::Limit,
                format!("{most} sessions are open; expected fewer: try again later"),
            ));
        }
        let most = self.config.sessions_per_address_max.count();
        if of_address.get(&address).copied().unwrap_or(0) >= most {
            self.metrics.refused("sessions_of_address");
            let message = format!("{most} sessions of this address are open; expected fewer: try again later");
            return Err(refusal(ErrorCode::Limit, message));
        }
        Ok(())
    }

    /// The session that the hello asks for, resumed or begun. The first answer comes by `outgoing`.
    pub(super) async fn enter(
        self: &Arc<Host>,
        stranger: Stranger,
        mut hello: Box<Hello>,
        outgoing: Arc<Outgoing>,
    ) -> Result<Arc<Handle>, Error> {
        let address = stranger.address;
        if let Some(session) =
            hello.resume.as_ref().and_then(|id| self.find(id)).filter(|s| s.world.name() == hello.world)
        {
            let at = clock::now();
            if session.post(Item::Resume { at, hello: hello.clone(), outgoing: outgoing.clone() }) {
                return Ok(session);
            }
        }
        let Some((world, _)) = self.worlds.get(hello.world.as_str()) else {
            self.metrics.refused("world");
            let names: Vec<&str> = self.worlds.keys().copied().collect();
            let message =
                format!("there is no world {:?}; expected one of {}", clipped(&hello.world), names.join(", "));
            return Err(refusal(ErrorCode::World, message));
        };
        if let (None, Some(client), Some(estimates)) = (&hello.link, &hello.client, &self.estimates) {
            hello.link = estimates.guess(client).await;
        }
        let id = new_id().ok_or_else(|| refusal(ErrorCode::Internal, "the system gives no random numbers"))?;
        self.must_run()?;
        let mut sessions = self.sessions();
        self.must_have_room(sessions.by_id.len(), &sessions.of_address, address)?;
        sessions.begun += 1;
        let thread = self.threads.iter().min_by_key(|thread| Arc::strong_count(thread)).unwrap_or(&self.threads[0]);
        let room = ROOM_FRAMES * self.config.message_bytes_max.length();
        let begun = (id.clone(), sessions.begun);
        let session = Arc::new(Handle::new(begun, world, address, clock::now(), thread.clone(), room));
        *sessions.of_address.entry(address).or_default() += 1;
        sessions.by_id.insert(id, session.clone());
        drop(sessions);
        if let Some(links) = self.links() {
            links.open(&session.id);
        }
        self.metrics.opened.inc();
        self.metrics.active.inc();
        session.post(Item::Open { hello, outgoing });
        Ok(session)
    }

    /// The session of an id.
    pub(super) fn find(&self, id: &str) -> Option<Arc<Handle>> {
        self.sessions().by_id.get(id).cloned()
    }

    /// The links by which sessions' responses are shaped.
    pub(super) fn links(&self) -> Option<&Links> {
        self.http.links.as_ref()
    }

    /// Counts a WebSocket until what this gives is dropped.
    pub(super) fn socket(self: &Arc<Host>) -> Socket {
        self.sockets.fetch_add(1, Ordering::Relaxed);
        Socket(self.clone())
    }

    /// The world of a session.
    pub(super) fn world_of(&self, session: &Handle) -> Option<SessionWorld<'static>> {
        self.worlds.get(session.world.name()).map(|(_, world)| *world)
    }

    /// A session is over.
    pub(super) fn forget(&self, session: &Handle) {
        session.close();
        let mut sessions = self.sessions();
        if sessions.by_id.remove(&session.id).is_some() {
            leave(&mut sessions.of_address, session.address);
            drop(sessions);
            self.metrics.active.dec();
            if let Some(links) = self.links() {
                links.close(&session.id);
            }
        }
    }

    /// Whether clients of a world are told what to do.
    pub(super) fn drives(&self, world: &str) -> bool {
        let switch = self.switch();
        switch.driving && !switch.not_driven.contains(world)
    }

    fn switch(&self) -> MutexGuard<'_, Switch> {
        self.switch.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How the switch stands.
    pub(super) fn switch_state(&self) -> Switch {
        self.switch().clone()
    }

    /// Moves the switch, for a world or for all, and tells every session that it concerns. False if there is no such world.
    pub(super) fn set_driving(&self, driving: bool, world: Option<&str>) -> bool {
        match world {
            Some(name) if !self.worlds.contains_key(name) => return false,
            Some(name) if driving => {
                self.switch().not_driven.remove(name);
            }
            Some(name) => {
                self.switch().not_driven.insert(name.to_owned());
            }
            None => {
                self.switch().driving = driving;
                self.metrics.driving.set(i64::from(driving));
            }
        }
        tracing::warn!(driving, world, "the switch was moved");
        let all: Vec<Arc<Handle>> = self.sessions().by_id.values().cloned().collect();
        for session in all.iter().filter(|session| world.is_none_or(|world| session.world.name() == world)) {
            session.post(Item::Driving(self.drives(session.world.name())));
        }
        true
    }

    /// What is not as it should be, though the server goes on.
    pub fn degraded(&self) -> Option<String> {
        self.estimates.as_ref().and_then(Estimates::fault)
    }

    /// Tells all sessions that the server is going, closes recordings and writes estimates, within a time; false if that
    /// was not enough.
    pub async fn stop(&self, within: Duration) -> bool {
        self.stopping.store(true, Ordering::Relaxed);
        let all: Vec<Arc<Handle>> = self.sessions().by_id.values().cloned().collect();
        for session in &all {
            session.post(Item::End("shutdown"));
        }
        let closing = async {
            while !self.sessions().by_id.is_empty() || self.sockets.load(Ordering::Relaxed) > 0 {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            self.threads.iter().for_each(|thread| thread.stop());
            if let Some(recorder) = &self.recorder {
                recorder.flush().await;
            }
            if let Some(estimates) = &self.estimates {
                estimates.flush().await;
            }
        };
        tokio::time::timeout(within, closing).await.is_ok()
    }
}

/// A session's view of a world; lives as long as the process, like the world.
fn session_world(world: &'static HostedWorld) -> SessionWorld<'static> {
    let uri: &'static (dyn Fn(RepId) -> String + Sync) = Box::leak(Box::new(move |rep| world.uri(rep)));
    SessionWorld {
        name: world.name(),
        identity: world.identity(),
        base: &world.facts.base,
        tree: &world.world.tree,
        uri,
        up: world.world.up,
    }
}

/// What a client said, short enough to be said again.
fn clipped(text: &str) -> String {
    text.chars().take(64).collect()
}
