//! GeoTIFF (OGC 19-008): one band of heights in strips or tiles; its place by ModelPixelScale with ModelTiepoint, or by
//! ModelTransformation; its system by the geographic keys; `GDAL_NODATA` for samples without a height.
//!
//! A geographic system is taken as WGS 84, whatever its datum: others are within about 100 m of it across.

use std::io::{Cursor, Read, Seek, SeekFrom};

use glam::DVec2;
use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::{Coordinates, Grid, GridError};
use crate::terrain::MAX_SAMPLES;
use crate::world::Severity;

/// Geographic keys.
const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const GEODETIC_CRS: u16 = 2048;
const PROJECTED_CRS: u16 = 3072;
const VERTICAL_UNITS: u16 = 4099;
/// EPSG code of the metre.
const METRE: u16 = 9001;
/// A code that says "user-defined".
const USER_DEFINED: u16 = 32767;
/// Most bytes that a byte of LZW or deflate can unfold to, rounded up: a file that claims more is refused unread.
const MOST_UNFOLDED: u64 = 4096;

/// Reads a GeoTIFF from its bytes.
pub fn parse(bytes: &[u8]) -> Result<Grid, GridError> {
    read(&mut Cursor::new(bytes))
}

pub(super) fn read(reader: &mut (impl Read + Seek)) -> Result<Grid, GridError> {
    let whole = |error: String| GridError::new("TIFF", error);
    let length = reader.seek(SeekFrom::End(0)).and_then(|end| reader.rewind().map(|()| end));
    let length = length.map_err(|error| whole(error.to_string()))?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_SAMPLES as usize * 8;
    limits.intermediate_buffer_size = MAX_SAMPLES as usize * 8;
    limits.ifd_value_size = 1 << 24;
    let mut tiff = Decoder::new(reader).map_err(|error| whole(error.to_string()))?.with_limits(limits);
    let (columns, rows) = tiff.dimensions().map_err(|error| whole(error.to_string()))?;
    let samples = u64::from(columns) * u64::from(rows);
    if columns < 2 || rows < 2 || samples > MAX_SAMPLES {
        let fault = format!("{columns} × {rows} samples; expected 2 × 2 to {MAX_SAMPLES} in all");
        return Err(GridError::new("ImageWidth, ImageLength", fault));
    }
    if samples > length.saturating_mul(MOST_UNFOLDED) {
        let fault = format!("{columns} × {rows} samples in {length} bytes; expected as many as these can hold");
        return Err(GridError::new("ImageWidth, ImageLength", fault));
    }
    match tiff.colortype() {
        Ok(ColorType::Gray(_) | ColorType::Multiband { num_samples: 1, .. }) => {}
        Ok(other) => {
            return Err(GridError::new(
                "PhotometricInterpretation",
                format!("{other:?}; expected one band of heights"),
            ));
        }
        Err(error) => return Err(GridError::new("PhotometricInterpretation", error.to_string())),
    }
    let doubles = |tiff: &mut Decoder<_>, tag: Tag| tiff.get_tag_f64_vec(tag).ok();
    let scale = doubles(&mut tiff, Tag::ModelPixelScaleTag);
    let tie = doubles(&mut tiff, Tag::ModelTiepointTag);
    let matrix = doubles(&mut tiff, Tag::ModelTransformationTag);
    let keys = keys(&tiff.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap_or_default())?;
    let nodata = tiff.get_tag_ascii_string(Tag::GdalNodata).ok();
    let nodata =
        nodata.and_then(|text| text.trim_matches(|c: char| c.is_whitespace() || c == '\0').parse::<f64>().ok());
    let mut notes = Vec::new();
    let (mut origin, column, row) = place(scale.as_deref(), tie.as_deref(), matrix.as_deref())?;
    if keys.raster_type != Some(2) {
        // Pixels are areas: the tags place their corners, heights are those of their middles.
        origin += 0.5 * (column + row);
    }
    let coordinates = coordinates(&keys, &mut notes)?;
    if let Some(units) = keys.vertical_units.filter(|&units| units != METRE) {
        let fault = format!("vertical units of EPSG code {units}; expected {METRE}, metres");
        return Err(GridError::new("GeoKeyDirectory, VerticalUnits", fault));
    }
    let image = tiff.read_image().map_err(|error| GridError::new("TIFF", format!("{error}; expected its samples")))?;
    let heights = heights(image, nodata);
    if heights.len() as u64 != samples {
        return Err(GridError::new("TIFF", format!("{} samples; expected {samples}", heights.len())));
    }
    Ok(Grid { columns, rows, heights, origin, column, row, coordinates, notes })
}

/// Samples as heights, NaN for `nodata`.
fn heights(image: DecodingResult, nodata: Option<f64>) -> Vec<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "heights in metres to 7 digits")]
    let height = |value: f64| if nodata == Some(value) { f32::NAN } else { value as f32 };
    match image {
        DecodingResult::U8(values) => values.into_iter().map(|value| height(f64::from(value))).collect(),
        DecodingResult::I8(values) => values.into_iter().map(|value| height(f64::from(value))).collect(),
        DecodingResult::U16(values) => values.into_iter().map(|value| height(f64::from(value))).collect(),
        DecodingResult::I16(values) => values.into_iter().map(|value| height(f64::from(value))).collect(),
        DecodingResult::U32(values) => values.into_iter().map(|value| height(f64::from(value))).collect(),
        DecodingResult::I32(values) => values.into_iter().map(|value| height(f64::from(value))).collect(),
        DecodingResult::U64(values) => values.into_iter().map(|value| height(value as f64)).collect(),
        DecodingResult::I64(values) => values.into_iter().map(|value| height(value as f64)).collect(),
        DecodingResult::F16(values) => values.into_iter().map(|value| height(f64::from(f32::from(value)))).collect(),
        DecodingResult::F32(values) => {
            // A no-data value is written with as many digits as the writer liked: compared as the samples are stored.
            #[expect(clippy::cast_possible_truncation, reason = "to the samples' own type")]
            let absent = nodata.map(|value| value as f32);
            values.into_iter().map(|value| if absent == Some(value) { f32::NAN } else { value }).collect()
        }
        DecodingResult::F64(values) => values.into_iter().map(height).collect(),
    }
}

/// Place of the first pixel's corner and the steps along columns and rows.
fn place(
    scale: Option<&[f64]>,
    tie: Option<&[f64]>,
    matrix: Option<&[f64]>,
) -> Result<(DVec2, DVec2, DVec2), GridError> {
    if let Some(m) = matrix {
        if m.len() != 16 {
            return Err(GridError::new("ModelTransformation", format!("{} numbers; expected 16", m.len())));
        }
        return Ok((DVec2::new(m[3], m[7]), DVec2::new(m[0], m[4]), DVec2::new(m[1], m[5])));
    }
    let (Some(scale), Some(tie)) = (scale, tie) else {
        let fault = "not there; expected ModelPixelScale with ModelTiepoint, or ModelTransformation";
        return Err(GridError::new("ModelPixelScale", fault));
    };
    if scale.len() < 2 {
        return Err(GridError::new("ModelPixelScale", format!("{} numbers; expected 3", scale.len())));
    }
    if tie.len() != 6 {
        return Err(GridError::new("ModelTiepoint", format!("{} numbers; expected 6, one point", tie.len())));
    }
    let (column, row) = (DVec2::new(scale[0], 0.0), DVec2::new(0.0, -scale[1]));
    Ok((DVec2::new(tie[3], tie[4]) - tie[0] * column - tie[1] * row, column, row))
}

/// What the geographic keys say.
#[derive(Debug, Default)]
struct Keys {
    model_type: Option<u16>,
    raster_type: Option<u16>,
    geodetic: Option<u16>,
    projected: Option<u16>,
    vertical_units: Option<u16>,
}

/// Reads the key directory: a header of four numbers, then id, location, count and value of each.
fn keys(directory: &[u16]) -> Result<Keys, GridError> {
    let mut keys = Keys::default();
    let Some(&[version, _, _, count]) = directory.first_chunk::<4>() else { return Ok(keys) };
    if version != 1 {
        return Err(GridError::new("GeoKeyDirectory", format!("version {version}; expected 1")));
    }
    for entry in directory[4..].chunks_exact(4).take(usize::from(count)) {
        // A location of 0: the value stands in the entry itself.
        if let [id, 0, _, value] = *entry {
            match id {
                MODEL_TYPE => keys.model_type = Some(value),
                RASTER_TYPE => keys.raster_type = Some(value),
                GEODETIC_CRS => keys.geodetic = Some(value),
                PROJECTED_CRS => keys.projected = Some(value),
                VERTICAL_UNITS => keys.vertical_units = Some(value),
                _ => {}
            }
        }
    }
    Ok(keys)
}

fn coordinates(keys: &Keys, notes: &mut Vec<(Severity, String, String)>) -> Result<Coordinates, GridError> {
    let mut trap = |text: String| notes.push((Severity::Trap, "GeoKeyDirectory".to_owned(), text));
    match (keys.model_type, keys.projected) {
        (Some(2), _) => {
            if let Some(code) = keys.geodetic.filter(|&code| code != 4326) {
                trap(format!("degrees in the geographic system of EPSG code {code}: taken as WGS 84"));
            }
            Ok(Coordinates::Degrees)
        }
        (Some(1) | None, Some(code)) if code != USER_DEFINED && code != 0 => {
            Ok(Coordinates::Projected(u32::from(code)))
        }
        (Some(1) | None, _) => {
            trap("no projected system by its EPSG code: taken as metres in a system of their own".to_owned());
            Ok(Coordinates::Metres)
        }
        (Some(other), _) => {
            let fault = format!("model type {other}; expected 1 (projected) or 2 (geographic)");
            Err(GridError::new("GeoKeyDirectory, GTModelType", fault))
        }
    }
}
