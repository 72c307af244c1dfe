//! A session whose camera is moved by hand and whose contents are drawn.

use super::{FlightError, Leave, Plan, Session, Transport};
use crate::camera::Eye;
use crate::clock::Clock;
use crate::exchange::{Exchange, Fate, Fetching, Link, Status};
use crate::fetch::Http;
use crate::summary::Summary;
use foresight_traces::flight::tick_time;
use foresight_wire::message::Fetch;

/// A session that is drawn.
pub struct Drawn<'a> {
    /// What it has in common with others.
    pub plan: &'a Plan,
    /// Representations of the world that is drawn: a server's world with another number is another world.
    pub representations: usize,
    /// Where the camera is and contents go.
    pub exchange: &'a Exchange,
    /// The program's clock.
    pub clock: Clock,
    /// HTTP.
    pub http: Http,
}

/// Ticks from one status to the next.
const TICKS_PER_STATUS: u64 = 6;

/// Has it drawn until [`Exchange::leave`].
///
/// # Errors
/// When the server cannot be reached in the beginning, or refuses the session for good.
pub async fn fly_drawn(drawn: Drawn<'_>) -> Result<Summary, FlightError> {
    let Drawn { plan, representations, exchange, clock, http } = drawn;
    let new = Session::new(plan, Eye::Hand(exchange), Some(exchange), clock, http);
    let mut session = Session { representations: Some(representations), ..new };
    session.begin().await?;
    let mut tick = 0;
    while !exchange.is_left() {
        let due = session.zero_ns + tick_time(tick as u64).0;
        tokio::select! {
            biased;
            incoming = session.connection.next() => session.hear(incoming)?,
            () = session.clock.sleep_until(due) => {
                session.tick(tick)?;
                if (tick as u64).is_multiple_of(TICKS_PER_STATUS) {
                    exchange.set_status(session.status());
                }
                tick = session.next_tick(tick);
            }
        }
    }
    Ok(session.finish(tick, Leave::Bye).await?.0)
}

impl Session<'_> {
    /// What has become of what was given to whoever draws.
    pub(super) fn hear_screen(&mut self, now: u64) {
        for told in self.exchange.map(Exchange::hear).unwrap_or_default() {
            match told.fate {
                Fate::Shown => self.residency.uploaded(told.rep),
                Fate::Broken(reason) => self.residency.fail(told.rep, now, reason),
                Fate::Lost => self.residency.lose(told.rep, now),
            }
            self.abort();
        }
    }

    /// How things stand, for whoever draws.
    fn status(&self) -> Status {
        let received = |rep| match &self.transport {
            Transport::Http(requests) => requests.received(rep),
            Transport::Modelled(_) => 0,
        };
        let fetching = self.wanted.values().map(|fetch| Fetching {
            rep: fetch.rep,
            bytes: fetch.wire_bytes,
            received: received(fetch.rep),
            why: why(fetch),
        });
        let link = match &self.welcome {
            Some(_) => Link::Connected,
            None => Link::Away { why: self.away.clone() },
        };
        Status {
            link,
            policy: self.summary.policy.clone(),
            quality: self.quality.2,
            estimate: self.summary.link,
            received: self.bytes().0,
            memory: self.residency.used_bytes(),
            budget: self.plan.memory,
            fetching: fetching.collect(),
            waiting: self.waiting.clone(),
            failed: self.failed.values().sum(),
            failure: self.failure.clone(),
        }
    }
}

/// Why the server wants something, in words: RFC 9218's urgency as the protocol has it.
fn why(fetch: &Fetch) -> String {
    let urgency = match fetch.urgency {
        0 => "in view, and nothing is there yet",
        1 => "in view, and better than what is there",
        2 => "in view, mostly in case of a surprise",
        3..=4 => "on the path ahead",
        5..=6 => "on the path or beside it",
        _ => "in case of a surprise",
    };
    let share = fetch.predicted_share.map(|share| format!(", {:.0} % for the path", 100.0 * share));
    format!("{urgency}{}", share.unwrap_or_default())
}
