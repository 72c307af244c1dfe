//! IGC flight recorder files: B records (time of day, position, pressure and GNSS altitude) of the day of the date
//! record. A time of day earlier by more than 12 hours is the next day's.

use igc::records::BRecord;

use crate::path::{CameraPath, Heights, PathError};
use crate::text_lines::LINE_BYTES_MAX;

use super::instant;
use super::track::{Fix, Track};
use super::xml::excerpt;

const DAY: i64 = 86_400;

/// A line that hardly another format holds: a date record, or a fix.
pub(super) fn is_typical(line: &[u8]) -> bool {
    let line = line.trim_ascii();
    line.starts_with(b"HFDTE") || line.starts_with(b"HODTE") || fix_of(line).is_some_and(|fix| fix.is_ok())
}

/// A fix of a line that begins as one.
fn fix_of(line: &[u8]) -> Option<Result<BRecord<'_>, String>> {
    if line.first() != Some(&b'B') {
        return None;
    }
    let record = match std::str::from_utf8(line) {
        Ok(text) if text.is_ascii() => BRecord::parse(text).map_err(|error| format!("{error:?}")),
        _ => Err("not ASCII".to_owned()),
    };
    Some(record)
}

/// Where a line's extension holds further digits of the minutes, as `I` records say: first and last byte from 0.
#[derive(Clone, Copy, Default)]
struct Digits {
    latitude: Option<(usize, usize)>,
    longitude: Option<(usize, usize)>,
}

impl Digits {
    /// `I` and a count, then for each extension its first byte, its last byte (from 1, two digits each) and three letters.
    fn of(line: &[u8]) -> Digits {
        let mut digits = Digits::default();
        for extension in line.get(3..).unwrap_or_default().chunks_exact(7) {
            let number = |at: usize| std::str::from_utf8(&extension[at..at + 2]).ok()?.parse::<usize>().ok();
            let range = match (number(0), number(2)) {
                (Some(first), Some(last)) if first >= 36 && (first..first + 9).contains(&last) => (first - 1, last),
                _ => continue,
            };
            match &extension[4..] {
                b"LAD" => digits.latitude = Some(range),
                b"LOD" => digits.longitude = Some(range),
                _ => {}
            }
        }
        digits
    }

    /// Degrees of the further digits.
    fn degrees(range: Option<(usize, usize)>, line: &[u8]) -> f64 {
        let Some((first, last)) = range else { return 0.0 };
        let digits = line.get(first..last).unwrap_or_default();
        if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
            return 0.0;
        }
        let fraction = digits.iter().rev().fold(0.0, |sum, digit| (sum + f64::from(digit - b'0')) / 10.0);
        fraction / 60_000.0
    }
}

/// Reads a file. The GNSS altitude counts where the file has one (its `HFALG` says above what), else the pressure
/// altitude; fixes without GNSS (validity V) are left out.
pub(super) fn read(name: &str, bytes: &[u8]) -> Result<CameraPath, PathError> {
    let mut day = None;
    let mut digits = Digits::default();
    let mut gnss_above = None;
    let (mut invalid, mut rollovers) = (0usize, 0usize);
    // Seconds of the first day, and both altitudes.
    let mut fixes: Vec<(usize, i64, [f64; 2], [f64; 2])> = Vec::new();
    let mut previous: Option<i64> = None;
    for (index, line) in bytes.split(|&b| b == b'\n').enumerate() {
        let number = index + 1;
        let error = |message: String| PathError::Line { name: name.to_owned(), line: number, message };
        if line.len() > LINE_BYTES_MAX {
            return Err(error(format!("is longer than {LINE_BYTES_MAX} bytes; expected short lines of text")));
        }
        let line = line.trim_ascii();
        if line.starts_with(b"I") {
            digits = Digits::of(line);
        } else if line.starts_with(b"HFALG") || line.starts_with(b"HOALG") {
            let text = line.to_ascii_uppercase();
            let says = |word: &[u8]| text[5..].windows(word.len()).any(|part| part == word);
            gnss_above = if says(b"ELL") {
                Some(Heights::Ellipsoid)
            } else if says(b"GEO") {
                Some(Heights::SeaLevel)
            } else {
                gnss_above
            };
        } else if line.starts_with(b"HFDTE") || line.starts_with(b"HODTE") {
            let date = date_of(line).ok_or_else(|| {
                let found = excerpt(&String::from_utf8_lossy(line));
                error(format!("date `{found}`; expected HFDTE and DDMMYY"))
            })?;
            // A second date is that of a second flight in the file, or the same again.
            day = day.or(Some(date));
        }
        let Some(record) = fix_of(line) else { continue };
        let record = record.map_err(|reason| {
            let found = excerpt(&String::from_utf8_lossy(line));
            error(format!("fix `{found}` ({reason}); expected BHHMMSSDDMMmmmNDDDMMmmmEAPPPPPGGGGG"))
        })?;
        let seconds = i64::from(record.timestamp.seconds_since_midnight());
        if previous.is_some_and(|previous| previous - seconds > DAY / 2) {
            rollovers += 1;
        }
        previous = Some(seconds);
        if record.fix_valid == igc::records::FixValid::NavWarning {
            invalid += 1;
            continue;
        }
        let sign = |negative: bool| if negative { -1.0 } else { 1.0 };
        let (latitude, longitude) = (f64::from(record.pos.lat), f64::from(record.pos.lon));
        let south = record.pos.lat.0.sign == igc::util::Compass::South;
        let west = record.pos.lon.0.sign == igc::util::Compass::West;
        let position = [
            latitude + sign(south) * Digits::degrees(digits.latitude, line),
            longitude + sign(west) * Digits::degrees(digits.longitude, line),
        ];
        let time = seconds + i64::try_from(rollovers).unwrap_or(i64::MAX / DAY) * DAY;
        fixes.push((number, time, position, [f64::from(record.pressure_alt), f64::from(record.gps_alt)]));
    }
    if fixes.is_empty() {
        let message = format!("no valid fix ({invalid} without GNSS); expected B records");
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    let mut track = Track::new(name, day.is_some());
    let count = fixes.len() as f64;
    let has = |which: usize| fixes.iter().any(|(.., altitudes)| altitudes[which] != 0.0);
    let (which, heights) = match (has(1), has(0)) {
        (true, _) => (1, gnss_above.unwrap_or(Heights::Ellipsoid)),
        (false, true) => (0, Heights::Pressure),
        (false, false) => (1, Heights::Ground),
    };
    if has(0) && has(1) {
        let mean = fixes.iter().map(|(.., [pressure, gnss])| gnss - pressure).sum::<f64>() / count;
        track.add_note(format!(
            "mind: GNSS altitudes taken ({heights}), on average {mean:+.1} m against the pressure altitudes, which the \
             file holds too"
        ));
    }
    if which == 1 && gnss_above.is_none() && heights == Heights::Ellipsoid {
        track.add_note("the file does not say what its GNSS altitudes are above: taken as the ellipsoid");
    }
    if day.is_none() {
        track.add_note("no date record");
    }
    if invalid > 0 {
        track.add_note(format!("{invalid} of {} fixes without GNSS (validity V) left out", invalid + fixes.len()));
    }
    if rollovers > 0 {
        track.add_note(format!("{rollovers} times past midnight"));
    }
    let start = day.unwrap_or(0) * DAY;
    for (line, time, [latitude, longitude], altitudes) in fixes {
        let height = (heights != Heights::Ground).then_some(altitudes[which]);
        let time = (start + time) as f64;
        let fix = Fix { time, latitude, longitude, height, attitude: None };
        track.push(fix).map_err(|message| PathError::Line { name: name.to_owned(), line, message })?;
    }
    track.finish(heights)
}

/// Days since 1970 of `HFDTE` or `HFDTEDATE:` and DDMMYY; years from 80 on are of the 20th century.
fn date_of(line: &[u8]) -> Option<i64> {
    let rest = line.get(5..)?;
    let rest = rest.strip_prefix(b"DATE").unwrap_or(rest);
    let rest = rest.strip_prefix(b":").unwrap_or(rest).trim_ascii_start();
    let number = |at: usize| std::str::from_utf8(rest.get(at..at + 2)?).ok()?.parse::<u8>().ok();
    let (day, month, year) = (number(0)?, number(2)?, i32::from(number(4)?));
    instant::days(if year >= 80 { 1900 + year } else { 2000 + year }, month, day)
}
