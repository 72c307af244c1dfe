//! Links from files and from specifications.

use std::iter::Peekable;
use std::path::Path;

use foresight_scheduler::units::Time;

use crate::text_lines::{LINE_BYTES_MAX, TextLines};

use super::{LinkError, LinkTrace, RatePiece, SECONDS_MAX};

/// Round trip of a link whose file states none.
pub const ASSUMED_RTT: Time = Time(50_000_000);

/// Largest file read, bytes.
const FILE_BYTES_MAX: u64 = 1 << 30;

/// How long the rate of a file with a single line holds.
const SINGLE_STEP: Time = Time(1_000_000_000);

/// Reads `FILE|constant:RATE,RTT[,scale=X][,start=SECONDS][,rtt=MS]`.
///
/// RATE is a number with `bit`, `kbit`, `Mbit` or `Gbit` (`/s` or `ps` may follow), RTT one with `us`, `ms` or `s`; `rtt=`
/// without a unit is in milliseconds, `start=` in seconds.
///
/// # Errors
/// A specification of another form, a file that cannot be read, and all errors of [`from_bytes`].
pub fn from_specification(spec: &str) -> Result<LinkTrace, LinkError> {
    let fail = |message: String| LinkError::Specification { spec: spec.to_owned(), message };
    let mut source = spec;
    let (mut scale, mut start, mut rtt) = (None, None, None);
    while let Some((rest, option)) = source.rsplit_once(',') {
        let Some((key, value)) = option.split_once('=') else { break };
        let slot = match key {
            "scale" => &mut scale,
            "start" => &mut start,
            "rtt" => &mut rtt,
            // A file name may hold a comma and an equals sign.
            _ if Path::new(source).exists() => break,
            _ => return Err(fail(format!("unknown option `{key}`; expected scale, start or rtt"))),
        };
        if slot.replace(value).is_some() {
            return Err(fail(format!("`{key}` is given twice; expected once")));
        }
        source = rest;
    }
    let scale = match scale {
        None => None,
        Some(text) => match text.parse::<f64>() {
            Ok(value) if value.is_finite() && value > 0.0 => Some(value),
            _ => return Err(fail(format!("scale `{text}`; expected a positive number"))),
        },
    };
    let start = match start {
        None => None,
        Some(text) => Some(time(text, "s").ok_or_else(|| fail(format!("start `{text}`; expected seconds, 0 to 1e9")))?),
    };
    let rtt = match rtt {
        None => None,
        Some(text) => {
            Some(time(text, "ms").ok_or_else(|| fail(format!("rtt `{text}`; expected milliseconds, such as 40")))?)
        }
    };

    let mut link = match source.strip_prefix("constant:") {
        Some(constant) => {
            let expected = "expected `constant:RATE,RTT`, such as constant:5Mbit,40ms";
            let (rate_text, rtt_text) = match constant.split_once(',') {
                Some((rate_text, rtt_text)) => (rate_text, Some(rtt_text)),
                None => (constant, None),
            };
            let bits = rate(rate_text).ok_or_else(|| fail(format!("rate `{rate_text}`; {expected}")))?;
            match (rtt_text, rtt) {
                (Some(text), _) => {
                    let own = time(text, "").ok_or_else(|| fail(format!("round trip `{text}`; {expected}")))?;
                    LinkTrace::constant(source, bits, own)?
                }
                (None, Some(given)) => LinkTrace::constant(source, bits, given)?,
                (None, None) => return Err(fail(format!("no round trip; {expected}"))),
            }
        }
        None => {
            let io = |error| LinkError::Io { name: source.to_owned(), source: error };
            let size = std::fs::metadata(source).map_err(io)?.len();
            check_size(source, size)?;
            file_content(source, &std::fs::read(source).map_err(io)?)?
        }
    };
    match rtt {
        Some(rtt) => link = link.with_rtt(rtt)?,
        None if !source.starts_with("constant:") => assume_rtt(&mut link),
        None => {}
    }
    if let Some(factor) = scale {
        link = link.scaled(factor)?;
    }
    if let Some(start) = start {
        link = link.shifted(start);
    }
    link.set_name(spec);
    Ok(link)
}

/// Reads a file's content, recognised by itself: Mahimahi lines (an integer of milliseconds each, non-decreasing, one
/// opportunity of 1500 bytes), or lines of `seconds Mbit/s`. Empty lines and lines that begin with `#` are skipped.
/// Neither format states a round trip: [`ASSUMED_RTT`] is taken, and noted.
///
/// In the second format the first time becomes 0, a rate holds until the next line's time, the last one for the median
/// step. Lines whose time is not later than the one before are dropped, and noted.
///
/// # Errors
/// [`LinkError`] names the line and what was expected of it.
pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<LinkTrace, LinkError> {
    let mut link = file_content(name, bytes)?;
    assume_rtt(&mut link);
    Ok(link)
}

fn assume_rtt(link: &mut LinkTrace) {
    link.add_note(format!("states no round trip: {} ms assumed", ASSUMED_RTT.0 / 1_000_000));
}

fn check_size(name: &str, size: u64) -> Result<(), LinkError> {
    if size <= FILE_BYTES_MAX {
        return Ok(());
    }
    let message = format!("{size} bytes; expected at most {FILE_BYTES_MAX}");
    Err(LinkError::Whole { name: name.to_owned(), message })
}

/// A link with [`ASSUMED_RTT`], not noted yet.
fn file_content(name: &str, bytes: &[u8]) -> Result<LinkTrace, LinkError> {
    check_size(name, bytes.len() as u64)?;
    let mut lines = text_lines(name, bytes)?.peekable();
    match lines.peek() {
        None => {
            Err(LinkError::Whole { name: name.to_owned(), message: "is empty; expected a network trace".to_owned() })
        }
        Some((_, line)) if line.split_ascii_whitespace().count() == 1 => mahimahi(name, lines),
        Some(_) => rates(name, lines),
    }
}

fn text_lines<'a>(name: &str, bytes: &'a [u8]) -> Result<TextLines<'a>, LinkError> {
    TextLines::new(bytes).map_err(|line| {
        let message = format!("is longer than {LINE_BYTES_MAX} bytes; expected short lines of text");
        LinkError::Line { name: name.to_owned(), line, message }
    })
}

fn unsupported(name: &str, line: usize, found: &str) -> LinkError {
    LinkError::Unsupported { name: name.to_owned(), line, found: found.chars().take(40).collect() }
}

fn mahimahi(name: &str, lines: Peekable<TextLines<'_>>) -> Result<LinkTrace, LinkError> {
    let mut milliseconds: Vec<u64> = Vec::new();
    for (number, line) in lines {
        let Ok(ms) = line.parse::<u64>() else { return Err(unsupported(name, number, &line)) };
        let wrong = |message: String| LinkError::Line { name: name.to_owned(), line: number, message };
        if let Some(&previous) = milliseconds.last()
            && ms < previous
        {
            return Err(wrong(format!(
                "{ms} after {previous}: not a supported link format; expected the non-decreasing milliseconds of a \
                 Mahimahi trace (a list of delays is not a link)"
            )));
        }
        if ms as f64 > SECONDS_MAX * 1e3 {
            return Err(wrong(format!("{ms} ms; expected at most {SECONDS_MAX} s")));
        }
        milliseconds.push(ms);
    }
    LinkTrace::from_opportunities(name, &milliseconds, ASSUMED_RTT)
}

fn rates(name: &str, lines: Peekable<TextLines<'_>>) -> Result<LinkTrace, LinkError> {
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
        if mbit * 1e6 > super::RATE_MAX as f64 {
            return Err(wrong(format!("a rate of {mbit} Mbit/s; expected at most {} bit/s", super::RATE_MAX)));
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

/// A number with one of `units`; the first unit that fits is taken, and "" fits last.
fn quantity(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    for &(unit, factor) in units {
        if let Some(number) = text.strip_suffix(unit) {
            // `inf`, `nan` and signs are not numbers here.
            if !number.starts_with(|c: char| c.is_ascii_digit() || c == '.') {
                return None;
            }
            return number.parse::<f64>().ok().map(|value| value * factor).filter(|value| value.is_finite());
        }
    }
    None
}

/// Bit/s, more than 0.
fn rate(text: &str) -> Option<u64> {
    let text = text.strip_suffix("/s").or_else(|| text.strip_suffix("ps")).unwrap_or(text);
    let units = [("Gbit", 1e9), ("Mbit", 1e6), ("kbit", 1e3), ("bit", 1.0), ("Gb", 1e9), ("Mb", 1e6), ("kb", 1e3)];
    let bits = quantity(text, &units)?;
    // The cast saturates; what is above the limit is refused with the link.
    (bits >= 0.5).then(|| libm::round(bits) as u64)
}

/// A time with a unit, or without one in `default` (an empty `default` demands a unit).
fn time(text: &str, default: &str) -> Option<Time> {
    let bare = match default {
        "s" => ("", 1.0),
        "ms" => ("", 1e-3),
        _ => ("\0", 1.0),
    };
    let seconds = quantity(text, &[("us", 1e-6), ("ms", 1e-3), ("s", 1.0), bare])?;
    (seconds <= SECONDS_MAX).then(|| Time(libm::round(seconds * 1e9) as u64))
}
