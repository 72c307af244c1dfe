//! KML: the longest `gx:Track` (`when`, `gx:coord`, `gx:angles`), or the first `gx:Tour` (`gx:FlyTo` to a `Camera` or a
//! `LookAt`, and `gx:Wait`). Element names count without their prefixes.

use foresight_index::geodesy::Geodetic;
use glam::DVec3;

use crate::path::{CameraPath, Heights, PathError};

use super::instant;
use super::track::{Attitude, Fix, Track};
use super::xml::{Node, Xml, excerpt};

/// What a flight without duration takes, seconds: poses need increasing times.
const JUMP_SECONDS: f64 = 1e-3;

/// Longest step of a tour, seconds.
const STEP_SECONDS_MAX: f64 = 1e8;

/// A `Camera` or a `LookAt`; degrees and metres.
#[derive(Clone, Copy, Default)]
struct View {
    /// A `LookAt` has a range; the rest is that of its target.
    is_look_at: bool,
    latitude: Option<f64>,
    longitude: Option<f64>,
    altitude: f64,
    heading: f64,
    tilt: f64,
    roll: f64,
    range: f64,
    mode: Mode,
}

/// What altitudes are above.
#[derive(Clone, Copy, Default, PartialEq)]
enum Mode {
    /// On the ground, whatever the altitude; the format's default.
    #[default]
    Clamped,
    Relative,
    Absolute,
}

impl Mode {
    fn of(text: &str) -> Option<Mode> {
        match text {
            "clampToGround" | "clampToSeaFloor" => Some(Mode::Clamped),
            "relativeToGround" | "relativeToSeaFloor" => Some(Mode::Relative),
            "absolute" => Some(Mode::Absolute),
            _ => None,
        }
    }

    fn heights(self) -> Heights {
        if self == Mode::Absolute { Heights::SeaLevel } else { Heights::Ground }
    }
}

/// A `gx:Track`, or the tracks of one `gx:MultiTrack`.
#[derive(Default)]
struct Recorded {
    times: Vec<f64>,
    /// Longitude, latitude, altitude.
    positions: Vec<Option<[f64; 3]>>,
    /// Heading, tilt, roll.
    angles: Vec<Option<[f64; 3]>>,
    mode: Option<Mode>,
}

/// A step of a tour.
enum Step {
    FlyTo(f64, View),
    Wait(f64),
}

/// What a file holds, as far as it is read.
#[derive(Default)]
struct Content {
    tracks: Vec<Recorded>,
    tour: Vec<Step>,
    tours: usize,
    bounces: usize,
}

/// Reads a file.
pub(super) fn read(name: &str, bytes: &[u8]) -> Result<CameraPath, PathError> {
    let content = content(name, bytes)?;
    if !content.tour.is_empty() {
        return tour(name, content);
    }
    let several = content.tracks.len();
    let longest = content.tracks.into_iter().rev().max_by_key(|track| track.times.len());
    let Some(recorded) = longest.filter(|track| !track.times.is_empty()) else {
        let message = "holds no gx:Track and no gx:Tour with positions; expected one (lines and points have no times)";
        return Err(PathError::Whole { name: name.to_owned(), message: message.to_owned() });
    };
    let mut track = Track::new(name, true);
    let mode = recorded.mode.unwrap_or_default();
    let (total, mut has_angles) = (recorded.times.len(), false);
    let angles = recorded.angles.into_iter().chain(std::iter::repeat(None));
    for (index, ((time, position), angles)) in
        recorded.times.into_iter().zip(recorded.positions).zip(angles).enumerate()
    {
        let Some([longitude, latitude, altitude]) = position else { continue };
        let height = Some(if mode == Mode::Clamped { 0.0 } else { altitude });
        // Model angles: a positive tilt lowers the nose, a positive roll the left side.
        let attitude = angles.map(|angles| angles.map(f64::to_radians)).map(|[heading, tilt, roll]| Attitude {
            heading,
            pitch: -tilt,
            roll: -roll,
        });
        has_angles |= attitude.is_some();
        let place = || format!("gx:Track, point {index}");
        track.push(Fix { time, latitude, longitude, height, attitude }).map_err(|message| PathError::Place {
            name: name.to_owned(),
            place: place(),
            message,
        })?;
    }
    let missing = total - track.fixes().len();
    if missing > 0 {
        track.add_note(format!("{missing} of {total} times have no position: left out"));
    }
    if has_angles {
        track.add_note("gx:angles are a model's: a positive tilt lowers the nose, a positive roll the left side");
    }
    if several > 1 {
        track.add_note(format!("mind: {several} gx:Tracks: the longest taken"));
    }
    track.finish(mode.heights())
}

fn content(name: &str, bytes: &[u8]) -> Result<Content, PathError> {
    let mut xml = Xml::new(name, bytes)?;
    let mut content = Content::default();
    let mut recorded = Recorded::default();
    let (mut duration, mut view): (f64, Option<View>) = (0.0, None);
    loop {
        match xml.next()? {
            Node::End => return Ok(content),
            Node::Open(element, _) => match element.as_str() {
                "Tour" => content.tours += 1,
                "MultiTrack" => recorded = Recorded::default(),
                "Track" if !xml.is_within("MultiTrack") => recorded = Recorded::default(),
                "FlyTo" => (duration, view) = (0.0, None),
                "Wait" => duration = 0.0,
                "Camera" => view = Some(View::default()),
                "LookAt" => view = Some(View { is_look_at: true, ..View::default() }),
                _ => {}
            },
            Node::Close(element, text) => {
                let parent = xml.parent().to_owned();
                match (parent.as_str(), element.as_str()) {
                    ("Track", _) => track_element(&xml, &mut recorded, &element, &text)?,
                    (_, "Track") if recorded.times.len() != recorded.positions.len() => {
                        let (times, positions) = (recorded.times.len(), recorded.positions.len());
                        let message = format!("{times} when and {positions} gx:coord; expected as many of both");
                        return Err(xml.error(message));
                    }
                    (_, "Track") => {
                        // Angles of a later track of a MultiTrack must not be those of an earlier one.
                        recorded.angles.resize(recorded.times.len(), None);
                        if !xml.is_within("MultiTrack") {
                            content.tracks.push(std::mem::take(&mut recorded));
                        }
                    }
                    (_, "MultiTrack") => content.tracks.push(std::mem::take(&mut recorded)),
                    ("FlyTo" | "Wait", "duration") => {
                        duration = xml.number("gx:duration", &text)?;
                        if !(0.0..=STEP_SECONDS_MAX).contains(&duration) {
                            let message = format!("a gx:duration of {duration}; expected 0 to {STEP_SECONDS_MAX} s");
                            return Err(xml.error(message));
                        }
                    }
                    ("FlyTo", "flyToMode") => content.bounces += usize::from(text == "bounce"),
                    ("Camera" | "LookAt", _) => {
                        if let Some(view) = &mut view {
                            view_element(&xml, view, &element, &text)?;
                        }
                    }
                    (_, "FlyTo") if content.tours == 1 && xml.is_within("Tour") => {
                        let view = view.take().ok_or_else(|| {
                            xml.error("a gx:FlyTo without Camera and LookAt; expected one of them".to_owned())
                        })?;
                        content.tour.push(Step::FlyTo(duration, view));
                    }
                    (_, "Wait") if content.tours == 1 && xml.is_within("Tour") => {
                        content.tour.push(Step::Wait(duration));
                    }
                    _ => {}
                }
            }
        }
    }
}

/// Three numbers with spaces between them; `None` without any.
fn three(xml: &Xml<'_>, what: &str, text: &str) -> Result<Option<[f64; 3]>, PathError> {
    let mut numbers = [0.0; 3];
    let mut fields = text.split_ascii_whitespace();
    for (i, slot) in numbers.iter_mut().enumerate() {
        match fields.next() {
            Some(field) => *slot = xml.number(what, field)?,
            None if i == 0 => return Ok(None),
            // Longitude and latitude suffice.
            None if i == 2 => {}
            None => return Err(xml.error(format!("{what} `{}`; expected 3 numbers", excerpt(text)))),
        }
    }
    Ok(Some(numbers))
}

fn track_element(xml: &Xml<'_>, track: &mut Recorded, element: &str, text: &str) -> Result<(), PathError> {
    match element {
        "when" => {
            let time = instant::from_iso(text).ok_or_else(|| {
                xml.error(format!("when `{}`; expected a time such as 2010-05-28T02:02:09Z", excerpt(text)))
            })?;
            track.times.push(time);
        }
        "coord" => track.positions.push(three(xml, "gx:coord", text)?),
        "angles" => track.angles.push(three(xml, "gx:angles", text)?),
        "altitudeMode" => track.mode = Some(mode(xml, text)?),
        _ => {}
    }
    Ok(())
}

fn view_element(xml: &Xml<'_>, view: &mut View, element: &str, text: &str) -> Result<(), PathError> {
    match element {
        "longitude" => view.longitude = Some(xml.number(element, text)?),
        "latitude" => view.latitude = Some(xml.number(element, text)?),
        "altitude" => view.altitude = xml.number(element, text)?,
        "heading" => view.heading = xml.number(element, text)?,
        "tilt" => view.tilt = xml.number(element, text)?,
        "roll" => view.roll = xml.number(element, text)?,
        "range" => view.range = xml.number(element, text)?,
        "altitudeMode" => view.mode = mode(xml, text)?,
        _ => {}
    }
    Ok(())
}

fn mode(xml: &Xml<'_>, text: &str) -> Result<Mode, PathError> {
    let expected = "expected absolute, relativeToGround, clampToGround, relativeToSeaFloor or clampToSeaFloor";
    Mode::of(text).ok_or_else(|| xml.error(format!("altitudeMode `{}`; {expected}", excerpt(text))))
}

/// The views of a tour over time: each step arrives after its duration; the first is there at once.
fn tour(name: &str, content: Content) -> Result<CameraPath, PathError> {
    let mut track = Track::new(name, false);
    let (mut time, mut last): (f64, Option<Fix>) = (0.0, None);
    let (mut jumps, mut relative, mut views) = (0usize, 0usize, 0usize);
    for (index, step) in content.tour.into_iter().enumerate() {
        let wrong = |message: String| PathError::Place {
            name: name.to_owned(),
            place: format!("gx:Tour, step {index}"),
            message,
        };
        let fix = match (step, last) {
            (Step::Wait(duration), Some(last)) if duration > 0.0 => {
                time += duration;
                Fix { time, ..last }
            }
            (Step::Wait(_), _) => continue,
            (Step::FlyTo(duration, view), last) => {
                if last.is_some() {
                    jumps += usize::from(duration < JUMP_SECONDS);
                    time += duration.max(JUMP_SECONDS);
                }
                views += 1;
                relative += usize::from(view.mode != Mode::Absolute);
                fix_of(time, &view).map_err(wrong)?
            }
        };
        track.push(fix).map_err(wrong)?;
        last = Some(fix);
    }
    if jumps > 0 {
        track.add_note(format!("{jumps} flights of the tour take no time: made {JUMP_SECONDS} s"));
    }
    if content.bounces > 0 {
        track
            .add_note(format!("{} flights stop at their ends (bounce): flown through as smooth ones", content.bounces));
    }
    if content.tours > 1 {
        track.add_note(format!("mind: {} gx:Tours: the first taken", content.tours));
    }
    if relative > 0 && relative < views {
        track.add_note(format!(
            "mind: {relative} of {views} altitudes are above the ground, the others above sea level"
        ));
    }
    track.finish(if 2 * relative > views { Heights::Ground } else { Heights::SeaLevel })
}

/// Camera of a view. A `Camera` with tilt 0 looks down, with 90 at the horizon; its roll is clockwise. A `LookAt` stands
/// its range away from its target.
fn fix_of(time: f64, view: &View) -> Result<Fix, String> {
    let (Some(latitude), Some(longitude)) = (view.latitude, view.longitude) else {
        return Err("a view without latitude or longitude; expected both".to_owned());
    };
    if !(latitude.abs() <= 90.0 && longitude.abs() <= 360.0 && view.altitude.abs() <= 1e7) {
        let altitude = view.altitude;
        return Err(format!("a view at {latitude}, {longitude}, {altitude} m; expected degrees and at most 1e7 m"));
    }
    let altitude = if view.mode == Mode::Clamped { 0.0 } else { view.altitude };
    let [heading, pitch, roll] = [view.heading, view.tilt - 90.0, view.roll].map(f64::to_radians);
    if !view.is_look_at {
        let attitude = Some(Attitude { heading, pitch, roll });
        return Ok(Fix { time, latitude, longitude, height: Some(altitude), attitude });
    }
    if !(0.0..=1e7).contains(&view.range) {
        return Err(format!("a range of {}; expected 0 to 1e7 m", view.range));
    }
    let there = Geodetic::from_degrees(latitude, longitude, altitude);
    let target = there.to_ecef();
    let level = libm::cos(pitch);
    let forward = DVec3::new(libm::sin(heading) * level, libm::cos(heading) * level, libm::sin(pitch));
    let camera = Geodetic::from_ecef(target - there.east_north_up() * forward * view.range)
        .ok_or("a camera at the Earth's centre; expected one near its surface")?;
    // The vertical at the camera is not the one at its target.
    let d = camera.east_north_up().transpose() * (target - camera.to_ecef());
    let across = libm::hypot(d.x, d.y);
    let attitude = if view.range < 1e-3 {
        Attitude { heading, pitch, roll: 0.0 }
    } else {
        let heading = if across > 1e-6 * view.range { libm::atan2(d.x, d.y) } else { heading };
        Attitude { heading, pitch: libm::atan2(d.z, across), roll: 0.0 }
    };
    Ok(Fix {
        time,
        latitude: camera.latitude.to_degrees(),
        longitude: camera.longitude.to_degrees(),
        height: Some(camera.height),
        attitude: Some(attitude),
    })
}
