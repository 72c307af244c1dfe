//! A decision thread: its sessions, their timers, and turn by turn their mail.

use super::host::Host;
use super::hosted::{Hosted, Over};
use super::mailbox::{Handle, Item, Next, Thread};
use crate::clock;
use foresight_wire::message::{Error, ErrorCode};
use std::collections::{BTreeMap, BTreeSet};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

/// A decision thread.
pub(super) struct Worker {
    host: Arc<Host>,
    thread: Arc<Thread>,
    sessions: BTreeMap<u64, Seat>,
    timers: BTreeSet<(Instant, u64)>,
}

/// A session and the timer that is set for it.
struct Seat {
    hosted: Hosted,
    timer: Instant,
}

impl Worker {
    pub(super) fn new(host: Arc<Host>, thread: Arc<Thread>) -> Worker {
        Worker { host, thread, sessions: BTreeMap::new(), timers: BTreeSet::new() }
    }

    /// Works until the thread is stopped.
    pub(super) fn run(&mut self) {
        loop {
            // Timers put their sessions in the queue like mail does: none is served before its turn.
            let now = clock::now();
            while let Some(&(at, number)) = self.timers.first().filter(|(at, _)| *at <= now) {
                self.timers.remove(&(at, number));
                if let Some(seat) = self.sessions.get(&number) {
                    seat.hosted.handle.due();
                }
            }
            match self.thread.next(self.timers.first().map(|(at, _)| *at)) {
                Next::Session(handle) => self.turn(&handle),
                Next::Timer => {}
                Next::Stop => return,
            }
        }
    }

    /// One turn of a session. A fault in it ends this session and no other.
    fn turn(&mut self, handle: &Arc<Handle>) {
        let turn = handle.turn(clock::now(), self.host.limits.messages_max);
        self.host.metrics.frames_merged.inc_by(turn.merged);
        let mut seat = self.sessions.remove(&handle.number);
        if let Some(seat) = &seat {
            self.timers.remove(&(seat.timer, handle.number));
        }
        let worked = catch_unwind(AssertUnwindSafe(|| {
            for item in turn.items {
                match (&mut seat, item) {
                    (Some(seat), item) => seat.hosted.take(&self.host, item)?,
                    (None, Item::Open { hello, outgoing }) => {
                        let hosted = Hosted::open(&self.host, handle, &hello, outgoing)?;
                        seat = Some(Seat { hosted, timer: clock::now() });
                    }
                    // What came after a hello that was refused.
                    (None, _) => {}
                }
            }
            match &mut seat {
                Some(seat) if turn.due => seat.hosted.due(&self.host, clock::now()),
                Some(_) => Ok(()),
                None => Err(Over { reason: "never_opened", error: None }),
            }
        }));
        let over = match worked {
            Ok(Ok(())) => None,
            Ok(Err(over)) => Some(over),
            Err(_) => {
                self.host.metrics.panics.inc();
                tracing::error!(session = handle.short(), "a fault of the server ends this session");
                let message = "a fault of the server has ended this session".to_owned();
                let error = Some(Error { code: ErrorCode::Internal, message, fatal: true });
                Some(Over { reason: "fault", error })
            }
        };
        match (over, seat) {
            (None, Some(mut seat)) => {
                seat.timer = seat.hosted.timer(&self.host);
                self.timers.insert((seat.timer, handle.number));
                self.sessions.insert(handle.number, seat);
            }
            (over, seat) => {
                // From now on the address may open another.
                self.host.forget(handle);
                if let (Some(over), Some(seat)) = (over, seat) {
                    let ended = catch_unwind(AssertUnwindSafe(|| seat.hosted.end(&self.host, over)));
                    if ended.is_err() {
                        self.host.metrics.panics.inc();
                    }
                }
            }
        }
    }
}
