//! What waits for a session, and which sessions wait for their thread.
//!
//! A session has a mailbox; a decision thread has a queue of sessions with mail, each in it once. The thread takes the
//! first, works off one frame, and puts it back at the end if there is more: sessions take turns, whatever they send.
//! A frame holds a share of its session's room until it is worked off, so that a full mailbox stops the reading of the
//! socket and nothing else.

use super::outgoing::Outgoing;
use super::stream::Events;
use crate::http::worlds::HostedWorld;
use foresight_wire::message::{ClientMessage, Hello};
use prometheus_client::metrics::gauge::Gauge;
use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Frames are merged once the oldest has waited so long.
const MERGE_AFTER: Duration = Duration::from_millis(10);

/// Least room that a frame takes, bytes: bounds the number of frames.
const FRAME_ROOM_MIN: usize = 1024;

/// What comes to a session.
#[derive(Debug)]
pub(super) enum Item {
    /// First of all.
    Open { hello: Box<Hello>, outgoing: Arc<Outgoing> },
    /// The client is back, or has opened a second connection.
    Resume { at: Instant, hello: Box<Hello>, outgoing: Arc<Outgoing> },
    /// Messages of the client.
    Frame(Frame),
    /// The kill switch has moved.
    Driving(bool),
    /// This connection is gone; its answers can be kept for the next reader, or not.
    Absent { at: Instant, outgoing: Arc<Outgoing>, keeps_answers: bool },
    /// Somebody reads the answers of this connection again.
    Present { outgoing: Arc<Outgoing> },
    /// It is over.
    End(&'static str),
}

/// Messages of a client.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) at: Instant,
    pub(super) messages: Vec<ClientMessage>,
    /// The connection that it came over; `None` if it named its session.
    pub(super) over: Option<Arc<Outgoing>>,
    /// Given back when they have been worked off.
    pub(super) room: Option<OwnedSemaphorePermit>,
}

/// A session as everybody but its own thread knows it.
#[derive(Debug)]
pub(super) struct Handle {
    pub(super) id: String,
    /// Counts up; the order in which sessions began.
    pub(super) number: u64,
    pub(super) world: &'static HostedWorld,
    pub(super) address: IpAddr,
    pub(super) began: Instant,
    pub(super) thread: Arc<Thread>,
    mail: Mutex<Mail>,
    /// Of a session without a socket.
    events: Mutex<Option<Arc<Events>>>,
    room: Arc<Semaphore>,
    room_bytes: usize,
}

#[derive(Debug, Default)]
struct Mail {
    items: VecDeque<Item>,
    /// A timer of the session has run out.
    due: bool,
    /// It is in its thread's queue.
    queued: bool,
    /// Nothing more is taken.
    closed: bool,
}

/// What a session does in its turn.
#[derive(Debug)]
pub(super) struct Turn {
    pub(super) items: Vec<Item>,
    pub(super) due: bool,
    /// Frames that were merged into others.
    pub(super) merged: u64,
}

impl Handle {
    pub(super) fn new(
        (id, number): (String, u64),
        world: &'static HostedWorld,
        address: IpAddr,
        began: Instant,
        thread: Arc<Thread>,
        room_bytes: usize,
    ) -> Handle {
        let room_bytes = room_bytes.clamp(FRAME_ROOM_MIN, Semaphore::MAX_PERMITS.min(u32::MAX as usize));
        let room = Arc::new(Semaphore::new(room_bytes));
        Handle {
            id,
            number,
            world,
            address,
            began,
            thread,
            mail: Mutex::default(),
            events: Mutex::default(),
            room,
            room_bytes,
        }
    }

    /// The beginning of the id, for the log: the whole would let its readers speak for the client.
    pub(super) fn short(&self) -> &str {
        self.id.get(..8).unwrap_or_default()
    }

    fn mail(&self) -> MutexGuard<'_, Mail> {
        self.mail.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for room for a frame of so many bytes. `None` when the session is over.
    pub(super) async fn room(&self, bytes: usize) -> Option<OwnedSemaphorePermit> {
        let bytes = u32::try_from(bytes.clamp(FRAME_ROOM_MIN, self.room_bytes)).unwrap_or(u32::MAX);
        self.room.clone().acquire_many_owned(bytes).await.ok()
    }

    /// Room for a frame of so many bytes, if there is some now.
    pub(super) fn room_now(&self, bytes: usize) -> Option<OwnedSemaphorePermit> {
        let bytes = u32::try_from(bytes.clamp(FRAME_ROOM_MIN, self.room_bytes)).unwrap_or(u32::MAX);
        self.room.clone().try_acquire_many_owned(bytes).ok()
    }

    /// Its answers' way where it has no socket.
    pub(super) fn events(&self) -> Option<Arc<Events>> {
        self.events.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Gives it a way for answers without a socket.
    pub(super) fn set_events(&self, events: Arc<Events>) {
        *self.events.lock().unwrap_or_else(PoisonError::into_inner) = Some(events);
    }

    /// Puts something in the mailbox; false if the session is over.
    pub(super) fn post(self: &Arc<Handle>, item: Item) -> bool {
        let mut mail = self.mail();
        if mail.closed {
            return false;
        }
        mail.items.push_back(item);
        self.queue(mail);
        true
    }

    /// A timer has run out.
    pub(super) fn due(self: &Arc<Handle>) {
        let mut mail = self.mail();
        mail.due = true;
        self.queue(mail);
    }

    fn queue(self: &Arc<Handle>, mut mail: MutexGuard<'_, Mail>) {
        if !std::mem::replace(&mut mail.queued, true) {
            drop(mail);
            self.thread.push(self.clone());
        }
    }

    /// What to do now: everything up to a frame and, if that has waited too long, the frames right behind it merged into
    /// it, to at most `messages_max` messages. What is left waits for the next turn.
    pub(super) fn turn(self: &Arc<Handle>, now: Instant, messages_max: usize) -> Turn {
        let mut mail = self.mail();
        let mut turn = Turn { items: Vec::new(), due: std::mem::take(&mut mail.due), merged: 0 };
        while let Some(item) = mail.items.pop_front() {
            let Item::Frame(mut frame) = item else {
                turn.items.push(item);
                continue;
            };
            if now.saturating_duration_since(frame.at) > MERGE_AFTER {
                while let Some(Item::Frame(next)) = mail.items.front() {
                    let is_same = frame.over.as_ref().map(Arc::as_ptr) == next.over.as_ref().map(Arc::as_ptr);
                    if !is_same || frame.messages.len() + next.messages.len() > messages_max {
                        break;
                    }
                    let Some(Item::Frame(next)) = mail.items.pop_front() else { break };
                    frame.absorb(next);
                    turn.merged += 1;
                }
            }
            turn.items.push(Item::Frame(frame));
            break;
        }
        mail.queued = false;
        if !mail.items.is_empty() {
            self.queue(mail);
        }
        turn
    }

    /// Takes nothing more; what waits is let go.
    pub(super) fn close(&self) {
        let mut mail = self.mail();
        mail.closed = true;
        mail.items.clear();
        drop(mail);
        self.room.close();
    }
}

impl Frame {
    /// Puts a later frame behind this one: all events stay; views, paths and progress that the later supersedes go.
    fn absorb(&mut self, later: Frame) {
        let has = |kind: fn(&ClientMessage) -> bool| later.messages.iter().any(kind);
        let view = has(|message| matches!(message, ClientMessage::View(_)));
        let path = has(|message| matches!(message, ClientMessage::Path(_)));
        let progress = has(|message| matches!(message, ClientMessage::Progress(_)));
        self.messages.retain(|message| match message {
            ClientMessage::View(_) => !view,
            ClientMessage::Path(_) => !path,
            ClientMessage::Progress(_) => !progress,
            _ => true,
        });
        self.messages.extend(later.messages);
        // Latency counts from the frame that is answered.
        self.at = later.at;
        match (&mut self.room, later.room) {
            (Some(room), Some(more)) => room.merge(more),
            (room @ None, more) => *room = more,
            (Some(_), None) => {}
        }
    }
}

/// A decision thread as others know it: the sessions that have something for it to do.
#[derive(Debug)]
pub(super) struct Thread {
    waiting: Mutex<Waiting>,
    changed: Condvar,
    /// Sessions that wait for their turn, on all threads.
    gauge: Gauge,
}

#[derive(Debug, Default)]
struct Waiting {
    sessions: VecDeque<Arc<Handle>>,
    stopped: bool,
}

/// What a decision thread is to do next.
#[derive(Debug)]
pub(super) enum Next {
    /// This session has mail.
    Session(Arc<Handle>),
    /// The time has come.
    Timer,
    /// To end.
    Stop,
}

impl Thread {
    pub(super) fn new(gauge: Gauge) -> Thread {
        Thread { waiting: Mutex::default(), changed: Condvar::new(), gauge }
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, session: Arc<Handle>) {
        self.waiting().sessions.push_back(session);
        self.gauge.inc();
        self.changed.notify_one();
    }

    /// Ends the thread once no session waits.
    pub(super) fn stop(&self) {
        self.waiting().stopped = true;
        self.changed.notify_one();
    }

    /// The next session, or that `until` has come.
    pub(super) fn next(&self, until: Option<Instant>) -> Next {
        let mut waiting = self.waiting();
        loop {
            if let Some(session) = waiting.sessions.pop_front() {
                self.gauge.dec();
                return Next::Session(session);
            }
            if waiting.stopped {
                return Next::Stop;
            }
            waiting = match until {
                None => self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner),
                Some(until) => {
                    let left = until.saturating_duration_since(crate::clock::now());
                    if left.is_zero() {
                        return Next::Timer;
                    }
                    self.changed.wait_timeout(waiting, left).unwrap_or_else(PoisonError::into_inner).0
                }
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_wire::message::{Event, Views};

    fn session(number: u64, thread: &Arc<Thread>) -> Arc<Handle> {
        let world = Box::leak(Box::new(HostedWorld::open("w=city:blocks=1").expect("a world")));
        let address = IpAddr::from([127, 0, 0, 1]);
        Arc::new(Handle::new((number.to_string(), number), world, address, crate::clock::now(), thread.clone(), 8192))
    }

    fn view(t_ns: u64) -> ClientMessage {
        ClientMessage::View(Views { t_ns, cameras: Vec::new() })
    }

    fn completed(rep: u32) -> ClientMessage {
        ClientMessage::Completed(Event { t_ns: 0, rep })
    }

    fn frame(at: Instant, messages: Vec<ClientMessage>) -> Item {
        Item::Frame(Frame { at, messages, over: None, room: None })
    }

    fn messages(turn: &Turn) -> Vec<ClientMessage> {
        let frames =
            turn.items.iter().filter_map(|item| if let Item::Frame(frame) = item { Some(frame) } else { None });
        frames.flat_map(|frame| frame.messages.clone()).collect()
    }

    #[test]
    fn frames_in_time_are_worked_off_one_by_one() {
        let thread = Arc::new(Thread::new(Gauge::default()));
        let (session, now) = (session(1, &thread), crate::clock::now());
        for t_ns in 0..3 {
            assert!(session.post(frame(now, vec![view(t_ns), completed(t_ns as u32)])));
        }
        for t_ns in 0..3 {
            assert!(matches!(thread.next(Some(now)), Next::Session(next) if next.number == 1));
            let turn = session.turn(now, 100);
            assert_eq!((messages(&turn), turn.merged), (vec![view(t_ns), completed(t_ns as u32)], 0));
        }
        assert!(matches!(thread.next(Some(now)), Next::Timer));
    }

    #[test]
    fn late_frames_are_merged_without_their_older_views_and_with_all_events() {
        let thread = Arc::new(Thread::new(Gauge::default()));
        let (session, now) = (session(1, &thread), crate::clock::now());
        for t_ns in 0..4 {
            session.post(frame(now, vec![completed(t_ns as u32), view(t_ns)]));
        }
        session.post(Item::Driving(false));
        session.post(frame(now, vec![view(9)]));
        let later = now + 2 * MERGE_AFTER;
        let turn = session.turn(later, 100);
        assert_eq!(messages(&turn), [completed(0), completed(1), completed(2), completed(3), view(3)]);
        assert_eq!(turn.merged, 3);
        let turn = session.turn(later, 100);
        assert!(matches!(turn.items[..], [Item::Driving(false), Item::Frame(_)]), "{turn:?}");
        // No more than a frame may hold.
        for t_ns in 0..4 {
            session.post(frame(now, vec![completed(t_ns as u32); 2]));
        }
        assert_eq!(messages(&session.turn(later, 5)).len(), 4);
    }

    #[test]
    fn sessions_take_turns_whatever_they_send() {
        let thread = Arc::new(Thread::new(Gauge::default()));
        let (greedy, modest, now) = (session(1, &thread), session(2, &thread), crate::clock::now());
        for _ in 0..100 {
            greedy.post(frame(now, vec![view(0)]));
        }
        modest.post(frame(now, vec![view(0)]));
        let mut order = Vec::new();
        for _ in 0..3 {
            let Next::Session(next) = thread.next(Some(now)) else { panic!("a session waits") };
            order.push(next.number);
            next.turn(now, 100);
        }
        assert_eq!(order, [1, 2, 1]);
        greedy.close();
        assert!(!greedy.post(frame(now, Vec::new())));
    }

    #[tokio::test]
    async fn a_full_mailbox_holds_its_own_connection_back() {
        let thread = Arc::new(Thread::new(Gauge::default()));
        let session = session(1, &thread);
        let first = session.room(6000).await.expect("room");
        assert!(session.room_now(6000).is_none());
        drop(first);
        // What is larger than the room takes all of it.
        let all = session.room(1 << 30).await.expect("room");
        assert!(session.room_now(1).is_none());
        drop(all);
        session.close();
        assert!(session.room(1).await.is_none());
    }
}
