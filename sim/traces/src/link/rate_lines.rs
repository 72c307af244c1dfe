//! Lines of `seconds Mbit/s`.
//!
//! The first time becomes 0, a rate holds until the next line's time, the last one for the median step. Lines whose time
//! is not later than the one before are dropped, and noted.

use std::iter::Peekable;

use foresight_scheduler::units::Time;

use crate::text_lines::TextLines;

use super::parse::{ASSUMED_RTT, unsupported};
use super::{LinkError, LinkTrace, RATE_MAX, RatePiece, SECONDS_MAX};

/// How long the rate of a file with a single line holds.
const SINGLE_STEP: Time = Time(1_000_000_000);

/// Reads the lines; the round trip is [`ASSUMED_RTT`].
pub(super) fn parse(name: &str, lines: Peekable<TextLines<'_>>) -> Result<LinkTrace, LinkError> {
    let mut pieces: Vec<RatePiece> = Vec::new();
    let mut first = None;
    let mut dropped = 0usize;
    let mut recognised = false;
    for (number, line) in lines {
        let mut fields = line.split_ascii_whitespace();
        let (Some(time), Some(rate), None) = (fields.next(), fields.next(), fields.next()) else {
            return Err(unsupported(name, number, &line));
        };
        let wrong = |message: String| LinkError::Line { name: name.to_owned(), line: number, message };
        let (seconds, mbit) = match (time.parse::<f64>(), rate.parse::<f64>()) {
            (Ok(seconds), Ok(mbit)) => (seconds, mbit),
            _ if recognised => return Err(wrong(format!("`{line}`; expected two numbers, seconds and Mbit/s"))),
            _ => return Err(unsupported(name, number, &line)),
        };
        recognised = true;
        if !(mbit.is_finite() && mbit >= 0.0) {
            return Err(wrong(format!("a rate of {mbit} Mbit/s; expected a number that is not negative")));
        }
        if mbit * 1e6 > RATE_MAX as f64 {
            return Err(wrong(format!("a rate of {mbit} Mbit/s; expected at most {} bit/s", RATE_MAX)));
        }
        let since_first = seconds - *first.get_or_insert(seconds);
        if !since_first.is_finite() || since_first > SECONDS_MAX {
            return Err(wrong(format!("a time of {seconds} s; expected at most {SECONDS_MAX} s after the first")));
        }
        // A negative number becomes 0, which is dropped as a regression.
        let from = Time(libm::round(since_first * 1e9) as u64);
        if pieces.last().is_some_and(|previous| from <= previous.from) {
            dropped += 1;
        } else {
            pieces.push(RatePiece { from, bits_per_second: libm::round(mbit * 1e6) as u64 });
        }
    }
    if dropped > pieces.len() {
        let message = format!(
            "{dropped} of {} times are not later than the one before; expected increasing times",
            dropped + pieces.len()
        );
        return Err(LinkError::Whole { name: name.to_owned(), message });
    }
    let mut steps: Vec<u64> = pieces.windows(2).map(|pair| pair[1].from.0 - pair[0].from.0).collect();
    steps.sort_unstable();
    let step = steps.get(steps.len() / 2).map_or(SINGLE_STEP, |&median| Time(median));
    let period = pieces.last().map_or(Time::ZERO, |last| last.from) + step;
    let mut link = LinkTrace::from_rates(name, pieces, period, ASSUMED_RTT)?;
    if let Some(first) = first
        && first != 0.0
    {
        link.add_note(format!("begins at {first} s: shifted to 0"));
    }
    if dropped > 0 {
        link.add_note(format!("{dropped} lines dropped whose time was not later than the one before"));
    }
    Ok(link)
}
