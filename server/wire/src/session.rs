//! A client's session without socket and clock: messages in, messages out.
//!
//! A [`Session`] opens with a [`Hello`] and is then given frames, each with the time at which it was received. It applies
//! what the client reports, in the order given, lets the [`Scheduler`] observe the last view of the frame, asks it what to
//! do until it waits, and answers. All it does follows from the sequence of its inputs, so a recording of these replays to
//! the same decisions ([`crate::recording`]).
//!
//! # Times
//! Session time is the client's, unless that is more than [`DRIFT_MAX_NS`] from the server's clock: then an event is taken
//! as happening when it comes, and after a second of that the client's clock is taken to have jumped. The answers bear the client's time.
//!
//! # What crosses on the way
//! An event may come of something that has been cancelled or discarded meanwhile. For a minute such an event is no error.
//! Where it says that the client holds what it should not, the answer is `cancel` or `discard` once more; where a cancelled
//! request had arrived, what was to go on its arrival is gone. What needs a representation that failed or was dropped is
//! given up with it: the client is told, unless it has said so itself in the same frame.
//!
//! # Who fetches
//! Under [`Mode::Drive`] the client fetches what it is told and nothing else: reports of anything else are errors. Under
//! [`Mode::Warm`], under [`Mode::Shadow`], and while the server does not drive, the client fetches by its own rules too:
//! what it reports as completed (when warming, already as arrived) counts as resident from then on, as far as the memory
//! goes; what does not fit is left out of account. Nothing is discarded to make room for it. Under `Shadow` decisions are
//! made four times a second by what the client holds, each as if it were the first; [`Session::unsent`] has them.

mod answers;
mod check;
mod clock;
mod events;
mod held;
mod limits;
mod reconcile;

pub use clock::DRIFT_MAX_NS;
pub use limits::SessionLimits;

use crate::message::{
    ClientMessage, Error, ErrorCode, Hello, LinkGuess, Mode, ServerMessage, Settings, VERSION, Views, Welcome,
};
use answers::{Answers, Said};
use clock::Clock;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::scheduler::{Action, Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::state::ClientState;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use glam::DVec3;
use held::LetGo;
use std::collections::{BTreeMap, BTreeSet};

/// A session asks the scheduler by itself this long after the last frame, ns; while nothing comes of it, after twice as
/// long, up to [`TICK_MAX_NS`]. A client that moves sends frames more often.
const TICK_MIN_NS: u64 = 100_000_000;
const TICK_MAX_NS: u64 = 1_600_000_000;
/// Time between two decisions under [`Mode::Shadow`], ns.
const SHADOW_NS: u64 = 250_000_000;

/// The world of a session; shared by all its sessions.
#[derive(Clone, Copy)]
pub struct SessionWorld<'a> {
    /// Name, as the server lists it.
    pub name: &'a str,
    /// Hash of its content.
    pub identity: &'a str,
    /// What the URIs are relative to.
    pub base: &'a str,
    /// Nodes and representations.
    pub tree: &'a LodTree,
    /// Where a representation is fetched, relative to `base`.
    pub uri: &'a (dyn Fn(RepId) -> String + Sync),
    /// Away from the ground, unit length.
    pub up: DVec3,
}

impl core::fmt::Debug for SessionWorld<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("SessionWorld")
            .field("name", &self.name)
            .field("identity", &self.identity)
            .finish_non_exhaustive()
    }
}

/// A client's session.
pub struct Session<'a> {
    id: String,
    world: SessionWorld<'a>,
    limits: SessionLimits,
    /// The policy as asked for.
    policy: String,
    refinement: crate::message::Refinement,
    mode: Mode,
    driving: bool,
    finished: bool,
    scheduler: Scheduler<'a>,
    clock: Clock,
    /// What each request under way frees when it has arrived; requests that free nothing are not in here.
    doomed: BTreeMap<u32, Vec<RepId>>,
    let_go: LetGo,
    /// After a break: requests of which the client has spoken since. Those of which it has not are over.
    resuming: Option<BTreeSet<u32>>,
    /// Bytes received before the client began to count anew, and as last told.
    received_before: u64,
    received: u64,
    said: Said,
    unsent: Vec<ServerMessage>,
    /// When the last decision under `Shadow` was made.
    shadowed: Option<Time>,
    /// Session time until which the policy waits.
    until: Time,
    /// After the last input, when to ask again.
    tick_ns: u64,
    asked: bool,
}

impl core::fmt::Debug for Session<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Session").field("id", &self.id).field("world", &self.world).finish_non_exhaustive()
    }
}

/// An error after which the connection is closed.
pub(crate) fn fatal(code: ErrorCode, message: impl Into<String>) -> Error {
    Error { code, message: message.into(), fatal: true }
}

impl<'a> Session<'a> {
    /// Opens a session, at 0 of the server's clock. The first answer is the welcome; discards of residents that do not fit
    /// may follow.
    ///
    /// # Errors
    /// What is wrong with the `hello`; all such errors are fatal.
    pub fn open(
        id: String,
        world: SessionWorld<'a>,
        limits: &SessionLimits,
        hello: &Hello,
    ) -> Result<(Session<'a>, Vec<ServerMessage>), Error> {
        check_hello(&world, limits, hello)?;
        let link = hello.link.unwrap_or(limits.link);
        let settings = SchedulerSettings {
            refinement: hello.refinement.into(),
            rate_guess: link.rate,
            latency_guess_s: link.latency_s,
            ..SchedulerSettings::with_budget(hello.memory_bytes)
        };
        let label = hello.policy.clone().unwrap_or_else(|| limits.policy.clone());
        let policy = build(&label, limits, &world).map_err(|message| fatal(ErrorCode::Value, message))?;
        let scheduler = Scheduler::checked(world.tree, settings, policy)
            .map_err(|error| fatal(ErrorCode::Value, error.to_string()))?;
        let mut session = Session {
            id,
            world,
            limits: limits.clone(),
            policy: label,
            refinement: hello.refinement,
            mode: hello.mode,
            driving: true,
            finished: false,
            scheduler,
            clock: Clock::default(),
            doomed: BTreeMap::new(),
            let_go: LetGo::default(),
            resuming: None,
            received_before: 0,
            received: 0,
            said: Said::default(),
            unsent: Vec::new(),
            shadowed: None,
            until: Time::ZERO,
            tick_ns: TICK_MIN_NS,
            asked: false,
        };
        let mut answers = Answers::new(limits.errors_max);
        answers.push(session.welcome(false));
        session.hold(&hello.resident, &mut answers);
        let out = answers.finish();
        Ok((session, out))
    }

    fn welcome(&self, resumed: bool) -> ServerMessage {
        let tree = self.world.tree;
        let bounds = tree.bounds(tree.root());
        ServerMessage::Welcome(Box::new(Welcome {
            version: VERSION,
            session: self.id.clone(),
            resumed,
            world: self.world.name.to_owned(),
            identity: self.world.identity.to_owned(),
            base: self.world.base.to_owned(),
            representations: tree.representations() as u64,
            up: self.world.up.to_array(),
            bounds: [bounds.min.to_array(), bounds.max.to_array()],
            policy: self.policy.clone(),
            driving: self.driving && self.mode != Mode::Shadow,
        }))
    }

    /// Applies a frame and decides. Answers at most `messages_max` messages of a frame; the rest is refused.
    pub fn frame(&mut self, received_ns: u64, messages: &[ClientMessage]) -> Vec<ServerMessage> {
        let mut answers = self.begin(received_ns);
        if self.finished {
            answers.error(ErrorCode::Order, "the client has said bye; expected nothing more");
            return answers.finish();
        }
        let most = self.limits.messages_max;
        if messages.len() > most {
            let count = messages.len();
            answers.error(ErrorCode::Limit, format!("the frame has {count} messages; expected at most {most}"));
        }
        let mut seen = None;
        for message in &messages[..messages.len().min(most)] {
            self.apply(message, &mut seen, &mut answers);
            if self.finished {
                return answers.finish();
            }
        }
        self.settle(&mut answers);
        if let Some((t_ns, cameras)) = seen {
            let now = self.event_time(t_ns, &mut answers);
            let observed = self.scheduler.observe_cameras(&cameras, now);
            report(observed, ErrorCode::Value, &mut answers);
        }
        self.tick_ns = TICK_MIN_NS;
        self.decide(self.clock.latest(), &mut answers);
        self.estimate(&mut answers);
        answers.finish()
    }

    /// Time has passed without a frame: decides anew.
    pub fn tick(&mut self, received_ns: u64) -> Vec<ServerMessage> {
        let mut answers = self.begin(received_ns);
        if self.finished {
            return Vec::new();
        }
        let now = self.clock.now();
        if !self.decide(now, &mut answers) {
            self.tick_ns = (2 * self.tick_ns).min(TICK_MAX_NS);
        }
        answers.finish()
    }

    fn begin(&mut self, received_ns: u64) -> Answers {
        self.clock.received(received_ns);
        self.unsent.clear();
        self.let_go.forget_before(self.clock.about_now());
        Answers::new(self.limits.errors_max)
    }

    fn apply(&mut self, message: &ClientMessage, seen: &mut Option<(u64, Vec<(f64, View)>)>, answers: &mut Answers) {
        match message {
            ClientMessage::Hello(_) => {
                answers.error(
                    ErrorCode::Order,
                    "a hello within a session; expected it once, at the start of a connection",
                );
            }
            ClientMessage::View(views) => match self.views(views) {
                Ok(cameras) => *seen = Some((views.t_ns, cameras)),
                Err(message) => answers.error(ErrorCode::Value, message),
            },
            ClientMessage::Responded(event) => self.event(events::Kind::Responded, event, answers),
            ClientMessage::Arrived(event) => self.event(events::Kind::Arrived, event, answers),
            ClientMessage::Completed(event) => self.event(events::Kind::Completed, event, answers),
            ClientMessage::Dropped(event) => self.event(events::Kind::Dropped, event, answers),
            ClientMessage::Failed(failure) => {
                let event = crate::message::Event { t_ns: failure.t_ns, rep: failure.rep };
                self.event(events::Kind::Failed, &event, answers);
            }
            ClientMessage::Progress(progress) => self.progress(progress, answers),
            ClientMessage::Path(path) => self.announce(path, answers),
            ClientMessage::Settings(settings) => self.settings(settings, answers),
            ClientMessage::Bye => self.finished = true,
        }
    }

    fn views(&self, views: &Views) -> Result<Vec<(f64, View)>, String> {
        check::views(views, &self.limits)
    }

    fn announce(&mut self, path: &crate::message::Path, answers: &mut Answers) {
        let (count, most) = (path.views.len(), self.limits.path_views_max);
        if count > most {
            return answers.error(ErrorCode::Limit, format!("the path has {count} views; expected at most {most}"));
        }
        let mut views = Vec::with_capacity(count);
        for (index, waypoint) in path.views.iter().enumerate() {
            match waypoint.camera.view() {
                Ok(view) => views.push((self.clock.at(waypoint.t_ns), view)),
                Err(error) => return answers.error(ErrorCode::Value, format!("view {index} of the path: {error}")),
            }
        }
        let announced = self.scheduler.announce_path(&views);
        report(announced, ErrorCode::Value, answers);
    }

    fn settings(&mut self, settings: &Settings, answers: &mut Answers) {
        if let Some(bytes) = settings.memory_bytes {
            match check::memory(bytes, &self.limits) {
                Ok(()) => self.scheduler.set_budget(bytes),
                Err(message) => answers.error(ErrorCode::Value, message),
            }
        }
        if let Some(policy) = &settings.policy {
            self.change_policy(policy, answers);
        }
        if let Some(mode) = settings.mode {
            self.mode = mode;
        }
    }

    fn change_policy(&mut self, label: &str, answers: &mut Answers) {
        match build(label, &self.limits, &self.world) {
            Ok(policy) => {
                self.scheduler.set_policy(policy);
                label.clone_into(&mut self.policy);
            }
            Err(message) => answers.error(ErrorCode::Value, message),
        }
    }

    /// Session time of an event; a jump of the client's clock is reported.
    fn event_time(&mut self, t_ns: u64, answers: &mut Answers) -> Time {
        let (now, jump) = self.clock.event(t_ns);
        if let Some(jump) = jump {
            let (said, taken) = (jump.said_s, jump.taken_s);
            answers.error(
                ErrorCode::Value,
                format!("the time {said:.3} s is more than 2 s from the server's clock; expected about {taken:.3} s, and taken as that"),
            );
        }
        now
    }

    /// Asks the scheduler until it waits; true if it did something. What cannot be done at once is left to the next frame.
    fn decide(&mut self, now: Time, answers: &mut Answers) -> bool {
        self.asked = true;
        if !self.driving {
            return false;
        }
        if self.mode == Mode::Shadow {
            return self.decide_in_shadow(now);
        }
        for count in 0..self.limits.actions_max {
            match self.scheduler.next(now) {
                Ok(Action::WaitUntil(until)) => {
                    self.until = until;
                    self.say_wait(answers);
                    return count > 0;
                }
                Ok(action) => {
                    let message = self.obey(action, now);
                    answers.push(message);
                }
                Err(error) => {
                    answers.error(ErrorCode::Internal, error.to_string());
                    return count > 0;
                }
            }
        }
        self.until = now;
        true
    }

    /// Remembers an action, and words it.
    fn obey(&mut self, action: Action, now: Time) -> ServerMessage {
        match action {
            Action::Fetch { rep, discard_on_arrival } => {
                let message = self.word_fetch(rep, &discard_on_arrival, now);
                if !discard_on_arrival.is_empty() {
                    self.doomed.insert(rep.0, discard_on_arrival);
                }
                message
            }
            Action::Cancel(rep) => {
                let doomed = self.doomed.remove(&rep.0).unwrap_or_default();
                self.let_go.insert(rep, now, doomed);
                ServerMessage::Cancel { rep: rep.0 }
            }
            Action::Discard(rep) => {
                self.let_go.insert(rep, now, Vec::new());
                ServerMessage::Discard { rep: rep.0 }
            }
            Action::WaitUntil(until) => ServerMessage::Wait { until_ns: self.clock.on_client(until), because: None },
        }
    }

    /// The server begins or ceases to drive. While it does not, the session follows what the client reports, and decides
    /// nothing.
    pub fn set_driving(&mut self, driving: bool) -> Vec<ServerMessage> {
        self.unsent.clear();
        if self.driving == driving {
            return Vec::new();
        }
        self.driving = driving;
        vec![ServerMessage::Switch { driving }]
    }

    /// When to call [`Session::tick`], on the server's clock, if no frame comes before; `None` if there is nothing to wait
    /// for: before the first view, after `bye`, or while the server does not drive.
    pub fn wake_ns(&self) -> Option<u64> {
        let waits_for_nothing = self.finished || !self.driving || self.scheduler.state().view.is_none();
        if waits_for_nothing || !self.asked {
            return None;
        }
        let soonest = Time(self.clock.latest().0.saturating_add(self.tick_ns));
        Some(self.clock.on_server(soonest.max(self.until)))
    }

    /// Decisions of the last input that were made and not sent: under [`Mode::Shadow`].
    pub fn unsent(&self) -> &[ServerMessage] {
        &self.unsent
    }

    /// Bytes that the session occupies beside the shared world, an upper bound; what the policy keeps for itself is not
    /// counted.
    pub fn heap_bytes(&self) -> usize {
        let lists: usize = self.doomed.values().map(|list| list.capacity() * size_of::<RepId>()).sum();
        size_of::<Session>()
            + self.scheduler.heap_bytes()
            + self.id.capacity()
            + self.policy.capacity()
            + self.limits.policy.capacity()
            + lists
            + held::map_bytes::<u32, Vec<RepId>>(self.doomed.len())
            + self.let_go.heap_bytes()
            + self.resuming.as_ref().map_or(0, |set| held::map_bytes::<u32, ()>(set.len()))
            + self.unsent.capacity() * size_of::<ServerMessage>()
    }

    /// What is known of the link, to be kept for the client's next session.
    pub fn link(&self) -> LinkGuess {
        let link = &self.scheduler.state().link;
        LinkGuess { rate: link.rate(), latency_s: link.latency_s() }
    }

    /// Whether the client has said `bye`.
    pub fn finished(&self) -> bool {
        self.finished
    }

    /// Under which it is resumed.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// What its answers are for.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Whether the server drives; see [`Session::set_driving`].
    pub fn driving(&self) -> bool {
        self.driving
    }

    /// The policy as asked for.
    pub fn policy(&self) -> &str {
        &self.policy
    }

    /// The client as the scheduler knows it: memory, requests, residents.
    pub fn state(&self) -> &ClientState<'a> {
        self.scheduler.state()
    }

    /// Session time of what the client says is at `t_ns`, ns.
    pub fn session_ns(&self, t_ns: u64) -> u64 {
        self.clock.at(t_ns).0
    }

    /// Session time, ns: that of the last event, view or tick.
    pub fn now_ns(&self) -> u64 {
        self.clock.latest().0
    }

    /// How often the client's clock has left the server's by more than [`DRIFT_MAX_NS`].
    pub fn clock_jumps(&self) -> u64 {
        self.clock.jumps()
    }
}

/// Says what the scheduler refuses.
fn report<T>(outcome: Result<T, SchedulerError>, code: ErrorCode, answers: &mut Answers) {
    if let Err(error) = outcome {
        answers.error(code, error.to_string());
    }
}

/// What can be said of a `hello` to this world.
fn check_hello(world: &SessionWorld, limits: &SessionLimits, hello: &Hello) -> Result<(), Error> {
    check::version(hello).map_err(|message| fatal(ErrorCode::Version, message))?;
    check::hello(hello, limits).map_err(|message| fatal(ErrorCode::Value, message))?;
    if hello.world != world.name {
        let message = format!("the session is for world {}; expected {}", shorten(&hello.world), world.name);
        return Err(fatal(ErrorCode::World, message));
    }
    Ok(())
}

/// A text of the client's as far as a message repeats it.
fn shorten(text: &str) -> String {
    text.chars().take(80).collect()
}

fn build<'a>(
    label: &str,
    limits: &SessionLimits,
    world: &SessionWorld<'a>,
) -> Result<Box<dyn foresight_scheduler::policy::Policy + 'a>, String> {
    let mut spec = limits.policy(label)?;
    spec.settings.reach.up = world.up;
    Ok(spec.build(world.tree))
}
