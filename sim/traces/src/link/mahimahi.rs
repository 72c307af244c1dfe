//! Mahimahi traces: a line for each opportunity to deliver 1500 bytes, its integer of milliseconds, non-decreasing.

use std::iter::Peekable;

use crate::text_lines::TextLines;

use super::parse::{ASSUMED_RTT, unsupported};
use super::{LinkError, LinkTrace, SECONDS_MAX};

/// Reads the lines; the round trip is [`ASSUMED_RTT`].
pub(super) fn parse(name: &str, lines: Peekable<TextLines<'_>>) -> Result<LinkTrace, LinkError> {
    let mut milliseconds: Vec<u64> = Vec::new();
    for (number, line) in lines {
        let Ok(ms) = line.parse::<u64>() else { return Err(unsupported(name, number, &line)) };
        let wrong = |message: String| LinkError::Line { name: name.to_owned(), line: number, message };
        if let Some(&previous) = milliseconds.last()
            && ms < previous
        {
            return Err(wrong(format!(
                "{ms} after {previous}: not a supported link format; expected the non-decreasing milliseconds of a \
                 Mahimahi trace (delays are no link: give them with ,delay=FILE)"
            )));
        }
        if ms as f64 > SECONDS_MAX * 1e3 {
            return Err(wrong(format!("{ms} ms; expected at most {SECONDS_MAX} s")));
        }
        milliseconds.push(ms);
    }
    LinkTrace::from_opportunities(name, &milliseconds, ASSUMED_RTT)
}
