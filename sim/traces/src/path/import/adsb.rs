//! ADS-B states in JSON: a list of records with `timestamp` (ms since 1970), `icao24`, `callsign`, `latitude` and
//! `longitude` (degrees), `altitude` (feet, by air pressure), `geoaltitude` (feet, by GNSS), `groundspeed` (knots), `last_position` (ms
//! since 1970, when the position was received: the position's time where all records have it); others are ignored, and a
//! record may lack any.

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error, SeqAccess, Visitor};

use crate::path::look::{Aim, Look, aim};
use crate::path::parse::Options;
use crate::path::{CameraPath, Heights, PathError};

use super::track::{Fix, Track};

/// Metres per foot.
const FOOT: f64 = 0.3048;

/// Metres per second per knot.
const KNOT: f64 = 1852.0 / 3600.0;

/// A speed off by more than this share from the stated one is worth a note.
const SPEED_MARGIN: f64 = 0.2;

/// Transponders report altitudes in steps of so many feet, or in finer ones.
const ALTITUDE_STEP: f64 = 25.0;

/// A position's reception is at most so long before its record, seconds.
const RECEPTION_MAX: f64 = 60.0;

/// Aircraft that a note names.
const NAMED_MAX: usize = 8;

#[derive(Deserialize)]
struct Record {
    timestamp: Option<f64>,
    icao24: Option<String>,
    callsign: Option<String>,
    latitude: Option<f64>,
    longitude: Option<f64>,
    altitude: Option<f64>,
    geoaltitude: Option<f64>,
    groundspeed: Option<f64>,
    last_position: Option<f64>,
}

/// A state with a position: seconds, degrees, feet, knots.
#[derive(Clone, Copy)]
struct State {
    time: f64,
    latitude: f64,
    longitude: f64,
    pressure: Option<f64>,
    gnss: Option<f64>,
    ground_speed: Option<f64>,
    /// When the position was received, seconds.
    received: Option<f64>,
}

#[derive(Default)]
struct Aircraft {
    states: Vec<State>,
    callsigns: BTreeSet<String>,
    /// Records without time or position.
    incomplete: usize,
    /// Times are those when positions were received.
    is_by_reception: bool,
}

impl Aircraft {
    fn name(&self, icao24: &str) -> String {
        let callsigns: Vec<&str> = self.callsigns.iter().take(3).map(String::as_str).collect();
        let callsigns = if callsigns.is_empty() { "no callsign".to_owned() } else { callsigns.join(" ") };
        format!("{icao24} ({callsigns}, {} positions)", self.states.len())
    }

    /// Puts each position at the time when it was received, where every record knows that.
    fn use_reception(&mut self) {
        let is_near = |state: &State| state.received.is_some_and(|at| (at - state.time).abs() <= RECEPTION_MAX);
        self.is_by_reception = self.states.iter().all(is_near);
        if self.is_by_reception {
            for state in &mut self.states {
                state.time = state.received.unwrap_or(state.time);
            }
        }
    }

    fn start(&self) -> f64 {
        self.states.iter().map(|state| state.time).fold(f64::INFINITY, f64::min)
    }

    fn path(&self, name: &str, icao24: &str) -> Result<CameraPath, PathError> {
        let mut track = Track::new(name, true);
        let has_gnss = !self.states.is_empty() && self.states.iter().all(|state| state.gnss.is_some());
        let heights = if has_gnss { Heights::Ellipsoid } else { Heights::Pressure };
        for (index, state) in self.states.iter().enumerate() {
            let feet = if has_gnss { state.gnss } else { state.pressure };
            let fix = Fix {
                time: state.time,
                latitude: state.latitude,
                longitude: state.longitude,
                height: feet.map(|feet| feet * FOOT),
                attitude: None,
            };
            track.push(fix).map_err(|message| PathError::Place {
                name: name.to_owned(),
                place: format!("position {index} of {icao24}"),
                message,
            })?;
        }
        if self.incomplete > 0 {
            track.add_note(format!("{} records of {icao24} without time or position left out", self.incomplete));
        }
        if self.is_by_reception {
            track.add_note("times are those of last_position, when each position was received");
        }
        let both = || self.states.iter().filter_map(|state| Some(state.gnss? - state.pressure?));
        let count = both().count();
        if has_gnss && count > 0 {
            let mean = both().sum::<f64>() / count as f64 * FOOT;
            track.add_note(format!(
                "mind: geoaltitude taken ({heights}), on average {mean:+.1} m against the pressure altitude, which the \
                 file holds too"
            ));
        }
        let used = || self.states.iter().filter_map(|state| if has_gnss { state.gnss } else { state.pressure });
        if used().count() > 1 && used().all(|feet| feet % ALTITUDE_STEP == 0.0) {
            track.add_note(format!("heights in steps of {ALTITUDE_STEP} ft ({:.1} m)", ALTITUDE_STEP * FOOT));
        }
        let mut path = track.finish(heights)?;
        if let Some([low, high]) = self.speed_ratios(&path) {
            path.add_note(format!(
                "mind: from one position to the next the aircraft moves {low:.2} to {high:.2} times as fast as the ground \
                 speed that the file states (5th to 95th percentile): times are coarser than positions"
            ));
        }
        Ok(path)
    }

    /// 5th and 95th percentile of the speed between two positions over the stated one, where they are worth a note.
    /// Compared only where no record was dropped or put elsewhere.
    fn speed_ratios(&self, path: &CameraPath) -> Option<[f64; 2]> {
        let poses = path.poses();
        if poses.len() != self.states.len() {
            return None;
        }
        let steps = poses.windows(2).zip(&self.states);
        let mut ratios: Vec<f64> = steps
            .filter_map(|(pair, state)| {
                let stated = state.ground_speed.filter(|speed| *speed > 0.0)? * KNOT;
                Some(pair[0].position.distance(pair[1].position) / (pair[1].time - pair[0].time) / stated)
            })
            .collect();
        ratios.sort_by(f64::total_cmp);
        let low = *ratios.get(ratios.len() / 20)?;
        let high = *ratios.get(ratios.len() - 1 - ratios.len() / 20)?;
        (low < 1.0 - SPEED_MARGIN || high > 1.0 + SPEED_MARGIN).then_some([low, high])
    }
}

/// Aircraft by their addresses.
type Fleet = BTreeMap<String, Aircraft>;

/// Reads a file: the aircraft selected, or the one with most positions.
pub(super) fn read(name: &str, bytes: &[u8], options: &Options) -> Result<CameraPath, PathError> {
    let fleet = fleet(name, bytes)?;
    let whole = |message: String| PathError::Whole { name: name.to_owned(), message };
    let list = || {
        let names: Vec<String> = fleet.iter().take(NAMED_MAX).map(|(icao24, one)| one.name(icao24)).collect();
        let more = fleet.len().saturating_sub(NAMED_MAX);
        names.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
    };
    let find = |icao24: &str| {
        let found = fleet.get_key_value(icao24.to_ascii_lowercase().as_str());
        found.ok_or_else(|| whole(format!("no aircraft {icao24}; expected one of {}", list())))
    };
    let (icao24, aircraft) = match &options.icao24 {
        Some(icao24) => find(icao24)?,
        // The last of the greatest in reverse order: the first address where several have as many.
        None => (fleet.iter().rev().max_by_key(|(_, one)| one.states.len()))
            .ok_or_else(|| whole("holds no record; expected states of aircraft".to_owned()))?,
    };
    let mut path = aircraft.path(name, icao24)?;
    if fleet.len() > 1 {
        let why = if options.icao24.is_some() { "as asked" } else { "the one with most positions" };
        path.add_note(format!("mind: {} aircraft: {}; {icao24} taken, {why} (see --icao24)", fleet.len(), list()));
    }
    let Some(Look::Other(id)) = &options.look else { return Ok(path) };
    let (other_id, other) = find(id)?;
    if other_id == icao24 {
        return Err(whole(format!("--look other={id} is the aircraft itself; expected another of {}", list())));
    }
    let earlier = aircraft.start() - other.start();
    let target = other.path(name, other_id)?;
    let mut aimed = aim(&path, Aim::Path(&target, earlier));
    let together = |time: f64| (0.0..=target.duration()).contains(&(time + earlier));
    let distances = path.poses().iter().filter(|pose| together(pose.time));
    let mut distances: Vec<f64> =
        distances.map(|pose| pose.position.distance(target.at(pose.time + earlier).0)).collect();
    distances.sort_by(f64::total_cmp);
    aimed.add_note(match (distances.first(), distances.last()) {
        (Some(nearest), Some(farthest)) => format!(
            "the camera is aimed at {} in {} of {} poses, {nearest:.0} m to {farthest:.0} m away, half of the time nearer \
             than {:.0} m",
            other.name(other_id),
            distances.len(),
            path.poses().len(),
            distances[distances.len() / 2]
        ),
        _ => format!("{other_id} is never under way at the same time: the camera looks along the motion"),
    });
    Ok(aimed)
}

fn fleet(name: &str, bytes: &[u8]) -> Result<Fleet, PathError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let (mut fleet, count) = (Fleet::new(), Cell::new(0));
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let read = Records { fleet: &mut fleet, count: &count }.deserialize(&mut json).and_then(|()| json.end());
    read.map_err(|error| PathError::Place {
        name: name.to_owned(),
        place: format!("[{}]", count.get()),
        message: error.to_string(),
    })?;
    fleet.values_mut().for_each(Aircraft::use_reception);
    Ok(fleet)
}

/// Puts records one by one into a fleet, without a list of all.
struct Records<'a> {
    fleet: &'a mut Fleet,
    count: &'a Cell<usize>,
}

impl<'de> DeserializeSeed<'de> for Records<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Records<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of records with timestamp, icao24, latitude, longitude and altitude")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut records: A) -> Result<(), A::Error> {
        while let Some(record) = records.next_element::<Record>()? {
            let icao24 = record.icao24.ok_or_else(|| A::Error::custom("a record without icao24; expected one"))?;
            let aircraft = self.fleet.entry(icao24.to_ascii_lowercase()).or_default();
            if let Some(callsign) = record.callsign.as_deref().map(str::trim).filter(|text| !text.is_empty()) {
                aircraft.callsigns.insert(callsign.to_owned());
            }
            match (record.timestamp, record.latitude, record.longitude) {
                (Some(milliseconds), Some(latitude), Some(longitude)) => aircraft.states.push(State {
                    time: milliseconds * 1e-3,
                    latitude,
                    longitude,
                    pressure: record.altitude,
                    gnss: record.geoaltitude,
                    ground_speed: record.groundspeed,
                    received: record.last_position.map(|milliseconds| milliseconds * 1e-3),
                }),
                _ => aircraft.incomplete += 1,
            }
            self.count.set(self.count.get() + 1);
        }
        Ok(())
    }
}
