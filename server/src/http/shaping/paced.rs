//! A link and the responses that cross it, without a clock.

use std::collections::BTreeMap;

use foresight_scheduler::units::Time;
use foresight_traces::link::{LinkTrace, SharedLink};

/// A response on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ticket {
    id: u64,
    /// When its first byte comes.
    pub(super) joins: Time,
    /// Bytes that cross the link.
    pub(super) bytes: u64,
    /// It breaks off after them.
    pub(super) breaks: bool,
}

/// How far a response has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crossed {
    /// Bytes.
    pub(super) bytes: u64,
    /// All that will come has come.
    pub(super) over: bool,
    /// When something on the link joins or ends next.
    pub(super) next: Option<Time>,
}

/// The link of a session: the simulator's own, its time zero at the session's first view. Places of responses that are over
/// are used again, so it holds no more of them than were ever under way at once.
#[derive(Debug)]
pub(super) struct PacedLink {
    link: SharedLink,
    /// By id: whether the response is over.
    over: Vec<bool>,
    free: Vec<u64>,
    /// How often each representation was asked for, on a link on which requests fail.
    attempts: BTreeMap<u64, u64>,
    ended: Vec<(u64, Time)>,
}

impl PacedLink {
    pub(super) fn new(trace: &LinkTrace) -> PacedLink {
        PacedLink {
            link: SharedLink::new(trace, Time::ZERO),
            over: Vec::new(),
            free: Vec::new(),
            attempts: BTreeMap::new(),
            ended: Vec::new(),
        }
    }

    /// Begins a response of `bytes`. `rep` is the representation that it holds: whether it breaks off, and where, depends on
    /// that and on how often it was asked for, as in the simulator. What holds none does not break off.
    pub(super) fn start(&mut self, rep: Option<u32>, bytes: u64, now: Time) -> Ticket {
        self.advance(now);
        let mut breaks_after = None;
        if let Some(rep) = rep.map(u64::from)
            && self.link.trace().loss() > 0.0
        {
            let attempts = self.attempts.entry(rep).or_default();
            *attempts += 1;
            breaks_after = self.link.trace().breaks_after(rep, *attempts, bytes);
        }
        let id = self.free.pop().unwrap_or_else(|| {
            self.over.push(true);
            self.over.len() as u64 - 1
        });
        let crossing = breaks_after.unwrap_or(bytes);
        self.over[id as usize] = false;
        self.link.start(id, crossing, now);
        let at = self.link.now();
        Ticket { id, joins: at + self.link.trace().rtt_at(at), bytes: crossing, breaks: breaks_after.is_some() }
    }

    /// How far the response has come by `now`.
    pub(super) fn crossed(&mut self, ticket: Ticket, now: Time) -> Crossed {
        self.advance(now);
        let over = self.over[ticket.id as usize];
        let bytes = if over { ticket.bytes } else { self.link.delivered(ticket.id).min(ticket.bytes) };
        Crossed { bytes, over, next: self.link.next_event() }
    }

    /// Takes the response off the link if it is still on it; the ticket is void afterwards.
    pub(super) fn end(&mut self, ticket: Ticket, now: Time) {
        self.link.cancel(ticket.id, now);
        self.advance(now);
        self.over[ticket.id as usize] = true;
        self.free.push(ticket.id);
    }

    fn advance(&mut self, now: Time) {
        self.link.advance(now, &mut self.ended);
        for (id, _) in self.ended.drain(..) {
            self.over[id as usize] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    fn megabytes_a_second(rtt_ms: u64) -> LinkTrace {
        LinkTrace::constant("test", 8_000_000, Time(rtt_ms * MS)).unwrap()
    }

    #[test]
    fn two_responses_share_the_link() {
        let mut link = PacedLink::new(&megabytes_a_second(40));
        let first = link.start(None, 100_000, Time::ZERO);
        assert_eq!((first.joins, first.breaks), (Time(40 * MS), false));
        assert_eq!(link.crossed(first, Time(40 * MS)), Crossed { bytes: 0, over: false, next: Some(Time(140 * MS)) });
        // 50 kB have crossed when the second joins; each has half of the link from then on.
        let second = link.start(None, 30_000, Time(50 * MS));
        assert_eq!(second.joins, Time(90 * MS));
        assert_eq!(link.crossed(first, Time(90 * MS)).bytes, 50_000);
        assert_eq!(link.crossed(second, Time(110 * MS)).bytes, 10_000);
        assert_eq!(link.crossed(first, Time(110 * MS)).bytes, 60_000);
        assert_eq!(
            link.crossed(second, Time(150 * MS)),
            Crossed { bytes: 30_000, over: true, next: Some(Time(170 * MS)) }
        );
        assert_eq!(link.crossed(first, Time(170 * MS)), Crossed { bytes: 100_000, over: true, next: None });
    }

    #[test]
    fn a_client_that_goes_away_frees_the_link() {
        let mut link = PacedLink::new(&megabytes_a_second(0));
        let (first, second) = (link.start(None, 100_000, Time::ZERO), link.start(None, 100_000, Time::ZERO));
        link.end(first, Time(100 * MS));
        assert_eq!(link.crossed(second, Time(150 * MS)), Crossed { bytes: 100_000, over: true, next: None });
        // A place is used again, by a response that begins from nothing.
        let third = link.start(None, 1000, Time(150 * MS));
        assert_eq!(third.id, first.id);
        assert_eq!(link.crossed(third, Time(150 * MS + MS / 2)).bytes, 500);
        assert_eq!(link.over.len(), 2);
    }

    #[test]
    fn what_breaks_off_is_what_the_simulator_breaks_off() {
        let trace = megabytes_a_second(0).with_loss(0.5, 1).unwrap();
        let mut link = PacedLink::new(&trace);
        for attempt in 1..=20 {
            let ticket = link.start(Some(7), 1000, Time::ZERO);
            let breaks = trace.breaks_after(7, attempt, 1000);
            assert_eq!((ticket.breaks, ticket.bytes), (breaks.is_some(), breaks.unwrap_or(1000)));
        }
        assert!(!link.start(None, 1000, Time::ZERO).breaks);
    }

    proptest! {
        /// Bytes never pass what the link has delivered, all come in the end, and how often it is asked changes nothing.
        #[test]
        fn bytes_are_the_link_s(
            sizes in proptest::collection::vec((0u64..200_000, 0u64..300), 1..12),
            asked in proptest::collection::vec(0u64..2_000, 0..40),
        ) {
            let trace = megabytes_a_second(30);
            let mut link = PacedLink::new(&trace);
            let mut alone = SharedLink::new(&trace, Time::ZERO);
            let mut starts = sizes;
            starts.sort_by_key(|&(_, at)| at);
            let mut asked = asked;
            asked.sort_unstable();
            let mut asked = asked.into_iter().peekable();
            let mut tickets: Vec<Ticket> = Vec::new();
            for (index, &(bytes, at)) in starts.iter().enumerate() {
                while let Some(ms) = asked.next_if(|&ms| ms < at) {
                    let crossed: u64 = tickets.iter().map(|&t| link.crossed(t, Time(ms * MS)).bytes).sum();
                    prop_assert!(crossed <= ms * 1000);
                }
                tickets.push(link.start(None, bytes, Time(at * MS)));
                alone.start(index as u64, bytes, Time(at * MS));
            }
            let mut ends = Vec::new();
            alone.advance(Time(20_000 * MS), &mut ends);
            prop_assert_eq!(ends.len(), tickets.len());
            for (id, at) in ends {
                let ticket = tickets[id as usize];
                prop_assert!(link.crossed(ticket, at).over);
                prop_assert_eq!(link.crossed(ticket, at).bytes, starts[id as usize].0);
            }
        }
    }
}
