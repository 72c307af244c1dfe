//! A session on its decision thread.

use super::estimates::CLIENT_BYTES_MAX;
use super::host::Host;
use super::ledger::Ledger;
use super::mailbox::{Frame, Handle, Item};
use super::outgoing::Outgoing;
use super::recorder::Recording;
use crate::clock;
use foresight_index::sessions::Observation;
use foresight_wire::message::{ClientMessage, Error, ErrorCode, Hello, ServerMessage};
use foresight_wire::recording::{Entry, Header, Input, Writer};
use foresight_wire::session::Session;
use std::borrow::Cow;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Between two looks at a session's memory and link.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Between two observations of a link.
const OBSERVE_EVERY: Duration = Duration::from_secs(30);

/// A session on its decision thread.
pub(super) struct Hosted {
    pub(super) handle: Arc<Handle>,
    session: Session<'static>,
    outgoing: Option<Arc<Outgoing>>,
    /// Since when nobody reads the answers.
    absent: Option<Instant>,
    recording: Option<Recording>,
    ledger: Ledger,
    client: Option<String>,
    observed: Instant,
    looked: Instant,
    memory: usize,
    /// A view has come: its link's time has begun.
    viewed: bool,
    frames: u64,
    decisions: u64,
    longest: Duration,
}

/// A session is over, and why.
#[derive(Debug)]
pub(super) struct Over {
    pub(super) reason: &'static str,
    pub(super) error: Option<Error>,
}

impl Over {
    fn because(reason: &'static str) -> Over {
        Over { reason, error: None }
    }
}

impl Hosted {
    /// Opens a session.
    ///
    /// # Errors
    /// The answer to a hello that is refused has been given.
    pub(super) fn open(
        host: &Host,
        handle: &Arc<Handle>,
        hello: &Hello,
        outgoing: Arc<Outgoing>,
    ) -> Result<Hosted, Over> {
        let opened = host.world_of(handle).map(|world| Session::open(handle.id.clone(), world, &host.limits, hello));
        let now = clock::now();
        let (session, answers) = match opened {
            Some(Ok(opened)) => opened,
            Some(Err(error)) => {
                host.metrics.refused("hello");
                outgoing.close("hello", Some(error));
                return Err(Over::because("hello"));
            }
            None => return Err(Over::because("world")),
        };
        let mut hosted = Hosted {
            handle: handle.clone(),
            session,
            outgoing: Some(outgoing),
            absent: None,
            recording: begin_recording(host, handle, hello),
            ledger: Ledger::new(host.metrics.clone()),
            client: hello.client.clone().filter(|client| client.len() <= CLIENT_BYTES_MAX),
            observed: now,
            looked: now,
            memory: 0,
            viewed: false,
            frames: 0,
            decisions: 0,
            longest: Duration::ZERO,
        };
        host.metrics.connected.inc();
        tracing::info!(
            session = handle.short(), world = handle.world.name(), address = %handle.address, client = ?hello.client,
            mode = ?hello.mode, policy = ?hosted.session.policy(), memory_bytes = hello.memory_bytes,
            resident = hello.resident.len(), "session begins"
        );
        hosted.answer(0, Input::Open, answers, None);
        if !host.drives(handle.world.name()) {
            hosted.set_driving(false);
        }
        hosted.look(host, now, true);
        Ok(hosted)
    }

    fn nanos(&self, at: Instant) -> u64 {
        clock::nanos(self.handle.began, at)
    }

    /// Takes up one thing.
    ///
    /// # Errors
    /// That the session is over.
    pub(super) fn take(&mut self, host: &Host, item: Item) -> Result<(), Over> {
        match item {
            // A session opens once, before this.
            Item::Open { .. } => {}
            Item::Resume { at, hello, outgoing } => self.resume(host, at, &hello, outgoing),
            Item::Frame(frame) => return self.frame(host, frame),
            Item::Driving(driving) => self.set_driving(driving),
            Item::Absent { at, outgoing, keeps_answers } => self.leave(host, at, &outgoing, keeps_answers),
            Item::Present { outgoing } => {
                if self.is(&outgoing) && self.absent.take().is_some() {
                    host.metrics.connected.inc();
                }
            }
            Item::End(reason) => {
                let error = (reason == "shutdown").then(|| Error {
                    code: ErrorCode::Shutdown,
                    message: "the server is shutting down; resume with what you hold".to_owned(),
                    fatal: true,
                });
                return Err(Over { reason, error });
            }
        }
        Ok(())
    }

    fn is(&self, outgoing: &Arc<Outgoing>) -> bool {
        self.outgoing.as_ref().is_some_and(|own| Arc::ptr_eq(own, outgoing))
    }

    fn resume(&mut self, host: &Host, at: Instant, hello: &Hello, outgoing: Arc<Outgoing>) {
        if let Some(before) = self.outgoing.replace(outgoing) {
            let message = "the session goes on over another connection".to_owned();
            before.close("resumed_elsewhere", Some(Error { code: ErrorCode::Order, message, fatal: true }));
        }
        if self.absent.take().is_some() {
            host.metrics.connected.inc();
        }
        host.metrics.resumed.inc();
        let received_ns = self.nanos(at);
        let answers = self.session.resume(received_ns, hello);
        tracing::debug!(session = self.handle.short(), "session goes on");
        let state = self.session.state();
        self.ledger.resumed(&hello.resident, |rep| state.requests().iter().any(|request| request.rep == rep));
        self.answer(received_ns, Input::Resume { hello: Cow::Owned(hello.clone()) }, answers, Some(at));
    }

    fn leave(&mut self, host: &Host, at: Instant, outgoing: &Arc<Outgoing>, keeps_answers: bool) {
        if self.is(outgoing) {
            if self.absent.is_none() {
                host.metrics.connected.dec();
                self.absent = Some(at);
            }
            if !keeps_answers {
                self.outgoing = None;
            }
        }
    }

    fn frame(&mut self, host: &Host, frame: Frame) -> Result<(), Over> {
        if frame.over.as_ref().is_some_and(|over| !self.is(over)) {
            // What a connection said before it was superseded, read only after: the hello that resumed has said what is held.
            return Ok(());
        }
        self.frames += 1;
        let received_ns = self.nanos(frame.at);
        let begun = clock::now();
        let answers = self.session.frame(received_ns, &frame.messages);
        self.decided(host, begun);
        self.ledger.reported(&frame.messages);
        let finished = self.session.finished();
        let viewed = frame.messages.iter().any(|message| matches!(message, ClientMessage::View(_)));
        if viewed && !self.viewed {
            self.viewed = true;
            if let Some(links) = host.links() {
                links.begin(&self.handle.id, frame.at);
            }
        }
        let input = Input::Frame { messages: Cow::Owned(frame.messages) };
        if viewed && answers.is_empty() {
            // Decided, and nothing new to say.
            let took = clock::now().saturating_duration_since(frame.at);
            host.metrics.view_to_decision.observe(took.as_secs_f64());
        }
        self.answer(received_ns, input, answers, viewed.then_some(frame.at));
        if finished { Err(Over::because("bye")) } else { Ok(()) }
    }

    fn decided(&mut self, host: &Host, begun: Instant) {
        let took = clock::now().saturating_duration_since(begun);
        host.metrics.decision.observe(took.as_secs_f64());
        self.decisions += 1;
        self.longest = self.longest.max(took);
    }

    fn set_driving(&mut self, driving: bool) {
        let answers = self.session.set_driving(driving);
        let received_ns = self.nanos(clock::now());
        self.answer(received_ns, Input::Switch { driving }, answers, None);
    }

    /// Looks at every timer that may have run out.
    ///
    /// # Errors
    /// That the session is over.
    pub(super) fn due(&mut self, host: &Host, now: Instant) -> Result<(), Over> {
        if self.absent.is_some_and(|since| now.saturating_duration_since(since) >= host.config.keep_session.0) {
            return Err(Over::because("not_resumed"));
        }
        if self.wake().is_some_and(|wake| wake <= now) {
            let received_ns = self.nanos(now);
            let answers = self.session.tick(received_ns);
            self.decided(host, now);
            self.answer(received_ns, Input::Tick, answers, None);
        }
        if now.saturating_duration_since(self.looked) >= LOOK_EVERY {
            self.look(host, now, false);
        }
        if self.memory > host.config.session_memory_max.length() {
            let most = host.config.session_memory_max.0;
            let message = format!("the session takes {} bytes of the server; expected at most {most}", self.memory);
            let error = Error { code: ErrorCode::Limit, message, fatal: true };
            return Err(Over { reason: "memory", error: Some(error) });
        }
        Ok(())
    }

    fn look(&mut self, host: &Host, now: Instant, first: bool) {
        self.looked = now;
        let memory = self.session.heap_bytes();
        let signed = |bytes: usize| i64::try_from(bytes).unwrap_or(i64::MAX);
        host.metrics.memory_bytes.inc_by(signed(memory) - signed(self.memory));
        self.memory = memory;
        if !first && now.saturating_duration_since(self.observed) >= OBSERVE_EVERY {
            self.observe(host, now);
        }
    }

    /// Keeps what is known of the link, if anything came over it since.
    fn observe(&mut self, host: &Host, now: Instant) {
        let seconds = now.saturating_duration_since(self.observed).as_secs_f64();
        self.observed = now;
        let (Some(client), Some(estimates)) = (&self.client, &host.estimates) else { return };
        if self.ledger.take_received() {
            let link = self.session.link();
            let at_ms = i64::try_from(clock::unix().as_millis()).unwrap_or(i64::MAX);
            let client = client.clone();
            estimates.observe(Observation { client, rate: link.rate, latency_s: link.latency_s, seconds, at_ms });
        }
    }

    fn wake(&self) -> Option<Instant> {
        self.session.wake_ns().and_then(|ns| self.handle.began.checked_add(Duration::from_nanos(ns)))
    }

    /// When [`Hosted::due`] is to be called next.
    pub(super) fn timer(&self, host: &Host) -> Instant {
        let expiry = self.absent.map(|since| since + host.config.keep_session.0);
        let look = self.looked + LOOK_EVERY;
        [expiry, self.wake()].into_iter().flatten().fold(look, Instant::min)
    }

    /// Records what the session has made of an input, and hands its answers to the connection.
    fn answer(
        &mut self,
        received_ns: u64,
        input: Input<'static>,
        answers: Vec<ServerMessage>,
        received: Option<Instant>,
    ) {
        self.ledger.answered(&answers);
        if let Some(recording) = self.recording.as_ref().filter(|recording| recording.is_alive()) {
            let decides = matches!(input, Input::Frame { .. } | Input::Tick);
            let unsent = if decides { self.session.unsent().to_vec() } else { Vec::new() };
            let entry = Entry { received_ns, input, out: Cow::Owned(answers.clone()), unsent: Cow::Owned(unsent) };
            // Messages hold no number that JSON has not.
            recording.line(move || entry.line().unwrap_or_default());
        }
        if answers.is_empty() {
            return;
        }
        if let Some(outgoing) = &self.outgoing {
            // One that is closed, or closes over this, says so to its socket, and the socket then says that it is gone.
            outgoing.push(answers, received);
        }
    }

    /// Ends the session: the connection is told, the link remembered, the recording closed, the log written.
    pub(super) fn end(mut self, host: &Host, over: Over) {
        let now = clock::now();
        self.observe(host, now);
        self.look(host, now, true);
        host.metrics.memory_bytes.dec_by(i64::try_from(self.memory).unwrap_or(i64::MAX));
        if self.absent.is_none() {
            host.metrics.connected.dec();
        }
        host.metrics.ended.get_or_create(&super::metrics::ReasonLabel { reason: over.reason }).inc();
        if let Some(outgoing) = self.outgoing.take() {
            outgoing.close(over.reason, over.error);
        }
        let link = self.session.link();
        let figures = self.ledger.end();
        tracing::info!(
            session = self.handle.short(),
            world = self.handle.world.name(),
            reason = over.reason,
            seconds = now.saturating_duration_since(self.handle.began).as_secs_f64(),
            frames = self.frames,
            decisions = self.decisions,
            longest_decision_ms = self.longest.as_secs_f64() * 1e3,
            requests = figures.requests,
            completed = figures.completed,
            cancelled = figures.cancelled,
            failed = figures.failed,
            discards = figures.discards,
            completed_bytes = figures.completed_bytes,
            wasted_bytes = figures.wasted_bytes,
            memory_bytes = self.memory,
            clock_jumps = self.session.clock_jumps(),
            rate = link.rate,
            latency_s = link.latency_s,
            "session ends"
        );
    }
}

fn begin_recording(host: &Host, handle: &Handle, hello: &Hello) -> Option<Recording> {
    let (recorder, world) = (host.recorder.as_ref()?, host.world_of(handle)?);
    let header = Header::new(&handle.id, &world, &host.limits, hello);
    let since = clock::unix().as_millis();
    // The whole id would let whoever reads the folder resume the session.
    let name = format!("{}-{since}-{}", handle.world.name(), handle.number);
    recorder.begin(handle.number, name, move || {
        Writer::new(Vec::new(), &header).map(Writer::into_inner).unwrap_or_default()
    })
}
