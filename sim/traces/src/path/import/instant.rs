//! Dates and times of day as recordings write them.

use time::format_description::well_known::Rfc3339;
use time::{Date, Month, OffsetDateTime};

/// Seconds since 1970 of an RFC 3339 time, with two freedoms that GPX and KML take: without a zone it is UTC, without
/// a time of day it is midnight.
pub(super) fn from_iso(text: &str) -> Option<f64> {
    let text = text.trim();
    let parsed = match text.len() {
        10 => OffsetDateTime::parse(&format!("{text}T00:00:00Z"), &Rfc3339),
        _ => OffsetDateTime::parse(text, &Rfc3339).or_else(|_| OffsetDateTime::parse(&format!("{text}Z"), &Rfc3339)),
    };
    let nanoseconds = parsed.ok()?.unix_timestamp_nanos();
    #[expect(clippy::cast_precision_loss, reason = "to a quarter of a microsecond")]
    Some(nanoseconds as f64 * 1e-9)
}

/// Days since 1970 of a date.
pub(super) fn days(year: i32, month: u8, day: u8) -> Option<i64> {
    let date = Date::from_calendar_date(year, Month::try_from(month).ok()?, day).ok()?;
    Some(date.midnight().assume_utc().unix_timestamp().div_euclid(86_400))
}

/// A time for the reader, to the second.
pub(super) fn to_text(seconds: f64) -> String {
    #[expect(clippy::cast_possible_truncation, reason = "saturates, and what is out of range has no text")]
    match OffsetDateTime::from_unix_timestamp(libm::floor(seconds) as i64) {
        Ok(t) => format!(
            "{:04}-{:02}-{:02} {:02}:{:02}:{:02} UTC",
            t.year(),
            u8::from(t.month()),
            t.day(),
            t.hour(),
            t.minute(),
            t.second()
        ),
        Err(_) => format!("{seconds} s after 1970"),
    }
}
