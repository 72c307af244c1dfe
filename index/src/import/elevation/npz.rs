//! A numpy archive with a grid of heights: `elevation` (or `dem`, `height`, `z`, else the only array of two dimensions),
//! its steps `dx`, `dy` and its extent `xmin`, `xmax`, `ymin`, `ymax`, each a single number.
//!
//! Row 0 is the northernmost, as in an image. The archive names no coordinate system: steps below 0.1 within the globe's
//! range are taken as degrees, others as metres. Where extent over step is the number of samples the extent is that of
//! cells with a sample in the middle of each; where it is one less, the samples lie on its edge.

use std::collections::BTreeMap;
use std::io::{Cursor, Read, Seek};

use glam::DVec2;
use zip::ZipArchive;

use super::npy::{self, Array};
use super::{Coordinates, Grid, GridError};
use crate::world::Severity;

/// Names of the array of heights, the first found counts.
const HEIGHTS: [&str; 4] = ["elevation", "dem", "height", "z"];
/// Most members looked at.
const MAX_MEMBERS: usize = 64;

/// Reads an archive from its bytes.
pub fn parse(bytes: &[u8]) -> Result<Grid, GridError> {
    read(&mut Cursor::new(bytes))
}

pub(super) fn read(reader: &mut (impl Read + Seek)) -> Result<Grid, GridError> {
    let whole = |error: String| GridError::new("archive", format!("{error}; expected a zip archive of numpy arrays"));
    let mut archive = ZipArchive::new(reader).map_err(|error| whole(error.to_string()))?;
    if archive.len() > MAX_MEMBERS {
        return Err(whole(format!("{} members, {MAX_MEMBERS} at most", archive.len())));
    }
    let mut scalars = BTreeMap::new();
    let mut grids: BTreeMap<String, Array> = BTreeMap::new();
    let mut room = npy::MAX_BYTES;
    for index in 0..archive.len() {
        let member = archive.by_index(index).map_err(|error| whole(error.to_string()))?;
        let name = member.name().map_or_else(|_| String::new(), |name| name.into_owned());
        let Some(stem) = name.strip_suffix(".npy").map(str::to_owned) else { continue };
        let mut bytes = Vec::new();
        member
            .take(room + 1)
            .read_to_end(&mut bytes)
            .map_err(|error| GridError::new(name.clone(), error.to_string()))?;
        // What is unfolded from all members together is bounded, not what each claims.
        room = room.checked_sub(bytes.len() as u64).ok_or_else(|| {
            GridError::new(
                name.clone(),
                format!("members of more than {} bytes; expected at most that", npy::MAX_BYTES),
            )
        })?;
        let array = npy::parse(&name, &bytes)?;
        if let [value] = array.values[..] {
            scalars.insert(stem, value);
        } else if array.shape.len() == 2 {
            grids.insert(stem, array);
        }
    }
    let named = HEIGHTS.iter().find_map(|name| Some(((*name).to_owned(), grids.remove(*name)?)));
    let only = if grids.len() == 1 { grids.pop_first() } else { None };
    let Some((name, array)) = named.or(only) else {
        return Err(GridError::new("archive", format!("no array of two dimensions named {HEIGHTS:?}; expected one")));
    };
    let (rows, columns) = (array.shape[0], array.shape[1]);
    #[expect(clippy::cast_possible_truncation, reason = "heights in metres to 7 digits")]
    let heights = array.values.iter().map(|&value| value as f32).collect();
    let mut notes = Vec::new();
    let x = axis(&scalars, ["xmin", "xmax", "dx"], columns)?;
    let y = axis(&scalars, ["ymin", "ymax", "dy"], rows)?;
    if y.reversed {
        let text =
            format!("ymin {} lies above ymax {}: taken as the two ends, the first row at the upper one", y.high, y.low);
        notes.push((Severity::Trap, "ymin.npy".to_owned(), text));
    }
    let on_globe = x.low >= -180.0 && x.high <= 360.0 && y.low >= -90.0 && y.high <= 90.0;
    let coordinates = if on_globe && x.step < 0.1 && y.step < 0.1 { Coordinates::Degrees } else { Coordinates::Metres };
    let taken =
        if coordinates == Coordinates::Degrees { "degrees on WGS 84" } else { "metres in a system of their own" };
    let text = format!("the archive names no coordinate system: {name} is taken as metres over {taken}");
    notes.push((Severity::Trap, String::new(), text));
    Ok(Grid {
        columns,
        rows,
        heights,
        origin: DVec2::new(x.low + x.inset, y.high - y.inset),
        column: DVec2::new(x.step, 0.0),
        row: DVec2::new(0.0, -y.step),
        coordinates,
        notes,
    })
}

/// Where samples lie along one axis.
struct Axis {
    low: f64,
    high: f64,
    step: f64,
    /// From the ends to the first and the last sample.
    inset: f64,
    reversed: bool,
}

fn axis(scalars: &BTreeMap<String, f64>, [min, max, step]: [&str; 3], samples: u32) -> Result<Axis, GridError> {
    let given = |name: &str| scalars.get(name).copied();
    let place = |name: &str| format!("{name}.npy");
    let (Some(a), Some(b)) = (given(min), given(max)) else {
        let absent = if given(min).is_none() { min } else { max };
        return Err(GridError::new(place(absent), "not there; expected the end of the grid as a single number"));
    };
    let (low, high) = (a.min(b), a.max(b));
    let span = high - low;
    if !(span > 0.0 && span.is_finite() && low.is_finite()) {
        return Err(GridError::new(place(min), format!("{a} to {b}; expected two different finite ends")));
    }
    let cells = f64::from(samples);
    let step = given(step).map_or(Ok(span / cells), |value| {
        let steps = span / value.abs();
        // Half a sample off is neither of the two readings.
        let fits = (steps - cells).abs() < 0.25 || (steps - cells + 1.0).abs() < 0.25;
        let fault = || {
            GridError::new(
                place(step),
                format!(
                    "{value}; expected the extent {span} over the {samples} samples, or over the steps between them"
                ),
            )
        };
        if fits { Ok(value.abs()) } else { Err(fault()) }
    })?;
    let inset = 0.5 * (span - step * (cells - 1.0));
    Ok(Axis { low, high, step, inset, reversed: a > b })
}
