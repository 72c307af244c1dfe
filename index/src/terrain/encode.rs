//! What a tile's heights cost on the wire and in memory.
//!
//! On the wire, as quantized-mesh does it: a header with the tile's rectangle and range of heights, then the heights in
//! steps of 1/65535 of that range as differences from a planar prediction, zigzag-coded, low bytes before high bytes,
//! deflated. Positions across and triangles follow from the grid and are not sent. The header is that of quantized-mesh,
//! 88 bytes: centre, range of heights, bounding sphere and horizon point.

use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;

/// Bytes before the heights.
const HEADER: usize = 88;
/// Where the header holds the range of heights, two f32.
const RANGE_AT: usize = 24;
/// Bytes of a vertex in memory: position and normal, f32.
const VERTEX_BYTES: u32 = 24;
/// Most samples of an encoded tile.
const MAX_TILE_SAMPLES: usize = 1 << 20;

/// Why heights cannot be decoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found}; expected {expected}")]
pub struct EncodeError {
    found: String,
    expected: String,
}

/// Encodes heights row by row, all finite. The header's rectangle is left zero: it is as long with any other.
pub fn encode_heights(heights: &[f32], columns: usize) -> Vec<u8> {
    let low = heights.iter().copied().fold(f32::INFINITY, f32::min);
    let high = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut bytes = vec![0; HEADER];
    bytes[RANGE_AT..RANGE_AT + 4].copy_from_slice(&low.to_le_bytes());
    bytes[RANGE_AT + 4..RANGE_AT + 8].copy_from_slice(&high.to_le_bytes());
    let steps_per_metre = if high > low { 65535.0 / (f64::from(high) - f64::from(low)) } else { 0.0 };
    let steps: Vec<u16> =
        heights.iter().map(|height| ((f64::from(*height) - f64::from(low)) * steps_per_metre).round() as u16).collect();
    let mut planes = vec![0; 2 * steps.len()];
    for (at, step) in steps.iter().enumerate() {
        let coded = zigzag(step.wrapping_sub(prediction(&steps, columns, at)));
        [planes[at], planes[steps.len() + at]] = coded.to_le_bytes();
    }
    let mut encoder = DeflateEncoder::new(bytes, Compression::new(6));
    // Writing into memory does not fail.
    encoder.write_all(&planes).unwrap_or_default();
    encoder.finish().unwrap_or_default()
}

/// The heights of an encoded tile of `columns` × `rows` samples, metres.
pub fn decode_heights(bytes: &[u8], columns: usize, rows: usize) -> Result<Vec<f32>, EncodeError> {
    let fault = |found: String, expected: String| Err(EncodeError { found, expected });
    let samples = columns.saturating_mul(rows);
    if samples == 0 || samples > MAX_TILE_SAMPLES {
        return fault(format!("{columns} × {rows} samples"), format!("1 to {MAX_TILE_SAMPLES}"));
    }
    let Some(coded) = bytes.get(HEADER..) else {
        return fault(format!("{} bytes", bytes.len()), format!("a header of {HEADER}"));
    };
    let mut planes = Vec::new();
    if let Err(error) = DeflateDecoder::new(coded).take(2 * samples as u64 + 1).read_to_end(&mut planes) {
        return fault(format!("byte {HEADER}: {error}"), "deflated heights".to_owned());
    }
    if planes.len() != 2 * samples {
        return fault(format!("byte {HEADER}: {} bytes of heights", planes.len()), format!("{}", 2 * samples));
    }
    let range = |at: usize| {
        let word = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
        f64::from(f32::from_le_bytes(word))
    };
    let (low, high) = (range(RANGE_AT), range(RANGE_AT + 4));
    if !(low.is_finite() && high.is_finite() && low <= high) {
        return fault(format!("byte {RANGE_AT}: heights from {low} to {high}"), "finite ones in order".to_owned());
    }
    let mut steps = vec![0_u16; samples];
    for at in 0..samples {
        let coded = u16::from_le_bytes([planes[at], planes[samples + at]]);
        steps[at] = prediction(&steps, columns, at).wrapping_add(unzigzag(coded));
    }
    #[expect(clippy::cast_possible_truncation, reason = "between two f32")]
    let metres = |step: u16| (low + (high - low) * f64::from(step) / 65535.0) as f32;
    Ok(steps.into_iter().map(metres).collect())
}

/// What the samples before `at` let expect: the plane through its three neighbours, else the one neighbour.
fn prediction(steps: &[u16], columns: usize, at: usize) -> u16 {
    let left = (!at.is_multiple_of(columns)).then(|| steps[at - 1]);
    match (left, at.checked_sub(columns)) {
        (None, None) => 0,
        (Some(left), None) => left,
        (None, Some(above)) => steps[above],
        (Some(left), Some(above)) => left.wrapping_add(steps[above]).wrapping_sub(steps[above - 1]),
    }
}

fn zigzag(difference: u16) -> u16 {
    let signed = difference as i16;
    ((signed << 1) ^ (signed >> 15)) as u16
}

fn unzigzag(coded: u16) -> u16 {
    (coded >> 1) ^ (coded & 1).wrapping_neg()
}

/// Bytes in memory of a tile of `columns` × `rows` samples: vertices with those of a skirt around them, and 16-bit
/// indices (32-bit where there are more vertices) of two triangles a cell and two per step along the skirt.
pub(crate) fn decoded_bytes(columns: u32, rows: u32) -> u32 {
    let around = 2 * (columns + rows);
    let vertices = columns * rows + around;
    let triangles = 2 * (columns - 1) * (rows - 1) + 4 * (columns - 1 + rows - 1);
    let index = if vertices > 65535 { 4 } else { 2 };
    vertices * VERTEX_BYTES + 3 * triangles * index
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn heights_come_back_to_half_a_step(heights in prop::collection::vec(-500.0_f32..9000.0, 1..200), columns in 1_usize..20) {
            let rows = heights.len().div_ceil(columns);
            let mut heights = heights;
            heights.resize(columns * rows, 0.0);
            let decoded = decode_heights(&encode_heights(&heights, columns), columns, rows).unwrap();
            let low = heights.iter().copied().fold(f32::INFINITY, f32::min);
            let high = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let half = f64::from(high - low) / 131_070.0 + 1e-3;
            for (given, found) in heights.iter().zip(&decoded) {
                prop_assert!((f64::from(*given) - f64::from(*found)).abs() <= half, "{given} {found}");
            }
        }
    }

    #[test]
    fn a_plane_is_small_and_noise_is_large() {
        let grid = |height: &dyn Fn(u32, u32) -> f32| -> Vec<f32> {
            (0..65).flat_map(|y| (0..65).map(move |x| (x, y))).map(|(x, y)| height(x, y)).collect()
        };
        let hashed = |x: u32, y: u32| {
            let mixed = x.wrapping_mul(374_761_393).wrapping_add(y.wrapping_mul(668_265_263));
            ((mixed ^ mixed >> 13).wrapping_mul(1_274_126_177) >> 16) as f32
        };
        let plane = encode_heights(&grid(&|x, y| (x + 2 * y) as f32), 65);
        let noise = encode_heights(&grid(&hashed), 65);
        assert!(plane.len() < 700 && noise.len() > 6000, "{} {}", plane.len(), noise.len());
        assert!(encode_heights(&[3.0; 4], 2).len() < HEADER + 8, "nothing but the header and zeros");
    }

    #[test]
    fn refuses_what_is_cut_short() {
        let bytes = encode_heights(&[1.0, 2.0, 3.0, 4.0], 2);
        for length in 0..bytes.len() {
            assert!(decode_heights(&bytes[..length], 2, 2).is_err(), "{length}");
        }
        assert!(decode_heights(&bytes, 3, 2).is_err() && decode_heights(&bytes, usize::MAX, 2).is_err());
    }

    #[test]
    fn bytes_in_memory() {
        // 4 vertices and 8 of the skirt; 2 triangles and 8 of the skirt.
        assert_eq!(decoded_bytes(2, 2), 12 * 24 + 10 * 6);
    }
}
