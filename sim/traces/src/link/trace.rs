//! Capacity of a link over time.

use std::sync::Arc;

use foresight_scheduler::units::Time;

use super::latency::{Latency, RttPiece};
use super::loss::Loss;
use super::{LinkError, NANO_BITS_PER_BYTE, OPPORTUNITY_BYTES, RATE_MAX, SECONDS_MAX};

/// A rate that holds from `from` until the next piece begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RatePiece {
    /// When the rate begins, from the start of the trace.
    pub from: Time,
    /// Rate, bit/s.
    pub bits_per_second: u64,
}

/// Capacity of a link over time, repeating for ever, its round-trip time, and how often a request fails on it.
///
/// Capacity at an instant counts towards the interval that ends there: intervals are half-open, (from, to].
#[derive(Clone, Debug)]
pub struct LinkTrace {
    name: String,
    notes: Vec<String>,
    latency: Latency,
    loss: Loss,
    /// Where in the period time zero lies, less than the period.
    offset: u64,
    capacity: Arc<Capacity>,
}

/// One period, times in nanoseconds from its start, work in nano-bits.
#[derive(Debug)]
struct Capacity {
    period: u64,
    /// Work of a whole period, > 0.
    total: u128,
    shape: Shape,
}

#[derive(Debug)]
enum Shape {
    Rates {
        pieces: Vec<RatePiece>,
        /// Work delivered before each piece.
        before: Vec<u128>,
    },
    Opportunities {
        /// Distinct instants in (0, period], ascending.
        instants: Vec<u64>,
        /// Opportunities up to and including each instant.
        counts: Vec<u64>,
        /// Work of one opportunity.
        quantum: u64,
    },
}

impl LinkTrace {
    /// A constant rate in bit/s.
    ///
    /// # Errors
    /// A rate of 0 or above [`RATE_MAX`].
    pub fn constant(name: &str, bits_per_second: u64, rtt: Time) -> Result<LinkTrace, LinkError> {
        LinkTrace::from_rates(name, vec![RatePiece { from: Time::ZERO, bits_per_second }], Time(1_000_000_000), rtt)
    }

    /// Piecewise-constant rates over a period of length `period`, then again from the start.
    ///
    /// # Errors
    /// No piece, a first piece that does not begin at 0, pieces out of order or beyond the period, a rate above
    /// [`RATE_MAX`], a period or round trip above [`SECONDS_MAX`], no capacity at all.
    pub fn from_rates(name: &str, pieces: Vec<RatePiece>, period: Time, rtt: Time) -> Result<LinkTrace, LinkError> {
        let whole = |message: String| LinkError::Whole { name: name.to_owned(), message };
        let Some(first) = pieces.first() else {
            return Err(whole("no rates; expected at least one".into()));
        };
        if first.from != Time::ZERO {
            return Err(whole(format!("the first rate begins at {} s; expected 0", first.from.secs())));
        }
        check_span(name, "the trace", period)?;
        check_span(name, "the round trip", rtt)?;
        let mut before = Vec::with_capacity(pieces.len());
        let mut work = 0u128;
        for (i, piece) in pieces.iter().enumerate() {
            let end = pieces.get(i + 1).map_or(period, |next| next.from);
            if piece.from >= end {
                return Err(whole(format!(
                    "the rate from {} s ends at {} s; expected increasing times",
                    piece.from.secs(),
                    end.secs()
                )));
            }
            if piece.bits_per_second > RATE_MAX {
                return Err(whole(format!("a rate of {} bit/s; expected at most {RATE_MAX}", piece.bits_per_second)));
            }
            before.push(work);
            work += u128::from(piece.bits_per_second) * u128::from(end.0 - piece.from.0);
        }
        if work == 0 {
            return Err(LinkError::NoCapacity { name: name.to_owned(), seconds: period.secs() });
        }
        Ok(LinkTrace {
            name: name.to_owned(),
            notes: Vec::new(),
            latency: Latency::Constant(rtt),
            loss: Loss::NONE,
            offset: 0,
            capacity: Arc::new(Capacity { period: period.0, total: work, shape: Shape::Rates { pieces, before } }),
        })
    }

    /// Delivery opportunities of [`OPPORTUNITY_BYTES`] each at non-decreasing milliseconds. The trace repeats at its
    /// last timestamp, so an opportunity at 0 of the second round falls together with the last of the first.
    ///
    /// # Errors
    /// No timestamp, timestamps that decrease, a last timestamp of 0 or above [`SECONDS_MAX`], a round trip above it.
    pub fn from_opportunities(name: &str, milliseconds: &[u64], rtt: Time) -> Result<LinkTrace, LinkError> {
        let whole = |message: String| LinkError::Whole { name: name.to_owned(), message };
        let Some(&last) = milliseconds.last() else {
            return Err(whole("no delivery opportunities; expected at least one".into()));
        };
        if let Some(pair) = milliseconds.windows(2).find(|pair| pair[0] > pair[1]) {
            return Err(whole(format!("{} ms after {} ms; expected non-decreasing milliseconds", pair[1], pair[0])));
        }
        if last == 0 {
            return Err(whole("every delivery opportunity is at 0 ms; expected a trace that lasts".into()));
        }
        let period = last.saturating_mul(1_000_000);
        check_span(name, "the trace", Time(period))?;
        check_span(name, "the round trip", rtt)?;
        let mut instants: Vec<u64> = Vec::new();
        let mut counts: Vec<u64> = Vec::new();
        // What happens at 0 belongs to the end of the interval before it, that is to the end of the period.
        let at_zero = milliseconds.iter().take_while(|&&ms| ms == 0).count() as u64;
        let mut count = 0;
        let mut previous = 0;
        for &ms in &milliseconds[at_zero as usize..] {
            count += 1;
            if ms == previous {
                // `previous` starts at 0 and no `ms` here is 0, so there is a last count.
                if let Some(c) = counts.last_mut() {
                    *c = count;
                }
            } else {
                instants.push(ms * 1_000_000);
                counts.push(count);
            }
            previous = ms;
        }
        if let Some(c) = counts.last_mut() {
            *c += at_zero;
        }
        let quantum = OPPORTUNITY_BYTES * NANO_BITS_PER_BYTE as u64;
        let total = milliseconds.len() as u128 * u128::from(quantum);
        Ok(LinkTrace {
            name: name.to_owned(),
            notes: Vec::new(),
            latency: Latency::Constant(rtt),
            loss: Loss::NONE,
            offset: 0,
            capacity: Arc::new(Capacity { period, total, shape: Shape::Opportunities { instants, counts, quantum } }),
        })
    }

    /// The link as named, with what was done to it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Repairs and assumptions.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Time from a request at `now` to its first byte on an idle link.
    pub fn rtt_at(&self, now: Time) -> Time {
        self.latency.at(now)
    }

    /// The least and the greatest round trip; equal where it does not vary.
    pub fn rtt_range(&self) -> (Time, Time) {
        self.latency.range()
    }

    /// Probability that a request fails.
    pub fn loss(&self) -> f64 {
        self.loss.probability
    }

    /// Whether and after how many of its `bytes` a transfer breaks off. `subject` is what was asked for, `attempt` how
    /// often it was asked for before.
    pub fn breaks_after(&self, subject: u64, attempt: u64, bytes: u64) -> Option<u64> {
        self.loss.breaks_after(self.offset, subject, attempt, bytes)
    }

    /// Length of the trace before it repeats.
    pub fn period(&self) -> Time {
        Time(self.capacity.period)
    }

    /// Where in the period time zero lies.
    pub fn offset(&self) -> Time {
        Time(self.offset)
    }

    /// Adds a note.
    pub fn add_note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    /// Replaces the name.
    pub fn set_name(&mut self, name: impl Into<String>) {
        self.name = name.into();
    }

    /// The same capacity with another round trip.
    ///
    /// # Errors
    /// A round trip above [`SECONDS_MAX`].
    pub fn with_rtt(&self, rtt: Time) -> Result<LinkTrace, LinkError> {
        check_span(&self.name, "the round trip", rtt)?;
        Ok(LinkTrace { latency: Latency::Constant(rtt), ..self.clone() })
    }

    /// The same capacity with a round trip that varies: `pieces` over a period of their own, then again from the start.
    /// What counts for a request is the moment at which it is made.
    ///
    /// # Errors
    /// No piece, a first piece that does not begin at 0, pieces out of order or beyond the period, a period or round
    /// trip above [`SECONDS_MAX`].
    pub fn with_varying_rtt(&self, pieces: &[RttPiece], period: Time) -> Result<LinkTrace, LinkError> {
        check_span(&self.name, "the round trips' period", period)?;
        for piece in pieces {
            check_span(&self.name, "the round trip", piece.rtt)?;
        }
        let latency = Latency::varying(pieces, period, self.offset)
            .map_err(|message| LinkError::Whole { name: self.name.clone(), message })?;
        Ok(LinkTrace { latency, ..self.clone() })
    }

    /// The same link on which each request fails with `probability`.
    ///
    /// # Errors
    /// A probability that is not between 0 and 1.
    pub fn with_loss(&self, probability: f64, seed: u64) -> Result<LinkTrace, LinkError> {
        if !(0.0..=1.0).contains(&probability) {
            let message = format!("a loss of {probability}; expected a probability, 0 to 1");
            return Err(LinkError::Whole { name: self.name.clone(), message });
        }
        Ok(LinkTrace { loss: Loss { probability, seed }, ..self.clone() })
    }

    /// The same link whose failures another seed names.
    pub fn with_loss_seed(&self, seed: u64) -> LinkTrace {
        LinkTrace { loss: Loss { seed, ..self.loss }, ..self.clone() }
    }

    /// The same link with time zero put `start` later; beyond the period it wraps around.
    pub fn shifted(&self, start: Time) -> LinkTrace {
        let period = self.capacity.period;
        let offset = (u128::from(self.offset) + u128::from(start.0)) % u128::from(period);
        let latency = self.latency.shifted(start);
        LinkTrace { offset: offset as u64, latency, ..self.clone() }
    }

    /// The same link with every rate multiplied by `factor` and rounded to the bit/s; opportunities carry
    /// `factor` times their bytes, rounded to the nano-bit.
    ///
    /// # Errors
    /// A factor that is not finite and positive, that leaves no capacity, or a rate above [`RATE_MAX`].
    pub fn scaled(&self, factor: f64) -> Result<LinkTrace, LinkError> {
        let whole = |message: String| LinkError::Whole { name: self.name.clone(), message };
        if !(factor.is_finite() && factor > 0.0) {
            return Err(whole(format!("scale {factor}; expected a positive number")));
        }
        let scaled = |value: u64| libm::round(value as f64 * factor);
        let capacity = match &self.capacity.shape {
            Shape::Rates { pieces, .. } => {
                let mut out = Vec::with_capacity(pieces.len());
                for piece in pieces {
                    // Saturates far above RATE_MAX, where `from_rates` refuses it.
                    out.push(RatePiece { from: piece.from, bits_per_second: scaled(piece.bits_per_second) as u64 });
                }
                LinkTrace::from_rates(&self.name, out, self.period(), Time::ZERO)?.capacity
            }
            Shape::Opportunities { instants, counts, quantum } => {
                // At most RATE_MAX nano-bits for an opportunity is 125 kB.
                let limit = RATE_MAX as f64;
                let quantum = scaled(*quantum);
                if quantum > limit {
                    return Err(whole(format!(
                        "scale {factor} makes an opportunity larger than 125 kB; expected less"
                    )));
                }
                let quantum = quantum as u64;
                if quantum == 0 {
                    return Err(LinkError::NoCapacity { name: self.name.clone(), seconds: self.period().secs() });
                }
                let total = u128::from(counts.last().copied().unwrap_or(0)) * u128::from(quantum);
                let shape = Shape::Opportunities { instants: instants.clone(), counts: counts.clone(), quantum };
                Arc::new(Capacity { period: self.capacity.period, total, shape })
            }
        };
        Ok(LinkTrace { capacity, ..self.clone() })
    }

    /// Bytes that the link can deliver in (from, to], rounded down; 0 if `to` is not later.
    pub fn bytes_deliverable(&self, from: Time, to: Time) -> u64 {
        if to <= from {
            return 0;
        }
        let bytes = (self.work_until(to) - self.work_until(from)) / NANO_BITS_PER_BYTE;
        u64::try_from(bytes).unwrap_or(u64::MAX)
    }

    /// Mean rate over the period, bytes/s.
    pub fn mean_rate(&self) -> f64 {
        self.capacity.total as f64 / NANO_BITS_PER_BYTE as f64 / self.period().secs()
    }

    /// Longest time in which nothing is delivered, the repetition included.
    pub(super) fn longest_outage(&self) -> Time {
        Time(self.capacity.longest_outage())
    }

    /// BLAKE3 of what the link does: capacity, offset, round trips and failures; not of its name.
    pub fn hash(&self) -> blake3::Hash {
        let mut hasher = blake3::Hasher::new();
        let mut put = |value: u64| {
            hasher.update(&value.to_le_bytes());
        };
        self.latency.identify(&mut put);
        put(self.offset);
        put(self.capacity.period);
        match &self.capacity.shape {
            Shape::Rates { pieces, .. } => {
                put(0);
                for piece in pieces {
                    put(piece.from.0);
                    put(piece.bits_per_second);
                }
            }
            Shape::Opportunities { instants, counts, quantum } => {
                put(1);
                put(*quantum);
                for (&instant, &count) in instants.iter().zip(counts) {
                    put(instant);
                    put(count);
                }
            }
        }
        if self.loss.probability > 0.0 {
            put(self.loss.probability.to_bits());
            put(self.loss.seed);
        }
        hasher.finalize()
    }

    /// Nano-bits in (−offset, to], that is from the start of the period in which time zero lies.
    pub(super) fn work_until(&self, to: Time) -> u128 {
        let at = u128::from(self.offset) + u128::from(to.0);
        let period = u128::from(self.capacity.period);
        if at < period {
            return self.capacity.work_within(at as u64);
        }
        at / period * self.capacity.total + self.capacity.work_within((at % period) as u64)
    }

    /// The earliest time at which [`LinkTrace::work_until`] is at least `work`; [`Time::NEVER`] if it is beyond
    /// what a [`Time`] holds.
    pub(super) fn time_of_work(&self, work: u128) -> Time {
        let Some(last) = work.checked_sub(1) else { return Time::ZERO };
        let total = self.capacity.total;
        let (rounds, rest) = if work <= total { (0, work) } else { (last / total, last % total + 1) };
        let at = rounds
            .saturating_mul(u128::from(self.capacity.period))
            .saturating_add(u128::from(self.capacity.time_within(rest)));
        u64::try_from(at.saturating_sub(u128::from(self.offset))).map_or(Time::NEVER, Time)
    }
}

impl Capacity {
    /// Work in (0, at], `at` at most the period.
    fn work_within(&self, at: u64) -> u128 {
        match &self.shape {
            Shape::Rates { pieces, before } => {
                let i = pieces.partition_point(|piece| piece.from.0 <= at).saturating_sub(1);
                before[i] + u128::from(pieces[i].bits_per_second) * u128::from(at - pieces[i].from.0)
            }
            Shape::Opportunities { instants, counts, quantum } => match instants.partition_point(|&i| i <= at) {
                0 => 0,
                n => u128::from(counts[n - 1]) * u128::from(*quantum),
            },
        }
    }

    fn longest_outage(&self) -> u64 {
        match &self.shape {
            Shape::Rates { pieces, .. } => {
                let ends = pieces.iter().skip(1).map(|next| next.from.0).chain([self.period]);
                let (mut longest, mut current, mut at_start) = (0, 0, None);
                for (piece, end) in pieces.iter().zip(ends) {
                    if piece.bits_per_second == 0 {
                        current += end - piece.from.0;
                    } else {
                        at_start.get_or_insert(current);
                        longest = longest.max(current);
                        current = 0;
                    }
                }
                // What ends the period goes on at its start.
                longest.max(current + at_start.unwrap_or(0))
            }
            // The last instant is the period's end.
            Shape::Opportunities { instants, .. } => {
                let befores = [0].iter().chain(instants);
                instants.iter().zip(befores).map(|(at, before)| at - before).max().unwrap_or(0)
            }
        }
    }

    /// The earliest time within a period with `work_within` ≥ `work`, for `work` in 1 ..= total.
    fn time_within(&self, work: u128) -> u64 {
        match &self.shape {
            Shape::Rates { pieces, before } => {
                // The last piece with less before it: what follows it has at least `work`, so its rate is not 0.
                let i = before.partition_point(|&b| b < work).saturating_sub(1);
                let rate = u128::from(pieces[i].bits_per_second.max(1));
                pieces[i].from.0 + (work - before[i]).div_ceil(rate) as u64
            }
            Shape::Opportunities { instants, counts, quantum } => {
                let needed = work.div_ceil(u128::from(*quantum));
                let i = counts.partition_point(|&c| u128::from(c) < needed).min(instants.len() - 1);
                instants[i]
            }
        }
    }
}

fn check_span(name: &str, what: &str, span: Time) -> Result<(), LinkError> {
    if span.secs() <= SECONDS_MAX {
        return Ok(());
    }
    let message = format!("{what} lasts {} s; expected at most {SECONDS_MAX} s", span.secs());
    Err(LinkError::Whole { name: name.to_owned(), message })
}
