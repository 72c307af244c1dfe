//! Heights over the plane: a ridged multifractal (Musgrave 1998). Octave k has the wavelength λₖ = λ₀/2ᵏ and the amplitude
//! Gᵏ; its signal (1 − |noise|)², creased along ridges, is weighted by the signal of the octave before, so that valleys
//! are smooth and ridges rough.

use glam::DVec2;

use super::super::noise;
use crate::ground::Surface;
use crate::terrain::on_cell;

/// Wavelength of the first octave, metres.
const LONGEST: f64 = 16_384.0;
/// Amplitude of an octave over that of the one before.
const GAIN: f64 = 0.5;
/// Most octaves: down to wavelengths of a few millimetres.
const MAX_OCTAVES: usize = 24;

/// A fractal surface, linear between samples on a lattice.
#[derive(Clone, Debug)]
pub(crate) struct Fractal {
    seed: u64,
    /// Height of the highest point that there could be over the lowest, metres.
    relief: f64,
    /// Place of the first sample, and the step between samples along both axes, metres.
    origin: DVec2,
    step: f64,
    /// Samples along a side.
    samples: u64,
    octaves: usize,
    /// Relief over the sum of the amplitudes.
    scale: f64,
}

/// The surface at a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Profile {
    /// Metres.
    pub(super) height: f64,
    /// What each octave can add there, metres: its amplitude times its weight.
    reach: [f64; MAX_OCTAVES],
    octaves: usize,
}

impl Fractal {
    /// Octaves of wavelengths down to twice the step are summed.
    pub(super) fn new(seed: u64, relief: f64, origin: DVec2, step: f64, samples: u64) -> Fractal {
        let mut octaves = 1;
        let (mut wavelength, mut amplitude, mut sum) = (LONGEST, 1.0, 1.0);
        while octaves < MAX_OCTAVES && wavelength >= 4.0 * step {
            wavelength *= 0.5;
            amplitude *= GAIN;
            sum += amplitude;
            octaves += 1;
        }
        Fractal { seed, relief, origin, step, samples, octaves, scale: relief / sum }
    }

    /// The surface before it is sampled, at a place relative to the world's origin.
    pub(super) fn profile(&self, at: DVec2) -> Profile {
        let mut profile = Profile { height: 0.0, reach: [0.0; MAX_OCTAVES], octaves: self.octaves };
        let (mut place, mut amplitude, mut weight) = (at / LONGEST, self.scale, 1.0);
        for octave in 0..self.octaves {
            let ridge = 1.0 - noise::plane(self.seed.wrapping_add(octave as u64), place).abs();
            let signal = ridge * ridge * weight;
            profile.height += amplitude * signal;
            profile.reach[octave] = amplitude * weight;
            weight = (2.0 * signal).min(1.0);
            amplitude *= GAIN;
            // Turned by the angle of (3, 4)/5, so that the lattices of two octaves do not line up.
            place = 2.0 * DVec2::new(0.6 * place.x - 0.8 * place.y, 0.8 * place.x + 0.6 * place.y) + 0.37;
        }
        profile
    }

    /// The height of a sample, metres.
    pub(super) fn sample(&self, column: u64, row: u64) -> f64 {
        self.profile(self.origin + self.step * DVec2::new(column as f64, row as f64)).height
    }

    /// Height of the highest point that there could be, metres.
    pub(super) fn relief(&self) -> f64 {
        self.relief
    }
}

impl Profile {
    /// What samples `spacing` metres apart miss near the place, metres: Σ reachₖ · min(1, s·spacing/λₖ). Creases make the
    /// loss linear in the spacing.
    pub(super) fn unresolved(&self, spacing: f64, sharpness: f64) -> f64 {
        let mut per_wavelength = sharpness * spacing / LONGEST;
        let mut sum = 0.0;
        for reach in &self.reach[..self.octaves] {
            sum += reach * per_wavelength.min(1.0);
            per_wavelength *= 2.0;
        }
        sum
    }
}

impl Surface for Fractal {
    /// Between samples as the finest tiles show it; beyond them, the height of the nearest edge.
    fn height(&self, at: DVec2) -> f64 {
        let last = (self.samples - 1) as f64;
        let at = ((at - self.origin) / self.step).clamp(DVec2::ZERO, DVec2::splat(last));
        let cell = at.floor().min(DVec2::splat(last - 1.0));
        let (x, y) = (cell.x as u64, cell.y as u64);
        let corners = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| self.sample(x, y));
        on_cell(corners, at - cell)
    }
}
