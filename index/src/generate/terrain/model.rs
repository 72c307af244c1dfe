//! Errors and sizes of tiles whose geometry is not made: a world of 10⁷ tiles has 4 · 10¹⁰ samples.
//!
//! A tile is looked at on a lattice of 3 × 3 points. The fractal tells there what its octaves can still add, and so how
//! much samples a given distance apart miss: that is the error, the margin of the bounds, and, relative to the range of
//! heights, the entropy of the heights on the wire. The constants are fitted to tiles that were made and measured; the
//! tests hold the fit.
//!
//! Imagery: JPEG at 0.8 to 2.4 bits a texel, more where the ground is rougher, so 26 to 79 kB for 512 × 512 texels, within
//! the 20 to 100 kB of terrain services; in memory 4 bytes a texel and a third more for the mips. The error is at
//! least two texels of a 512-texel imagery, a quarter of the spacing of the samples: CesiumJS's estimate for height maps.

use glam::DVec2;

use super::super::random::Random;
use super::fractal::Fractal;
use super::{Shape, TerrainParams};
use crate::terrain::{TILE_CELLS, decoded_bytes};

/// Loss of an octave per sample spacing over wavelength, for the largest loss within a tile.
const SHARPNESS: f64 = 0.48;
/// Bits per height beyond the logarithm of what neighbours do not tell, in steps of quantisation.
const BITS: f64 = 2.4;
/// Bytes of a tile's header.
const HEADER: f64 = 88.0;
/// A quarter of the spacing of samples.
const LEAST_ERROR: f64 = 0.25;

/// A tile of the catalogue.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileModel {
    pub(super) min: DVec2,
    pub(super) max: DVec2,
    pub(super) low: f64,
    pub(super) high: f64,
    pub(super) error: f64,
    pub(super) wire_bytes: u32,
    pub(super) decoded_bytes: u32,
}

/// The tile over `tiles` × `tiles` of the finest, the (x, y)-th of its level.
pub(super) fn tile(params: &TerrainParams, shape: &Shape, fractal: &Fractal, tiles: u64, x: u64, y: u64) -> TileModel {
    let whole = DVec2::splat(-0.5 * shape.side * shape.across as f64);
    let side = shape.side * tiles as f64;
    let min = whole + side * DVec2::new(x as f64, y as f64);
    // The last tiles of a level reach as far as there are finest ones.
    let max = (min + side).min(-whole);
    let spacing = params.resolution * tiles as f64;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut missed, mut between) = (0.0_f64, 0.0_f64);
    for point in 0..9_u32 {
        let part = 0.5 * DVec2::new(f64::from(point % 3), f64::from(point / 3));
        let profile = fractal.profile(min + part * (max - min));
        (low, high) = (low.min(profile.height), high.max(profile.height));
        missed = missed.max(profile.unresolved(spacing, SHARPNESS));
        between = between.max(profile.unresolved(0.5 * side, 0.35));
    }
    let geometry = wire_bytes(missed, high - low + between);
    let (low, high) = ((low - between).max(0.0), (high + between).min(fractal.relief()));
    let measured = if tiles > 1 { missed } else { 0.0 };
    let texels = f64::from(params.texels) * f64::from(params.texels);
    let (imagery, least) = if params.texels == 0 {
        (0.0, 0.0)
    } else {
        let mut random = Random::at(params.seed, tiles, x, y);
        let roughness = (missed / (0.12 * spacing)).min(1.0);
        (texels / 8.0 * (0.8 + 1.6 * roughness) * random.within(0.85, 1.15), LEAST_ERROR * spacing)
    };
    let vertices = decoded_bytes(TILE_CELLS + 1, TILE_CELLS + 1);
    TileModel {
        min,
        max,
        low,
        high: high.max(low),
        error: measured.max(least),
        wire_bytes: (geometry + imagery) as u32,
        decoded_bytes: vertices + (texels * 16.0 / 3.0) as u32,
    }
}

/// Bytes of a tile's heights as they are encoded, see `terrain::encode_heights`.
pub(super) fn wire_bytes(missed: f64, range: f64) -> f64 {
    let samples = f64::from((TILE_CELLS + 1) * (TILE_CELLS + 1));
    let steps = if range > 0.0 { 65535.0 * missed / range } else { 0.0 };
    HEADER + samples / 8.0 * (BITS + libm::log2(1.0 + steps))
}
