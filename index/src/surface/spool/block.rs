//! Triangles as the spool keeps them: those of one leaf in a block. A corner keeps all its bits; texture coordinates are 32-bit
//! floats; what all triangles of a block lack is left out.

use glam::{DVec2, DVec3};

use crate::orthoview::raster::Triangle;

const HAS_UV: u8 = 1;
const HAS_TINT: u8 = 2;
const TWO_SIDED: u32 = 1 << 31;
/// Most materials.
pub(super) const MAX_MATERIALS: u32 = TWO_SIDED - 1;

/// What a block's triangles have.
pub(super) fn flags<'t>(triangles: impl Iterator<Item = &'t Triangle>) -> u8 {
    triangles.fold(0, |flags, triangle| {
        let uv = if triangle.uv == [DVec2::ZERO; 3] { 0 } else { HAS_UV };
        let tint = if triangle.tint == Triangle::WHITE { 0 } else { HAS_TINT };
        flags | uv | tint
    })
}

/// Bytes of a triangle.
pub(super) fn stride(flags: u8) -> usize {
    76 + if flags & HAS_UV == 0 { 0 } else { 24 } + if flags & HAS_TINT == 0 { 0 } else { 9 }
}

#[expect(clippy::cast_possible_truncation, reason = "texture coordinates to 7 digits")]
pub(super) fn put(triangle: &Triangle, flags: u8, out: &mut Vec<u8>) {
    for corner in triangle.corners {
        corner.to_array().iter().for_each(|value| out.extend_from_slice(&value.to_le_bytes()));
    }
    let sides = if triangle.two_sided { TWO_SIDED } else { 0 };
    out.extend_from_slice(&(triangle.material | sides).to_le_bytes());
    if flags & HAS_UV != 0 {
        triangle.uv.iter().for_each(|uv| {
            out.extend_from_slice(&(uv.x as f32).to_le_bytes());
            out.extend_from_slice(&(uv.y as f32).to_le_bytes());
        });
    }
    if flags & HAS_TINT != 0 {
        triangle.tint.iter().for_each(|tint| out.extend_from_slice(tint));
    }
}

/// Adds the triangles of a block; `bytes` is a multiple of its stride.
pub(super) fn take(bytes: &[u8], flags: u8, out: &mut Vec<Triangle>) {
    for record in bytes.chunks_exact(stride(flags)) {
        let eight = |at: usize| record[at..].first_chunk().map_or(f64::NAN, |b| f64::from_le_bytes(*b));
        let four = |at: usize| record[at..].first_chunk().map_or(0, |b| u32::from_le_bytes(*b));
        let mut triangle = Triangle::default();
        for (corner, into) in triangle.corners.iter_mut().enumerate() {
            *into = DVec3::from_array(std::array::from_fn(|axis| eight(24 * corner + 8 * axis)));
        }
        let look = four(72);
        (triangle.material, triangle.two_sided) = (look & !TWO_SIDED, look & TWO_SIDED != 0);
        let mut at = 76;
        if flags & HAS_UV != 0 {
            for uv in &mut triangle.uv {
                let number = |at: usize| f64::from(f32::from_bits(four(at)));
                *uv = DVec2::new(number(at), number(at + 4));
                at += 8;
            }
        }
        if flags & HAS_TINT != 0 {
            for tint in &mut triangle.tint {
                *tint = record[at..].first_chunk().copied().unwrap_or([255; 3]);
                at += 3;
            }
        }
        out.push(triangle);
    }
}
