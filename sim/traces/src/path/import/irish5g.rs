//! G-NetTrack tables (as of the Irish 5G production data set): `Timestamp` (YYYY.MM.DD_hh.mm.ss), `Longitude`,
//! `Latitude` (degrees), `Speed` (km/h); no heights. The link that they hold besides is read elsewhere.

use crate::path::{CameraPath, Heights, PathError};
use crate::text_lines::TextLines;

use super::instant;
use super::track::{Fix, Track};
use super::xml::excerpt;

/// Where the columns are.
struct Columns {
    time: usize,
    longitude: usize,
    latitude: usize,
    speed: Option<usize>,
}

impl Columns {
    fn find(header: &str) -> Option<Columns> {
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        let column = |name: &str| names.iter().position(|n| n.eq_ignore_ascii_case(name));
        Some(Columns {
            time: column("Timestamp")?,
            longitude: column("Longitude")?,
            latitude: column("Latitude")?,
            speed: column("Speed"),
        })
    }
}

/// Is this the header of such a table?
pub(super) fn is_header(line: &str) -> bool {
    Columns::find(line).is_some()
}

/// Reads a table. Its receiver repeats a position until it has another; a row that moves but stays where the last one
/// was is therefore left out, and the motion between two positions is interpolated. Rows at rest stay.
pub(super) fn read(name: &str, mut lines: TextLines<'_>) -> Result<CameraPath, PathError> {
    let error = |line: usize, message: String| PathError::Line { name: name.to_owned(), line, message };
    let columns = lines
        .next()
        .and_then(|(_, header)| Columns::find(&header))
        .ok_or_else(|| error(1, "no header with Timestamp, Longitude and Latitude; expected one".to_owned()))?;
    let mut track = Track::new(name, true);
    let (mut rows, mut without, mut held, mut duplicates) = (0usize, 0usize, 0usize, 0usize);
    let (mut previous, mut last, mut longest_hold): (Option<f64>, Option<Fix>, f64) = (None, None, 0.0);
    for (number, line) in lines {
        rows += 1;
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let field = |column: usize| {
            let missing = || error(number, format!("{} columns; expected a column {}", fields.len(), column + 1));
            fields.get(column).copied().ok_or_else(missing)
        };
        let text = field(columns.time)?;
        let time = time_of(text).ok_or_else(|| {
            error(number, format!("time `{}`; expected one such as 2019.12.16_07.22.43", excerpt(text)))
        })?;
        let (longitude, latitude) = (field(columns.longitude)?, field(columns.latitude)?);
        if [longitude, latitude].iter().any(|field| matches!(*field, "-" | "")) {
            without += 1;
            continue;
        }
        let degrees = |what: &str, text: &str| {
            text.parse::<f64>().map_err(|_| error(number, format!("{what} `{}`; expected degrees", excerpt(text))))
        };
        let (longitude, latitude) = (degrees("longitude", longitude)?, degrees("latitude", latitude)?);
        let speed = columns.speed.and_then(|column| fields.get(column)).and_then(|text| text.parse::<f64>().ok());
        if previous == Some(time) {
            duplicates += 1;
            continue;
        }
        previous = Some(time);
        let fix = Fix { time, latitude, longitude, height: None, attitude: None };
        let is_held = last.is_some_and(|last| last.latitude == latitude && last.longitude == longitude);
        if is_held && speed.is_some_and(|speed| speed > 0.0) {
            held += 1;
            longest_hold = longest_hold.max(last.map_or(0.0, |last| time - last.time));
            continue;
        }
        track.push(fix).map_err(|message| error(number, message))?;
        last = Some(fix);
    }
    if duplicates > 0 {
        track.add_note(format!("mind: {duplicates} of {rows} rows have the time of the row before: left out"));
    }
    if held > 0 {
        track.add_note(format!(
            "mind: {held} of {rows} rows repeat the last position while moving, for up to {longest_hold:.0} s: left \
             out, the motion between positions is interpolated"
        ));
    }
    if without > 0 {
        track.add_note(format!("{without} of {rows} rows without position left out"));
    }
    track.finish(Heights::Ground)
}

/// Seconds since 1970 of `YYYY.MM.DD_hh.mm.ss`.
pub(crate) fn time_of(text: &str) -> Option<f64> {
    let (date, clock) = text.split_once('_')?;
    let three = |text: &str| {
        let mut parts = text.split('.').map(|part| part.parse::<u16>().ok());
        let three = [parts.next()??, parts.next()??, parts.next()??];
        parts.next().is_none().then_some(three)
    };
    let ([year, month, day], [hour, minute, second]) = (three(date)?, three(clock)?);
    if hour > 23 || minute > 59 || second > 60 {
        return None;
    }
    let days = instant::days(i32::from(year), u8::try_from(month).ok()?, u8::try_from(day).ok()?)?;
    Some(days as f64 * 86_400.0 + f64::from(hour) * 3600.0 + f64::from(minute) * 60.0 + f64::from(second))
}
