//! A file per format of recorded paths.

mod adsb;
mod comma2k19;
mod eye_nav;
mod gpx;
mod igc;
mod instant;
mod irish5g;
mod kml;
mod npy;
mod recording;
mod track;
mod tum;
mod xml;

#[cfg(test)]
mod tests;

use std::fmt;
use std::io::Read;

use flate2::read::MultiGzDecoder;

use crate::text_lines::{LINE_BYTES_MAX, TextLines};

use super::look::Look;
use super::parse::Options;
use super::{CameraPath, PathError};

pub(super) use comma2k19::{from_folder, is_array, is_folder};
pub(crate) use irish5g::time_of as g_nettrack_time;

/// Most bytes that a compressed file may hold …
const DECOMPRESSED_BYTES_MAX: u64 = 1 << 30;
/// … and most for each of its own, beyond a first mebibyte; recordings stay below 30.
const DECOMPRESSED_RATIO_MAX: u64 = 200;

/// How many lines are looked at for what only an IGC file holds.
const IGC_LINES: usize = 200;

/// A format of recorded paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `t x y z qx qy qz qw`.
    Tum,
    /// A table of head poses.
    EyeNavGs,
    /// GPS exchange format.
    Gpx,
    /// Flight recorder files of the International Gliding Commission.
    Igc,
    /// Keyhole Markup Language: `gx:Track` and `gx:Tour`.
    Kml,
    /// A list of aircraft states in JSON.
    AdsB,
    /// A G-NetTrack table with positions and bitrates.
    Irish5g,
    /// Our own recording.
    Recording,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Format::Tum => "TUM lines",
            Format::EyeNavGs => "an EyeNavGS table",
            Format::Gpx => "GPX",
            Format::Igc => "IGC",
            Format::Kml => "KML",
            Format::AdsB => "ADS-B JSON",
            Format::Irish5g => "a G-NetTrack table",
            Format::Recording => "a foresight-recording",
        })
    }
}

/// The format of a file's content, decompressed. What is nothing else is taken for TUM lines, which say what is wrong.
///
/// # Errors
/// XML with another root than `gpx` or `kml`.
fn recognise(name: &str, bytes: &[u8]) -> Result<Format, PathError> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    match text.first() {
        Some(b'<') => {
            let root = xml::Xml::new(name, bytes)?.root()?;
            return match root.as_str() {
                "gpx" => Ok(Format::Gpx),
                "kml" => Ok(Format::Kml),
                _ => Err(PathError::Unsupported { name: name.to_owned(), line: 1, found: format!("<{root}>") }),
            };
        }
        Some(b'{') if super::recording::is_recording(text) => return Ok(Format::Recording),
        Some(b'[' | b'{') => return Ok(Format::AdsB),
        _ => {}
    }
    let Some((_, first)) = text_lines(name, text)?.next() else { return Ok(Format::Tum) };
    Ok(if eye_nav::is_header(&first) {
        Format::EyeNavGs
    } else if irish5g::is_header(&first) {
        Format::Irish5g
    } else if text.split(|&b| b == b'\n').take(IGC_LINES).any(igc::is_typical) {
        Format::Igc
    } else {
        Format::Tum
    })
}

/// Reads a file's content in the format that it is in; a gzip file's content is decompressed first.
pub(super) fn read(name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return read_as(recognise(name, bytes)?, name, bytes, options);
    }
    let mut content = Vec::new();
    let decoder = MultiGzDecoder::new(bytes);
    let most = DECOMPRESSED_BYTES_MAX.min((1 << 20) + DECOMPRESSED_RATIO_MAX * bytes.len() as u64);
    let read = decoder.take(most + 1).read_to_end(&mut content);
    read.map_err(|error| PathError::Whole { name: name.to_owned(), message: format!("gzip: {error}") })?;
    if content.len() as u64 > most {
        let message = format!("{} bytes hold more than {most}; expected at most that decompressed", bytes.len());
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    read_as(recognise(name, &content)?, name, &content, options)
}

/// Reads a file's content, decompressed, in a format.
pub(super) fn read_as(format: Format, name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    let wrong = |option: &str, expected: &str| {
        Err(PathError::Option { given: option.to_owned(), message: format!("{name} is {format}; expected {expected}") })
    };
    if options.icao24.is_some() && format != Format::AdsB {
        return wrong("--icao24", "ADS-B JSON to select an aircraft of");
    }
    if matches!(options.look, Some(Look::Other(_))) && format != Format::AdsB {
        return wrong("--look other", "ADS-B JSON, where another aircraft is");
    }
    if options.crs.is_some() && !matches!(format, Format::Tum | Format::EyeNavGs) {
        return wrong("--path-crs", "positions in metres, for which a projected system can be given");
    }
    match format {
        Format::Tum => tum::read(name, bytes, text_lines(name, bytes)?, options),
        Format::EyeNavGs => eye_nav::read(name, text_lines(name, bytes)?, options),
        Format::Gpx => gpx::read(name, bytes),
        Format::Igc => igc::read(name, bytes),
        Format::Kml => kml::read(name, bytes),
        Format::AdsB => adsb::read(name, bytes, options),
        Format::Irish5g => irish5g::read(name, text_lines(name, bytes)?),
        Format::Recording => super::recording::path_from_bytes(name, bytes, options),
    }
}

/// The three arrays of a comma2k19 folder: times, positions, orientations.
pub(super) fn read_arrays(name: &str, arrays: [&[u8]; 3], options: &Options) -> Result<CameraPath, PathError> {
    comma2k19::read(name, arrays, options)
}

fn text_lines<'a>(name: &str, bytes: &'a [u8]) -> Result<TextLines<'a>, PathError> {
    TextLines::new(bytes).map_err(|line| {
        let message = format!("is longer than {LINE_BYTES_MAX} bytes; expected short lines of text");
        PathError::Line { name: name.to_owned(), line, message }
    })
}
