//! Logs of G-NetTrack, the drive-test app, as in the Irish 5G data set (Raca et al., *Beyond Throughput, the Next
//! Generation: a 5G Dataset with Channel and Context Metrics*, MMSys 2020): a CSV table of about one row a second, of which
//! `Timestamp` (`2019.12.16_07.22.43`), `DL_bitrate` (kbit/s), `State` and `PINGAVG` (ms, `-` where not measured) are
//! read here.
//!
//! Timestamps are whole seconds, so rows of a slightly faster clock share them, and others are skipped. The rate of a
//! second is the mean of its rows; a second without a row holds the rate before. A measured ping is the round trip from
//! its second until the next one; the first also holds before.

use std::iter::Peekable;

use foresight_scheduler::units::Time;

use crate::path::g_nettrack_time;
use crate::text_lines::TextLines;

use super::parse::{ASSUMED_RTT, Read};
use super::{LinkError, LinkTrace, RATE_MAX, RatePiece, RttPiece, SECONDS_MAX};

const SECOND: u64 = 1_000_000_000;

/// Places of the columns that are read.
#[derive(Clone, Copy, Debug)]
pub(super) struct Columns {
    timestamp: usize,
    rate: usize,
    state: Option<usize>,
    ping: Option<usize>,
}

impl Columns {
    /// `None` if this is not the header of such a table.
    pub(super) fn find(header: &str) -> Option<Columns> {
        let column = |name: &str| header.split(',').position(|field| field.trim().eq_ignore_ascii_case(name));
        Some(Columns {
            timestamp: column("Timestamp")?,
            rate: column("DL_bitrate")?,
            state: column("State"),
            ping: column("PINGAVG"),
        })
    }
}

/// What the rows of one second say.
struct Second {
    /// Since the first.
    number: u64,
    /// Sum of the rates, kbit/s, and their number.
    kilobits: f64,
    rows: u32,
}

/// Reads the rows after the header.
pub(super) fn parse(name: &str, columns: Columns, lines: Peekable<TextLines<'_>>) -> Result<Read, LinkError> {
    let mut seconds: Vec<Second> = Vec::new();
    let mut pings: Vec<RttPiece> = Vec::new();
    let mut first = None;
    let (mut shared, mut regressed, mut without_rate, mut idle) = (0usize, 0usize, 0usize, 0usize);
    for (number, line) in lines {
        let wrong = |message: String| LinkError::Line { name: name.to_owned(), line: number, message };
        let field = |column: usize| line.split(',').nth(column).map(str::trim);
        let stamp = field(columns.timestamp).unwrap_or_default();
        let at = g_nettrack_time(stamp).ok_or_else(|| {
            let stamp: String = stamp.chars().take(40).collect();
            wrong(format!("a time of `{stamp}`; expected one such as 2019.12.16_07.22.43"))
        })?;
        let text = field(columns.rate).unwrap_or_default();
        let rate = match text {
            "" | "-" => None,
            _ => Some(text.parse::<f64>().ok().filter(|r| (0.0..=RATE_MAX as f64 * 1e-3).contains(r)).ok_or_else(
                || {
                    let text: String = text.chars().take(40).collect();
                    wrong(format!("a DL_bitrate of `{text}`; expected kbit/s, or -"))
                },
            )?),
        };
        let since = at - *first.get_or_insert(at);
        if since > SECONDS_MAX {
            return Err(wrong(format!("{since} s after the first row; expected at most {SECONDS_MAX:e}")));
        }
        let latest = seconds.last().map_or(0.0, |s| s.number as f64);
        if since < latest {
            regressed += 1;
            continue;
        }
        idle += usize::from(columns.state.and_then(field) == Some("I"));
        // Not measured in most rows; `-` and nonsense alike say nothing.
        let ping = columns.ping.and_then(field).and_then(|ms| ms.parse::<f64>().ok());
        if let Some(ms) = ping.filter(|ms| (0.0..=SECONDS_MAX * 1e3).contains(ms)) {
            let rtt = Time(libm::round(ms * 1e6) as u64);
            let from = Time(since as u64 * SECOND);
            match pings.last_mut() {
                Some(last) if last.from == from => last.rtt = rtt,
                _ => pings.push(RttPiece { from, rtt }),
            }
        }
        let Some(kilobits) = rate else {
            without_rate += 1;
            continue;
        };
        match seconds.last_mut() {
            Some(last) if last.number == since as u64 => {
                last.kilobits += kilobits;
                last.rows += 1;
                shared += 1;
            }
            _ => seconds.push(Second { number: since as u64, kilobits, rows: 1 }),
        }
    }
    let whole = |message: String| LinkError::Whole { name: name.to_owned(), message };
    let (Some(begins), Some(last)) = (seconds.first().map(|s| s.number), seconds.last()) else {
        return Err(whole("holds no row with a DL_bitrate; expected a G-NetTrack log".to_owned()));
    };
    if regressed > seconds.len() {
        return Err(whole(format!("{regressed} rows are earlier than the one before; expected rows in order of time")));
    }
    let period = Time((last.number - begins + 1) * SECOND);
    let rates = seconds.iter().map(|second| RatePiece {
        from: Time((second.number - begins) * SECOND),
        bits_per_second: libm::round(second.kilobits * 1e3 / f64::from(second.rows)) as u64,
    });
    let mut link = LinkTrace::from_rates(name, rates.collect(), period, ASSUMED_RTT)?;
    let states_rtt = !pings.is_empty();
    if states_rtt {
        let measured = pings.len();
        link = link.with_varying_rtt(&held(pings, begins * SECOND, period), period)?;
        link.add_note(format!("round trips: PINGAVG of {measured} rows, each held until the next"));
    }
    let steps = seconds.windows(2).map(|pair| pair[1].number - pair[0].number);
    let (mut skipped, mut longest) = (0, 0);
    for step in steps {
        skipped += step - 1;
        longest = longest.max(step - 1);
    }
    let mut note = |count: u64, text: String| {
        if count > 0 {
            link.add_note(text);
        }
    };
    note(shared as u64, format!("{shared} rows share their second with another: the second's rate is their mean"));
    note(skipped, format!("{skipped} seconds without a row, at most {longest} in a row: the rate before holds"));
    note(regressed as u64, format!("{regressed} rows dropped that are earlier than the one before"));
    note(without_rate as u64, format!("{without_rate} rows without a DL_bitrate dropped"));
    note(idle as u64, format!("{idle} rows in state I (idle): what was received there is no measure of the capacity"));
    Ok(Read { link, states_rtt })
}

/// Pings as pieces from `begins` over `period`, both in the time of the first row.
fn held(pings: Vec<RttPiece>, begins: u64, period: Time) -> Vec<RttPiece> {
    let mut pieces: Vec<RttPiece> = Vec::with_capacity(pings.len());
    for ping in pings {
        let from = if pieces.is_empty() { Time::ZERO } else { Time(ping.from.0.saturating_sub(begins)) };
        match pieces.last_mut() {
            _ if from >= period => {}
            // Only what came before the first rate falls together.
            Some(last) if last.from >= from => last.rtt = ping.rtt,
            _ => pieces.push(RttPiece { from, rtt: ping.rtt }),
        }
    }
    pieces
}
