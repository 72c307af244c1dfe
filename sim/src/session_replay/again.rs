//! The recorded inputs through the same session: whether it answers the same, and what happened when.

use super::{SessionReplayError, TICKS_MAX};
use foresight_index::world::World;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::flight::{Flight, TICKS_PER_SECOND, tick_time};
use foresight_wire::message::{ClientMessage, Mode, ServerMessage, Views};
use foresight_wire::recording::{Entry, Header, Input, Reader, RecordingError, feed, open};
use foresight_wire::session::{Session, SessionWorld};
use glam::DVec3;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::io::BufRead;

/// Whether the answers are made again, one by one.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Agreement {
    /// Fetches, cancellations and discards, those under shadow mode included.
    pub decisions: u64,
    /// Of these, made again. URIs are not compared: they are the server's words for the same thing.
    pub decisions_equal: u64,
    /// Everything else that was said.
    pub others: u64,
    /// Of these, said again.
    pub others_equal: u64,
    /// The first that differs.
    pub first_difference: Option<Difference>,
}

impl Agreement {
    /// Whether nothing differs.
    pub fn is_complete(&self) -> bool {
        self.first_difference.is_none()
    }
}

/// An answer that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Of the recording, from 1.
    pub line: u64,
    /// When the input came, seconds of the server's clock.
    pub received_s: f64,
    /// As recorded; `None` if there is no such answer.
    pub recorded: Option<ServerMessage>,
    /// As made again; `None` if there is none.
    pub again: Option<ServerMessage>,
}

/// What changed for the client, in session time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    Requested(RepId),
    Shown(RepId),
    Hidden(RepId),
    /// A request or what had come of it.
    LetGo(RepId),
}

/// A recorded session, replayed.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// Its first line.
    pub header: Header,
    /// Whether its answers are made again.
    pub agreement: Agreement,
    /// Of the world.
    pub(super) up: DVec3,
    /// By session time, which never decreases.
    pub(super) views: Vec<(Time, View)>,
    /// In the order in which they were said.
    pub(super) changes: Vec<(Time, Change)>,
    /// Resident from the start.
    pub(super) held_at_start: Vec<RepId>,
    /// Bytes received, as last told.
    pub(super) received: u64,
    pub(super) warnings: Vec<String>,
}

impl Recorded {
    /// From the first to the last view.
    pub(super) fn duration(&self) -> Time {
        let (Some((first, _)), Some((last, _))) = (self.views.first(), self.views.last()) else { return Time::ZERO };
        last.since(*first)
    }

    /// The views at the simulator's ticks, from the first on: the last that is not later; `None` without one.
    pub(super) fn flight(&self, name: &str) -> Result<Option<Flight>, SessionReplayError> {
        let Some(&(start, _)) = self.views.first() else { return Ok(None) };
        let duration = self.duration();
        // A tick's time is rounded down: the one after may be in time too.
        let before = u128::from(duration.0) * u128::from(TICKS_PER_SECOND) / 1_000_000_000;
        if before >= u128::from(TICKS_MAX) {
            return Err(SessionReplayError::Length { name: name.to_owned(), seconds: duration.secs() });
        }
        let last = before as u64 + u64::from(tick_time(before as u64 + 1) <= duration);
        let mut place = 0;
        let views = (0..=last).map(|tick| {
            let at = start + tick_time(tick);
            while self.views.get(place + 1).is_some_and(|(next, _)| *next <= at) {
                place += 1;
            }
            self.views[place].1
        });
        Ok(Some(Flight { views: views.collect() }))
    }
}

/// Replays a recording over its world.
///
/// # Errors
/// What is no recording, or one of another world.
pub fn replay_recording(name: &str, world: &World, recording: impl BufRead) -> Result<Recorded, SessionReplayError> {
    let mut reader = Reader::new(name, recording)?;
    let header = reader.header().clone();
    let mut replayed = Replayed {
        recorded: Recorded {
            header: header.clone(),
            agreement: Agreement::default(),
            up: world.up,
            views: Vec::new(),
            changes: Vec::new(),
            held_at_start: Vec::new(),
            received: 0,
            warnings: Vec::new(),
        },
        representations: world.tree.representations() as u32,
        frees: BTreeMap::new(),
        shown: BTreeSet::new(),
        warned: BTreeSet::new(),
    };
    let identity = world.hash().to_hex().to_string();
    if identity != header.identity {
        replayed.warn(format!("the world was recorded as {}; this one is {identity}", header.identity));
    }
    let Some(first) = reader.next().transpose()? else {
        replayed.warn("the session was never opened".to_owned());
        return Ok(replayed.recorded);
    };
    if first.input != Input::Open {
        let message = "is another input; expected that the session is opened".to_owned();
        return Err(RecordingError::Line { name: name.to_owned(), line: 2, message }.into());
    }
    let welcome = first.out.iter().find_map(|message| match message {
        ServerMessage::Welcome(welcome) => Some(welcome),
        _ => None,
    });
    let given = world.tree.representations() as u64;
    if let Some(recorded) = welcome.map(|w| w.representations).filter(|recorded| *recorded != given) {
        return Err(SessionReplayError::World { name: name.to_owned(), recorded, given });
    }
    let uri = |_: RepId| String::new();
    let of = SessionWorld {
        name: &header.world,
        identity: &header.identity,
        base: welcome.map_or("", |welcome| &welcome.base),
        tree: &world.tree,
        uri: &uri,
        up: world.up,
    };
    let (mut session, answers) =
        open(&header, of).map_err(|error| SessionReplayError::Open { name: name.to_owned(), error })?;
    replayed.recorded.held_at_start = session.state().residents().collect();
    replayed.shown = replayed.recorded.held_at_start.iter().map(|rep| rep.0).collect();
    replayed.compare(2, &first, &answers, &[]);
    let mut line = 2;
    while let Some(entry) = reader.next().transpose()? {
        line += 1;
        let answers = feed(&mut session, entry.received_ns, &entry.input);
        replayed.compare(line, &entry, &answers, session.unsent());
        replayed.take(&session, &entry);
    }
    if reader.cut_off() {
        replayed.warn(format!("line {}, the last, is cut off; left out", line + 1));
    }
    if session.clock_jumps() > 0 {
        replayed.warn(format!("the client's clock jumped {} times", session.clock_jumps()));
    }
    Ok(replayed.recorded)
}

struct Replayed {
    recorded: Recorded,
    representations: u32,
    /// What each request frees when it has arrived.
    frees: BTreeMap<u32, Vec<u32>>,
    /// What can be shown after all changes so far.
    shown: BTreeSet<u32>,
    warned: BTreeSet<&'static str>,
}

fn is_decision(message: &ServerMessage) -> bool {
    matches!(message, ServerMessage::Fetch(_) | ServerMessage::Cancel { .. } | ServerMessage::Discard { .. })
}

/// Whether both say the same, URIs apart.
fn agree(recorded: &ServerMessage, again: &ServerMessage) -> bool {
    match (recorded, again) {
        (ServerMessage::Fetch(recorded), ServerMessage::Fetch(again)) => {
            let again = foresight_wire::message::Fetch { uri: recorded.uri.clone(), ..again.clone() };
            *recorded == again
        }
        _ => recorded == again,
    }
}

impl Replayed {
    fn warn(&mut self, warning: String) {
        self.recorded.warnings.push(warning);
    }

    fn warn_once(&mut self, key: &'static str) {
        if self.warned.insert(key) {
            self.warn(key.to_owned());
        }
    }

    fn compare(&mut self, line: u64, entry: &Entry, out: &[ServerMessage], unsent: &[ServerMessage]) {
        for (recorded, again) in [(&entry.out[..], out), (&entry.unsent[..], unsent)] {
            for place in 0..recorded.len().max(again.len()) {
                let (recorded, again) = (recorded.get(place), again.get(place));
                let is_equal = recorded.zip(again).is_some_and(|(recorded, again)| agree(recorded, again));
                let agreement = &mut self.recorded.agreement;
                let (count, equal) = if recorded.or(again).is_some_and(is_decision) {
                    (&mut agreement.decisions, &mut agreement.decisions_equal)
                } else {
                    (&mut agreement.others, &mut agreement.others_equal)
                };
                *count += 1;
                *equal += u64::from(is_equal);
                if !is_equal && agreement.first_difference.is_none() {
                    agreement.first_difference = Some(Difference {
                        line,
                        received_s: entry.received_ns as f64 * 1e-9,
                        recorded: recorded.cloned(),
                        again: again.cloned(),
                    });
                }
            }
        }
    }

    /// What the input and its answers changed. What the recording names is looked at by its number only: it need not exist.
    fn take(&mut self, session: &Session, entry: &Entry) {
        let now = Time(session.now_ns());
        let at = |t_ns: u64| Time(session.session_ns(t_ns)).min(now);
        match &entry.input {
            Input::Frame { messages } => {
                for message in messages.iter() {
                    self.take_message(message, &at);
                }
            }
            Input::Resume { hello } => {
                self.warn_once("the connection broke and was resumed: what is simulated knows nothing of that");
                let held: BTreeSet<u32> = hello.resident.iter().copied().collect();
                let gone: Vec<u32> = self.shown.difference(&held).copied().collect();
                let come: Vec<u32> = held.difference(&self.shown).copied().collect();
                gone.into_iter().for_each(|rep| self.change(now, Change::Hidden(RepId(rep))));
                let count = self.representations;
                come.into_iter().filter(|rep| *rep < count).for_each(|rep| self.change(now, Change::Shown(RepId(rep))));
            }
            Input::Open | Input::Tick => {}
            Input::Switch { .. } => {
                self.warn_once("the server began or ceased to drive: what is simulated knows nothing of that");
            }
        }
        for message in entry.out.iter() {
            match message {
                ServerMessage::Fetch(fetch) => {
                    self.frees.insert(fetch.rep, fetch.discard_on_arrival.clone());
                    self.change(now, Change::Requested(RepId(fetch.rep)));
                }
                // A client that warms a cache need not obey.
                ServerMessage::Discard { rep } if session.mode() == Mode::Drive => {
                    self.change(now, Change::Hidden(RepId(*rep)));
                }
                ServerMessage::Cancel { rep } => {
                    self.change(now, Change::LetGo(RepId(*rep)));
                }
                _ => {}
            }
        }
    }

    fn change(&mut self, at: Time, change: Change) {
        match change {
            Change::Shown(rep) => _ = self.shown.insert(rep.0),
            Change::Hidden(rep) | Change::LetGo(rep) => _ = self.shown.remove(&rep.0),
            Change::Requested(_) => {}
        }
        self.recorded.changes.push((at, change));
    }

    /// What a request was to free is freed.
    fn free(&mut self, at: Time, rep: u32) {
        for freed in self.frees.remove(&rep).unwrap_or_default() {
            self.change(at, Change::Hidden(RepId(freed)));
        }
    }

    fn take_message(&mut self, message: &ClientMessage, at: &dyn Fn(u64) -> Time) {
        match message {
            ClientMessage::View(views) => self.take_views(views, at(views.t_ns)),
            ClientMessage::Arrived(event) => self.free(at(event.t_ns), event.rep),
            ClientMessage::Completed(event) => {
                self.free(at(event.t_ns), event.rep);
                if event.rep < self.representations {
                    self.change(at(event.t_ns), Change::Shown(RepId(event.rep)));
                }
            }
            ClientMessage::Dropped(event) => {
                self.frees.remove(&event.rep);
                self.change(at(event.t_ns), Change::LetGo(RepId(event.rep)));
            }
            ClientMessage::Failed(failure) => _ = self.frees.remove(&failure.rep),
            ClientMessage::Progress(progress) => self.recorded.received = progress.total_bytes,
            ClientMessage::Path(_) => {
                self.warn_once("the client announced paths: what is simulated is not told of them");
            }
            ClientMessage::Settings(_) => {
                self.warn_once("settings changed during the session: what is simulated has those of the start");
            }
            ClientMessage::Hello(_) | ClientMessage::Responded(_) | ClientMessage::Bye => {}
        }
    }

    fn take_views(&mut self, views: &Views, at: Time) {
        if views.cameras.len() > 1 {
            self.warn_once("several cameras: the one of the largest weight is judged and simulated");
        }
        // The first of equals.
        let largest = views.cameras.iter().rev().max_by(|a, b| a.weight.total_cmp(&b.weight));
        let Some(view) = largest.and_then(|camera| camera.view().ok()) else { return };
        let latest = self.recorded.views.last().map_or(Time::ZERO, |(latest, _)| *latest);
        self.recorded.views.push((at.max(latest), view));
    }
}
