//! Transfers that share a link in equal parts.

use std::collections::{BTreeMap, BTreeSet};

use foresight_scheduler::units::Time;

use super::{LinkTrace, NANO_BITS_PER_BYTE};

/// Processor sharing of a link among transfers, exact.
///
/// With n transfers on the link each receives 1/n of what it delivers. The arithmetic is that of fair queueing: the
/// *level* is the work that every transfer on the link since the beginning would have received; a transfer that
/// joins at level v ends at level v + its size, and n transfers raise the level by one nano-bit for n of the link.
/// Levels are integers; what does not divide by n is carried. A completion happens at an exact amount of
/// work, within a nanosecond, and what remains of that nanosecond (or delivery opportunity) goes to the others; only
/// its reported time is rounded up. So neither how often the link is advanced nor the order of calls at one
/// instant changes a completion, and n transfers begun together end at τ + c·(Σ_{j≤k} M_j + (n−k)·M_k).
///
/// A transfer joins one round trip after it was started, the round trip of that moment. Capacity at the very instant of
/// joining is not for it.
#[derive(Clone, Debug)]
pub struct SharedLink {
    trace: LinkTrace,
    now: Time,
    /// Every transfer begun, by id.
    transfers: BTreeMap<u64, Transfer>,
    /// Started and not joined yet, by time of joining; ids that were cancelled since are skipped.
    joining: BTreeSet<(Time, u64)>,
    /// Transfers on the link by the level at which they end, then by id.
    ends: BTreeSet<(u128, u64)>,
    /// Level, in nano-bits, at work `at` of the trace, reached at `at_time`.
    level: u128,
    at: u128,
    at_time: Time,
    /// Work delivered up to `at` that no transfer has received, less than the number of transfers.
    carried: u128,
    /// Work delivered up to `at` to transfers, `carried` included.
    delivered: u128,
    /// When the next transfer ends if none joins before; [`Time::NEVER`] if there is none.
    next_end: Time,
    /// Ended, not yet handed out.
    ended: Vec<(u64, Time)>,
}

#[derive(Clone, Copy, Debug)]
enum Transfer {
    Joining { joins: Time, bytes: u64 },
    OnLink { joined_level: u128, ends_level: u128 },
    Over { bytes: u64 },
}

impl SharedLink {
    /// An idle link whose time zero lies at `start` of the trace.
    pub fn new(trace: &LinkTrace, start: Time) -> SharedLink {
        SharedLink {
            trace: trace.shifted(start),
            now: Time::ZERO,
            transfers: BTreeMap::new(),
            joining: BTreeSet::new(),
            ends: BTreeSet::new(),
            level: 0,
            at: 0,
            at_time: Time::ZERO,
            carried: 0,
            delivered: 0,
            next_end: Time::NEVER,
            ended: Vec::new(),
        }
    }

    /// The link, time zero where this one's lies.
    pub fn trace(&self) -> &LinkTrace {
        &self.trace
    }

    /// Begins a transfer of `bytes`, which joins the link at `now` + the round trip there. A `now` before the latest call counts
    /// as that. False, and nothing happens, if a transfer of this id is under way.
    pub fn start(&mut self, id: u64, bytes: u64, now: Time) -> bool {
        if matches!(self.transfers.get(&id), Some(Transfer::Joining { .. } | Transfer::OnLink { .. })) {
            return false;
        }
        self.settle(now);
        let joins = self.now + self.trace.rtt_at(self.now);
        self.transfers.insert(id, Transfer::Joining { joins, bytes });
        self.joining.insert((joins, id));
        true
    }

    /// Ends a transfer early and answers the bytes that it has received, rounded down; these stay charged to the link.
    /// A transfer that has ended by `now` keeps all its bytes, and its completion is still reported. 0 for an unknown id.
    pub fn cancel(&mut self, id: u64, now: Time) -> u64 {
        self.settle(now);
        let bytes = self.delivered(id);
        match self.transfers.get(&id).copied() {
            None | Some(Transfer::Over { .. }) => return bytes,
            Some(Transfer::Joining { .. }) => {}
            Some(Transfer::OnLink { ends_level, .. }) => {
                self.raise_level(self.now);
                self.ends.remove(&(ends_level, id));
                self.spread_carried();
                self.find_next_end();
            }
        }
        self.transfers.insert(id, Transfer::Over { bytes });
        self.settle(now);
        bytes
    }

    /// When the next transfer joins or ends. Earlier than the latest call if completions wait to be handed out.
    pub fn next_event(&self) -> Option<Time> {
        if let Some(&(_, at)) = self.ended.first() {
            return Some(at);
        }
        let next = self.joining.first().map_or(self.next_end, |&(joins, _)| joins.min(self.next_end));
        (next != Time::NEVER).then_some(next)
    }

    /// Proceeds to `now` and appends the transfers that ended, by time, then by id.
    pub fn advance(&mut self, now: Time, completions: &mut Vec<(u64, Time)>) {
        self.settle(now);
        self.ended.sort_unstable_by_key(|&(id, at)| (at, id));
        completions.append(&mut self.ended);
    }

    /// Bytes that a transfer has received, rounded down; also after its end. 0 for an unknown id.
    pub fn delivered(&self, id: u64) -> u64 {
        match self.transfers.get(&id) {
            None | Some(Transfer::Joining { .. }) => 0,
            Some(&Transfer::Over { bytes }) => bytes,
            Some(&Transfer::OnLink { joined_level, .. }) => {
                let (level, _) = self.level_at(self.trace.work_until(self.now));
                ((level - joined_level) / NANO_BITS_PER_BYTE) as u64
            }
        }
    }

    /// Bytes that have crossed the link, rounded down once: the sum over all transfers, cancelled ones included, of
    /// what they received before rounding.
    pub fn total_delivered(&self) -> u64 {
        u64::try_from(self.total_work() / NANO_BITS_PER_BYTE).unwrap_or(u64::MAX)
    }

    /// What has crossed the link, nano-bits.
    pub fn total_work(&self) -> u128 {
        if self.ends.is_empty() { self.delivered } else { self.delivered + self.trace.work_until(self.now) - self.at }
    }

    /// The latest time that the link was told.
    pub fn now(&self) -> Time {
        self.now
    }

    /// Transfers that share the link.
    pub fn active(&self) -> usize {
        self.ends.len()
    }

    fn still_joins(&self, joins: Time, id: u64) -> bool {
        matches!(self.transfers.get(&id), Some(&Transfer::Joining { joins: j, .. }) if j == joins)
    }

    /// Handles every event up to `now`, which becomes the present. Afterwards the first of `joining` does join.
    fn settle(&mut self, now: Time) {
        let now = now.max(self.now);
        loop {
            while self.joining.first().is_some_and(|&(joins, id)| !self.still_joins(joins, id)) {
                self.joining.pop_first();
            }
            let join = self.joining.first().copied().filter(|&(joins, _)| joins <= now);
            match join {
                // An end within the nanosecond before a join comes first.
                Some((joins, id)) if joins < self.next_end => {
                    self.joining.pop_first();
                    self.join(id, joins);
                }
                _ if self.next_end <= now && self.next_end != Time::NEVER => self.end_next(),
                _ => break,
            }
        }
        self.now = now;
    }

    fn join(&mut self, id: u64, at: Time) {
        let Some(&Transfer::Joining { bytes, .. }) = self.transfers.get(&id) else { return };
        self.raise_level(at);
        let ends_level = self.level + u128::from(bytes) * NANO_BITS_PER_BYTE;
        self.transfers.insert(id, Transfer::OnLink { joined_level: self.level, ends_level });
        self.ends.insert((ends_level, id));
        self.find_next_end();
    }

    /// Ends all transfers at the lowest level of ending, at `next_end`.
    fn end_next(&mut self) {
        let Some(&(level, _)) = self.ends.first() else { return };
        let (work, carried) = self.work_to_level(level);
        self.delivered += work;
        self.at += work;
        self.at_time = self.next_end;
        self.carried = carried;
        self.level = level;
        while let Some(&(l, id)) = self.ends.first()
            && l == level
        {
            self.ends.pop_first();
            if let Some(transfer) = self.transfers.get_mut(&id)
                && let Transfer::OnLink { joined_level, ends_level } = *transfer
            {
                *transfer = Transfer::Over { bytes: ((ends_level - joined_level) / NANO_BITS_PER_BYTE) as u64 };
            }
            self.ended.push((id, self.next_end));
        }
        self.spread_carried();
        self.find_next_end();
    }

    /// Brings `level`, `at` and `carried` to the time `to`, before which nothing ends.
    fn raise_level(&mut self, to: Time) {
        let work = self.trace.work_until(to);
        if !self.ends.is_empty() {
            let (level, carried) = self.level_at(work);
            self.delivered += work - self.at;
            self.level = level;
            self.carried = carried;
        }
        self.at = work;
        self.at_time = to;
    }

    /// Level, and what is carried, when the trace has delivered `work`.
    fn level_at(&self, work: u128) -> (u128, u128) {
        let n = self.ends.len().max(1) as u128;
        let shared = self.carried + (work - self.at);
        (self.level + shared / n, shared % n)
    }

    /// Work from `at` until `level` is reached, and what is carried then.
    fn work_to_level(&self, level: u128) -> (u128, u128) {
        let needed = (level - self.level).saturating_mul(self.ends.len() as u128);
        (needed.saturating_sub(self.carried), self.carried.saturating_sub(needed))
    }

    /// Restores `carried` < n after transfers left, without passing the lowest level of ending. With no transfer left
    /// the few nano-bits that are carried are lost.
    fn spread_carried(&mut self) {
        let n = self.ends.len() as u128;
        if let Some(&(lowest, _)) = self.ends.first() {
            let rise = (self.carried / n).min(lowest - self.level);
            self.level += rise;
            self.carried -= rise * n;
        } else {
            self.delivered -= self.carried;
            self.carried = 0;
        }
    }

    fn find_next_end(&mut self) {
        self.next_end = match self.ends.first() {
            None => Time::NEVER,
            Some(&(level, _)) => {
                let (work, _) = self.work_to_level(level);
                self.trace.time_of_work(self.at.saturating_add(work)).max(self.at_time)
            }
        };
    }
}
