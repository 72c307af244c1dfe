//! Links from files and from specifications.

use std::path::{Path, PathBuf};

use foresight_scheduler::units::Time;

use crate::text_lines::{LINE_BYTES_MAX, TextLines};

use super::{LinkError, LinkTrace, SECONDS_MAX, delay, g_nettrack, mahimahi, rate_lines, sabre};

/// Round trip of a link whose file states none.
pub const ASSUMED_RTT: Time = Time(50_000_000);

/// Largest file read, bytes.
const FILE_BYTES_MAX: u64 = 1 << 30;

/// Reads `FILE|constant:RATE,RTT[,scale=X][,start=SECONDS][,rtt=MS|,delay=FILE][,loss=P]`.
///
/// RATE is a number with `bit`, `kbit`, `Mbit` or `Gbit` (`/s` or `ps` may follow), RTT one with `us`, `ms` or `s`; `rtt=`
/// without a unit is in milliseconds, `start=` in seconds; `delay=` names a list of one-way delays (see [`delay`]), which is
/// also taken from `NAME.delay` beside a `NAME.down`; `loss=` is the probability that a request fails.
///
/// # Errors
/// A specification of another form, a file that cannot be read, and all errors of [`from_bytes`] and [`delay::parse`].
pub fn from_specification(spec: &str) -> Result<LinkTrace, LinkError> {
    let fail = |message: String| LinkError::Specification { spec: spec.to_owned(), message };
    let mut source = spec;
    let (mut scale, mut start, mut rtt, mut delay_file, mut loss) = (None, None, None, None, None);
    while let Some((rest, option)) = source.rsplit_once(',') {
        let Some((key, value)) = option.split_once('=') else { break };
        let slot = match key {
            "scale" => &mut scale,
            "start" => &mut start,
            "rtt" => &mut rtt,
            "delay" => &mut delay_file,
            "loss" => &mut loss,
            // A file name may hold a comma and an equals sign.
            _ if Path::new(source).exists() => break,
            _ => return Err(fail(format!("unknown option `{key}`; expected scale, start, rtt, delay or loss"))),
        };
        if slot.replace(value).is_some() {
            return Err(fail(format!("`{key}` is given twice; expected once")));
        }
        source = rest;
    }
    let number = |what: &str, text: Option<&str>, fits: fn(f64) -> bool, expected: &str| match text {
        None => Ok(None),
        Some(text) => match text.parse::<f64>() {
            Ok(value) if fits(value) => Ok(Some(value)),
            _ => Err(fail(format!("{what} `{text}`; expected {expected}"))),
        },
    };
    let scale = number("scale", scale, |v| v.is_finite() && v > 0.0, "a positive number")?;
    let loss = number("loss", loss, |v| (0.0..=1.0).contains(&v), "a probability, 0 to 1")?;
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
    if rtt.is_some() && delay_file.is_some() {
        return Err(fail("both rtt and delay are given; expected one".to_owned()));
    }

    let (mut link, states_rtt) = match source.strip_prefix("constant:") {
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
                    (LinkTrace::constant(source, bits, own)?, true)
                }
                (None, Some(given)) => (LinkTrace::constant(source, bits, given)?, true),
                (None, None) if delay_file.is_some() => (LinkTrace::constant(source, bits, Time::ZERO)?, true),
                (None, None) => return Err(fail(format!("no round trip; {expected}"))),
            }
        }
        None => {
            let read = file_content(source, &read(source)?)?;
            (read.link, read.states_rtt)
        }
    };
    let delays = delay_file.map(PathBuf::from).or_else(|| delays_beside(source).filter(|_| rtt.is_none()));
    match (rtt, delays) {
        (Some(rtt), _) => link = link.with_rtt(rtt)?,
        (None, Some(file)) => {
            let name = file.to_string_lossy();
            let delays = delay::parse(&name, &read(&name)?)?;
            link = link.with_varying_rtt(&delays.pieces, delays.period)?;
            link.add_note(format!("round trips: twice the one-way delays in {name}"));
        }
        (None, None) if !states_rtt => assume_rtt(&mut link),
        (None, None) => {}
    }
    if let Some(factor) = scale {
        link = link.scaled(factor)?;
    }
    if let Some(probability) = loss {
        link = link.with_loss(probability, 1)?;
    }
    if let Some(start) = start {
        link = link.shifted(start);
    }
    link.set_name(spec);
    Ok(link)
}

fn read(name: &str) -> Result<Vec<u8>, LinkError> {
    let io = |error| LinkError::Io { name: name.to_owned(), source: error };
    check_size(name, std::fs::metadata(name).map_err(io)?.len())?;
    std::fs::read(name).map_err(io)
}

/// `NAME.delay` beside a `NAME.down`, if it is there.
fn delays_beside(source: &str) -> Option<PathBuf> {
    let file = Path::new(source);
    let beside = file.with_extension("delay");
    (file.extension()? == "down" && beside.is_file()).then_some(beside)
}

/// Reads a file's content, recognised by itself:
/// - Mahimahi lines (an integer of milliseconds each, non-decreasing, one opportunity of 1500 bytes);
/// - lines of `seconds Mbit/s`; the first time becomes 0, a rate holds until the next line's time, the last one for the
///   median step; lines whose time is not later than the one before are dropped, and noted;
/// - a SABRE list (JSON), see [`sabre`];
/// - a G-NetTrack log (CSV with `Timestamp` and `DL_bitrate`), see [`g_nettrack`].
///
/// Empty lines and lines that begin with `#` are skipped. Where a round trip is not stated, [`ASSUMED_RTT`] is taken, and
/// noted.
///
/// # Errors
/// [`LinkError`] names the line and what was expected of it.
pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<LinkTrace, LinkError> {
    let mut read = file_content(name, bytes)?;
    if !read.states_rtt {
        assume_rtt(&mut read.link);
    }
    Ok(read.link)
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

/// A link, with [`ASSUMED_RTT`] if it does not state its own.
pub(super) struct Read {
    pub(super) link: LinkTrace,
    pub(super) states_rtt: bool,
}

fn file_content(name: &str, bytes: &[u8]) -> Result<Read, LinkError> {
    check_size(name, bytes.len() as u64)?;
    if sabre::is_sabre(bytes) {
        return Ok(Read { link: sabre::parse(name, bytes)?, states_rtt: true });
    }
    let mut lines = text_lines(name, bytes)?.peekable();
    let Some((_, first)) = lines.peek() else {
        let message = "is empty; expected a network trace".to_owned();
        return Err(LinkError::Whole { name: name.to_owned(), message });
    };
    if let Some(columns) = g_nettrack::Columns::find(first) {
        lines.next();
        return g_nettrack::parse(name, columns, lines);
    }
    let is_mahimahi = first.split_ascii_whitespace().count() == 1;
    let link = if is_mahimahi { mahimahi::parse(name, lines)? } else { rate_lines::parse(name, lines)? };
    Ok(Read { link, states_rtt: false })
}

fn text_lines<'a>(name: &str, bytes: &'a [u8]) -> Result<TextLines<'a>, LinkError> {
    TextLines::new(bytes).map_err(|line| {
        let message = format!("is longer than {LINE_BYTES_MAX} bytes; expected short lines of text");
        LinkError::Line { name: name.to_owned(), line, message }
    })
}

pub(super) fn unsupported(name: &str, line: usize, found: &str) -> LinkError {
    LinkError::Unsupported { name: name.to_owned(), line, found: found.chars().take(40).collect() }
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
