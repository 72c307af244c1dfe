//! GPX 1.0 and 1.1: the points of all tracks that have times. Routes, waypoints and points without a time are left out.

use crate::path::{CameraPath, Heights, PathError};

use super::instant;
use super::track::{Fix, Track};
use super::xml::{Node, Xml, excerpt};

/// A point as it is read.
#[derive(Default)]
struct Point {
    latitude: Option<f64>,
    longitude: Option<f64>,
    height: Option<f64>,
    time: Option<f64>,
}

/// Reads a file. Elevations are above sea level, as the format has it.
pub(super) fn read(name: &str, bytes: &[u8]) -> Result<CameraPath, PathError> {
    let mut xml = Xml::new(name, bytes)?;
    let mut track = Track::new(name, true);
    let mut point = None;
    let (mut untimed, mut segments, mut others) = (0usize, 0usize, 0usize);
    let mut of_segment = 0usize;
    loop {
        match xml.next()? {
            Node::End => break,
            Node::Open(element, start) if element == "trkpt" => {
                let mut read = Point::default();
                for attribute in start.attributes().with_checks(false) {
                    let attribute = attribute.map_err(|error| xml.error(format!("{error}; expected attributes")))?;
                    match attribute.key.as_ref() {
                        "lat" => read.latitude = Some(xml.number("lat", &attribute.value)?),
                        "lon" => read.longitude = Some(xml.number("lon", &attribute.value)?),
                        _ => {}
                    }
                }
                point = Some(read);
            }
            Node::Open(element, _) => match element.as_str() {
                "trkseg" => of_segment = 0,
                "wpt" | "rtept" => others += 1,
                _ => {}
            },
            Node::Close(element, text) => match (element.as_str(), &mut point) {
                ("ele", Some(point)) if xml.parent() == "trkpt" => point.height = Some(xml.number("ele", &text)?),
                ("time", Some(point)) if xml.parent() == "trkpt" => {
                    let expected = || format!("time `{}`; expected one such as 2010-10-03T09:36:30Z", excerpt(&text));
                    point.time = Some(instant::from_iso(&text).ok_or_else(|| xml.error(expected()))?);
                }
                ("trkpt", _) => {
                    let Some(point) = point.take() else { continue };
                    let (Some(latitude), Some(longitude)) = (point.latitude, point.longitude) else {
                        return Err(xml.error("a trkpt without lat or lon; expected both".to_owned()));
                    };
                    let Some(time) = point.time else {
                        untimed += 1;
                        continue;
                    };
                    segments += usize::from(of_segment == 0);
                    of_segment += 1;
                    let fix = Fix { time, latitude, longitude, height: point.height, attitude: None };
                    track.push(fix).map_err(|message| xml.error(message))?;
                }
                _ => {}
            },
        }
    }
    if track.fixes().is_empty() && untimed > 0 {
        let message = format!("none of {untimed} track points has a time; expected a <time> in each <trkpt>");
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    if untimed > 0 {
        let total = untimed + track.fixes().len();
        track.add_note(format!("mind: {untimed} of {total} track points have no time: left out"));
    }
    if segments > 1 {
        track.add_note(format!("{segments} track segments with times, one after the other"));
    }
    if others > 0 {
        track.add_note(format!("{others} waypoints and route points left out"));
    }
    track.finish(Heights::SeaLevel)
}
