//! Session time from two clocks that may jump.
//!
//! Session time is the client's time plus an offset, 0 to begin with, as long as that stays within [`DRIFT_MAX_NS`] of the
//! server's clock, which counts from the `hello`. An event whose time does not is a stray: it is taken as happening when
//! it comes. Messages that were held up are strays until they have caught up. Where strays keep coming for [`STRAY_NS`], the
//! client's clock has jumped (it was set, or the client was suspended), and the offset is made anew; at the first event at
//! once. Session time never decreases. It depends on nothing but the sequence of (received, said) times, so a recording of
//! these replays to the same times.

use foresight_scheduler::units::Time;

/// Farthest that session time may be from the server's clock, ns.
pub const DRIFT_MAX_NS: u64 = 2_000_000_000;
/// How long strays have to come before the offset is made anew, ns.
const STRAY_NS: u64 = 1_000_000_000;

/// Where session time stands.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Clock {
    /// Session time minus client time, ns; `None` before the first event.
    offset: Option<i128>,
    /// Latest session time.
    latest: u64,
    /// Latest time of the server's clock.
    received: u64,
    /// Session time minus the server's clock, at the last message that bore a time, ns.
    ahead: i128,
    /// The server's clock at the first stray in a row.
    stray_since: Option<u64>,
    /// How often strays began.
    jumps: u64,
}

/// Strays have begun: what the client said and what it was taken for, seconds.
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
        let (said, received) = (i128::from(t_ns), i128::from(self.received));
        let mut at = said + self.offset.unwrap_or(0);
        let mut jump = None;
        if (at - received).unsigned_abs() <= u128::from(DRIFT_MAX_NS) {
            self.offset.get_or_insert(0);
            self.stray_since = None;
        } else {
            at = received;
            if self.stray_since.is_none() {
                self.jumps += 1;
                jump = Some(Jump { said_s: t_ns as f64 * 1e-9, taken_s: at as f64 * 1e-9 });
            }
            let since = *self.stray_since.get_or_insert(self.received);
            if self.offset.is_none() || self.received - since >= STRAY_NS {
                self.offset = Some(received - said);
                self.stray_since = None;
            }
        }
        self.ahead = at - received;
        (self.pass(at), jump)
    }

    /// Session time now, where the client has said nothing: the server's clock, as far ahead or behind as it was.
    pub(super) fn now(&mut self) -> Time {
        self.pass(i128::from(self.received) + self.ahead)
    }

    /// The same, and it moves nothing.
    pub(super) fn about_now(&self) -> Time {
        Clock { ..*self }.now()
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
        Time(u64::try_from((i128::from(t_ns) + self.offset.unwrap_or(0)).max(0)).unwrap_or(u64::MAX))
    }

    /// The client's time of a session time, ns.
    pub(super) fn on_client(&self, at: Time) -> u64 {
        u64::try_from((i128::from(at.0) - self.offset.unwrap_or(0)).max(0)).unwrap_or(u64::MAX)
    }

    /// The server's clock at a session time, ns.
    pub(super) fn on_server(&self, at: Time) -> u64 {
        u64::try_from((i128::from(at.0) - self.ahead).max(0)).unwrap_or(u64::MAX)
    }

    /// How often the client's clock has left the server's.
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
    fn jumps_either_way_are_followed() {
        let mut clock = Clock::default();
        said(&mut clock, 10, 10);
        // Set forward by an hour, then back: taken when it comes, until that has lasted.
        assert_eq!([(11, 3611), (12, 3612), (13, 3614)].map(|(r, t)| said(&mut clock, r, t)), [11, 12, 14]);
        assert_eq!(clock.at(3615 * SECOND), Time(15 * SECOND));
        assert_eq!([(15, 15), (16, 16), (17, 18)].map(|(r, t)| said(&mut clock, r, t)), [15, 16, 18]);
        assert_eq!((clock.jumps(), clock.at(19 * SECOND)), (2, Time(19 * SECOND)));
        // A first time of another epoch.
        let mut clock = Clock::default();
        assert_eq!([(1, 1_000_000), (2, 1_000_001)].map(|(r, t)| said(&mut clock, r, t)), [1, 2]);
        assert_eq!((clock.jumps(), clock.on_client(Time(3 * SECOND))), (1, 1_000_002 * SECOND));
    }

    #[test]
    fn what_was_held_up_is_taken_when_it_comes() {
        let mut clock = Clock::default();
        said(&mut clock, 1, 1);
        // Half a minute of messages at once.
        let times: Vec<u64> = (2..=31).map(|t| said(&mut clock, 31, t)).collect();
        assert!(times.iter().all(|&t| t == 31), "{times:?}");
        assert_eq!((said(&mut clock, 40, 40), clock.jumps()), (40, 1));
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
