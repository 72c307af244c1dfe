//! Responses at the pace of a link: each session has a link of its own, the simulator's, on the real clock.
//!
//! The head of a response leaves one round trip after the request came, its bytes as the link delivers them; transfers of
//! one session share its link in equal parts, whatever their priority, as they do in the simulator. A response breaks off
//! where a link with `loss=` says so. All requests that name no session, or none that is open, share one further link, whose
//! time begins with the first of them.

mod paced;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use foresight_scheduler::units::Time;
use foresight_traces::link::LinkTrace;

use self::paced::{PacedLink, Ticket};
use crate::clock;

/// Bytes are let go at most so often for each response, and when it ends.
const PACE: Duration = Duration::from_millis(2);

/// The links of all sessions.
#[derive(Debug)]
pub struct Links {
    trace: LinkTrace,
    sessions_max: usize,
    sessions: Mutex<BTreeMap<String, Arc<SessionLink>>>,
    rest: Arc<SessionLink>,
}

#[derive(Debug)]
struct SessionLink {
    begun: OnceLock<Instant>,
    paced: Mutex<PacedLink>,
}

impl SessionLink {
    fn new(trace: &LinkTrace) -> Arc<SessionLink> {
        Arc::new(SessionLink { begun: OnceLock::new(), paced: Mutex::new(PacedLink::new(trace)) })
    }

    /// The link and its time at `at`, which becomes its time zero if it has none.
    fn at(&self, at: Instant) -> (MutexGuard<'_, PacedLink>, Time) {
        let begun = *self.begun.get_or_init(|| at);
        (self.paced.lock().unwrap_or_else(PoisonError::into_inner), Time(clock::nanos(begun, at)))
    }

    fn instant(&self, time: Time) -> Option<Instant> {
        self.begun.get().and_then(|begun| begun.checked_add(Duration::from_nanos(time.0)))
    }
}

impl Links {
    /// A link like `trace` for each of at most `sessions_max` sessions.
    pub fn new(trace: LinkTrace, sessions_max: usize) -> Links {
        Links { rest: SessionLink::new(&trace), trace, sessions_max, sessions: Mutex::default() }
    }

    /// The link that all are like.
    pub fn trace(&self) -> &LinkTrace {
        &self.trace
    }

    /// Gives a session a link. False if there are as many as may be; the session then shares that of the rest. One that is
    /// open keeps its link.
    pub fn open(&self, session: &str) -> bool {
        let mut sessions = self.lock();
        if sessions.contains_key(session) {
            return true;
        }
        if sessions.len() >= self.sessions_max {
            return false;
        }
        sessions.insert(session.to_owned(), SessionLink::new(&self.trace));
        true
    }

    /// Lets the time of a session's link begin, with its first view. It begins with the session's first request if that comes
    /// earlier, and only once.
    pub fn begin(&self, session: &str, at: Instant) {
        if let Some(link) = self.lock().get(session) {
            link.begun.get_or_init(|| at);
        }
    }

    /// Forgets a session's link. Responses that are on it go on at its pace.
    pub fn close(&self, session: &str) {
        self.lock().remove(session);
    }

    /// Begins a response of `bytes` that was asked for at `at`; `rep` is the representation that it holds.
    pub(super) fn start(&self, session: Option<&str>, rep: Option<u32>, bytes: u64, at: Instant) -> Transfer {
        let link = session.and_then(|session| self.lock().get(session).cloned()).unwrap_or_else(|| self.rest.clone());
        let (mut paced, now) = link.at(at);
        let ticket = paced.start(rep, bytes, now);
        drop(paced);
        Transfer { link, ticket, last: Time::ZERO }
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, Arc<SessionLink>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A response on a link. It leaves the link when this is dropped.
#[derive(Debug)]
pub(super) struct Transfer {
    link: Arc<SessionLink>,
    ticket: Ticket,
    /// When bytes were let go last.
    last: Time,
}

/// What may be sent of a response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Released {
    /// So many of its bytes.
    pub(super) bytes: u64,
    /// No more will come: it breaks off here.
    pub(super) breaks: bool,
}

impl Transfer {
    /// Waits for the moment at which the first byte comes.
    pub(super) async fn first_byte(&self) {
        sleep_until(self.link.instant(self.ticket.joins)).await;
    }

    /// Lets what was handed over reach the client before the response breaks off.
    pub(super) async fn settle(&self) {
        tokio::time::sleep(PACE).await;
    }

    /// Waits until more than `sent` bytes may be sent, or no more will come.
    pub(super) async fn released(&mut self, sent: u64) -> Released {
        loop {
            let wake = {
                let (mut paced, now) = self.link.at(clock::now());
                let crossed = paced.crossed(self.ticket, now);
                let due = self.last + Time(PACE.as_nanos() as u64);
                if crossed.over || (crossed.bytes > sent && now >= due) {
                    self.last = now;
                    return Released { bytes: crossed.bytes, breaks: crossed.over && self.ticket.breaks };
                }
                let pace = if now >= due { now + Time(PACE.as_nanos() as u64) } else { due };
                crossed.next.map_or(pace, |next| next.min(pace).max(now + Time(1)))
            };
            sleep_until(self.link.instant(wake)).await;
        }
    }
}

impl Drop for Transfer {
    fn drop(&mut self) {
        let (mut paced, now) = self.link.at(clock::now());
        paced.end(self.ticket, now);
    }
}

/// For ever if there is no such instant.
async fn sleep_until(instant: Option<Instant>) {
    match instant {
        Some(instant) => tokio::time::sleep_until(instant.into()).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_have_links_of_their_own() {
        let links = Links::new(LinkTrace::constant("test", 8_000_000, Time::ZERO).unwrap(), 2);
        let begun = clock::now();
        assert!(links.open("a") && links.open("b") && links.open("a"));
        assert!(!links.open("c"));
        links.begin("a", begun);
        links.begin("b", begun);
        let at = begun + Duration::from_millis(10);
        let transfers = ["a", "b", "c", "d"].map(|session| links.start(Some(session), None, 10_000, at));
        let later = |transfer: &Transfer, ms| {
            let (mut paced, now) = transfer.link.at(at + Duration::from_millis(ms));
            paced.crossed(transfer.ticket, now).bytes
        };
        // 1 kB/ms each for `a` and `b`; what has no link of its own shares one.
        assert_eq!(transfers.each_ref().map(|transfer| later(transfer, 4)), [4000, 4000, 2000, 2000]);
        links.close("a");
        assert!(links.open("c"));
        assert_eq!(later(&transfers[0], 10), 10_000);
    }
}
