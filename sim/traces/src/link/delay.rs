//! Delays beside a Mahimahi trace, as LeoReplayer writes them: a line for every 10 ms, the one-way delay in milliseconds.
//!
//! LeoReplayer holds a packet back by the delay of the moment, in both directions: a round trip is twice the delay. The
//! list begins with the trace and repeats at its own end.

use foresight_scheduler::units::Time;

use crate::text_lines::{LINE_BYTES_MAX, TextLines};

use super::{LinkError, RttPiece, SECONDS_MAX};

/// How long each line's delay holds.
pub const STEP: Time = Time(10_000_000);

/// Round trips over a period of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Delays {
    /// One a line.
    pub pieces: Vec<RttPiece>,
    /// Their length together.
    pub period: Time,
}

/// Reads a list of delays. Empty lines and lines that begin with `#` are skipped.
///
/// # Errors
/// An empty list, a list longer than [`SECONDS_MAX`], a line that is no number from 0 to half of [`SECONDS_MAX`].
pub fn parse(name: &str, bytes: &[u8]) -> Result<Delays, LinkError> {
    let wrong = |line: usize, message: String| LinkError::Line { name: name.to_owned(), line, message };
    let lines = TextLines::new(bytes)
        .map_err(|line| wrong(line, format!("is longer than {LINE_BYTES_MAX} bytes; expected one delay a line")))?;
    let mut pieces: Vec<RttPiece> = Vec::new();
    let mut from = Time::ZERO;
    for (number, line) in lines {
        let max = 0.5e3 * SECONDS_MAX;
        let one_way = line.parse::<f64>().ok().filter(|ms| (0.0..=max).contains(ms)).ok_or_else(|| {
            let found: String = line.chars().take(40).collect();
            wrong(number, format!("`{found}`; expected a one-way delay in milliseconds, 0 to {max:e}"))
        })?;
        if from.secs() > SECONDS_MAX {
            return Err(wrong(number, format!("is at {} s; expected at most {SECONDS_MAX:e} s", from.secs())));
        }
        pieces.push(RttPiece { from, rtt: Time(2 * libm::round(one_way * 1e6) as u64) });
        from += STEP;
    }
    if pieces.is_empty() {
        let message = "holds no delay; expected milliseconds, one line for every 10 ms".to_owned();
        return Err(LinkError::Whole { name: name.to_owned(), message });
    }
    Ok(Delays { pieces, period: from })
}
