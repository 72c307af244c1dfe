//! Instanced models (i3dm): where a model stands. Lengths and offsets are checked one by one.

use glam::{DMat3, DMat4, DVec3};
use serde_json::Value;

use super::content::{self, ContentError};
use crate::geodesy::{WGS84_A, WGS84_B};

/// Most instances of one content.
const MAX_INSTANCES: usize = 1 << 20;

/// Bytes before the tables.
const HEADER: usize = 32;

/// A model and its places.
pub(super) struct Instances<'a> {
    /// From the model's axes, z up, to the tile's.
    pub(super) places: Vec<DMat4>,
    pub(super) model: Model<'a>,
}

/// Where the model is.
pub(super) enum Model<'a> {
    /// A glTF in the content.
    Inside(&'a [u8]),
    /// A file by its address.
    At(String),
}

/// Reads the tables of instances.
pub(super) fn parse(bytes: &[u8]) -> Result<Instances<'_>, ContentError> {
    let length = content::header(bytes)?;
    let bytes = &bytes[..length];
    let mut ends = [HEADER; 5];
    for (part, at) in [12, 16, 20, 24].into_iter().enumerate() {
        let end = ends[part].saturating_add(content::u32_at(bytes, at)?);
        if end > bytes.len() {
            let found = format!("tables up to byte {end}; expected an end within the file, {} bytes", bytes.len());
            return Err(ContentError::new(format!("byte {at}"), found));
        }
        ends[part + 1] = end;
    }
    let format = content::u32_at(bytes, 28)?;
    let json = bytes[HEADER..ends[1]].trim_ascii();
    let json: Value = serde_json::from_slice(json)
        .map_err(|error| ContentError::new("byte 32", format!("{error}; expected the feature table's JSON")))?;
    let table = Table { json: &json, binary: &bytes[ends[1]..ends[2]] };
    let model = &bytes[ends[4]..];
    let model = match format {
        0 => {
            let text = std::str::from_utf8(model).map_err(|error| {
                ContentError::new(format!("byte {}", ends[4]), format!("{error}; expected the model's address"))
            })?;
            Model::At(text.trim_matches(['\0', ' ']).to_owned())
        }
        1 => Model::Inside(model),
        other => return Err(ContentError::new("byte 28", format!("format {other}; expected 0 or 1"))),
    };
    Ok(Instances { places: table.places()?, model })
}

/// A feature table.
struct Table<'a> {
    json: &'a Value,
    binary: &'a [u8],
}

impl<'a> Table<'a> {
    /// The bytes of a property of `count` elements of `size` bytes; `None` if the table has no such property.
    fn property(&self, name: &str, count: usize, size: usize) -> Result<Option<&'a [u8]>, ContentError> {
        let Some(offset) = self.json.get(name).map(|property| property.get("byteOffset").and_then(Value::as_u64))
        else {
            return Ok(None);
        };
        let bytes = offset.and_then(|offset| {
            let start = usize::try_from(offset).ok()?;
            self.binary.get(start..start.checked_add(count.checked_mul(size)?)?)
        });
        let found = || {
            let fault = format!("{count} × {size} bytes that are not there; expected a byteOffset within the table");
            ContentError::new(format!("$.{name}"), fault)
        };
        bytes.map(Some).ok_or_else(found)
    }

    /// Three numbers in the JSON.
    fn triple(&self, name: &str) -> Result<Option<DVec3>, ContentError> {
        let Some(given) = self.json.get(name) else { return Ok(None) };
        let number = |at: usize| given.get(at).and_then(Value::as_f64);
        let found = number(0).zip(number(1)).zip(number(2)).map(|((x, y), z)| DVec3::new(x, y, z));
        let fault = || ContentError::new(format!("$.{name}"), "no three numbers; expected them");
        found.filter(|v| v.is_finite()).map(Some).ok_or_else(fault)
    }

    fn places(&self) -> Result<Vec<DMat4>, ContentError> {
        let count = self.json.get("INSTANCES_LENGTH").and_then(Value::as_u64).and_then(|n| usize::try_from(n).ok());
        let count = count.filter(|&count| count <= MAX_INSTANCES).ok_or_else(|| {
            let fault = format!("no number up to {MAX_INSTANCES}; expected that of the instances");
            ContentError::new("$.INSTANCES_LENGTH", fault)
        })?;
        let centre = self.triple("RTC_CENTER")?.unwrap_or(DVec3::ZERO);
        let positions = self.property("POSITION", count, 12)?;
        let quantised = self.property("POSITION_QUANTIZED", count, 6)?;
        let offset = self.triple("QUANTIZED_VOLUME_OFFSET")?.unwrap_or(DVec3::ZERO);
        let volume = self.triple("QUANTIZED_VOLUME_SCALE")?.unwrap_or(DVec3::ONE);
        if positions.is_none() && quantised.is_none() {
            return Err(ContentError::new("$.POSITION", "not there; expected it or POSITION_QUANTIZED"));
        }
        let ups = self.property("NORMAL_UP", count, 12)?;
        let rights = self.property("NORMAL_RIGHT", count, 12)?;
        let packed_ups = self.property("NORMAL_UP_OCT32P", count, 4)?;
        let packed_rights = self.property("NORMAL_RIGHT_OCT32P", count, 4)?;
        let scales = self.property("SCALE", count, 4)?;
        let stretches = self.property("SCALE_NON_UNIFORM", count, 12)?;
        let is_east_north_up = self.json.get("EAST_NORTH_UP").and_then(Value::as_bool).unwrap_or(false);
        let axis = |plain: Option<&[u8]>, packed: Option<&[u8]>, at: usize| {
            plain.map(|bytes| vector(bytes, at)).or_else(|| packed.map(|bytes| octahedral(bytes, at)))
        };
        let place = |at: usize| {
            let own = match (positions, quantised) {
                (Some(bytes), _) => vector(bytes, at),
                (None, Some(bytes)) => offset + volume * DVec3::from_array([0, 1, 2].map(|c| short(bytes, 3 * at + c))),
                (None, None) => DVec3::ZERO,
            };
            let position = centre + own;
            let turn = match (axis(ups, packed_ups, at), axis(rights, packed_rights, at)) {
                (Some(up), Some(right)) => DMat3::from_cols(right, up, right.cross(up)),
                _ if is_east_north_up => east_north_up(position),
                _ => DMat3::IDENTITY,
            };
            let scale = scales.map_or(1.0, |bytes| float(bytes, at)) * stretches.map_or(DVec3::ONE, |b| vector(b, at));
            DMat4::from_translation(position) * DMat4::from_mat3(turn * DMat3::from_diagonal(scale))
        };
        Ok((0..count).map(place).collect())
    }
}

/// The frame of the horizon at a point near the ellipsoid: east, north, up.
fn east_north_up(at: DVec3) -> DMat3 {
    let gradient = at / DVec3::new(WGS84_A * WGS84_A, WGS84_A * WGS84_A, WGS84_B * WGS84_B);
    let up = gradient.try_normalize().unwrap_or(DVec3::Z);
    let east = DVec3::Z.cross(up).try_normalize().unwrap_or(DVec3::Y);
    DMat3::from_cols(east, up.cross(east), up)
}

fn float(bytes: &[u8], at: usize) -> f64 {
    let four = bytes.get(4 * at..4 * at + 4).and_then(|four| <[u8; 4]>::try_from(four).ok());
    four.map_or(f64::NAN, |four| f64::from(f32::from_le_bytes(four)))
}

fn vector(bytes: &[u8], at: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|c| float(bytes, 3 * at + c)))
}

/// A 16-bit number as a share of the largest.
fn short(bytes: &[u8], at: usize) -> f64 {
    let two = bytes.get(2 * at..2 * at + 2).and_then(|two| <[u8; 2]>::try_from(two).ok());
    two.map_or(f64::NAN, |two| f64::from(u16::from_le_bytes(two)) / f64::from(u16::MAX))
}

/// A unit vector on the octahedron in two 16-bit numbers.
fn octahedral(bytes: &[u8], at: usize) -> DVec3 {
    let [x, y] = [0, 1].map(|c| 2.0 * short(bytes, 2 * at + c) - 1.0);
    let z = 1.0 - x.abs() - y.abs();
    let folded = |a: f64, b: f64| if z < 0.0 { (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 } } else { a };
    DVec3::new(folded(x, y), folded(y, x), z).normalize_or(DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn octahedra_and_horizons() {
        let packed = |x: u16, y: u16| [x.to_le_bytes(), y.to_le_bytes()].concat();
        assert!((octahedral(&packed(32768, 32768), 0) - DVec3::Z).length() < 1e-4);
        assert!((octahedral(&packed(65535, 32768), 0) - DVec3::X).length() < 1e-4);
        assert!((octahedral(&packed(65535, 65535), 0) - DVec3::NEG_Z).length() < 1e-4);
        let frame = east_north_up(DVec3::new(WGS84_A, 0.0, 0.0));
        assert!(frame.abs_diff_eq(DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X), 1e-12), "{frame}");
    }
}
