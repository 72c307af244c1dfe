//! One client: flies a path in real time and does what the server says.
//!
//! At every tick (60 Hz) what has happened until then is reported in one frame, in the order of the simulator's tick: first
//! and last bytes by their times, what can be shown, bytes received, the announced path, the view. What the server answers
//! is obeyed when it comes. A tick that has passed before it could be played is left out.
//!
//! A session that is drawn ([`fly_drawn`]) has its camera from an [`Exchange`], and puts there what comes.

mod drawn;

pub use drawn::{Drawn, fly_drawn};

use crate::camera::{Cameraman, Eye};
use crate::clock::Clock;
use crate::connection::{Address, Connection, Incoming};
use crate::events::{Happening, Log, What};
use crate::exchange::{Body, Exchange};
use crate::fetch::{Http, Requests, Step, TransferEvent};
use crate::modelled::ModelledRequests;
use crate::residency::{Admission, Residency};
use crate::statistics::Histogram;
use crate::summary::{SCHEMA_VERSION, Summary};
use foresight_scheduler::view::View;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{TICKS_PER_SECOND, tick_time};
use foresight_traces::link::LinkTrace;
use foresight_wire::message::{
    ClientMessage, Error as ServerError, ErrorCode, Fetch, Hello, Mode, Progress, Refinement, ServerMessage, VERSION,
    Welcome,
};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// A server that says nothing for so long, although views are sent, is gone.
const SILENCE_NS: u64 = 15_000_000_000;
/// What a lost session had requested is kept for so long, in case that the next asks for it.
const LEFT_OVER_NS: u64 = 3_000_000_000;
/// How long the first connection may take.
const PATIENCE_NS: u64 = 20_000_000_000;
/// How soon it is noticed that nobody draws any more, while there is no session.
const LEAVING_NS: u64 = 100_000_000;
/// Errors of the server that are kept.
const ERRORS_MAX: usize = 20;
/// Kinds of failures that are told apart.
const KINDS_MAX: usize = 32;
/// Frames whose answers are waited for; older ones are not counted.
const UNANSWERED_MAX: usize = 1024;

/// What every session of a program has in common.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Where the server is.
    pub address: Address,
    /// The world's name there.
    pub world: String,
    /// Whether its contents are files; otherwise they are made up, and only their lengths are checked.
    pub has_files: bool,
    /// Memory for everything, bytes.
    pub memory: u64,
    /// Policy with its options; the server's default if `None`.
    pub policy: Option<String>,
    /// When children may be drawn.
    pub refinement: Refinement,
    /// What the server's answers are for.
    pub mode: Mode,
    /// Name under which the server keeps link estimates.
    pub client: Option<String>,
    /// Decoding, uploading, announcing.
    pub settings: ClientSettings,
    /// Ticks from a view that is sent to the next, at least 1.
    pub ticks_per_view: u64,
    /// Requests are carried by this link, modelled; over HTTP if `None`.
    pub modelled: Option<LinkTrace>,
}

/// Why a flight could not be made.
#[derive(Debug, thiserror::Error)]
pub enum FlightError {
    /// No session was to be had.
    #[error("no session: {0}")]
    NoSession(String),
    /// The server has refused the session for good.
    #[error("the server refuses the session: {0}")]
    Refused(String),
    /// The world on the server is not the one that is drawn.
    #[error("the server's world has {found} representations; expected the {expected} of --world")]
    OtherWorld {
        /// Of the server's.
        found: usize,
        /// Of the one that is drawn.
        expected: usize,
    },
    /// The log cannot be written.
    #[error("the log of events: {0}")]
    Log(#[from] std::io::Error),
}

/// How a session is ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leave {
    /// With a `bye`.
    Bye,
    /// Without a word.
    Vanish,
}

/// What is told once a second.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Seconds flown, and in all.
    pub at_s: (f64, f64),
    /// Bytes received.
    pub bytes: u64,
    /// Memory in use, bytes.
    pub memory: u64,
    /// The server's latest estimate of the quality.
    pub quality: Option<f64>,
    /// Whether a session is there.
    pub connected: bool,
}

/// One flight.
pub struct Flight<'a> {
    /// What it has in common with others.
    pub plan: &'a Plan,
    /// The camera at every tick; at least one.
    pub views: &'a [View],
    /// The view with which it begins.
    pub offset: usize,
    /// Its length; beyond the last view it goes on from the first.
    pub ticks: usize,
    /// How it ends.
    pub leave: Leave,
    /// Where what happens is written.
    pub log: Option<Log>,
    /// The program's clock.
    pub clock: Clock,
    /// Answers are timed from then on, ns by the program's clock.
    pub timed_from_ns: u64,
    /// HTTP.
    pub http: Http,
}

enum Transport {
    Http(Requests),
    Modelled(Box<ModelledRequests>),
}

struct Session<'a> {
    plan: &'a Plan,
    camera: Eye<'a>,
    /// Where contents go, if they are drawn.
    exchange: Option<&'a Exchange>,
    /// What is on its way, if it is drawn.
    wanted: BTreeMap<u32, Fetch>,
    /// How many the server's world must have.
    representations: Option<usize>,
    /// Why there is no connection.
    away: String,
    clock: Clock,
    timed_from_ns: u64,
    connection: Connection,
    welcome: Option<Welcome>,
    /// The session that is asked to go on.
    resume: Option<String>,
    /// The first tick, by the program's clock.
    zero_ns: u64,
    /// When the server's session began, and what had been received by then.
    epoch_ns: u64,
    epoch_bytes: u64,
    /// The same of the latest `hello`.
    greeted_ns: u64,
    greeted_bytes: u64,
    heard_ns: u64,
    strangers: bool,
    transport: Transport,
    /// Steps that came after the latest tick.
    pending: VecDeque<TransferEvent>,
    residency: Residency,
    resident: BTreeSet<u32>,
    /// Views that were sent, by the session's time, and when.
    unanswered: VecDeque<(u64, u64)>,
    latencies: Histogram,
    quality: (f64, u64, Option<f64>),
    log: Option<Log>,
    failed: BTreeMap<String, u64>,
    failure: Option<String>,
    /// Why the server waits.
    waiting: Option<String>,
    summary: Summary,
}

/// Flies it. Once a second `report` is told how it goes.
///
/// # Errors
/// When the server cannot be reached in the beginning, or refuses the session for good.
pub async fn fly(flight: Flight<'_>, mut report: impl FnMut(&Report)) -> Result<(Summary, Histogram), FlightError> {
    let Flight { plan, views, offset, ticks, leave, log, clock, timed_from_ns, http } = flight;
    let eye = Eye::Path(Cameraman::new(views, offset, plan.settings.announce_s));
    let mut session = Session { log, timed_from_ns, ..Session::new(plan, eye, None, clock, http) };
    session.begin().await?;
    let mut tick = 0;
    while tick < ticks {
        let due = session.zero_ns + tick_time(tick as u64).0;
        tokio::select! {
            biased;
            incoming = session.connection.next() => session.hear(incoming)?,
            () = session.clock.sleep_until(due) => {
                session.tick(tick)?;
                if (tick as u64).is_multiple_of(TICKS_PER_SECOND) {
                    report(&session.report(tick, ticks));
                }
                tick = session.next_tick(tick);
            }
        }
    }
    session.finish(ticks, leave).await
}

impl<'a> Session<'a> {
    fn new(plan: &'a Plan, camera: Eye<'a>, exchange: Option<&'a Exchange>, clock: Clock, http: Http) -> Session<'a> {
        let transport = match &plan.modelled {
            Some(link) => Transport::Modelled(Box::new(ModelledRequests::new(link))),
            None => Transport::Http(Requests::new(http, plan.has_files, exchange.is_some(), clock)),
        };
        Session {
            plan,
            camera,
            exchange,
            wanted: BTreeMap::new(),
            representations: None,
            away: String::new(),
            clock,
            timed_from_ns: 0,
            connection: Connection::new(plan.address.clone(), clock),
            welcome: None,
            resume: None,
            zero_ns: 0,
            epoch_ns: 0,
            epoch_bytes: 0,
            greeted_ns: 0,
            greeted_bytes: 0,
            heard_ns: 0,
            strangers: false,
            transport,
            pending: VecDeque::new(),
            residency: match exchange {
                Some(_) => Residency::drawn(plan.memory),
                None => Residency::new(plan.memory, plan.settings),
            },
            resident: BTreeSet::new(),
            unanswered: VecDeque::new(),
            latencies: Histogram::default(),
            quality: (0.0, 0, None),
            log: None,
            failed: BTreeMap::new(),
            failure: None,
            waiting: None,
            summary: Summary::default(),
        }
    }

    /// Waits for the first welcome; the flight begins there.
    async fn begin(&mut self) -> Result<(), FlightError> {
        let until = self.clock.now_ns() + PATIENCE_NS;
        let mut why = "the server does not answer".to_owned();
        while self.welcome.is_none() && !self.exchange.is_some_and(Exchange::is_left) {
            tokio::select! {
                incoming = self.connection.next() => {
                    if let Incoming::Lost(reason) = &incoming {
                        why.clone_from(reason);
                    }
                    self.hear(incoming)?;
                }
                () = self.clock.sleep_until(until) => return Err(FlightError::NoSession(why)),
                () = self.clock.sleep_until(self.clock.now_ns() + LEAVING_NS), if self.exchange.is_some() => {}
            }
        }
        self.summary.reconnections = 0;
        self.zero_ns = self.clock.now_ns();
        (self.epoch_ns, self.greeted_ns, self.heard_ns) = (0, 0, 0);
        Ok(())
    }

    /// Now, ns since the first tick.
    fn now_ns(&self) -> u64 {
        self.clock.now_ns().saturating_sub(self.zero_ns)
    }

    /// The tick to play after this one.
    fn next_tick(&mut self, tick: usize) -> usize {
        let passed = (self.now_ns() as u128 * u128::from(TICKS_PER_SECOND) / 1_000_000_000) as usize;
        let next = (tick + 1).max(passed);
        self.summary.ticks_skipped += (next - tick - 1) as u64;
        next
    }

    fn hear(&mut self, incoming: Incoming) -> Result<(), FlightError> {
        match incoming {
            Incoming::Opened => {
                let hello = Hello {
                    version: VERSION,
                    world: self.plan.world.clone(),
                    memory_bytes: self.plan.memory,
                    refinement: self.plan.refinement,
                    policy: self.plan.policy.clone(),
                    mode: self.plan.mode,
                    resume: self.resume.clone(),
                    resident: self.residency.greet(),
                    client: self.plan.client.clone(),
                    link: None,
                };
                self.greeted_ns = self.now_ns();
                self.heard_ns = self.greeted_ns;
                self.greeted_bytes = self.bytes().0;
                self.connection.send(&[ClientMessage::Hello(Box::new(hello))]);
            }
            Incoming::Lost(why) => {
                self.away = why;
                self.welcome = None;
                self.unanswered.clear();
            }
            Incoming::Messages { at_ns, messages } => {
                self.heard_ns = at_ns.saturating_sub(self.zero_ns);
                for message in messages {
                    if let ServerMessage::Estimates(estimates) = &message {
                        self.answered(estimates.t_ns, at_ns);
                    }
                    self.obey(message)?;
                }
                self.account()?;
            }
        }
        Ok(())
    }

    /// The server has decided on the view of this time. It says so of one view a second.
    fn answered(&mut self, t_ns: u64, at_ns: u64) {
        while let Some((_, sent)) = self.unanswered.pop_front_if(|(view, _)| *view <= t_ns) {
            let is_it = self.unanswered.front().is_none_or(|(next, _)| *next > t_ns);
            if is_it && sent >= self.timed_from_ns {
                self.latencies.add(at_ns.saturating_sub(sent));
            }
        }
    }

    fn obey(&mut self, message: ServerMessage) -> Result<(), FlightError> {
        let now = self.now_ns();
        match message {
            ServerMessage::Welcome(welcome) => {
                let (found, expected) =
                    (usize::try_from(welcome.representations).unwrap_or(usize::MAX), self.representations);
                if let Some(expected) = expected.filter(|&expected| expected != found) {
                    return Err(FlightError::OtherWorld { found, expected });
                }
                self.enter(*welcome);
            }
            ServerMessage::Fetch(fetch) => {
                self.waiting = None;
                self.fetch(&fetch, now);
            }
            ServerMessage::Cancel { rep } => {
                self.summary.cancelled += 1;
                self.residency.cancel(rep, now);
                self.abort();
            }
            ServerMessage::Discard { rep } => {
                self.residency.discard(rep, now);
                self.abort();
            }
            ServerMessage::Estimates(estimates) => {
                self.summary.link = Some((estimates.rate, estimates.latency_s));
                self.quality.2 = estimates.quality;
                if let Some(quality) = estimates.quality {
                    self.quality.0 += quality;
                    self.quality.1 += 1;
                }
            }
            ServerMessage::Wait { because, .. } => self.waiting = because,
            // This client has no rules of its own to fall back upon.
            ServerMessage::Switch { .. } => {}
            ServerMessage::Error(error) => self.wrong(error)?,
        }
        Ok(())
    }

    fn enter(&mut self, welcome: Welcome) {
        if self.resume.is_some() {
            self.summary.reconnections += 1;
            self.summary.resumed += u64::from(welcome.resumed);
        }
        if !welcome.resumed {
            (self.epoch_ns, self.epoch_bytes) = (self.greeted_ns, self.greeted_bytes);
            self.camera.forget_announced();
        } else {
            self.residency.resumed(self.now_ns());
        }
        self.strangers = true;
        self.resume = Some(welcome.session.clone());
        self.connection.settled();
        self.summary.world.clone_from(&welcome.world);
        self.summary.identity.clone_from(&welcome.identity);
        self.summary.policy.clone_from(&welcome.policy);
        self.welcome = Some(welcome);
    }

    fn wrong(&mut self, error: ServerError) -> Result<(), FlightError> {
        if self.summary.errors.len() < ERRORS_MAX {
            self.summary.errors.push(error.message.clone());
        }
        if !error.fatal {
            return Ok(());
        }
        // A session that is new to the server, or a server that has too much to do, may be tried again.
        if self.welcome.is_none() && matches!(error.code, ErrorCode::Version | ErrorCode::World | ErrorCode::Value) {
            return Err(FlightError::Refused(error.message));
        }
        self.give_up_connection(error.message);
        Ok(())
    }

    fn give_up_connection(&mut self, why: String) {
        self.away = why;
        self.welcome = None;
        self.unanswered.clear();
        self.connection.lose();
    }

    fn fetch(&mut self, fetch: &Fetch, now: u64) {
        let Some(welcome) = self.welcome.clone() else { return };
        if self.resident.contains(&fetch.rep) {
            self.summary.fetched_while_resident += 1;
        }
        let admission = self.residency.fetch(fetch, now);
        self.abort();
        if admission != Admission::Start {
            return;
        }
        match &mut self.transport {
            Transport::Modelled(requests) => requests.start(fetch.rep, fetch.wire_bytes, now),
            Transport::Http(requests) => {
                if self.exchange.is_some() {
                    self.wanted.insert(fetch.rep, fetch.clone());
                }
                let url = format!("{}{}/{}", self.plan.address.origin, welcome.base.trim_end_matches('/'), fetch.uri);
                requests.start(fetch.rep, &url, &welcome.session, fetch.urgency, fetch.wire_bytes);
            }
        }
    }

    /// Aborts what is to be aborted.
    fn abort(&mut self) {
        let now = self.now_ns();
        for rep in self.residency.take_aborted() {
            self.pending.retain(|event| event.rep != rep);
            match &mut self.transport {
                Transport::Http(requests) => requests.abort(rep),
                Transport::Modelled(requests) => requests.abort(rep, now),
            }
        }
    }

    fn bytes(&self) -> (u64, u64) {
        match &self.transport {
            Transport::Http(requests) => requests.bytes(),
            Transport::Modelled(requests) => requests.bytes(),
        }
    }

    /// First and last bytes until `now`, in order of time; later ones wait for the next tick.
    fn receive(&mut self, now: u64) {
        let zero = self.zero_ns;
        match &mut self.transport {
            Transport::Http(requests) => {
                let events = std::iter::from_fn(|| requests.poll());
                let relative = events.map(|event| TransferEvent { at_ns: event.at_ns.saturating_sub(zero), ..event });
                self.pending.extend(relative);
            }
            Transport::Modelled(requests) => {
                requests.advance(now);
                self.pending.extend(std::iter::from_fn(|| requests.poll()));
            }
        }
        self.pending.make_contiguous().sort_by_key(|event| event.at_ns);
        while let Some(event) = self.pending.pop_front_if(|event| event.at_ns <= now) {
            match event.step {
                Step::Responded => self.residency.responded(event.rep, event.at_ns),
                Step::Ended(Ok(body)) => {
                    self.residency.arrived(event.rep, event.at_ns);
                    if let Some(exchange) = self.exchange.filter(|_| self.residency.is_arrived(event.rep)) {
                        exchange.give(event.rep, Body::Bytes(body));
                    }
                }
                Step::Ended(Err(error)) => self.residency.fail(event.rep, event.at_ns, error.to_string()),
            }
            self.abort();
        }
    }

    fn tick(&mut self, tick: usize) -> Result<(), FlightError> {
        let now = tick_time(tick as u64).0;
        let late_ms = self.now_ns().saturating_sub(now) as f64 / 1e6;
        self.summary.tick_late_ms_max = self.summary.tick_late_ms_max.max(late_ms);
        self.receive(now);
        self.hear_screen(now);
        self.residency.show(now);
        if self.strangers && now.saturating_sub(self.greeted_ns) > LEFT_OVER_NS && self.welcome.is_some() {
            self.strangers = false;
            self.residency.drop_strangers(now);
            self.abort();
        }
        if !(tick as u64).is_multiple_of(self.plan.ticks_per_view) {
            return Ok(());
        }
        let mut messages = self.account()?;
        if self.welcome.is_none() || !self.connection.is_open() {
            return Ok(());
        }
        if self.now_ns().saturating_sub(self.heard_ns) > SILENCE_NS {
            self.give_up_connection("the server is silent".to_owned());
            return Ok(());
        }
        let t_ns = now.saturating_sub(self.epoch_ns);
        let (total, in_flight_bytes) = self.bytes();
        let total_bytes = total.saturating_sub(self.epoch_bytes);
        let in_flight_bytes = in_flight_bytes.min(total_bytes);
        messages.push(ClientMessage::Progress(Progress { t_ns, total_bytes, in_flight_bytes }));
        messages.extend(self.camera.announce(tick, self.epoch_ns));
        messages.extend(self.camera.look(tick, t_ns));
        let sent = self.clock.now_ns();
        if self.connection.send(&messages) {
            self.summary.views += 1;
            self.unanswered.push_back((t_ns, sent));
            if self.unanswered.len() > UNANSWERED_MAX {
                self.unanswered.pop_front();
            }
        } else {
            self.welcome = None;
            self.unanswered.clear();
        }
        Ok(())
    }

    /// Counts and logs what has happened, and answers what the server is to be told.
    fn account(&mut self) -> Result<Vec<ClientMessage>, FlightError> {
        let mut happened = self.residency.take_happened();
        happened.sort_by_key(|h| h.at_ns);
        for h in &happened {
            self.count(h);
            if let Some(exchange) = self.exchange {
                if !matches!(h.what, What::Requested | What::Responded) {
                    self.wanted.remove(&h.rep);
                }
                if matches!(h.what, What::Cancelled | What::Discarded | What::Dropped | What::Failed { .. }) {
                    exchange.take_back(h.rep);
                }
            }
            if let Some(log) = &mut self.log {
                log.write(h)?;
            }
        }
        Ok(happened.iter().filter_map(|h| h.message(self.epoch_ns)).collect())
    }

    fn count(&mut self, happening: &Happening) {
        match &happening.what {
            What::Requested => self.summary.requests += 1,
            What::Completed => {
                self.summary.completed += 1;
                self.resident.insert(happening.rep);
            }
            What::Failed { reason } => {
                self.failure = Some(reason.clone());
                let kind = kind(reason);
                if self.failed.len() < KINDS_MAX || self.failed.contains_key(&kind) {
                    *self.failed.entry(kind).or_default() += 1;
                } else {
                    *self.failed.entry("other".to_owned()).or_default() += 1;
                }
            }
            What::Discarded => {
                self.summary.discarded += 1;
                self.resident.remove(&happening.rep);
            }
            What::Dropped => {
                self.summary.dropped += 1;
                self.resident.remove(&happening.rep);
            }
            What::Cancelled => {
                self.resident.remove(&happening.rep);
            }
            What::Responded | What::Arrived => {}
        }
    }

    fn report(&self, tick: usize, ticks: usize) -> Report {
        Report {
            at_s: (tick_time(tick as u64).secs(), tick_time(ticks as u64).secs()),
            bytes: self.bytes().0,
            memory: self.residency.used_bytes(),
            quality: self.quality.2,
            connected: self.welcome.is_some(),
        }
    }

    async fn finish(mut self, ticks: usize, leave: Leave) -> Result<(Summary, Histogram), FlightError> {
        self.account()?;
        if let Some(log) = &mut self.log {
            log.flush()?;
        }
        if leave == Leave::Bye && self.welcome.is_some() {
            self.connection.send(&[ClientMessage::Bye]);
            self.connection.finish().await;
        }
        let bytes_received = match &self.transport {
            Transport::Http(requests) => requests.bytes(),
            Transport::Modelled(requests) => requests.bytes(),
        };
        let summary = Summary {
            schema_version: SCHEMA_VERSION,
            session: self.resume.unwrap_or_default(),
            duration_s: tick_time(ticks as u64).secs(),
            bytes_received: bytes_received.0,
            failed: self.failed,
            memory_budget: self.plan.memory,
            memory_max: self.residency.used_bytes_max(),
            view_to_decision_ms: self.latencies.percentiles(),
            mean_quality: (self.quality.1 > 0).then(|| self.quality.0 / self.quality.1 as f64),
            ..self.summary
        };
        Ok((summary, self.latencies))
    }
}

/// A reason without its numbers, so that failures of a kind are counted together.
fn kind(reason: &str) -> String {
    let mut kind = String::new();
    for c in reason.chars().take(100) {
        if !c.is_ascii_digit() {
            kind.push(c);
        } else if !kind.ends_with('#') {
            kind.push('#');
        }
    }
    kind
}
