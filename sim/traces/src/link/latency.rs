//! Round-trip time of a link: the same for every request, or the one that holds at the moment of the request.

use std::sync::Arc;

use foresight_scheduler::units::Time;

/// A round trip that holds from `from` until the next piece begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RttPiece {
    /// When it begins, from the start of the series.
    pub from: Time,
    /// Time from a request to its first byte on an idle link.
    pub rtt: Time,
}

/// Round-trip time over time.
#[derive(Clone, Debug)]
pub(super) enum Latency {
    Constant(Time),
    Varying {
        series: Arc<Series>,
        /// Where in the series' period time zero lies, less than the period.
        offset: u64,
    },
}

/// One period of a varying round trip.
#[derive(Debug)]
pub(super) struct Series {
    /// Nanoseconds.
    period: u64,
    /// At least two, the first from 0, neighbours with different round trips.
    pieces: Vec<RttPiece>,
    least: Time,
    greatest: Time,
}

impl Latency {
    /// Pieces over `period`, then again from the start; the message of an error says what was expected.
    pub(super) fn varying(pieces: &[RttPiece], period: Time, start: u64) -> Result<Latency, String> {
        let Some(first) = pieces.first() else { return Err("no round trips; expected at least one".to_owned()) };
        if first.from != Time::ZERO {
            return Err(format!("the first round trip begins at {} s; expected 0", first.from.secs()));
        }
        let ends = pieces.iter().skip(1).map(|next| next.from).chain([period]);
        if let Some((piece, end)) = pieces.iter().zip(ends).find(|(piece, end)| piece.from >= *end) {
            let (from, end) = (piece.from.secs(), end.secs());
            return Err(format!("the round trip from {from} s ends at {end} s; expected increasing times"));
        }
        let mut kept: Vec<RttPiece> = Vec::new();
        for piece in pieces {
            if kept.last().is_none_or(|last| last.rtt != piece.rtt) {
                kept.push(*piece);
            }
        }
        if kept.len() == 1 {
            return Ok(Latency::Constant(first.rtt));
        }
        let least = kept.iter().map(|p| p.rtt).min().unwrap_or(first.rtt);
        let greatest = kept.iter().map(|p| p.rtt).max().unwrap_or(first.rtt);
        let series = Arc::new(Series { period: period.0, pieces: kept, least, greatest });
        Ok(Latency::Varying { offset: start % period.0, series })
    }

    /// Round trip of a request at `now`.
    pub(super) fn at(&self, now: Time) -> Time {
        match self {
            Latency::Constant(rtt) => *rtt,
            Latency::Varying { series, offset } => {
                let at = (u128::from(*offset) + u128::from(now.0)) % u128::from(series.period);
                let next = series.pieces.partition_point(|piece| u128::from(piece.from.0) <= at);
                series.pieces[next.saturating_sub(1)].rtt
            }
        }
    }

    /// The least and the greatest.
    pub(super) fn range(&self) -> (Time, Time) {
        match self {
            Latency::Constant(rtt) => (*rtt, *rtt),
            Latency::Varying { series, .. } => (series.least, series.greatest),
        }
    }

    /// Time zero put `start` later.
    pub(super) fn shifted(&self, start: Time) -> Latency {
        match self {
            Latency::Constant(rtt) => Latency::Constant(*rtt),
            Latency::Varying { series, offset } => {
                let offset = (u128::from(*offset) + u128::from(start.0)) % u128::from(series.period);
                Latency::Varying { series: Arc::clone(series), offset: offset as u64 }
            }
        }
    }

    /// Numbers that tell it from every other.
    pub(super) fn identify(&self, mut put: impl FnMut(u64)) {
        match self {
            Latency::Constant(rtt) => put(rtt.0),
            Latency::Varying { series, offset } => {
                // No constant is that long.
                put(u64::MAX);
                put(*offset);
                put(series.period);
                put(series.pieces.len() as u64);
                for piece in &series.pieces {
                    put(piece.from.0);
                    put(piece.rtt.0);
                }
            }
        }
    }
}
