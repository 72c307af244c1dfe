//! Session time from two clocks that may jump.
//!
//! Session time is the client's time as long as that stays within [`DRIFT_MAX_NS`] of the server's clock, counted from the
//! `hello`. Where it does not (the client was suspended, its clock was set, its messages were held up), it is anchored
//! anew: from then on the client's time plus an offset. It never decreases. It depends on nothing but the sequence of
//! (received, said) times, so a recording of these replays to the same times.

use foresight_scheduler::units::Time;

/// Farthest that session time may be from the server's clock, ns.
pub const DRIFT_MAX_NS: u64 = 2_000_000_000;

/// Where session time stands.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clock {
    /// Session time minus client time, ns.
    offset: i128,
    /// Latest session time.
    latest: u64,
    /// Latest time of the server's clock.
    received: u64,
    /// Session time minus the server's clock, at the last message that bore a time, ns.
    ahead: i128,
    /// How often it was anchored anew.
    jumps: u64,
}

/// A clock was anchored anew: what the client said and where session time is instead, seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Jump {
    pub(super) said_s: f64,
    pub(super) taken_s: f64,
}

impl Clock {
    /// Something came at this time of the server's clock, which never decreases: what does is taken as no later.
    pub(super) fn received(&mut self, received_ns: u64) {
        self.received = self.received.max(received_ns);
    }

    /// Session time of an event that the client says was at `t_ns`.
    pub(super) fn event(&mut self, t_ns: u64) -> (Time, Option<Jump>) {
        let mut at = i128::from(t_ns) + self.offset;
        let received = i128::from(self.received);
        let mut jump = None;
        if (at - received).unsigned_abs() > u128::from(DRIFT_MAX_NS) {
            at = received.max(i128::from(self.latest));
            let taken = at - i128::from(t_ns);
            // Held back at the latest time that is allowed, the offset moves on with every message: that is one jump.
            if taken != self.offset {
                self.offset = taken;
                self.jumps += 1;
                jump = Some(Jump { said_s: t_ns as f64 * 1e-9, taken_s: at as f64 * 1e-9 });
            }
        }
        self.ahead = at - received;
        (self.pass(at), jump)
    }

    /// Session time now, where the client has said nothing: the server's clock, as far ahead or behind as it was.
    pub(super) fn now(&mut self) -> Time {
        self.pass(i128::from(self.received) + self.ahead)
    }

    fn pass(&mut self, at: i128) -> Time {
        let at = u64::try_from(at.max(0)).unwrap_or(u64::MAX);
        self.latest = self.latest.max(at);
        Time(self.latest)
    }

    /// Latest session time.
    pub(super) fn latest(&self) -> Time {
        Time(self.latest)
    }

    /// Session time of something that lies ahead or behind by the client's clock; no event, so it moves nothing.
    pub(super) fn at(&self, t_ns: u64) -> Time {
        Time(u64::try_from((i128::from(t_ns) + self.offset).max(0)).unwrap_or(u64::MAX))
    }

    /// The client's time of a session time, ns.
    pub(super) fn on_client(&self, at: Time) -> u64 {
        u64::try_from((i128::from(at.0) - self.offset).max(0)).unwrap_or(u64::MAX)
    }

    /// The server's clock at a session time, ns.
    pub(super) fn on_server(&self, at: Time) -> u64 {
        u64::try_from((i128::from(at.0) - self.ahead).max(0)).unwrap_or(u64::MAX)
    }

    /// How often it was anchored anew.
    pub(super) fn jumps(&self) -> u64 {
        self.jumps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn said(clock: &mut Clock, received_s: u64, t_s: u64) -> u64 {
        clock.received(received_s * SECOND);
        clock.event(t_s * SECOND).0.0 / SECOND
    }

    #[test]
    fn the_clients_time_holds_while_it_stays_near() {
        let mut clock = Clock::default();
        assert_eq!([(0, 0), (3, 2), (3, 4), (9, 8)].map(|(r, t)| said(&mut clock, r, t)), [0, 2, 4, 8]);
        assert_eq!(clock.jumps(), 0);
        // Out of order, but near: never back.
        assert_eq!(said(&mut clock, 9, 7), 8);
        assert_eq!(clock.on_client(Time(8 * SECOND)), 8 * SECOND);
    }

    #[test]
    fn jumps_either_way_anchor_anew() {
        let mut clock = Clock::default();
        said(&mut clock, 10, 10);
        // Set forward by an hour, then back.
        assert_eq!([(11, 3611), (12, 3612), (13, 13), (14, 14)].map(|(r, t)| said(&mut clock, r, t)), [11, 12, 13, 14]);
        assert_eq!(clock.jumps(), 2);
        assert_eq!(clock.at(15 * SECOND), Time(15 * SECOND));
    }

    #[test]
    fn what_was_held_up_is_taken_when_it_comes() {
        let mut clock = Clock::default();
        said(&mut clock, 1, 1);
        // Half a minute of messages at once: session time waits for the server's clock.
        let times: Vec<u64> = (2..=31).map(|t| said(&mut clock, 31, t)).collect();
        assert!(times.iter().all(|&t| (31..=33).contains(&t)), "{times:?}");
        assert_eq!(said(&mut clock, 40, 40), 40);
    }

    #[test]
    fn extremes_saturate() {
        let mut clock = Clock::default();
        for (received, t) in [(0, u64::MAX), (u64::MAX, 0), (0, u64::MAX), (u64::MAX, u64::MAX)] {
            clock.received(received);
            let (at, _) = clock.event(t);
            assert_eq!(at, clock.latest());
        }
        assert_eq!(clock.now(), Time(u64::MAX));
    }
}
