//! Requests on a modelled link, for load without content: the server decides as for a client that fetches.

use crate::fetch::{Step, TransferEvent};
use bytes::Bytes;
use foresight_scheduler::units::Time;
use foresight_traces::link::LinkTrace;
use foresight_traces::link::shared::SharedLink;
use std::collections::{BTreeMap, VecDeque};

/// Requests of one session as its own link would carry them. Time zero is that of the link.
#[derive(Debug)]
pub struct ModelledRequests {
    link: SharedLink,
    rep_of: BTreeMap<u64, u32>,
    id_of: BTreeMap<u32, u64>,
    joining: BTreeMap<(Time, u64), u32>,
    next_id: u64,
    events: VecDeque<TransferEvent>,
}

impl ModelledRequests {
    /// An idle link.
    pub fn new(link: &LinkTrace) -> ModelledRequests {
        ModelledRequests {
            link: SharedLink::new(link, Time::ZERO),
            rep_of: BTreeMap::new(),
            id_of: BTreeMap::new(),
            joining: BTreeMap::new(),
            next_id: 0,
            events: VecDeque::new(),
        }
    }

    /// Begins a request of `wire_bytes`.
    pub fn start(&mut self, rep: u32, wire_bytes: u64, at_ns: u64) {
        self.abort(rep, at_ns);
        let (id, now) = (self.next_id, self.link.now().max(Time(at_ns)));
        self.next_id += 1;
        self.joining.insert((now + self.link.trace().rtt_at(now), id), rep);
        self.link.start(id, wire_bytes, now);
        self.rep_of.insert(id, rep);
        self.id_of.insert(rep, id);
    }

    /// Aborts a request.
    pub fn abort(&mut self, rep: u32, at_ns: u64) {
        if let Some(id) = self.id_of.remove(&rep) {
            self.rep_of.remove(&id);
            self.link.cancel(id, Time(at_ns));
        }
    }

    /// Lets the link carry until `now_ns`.
    pub fn advance(&mut self, now_ns: u64) {
        let now = Time(now_ns);
        let mut ended = Vec::new();
        self.link.advance(now, &mut ended);
        let mut events = Vec::new();
        while let Some(first) = self.joining.first_entry().filter(|first| first.key().0 <= now) {
            let ((at, id), rep) = first.remove_entry();
            if self.rep_of.contains_key(&id) {
                events.push(TransferEvent { at_ns: at.0, rep, step: Step::Responded });
            }
        }
        for (id, at) in ended {
            if let Some(rep) = self.rep_of.remove(&id) {
                self.id_of.remove(&rep);
                events.push(TransferEvent { at_ns: at.0, rep, step: Step::Ended(Ok(Bytes::new())) });
            }
        }
        // The sort is stable: of one request, the response stays before the end.
        events.sort_by_key(|event| event.at_ns);
        self.events.extend(events);
    }

    /// The next event up to the time last told.
    pub fn poll(&mut self) -> Option<TransferEvent> {
        self.events.pop_front()
    }

    /// Bytes received since the start, and of these those of requests under way.
    pub fn bytes(&self) -> (u64, u64) {
        let in_flight = self.rep_of.keys().map(|&id| self.link.delivered(id)).sum();
        (self.link.total_delivered(), in_flight)
    }
}
