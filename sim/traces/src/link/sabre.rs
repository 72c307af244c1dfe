//! SABRE's network traces: a JSON list of `{"duration_ms", "bandwidth_kbps", "latency_ms"}`, one a period, repeated from
//! the start (Spiteri, Sitaraman and Sparacio, *From Theory to Practice: Improving Bitrate Adaptation in the DASH
//! Reference Player*, MMSys 2018).
//!
//! A kilobit is 1000 bits. The latency is that from a request to its first byte; here it is taken at the moment of the
//! request, where SABRE lets the waiting itself go through the periods that it crosses.

use foresight_scheduler::units::Time;
use serde::Deserialize;

use super::{LinkError, LinkTrace, RATE_MAX, RatePiece, RttPiece, SECONDS_MAX};

#[derive(Deserialize)]
struct Period {
    duration_ms: f64,
    bandwidth_kbps: f64,
    latency_ms: f64,
}

/// Whether the content is a JSON list, which no other link format begins as.
pub fn is_sabre(bytes: &[u8]) -> bool {
    without_mark(bytes).trim_ascii_start().first() == Some(&b'[')
}

fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// Reads a trace. Periods of no duration are dropped, and noted.
///
/// # Errors
/// What is no such list, by line and column; a figure out of range, by its place; a list without capacity.
pub fn parse(name: &str, bytes: &[u8]) -> Result<LinkTrace, LinkError> {
    let whole = |message: String| LinkError::Whole { name: name.to_owned(), message };
    let periods: Vec<Period> = serde_json::from_slice(without_mark(bytes)).map_err(|error| {
        whole(format!("{error}; expected a SABRE list of {{\"duration_ms\", \"bandwidth_kbps\", \"latency_ms\"}}"))
    })?;
    let (mut rates, mut rtts) = (Vec::with_capacity(periods.len()), Vec::with_capacity(periods.len()));
    let mut from = Time::ZERO;
    for (i, period) in periods.iter().enumerate() {
        let in_range = |what: &str, value: f64, max: f64| {
            // Comparing with both ends also refuses what is not a number.
            let message = || format!("[{i}].{what} is {value}; expected 0 to {max:e}");
            if (0.0..=max).contains(&value) { Ok(value) } else { Err(whole(message())) }
        };
        let duration = in_range("duration_ms", period.duration_ms, SECONDS_MAX * 1e3)?;
        let rate = in_range("bandwidth_kbps", period.bandwidth_kbps, RATE_MAX as f64 * 1e-3)?;
        let latency = in_range("latency_ms", period.latency_ms, SECONDS_MAX * 1e3)?;
        let duration = Time(libm::round(duration * 1e6) as u64);
        if duration == Time::ZERO {
            continue;
        }
        rates.push(RatePiece { from, bits_per_second: libm::round(rate * 1e3) as u64 });
        rtts.push(RttPiece { from, rtt: Time(libm::round(latency * 1e6) as u64) });
        from += duration;
        if from.secs() > SECONDS_MAX {
            return Err(whole(format!("[{i}] ends at {} s; expected at most {SECONDS_MAX:e} s", from.secs())));
        }
    }
    let dropped = periods.len() - rates.len();
    let mut link = LinkTrace::from_rates(name, rates, from, Time::ZERO)?.with_varying_rtt(&rtts, from)?;
    if dropped > 0 {
        link.add_note(format!("{dropped} periods of no duration dropped"));
    }
    Ok(link)
}
