//! Gradient noise (Perlin 2002) over lattices of integers, hashed by a seed. Additions and products alone, so that every
//! machine computes the same.

#[cfg(feature = "terrain")]
use glam::DVec2;
#[cfg(feature = "asteroids")]
use glam::DVec3;

/// Mixes a seed and lattice coordinates to 64 bits (the finaliser of SplitMix64).
fn hash(seed: u64, parts: [i64; 3]) -> u64 {
    let mut state = seed;
    for part in parts {
        state = (state ^ (part as u64)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        state ^= state >> 29;
    }
    let mixed = (state ^ state >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    mixed ^ mixed >> 31
}

/// 6t⁵ − 15t⁴ + 10t³.
fn fade(t: f64) -> f64 {
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

fn lerp(t: f64, a: f64, b: f64) -> f64 {
    a + t * (b - a)
}

/// Noise over the plane in [−1, 1], 0 at whole coordinates, of wavelength about 1.
#[cfg(feature = "terrain")]
pub(super) fn plane(seed: u64, at: DVec2) -> f64 {
    let cell = at.floor();
    let (x, y) = (cell.x as i64, cell.y as i64);
    let within = at - cell;
    let corner = |dx: i64, dy: i64| {
        let gradient = hash(seed, [x + dx, y + dy, 0]);
        let to = within - DVec2::new(dx as f64, dy as f64);
        // Eight directions: along the axes and the diagonals.
        const DIAGONAL: f64 = core::f64::consts::FRAC_1_SQRT_2;
        match gradient & 7 {
            0 => to.x,
            1 => -to.x,
            2 => to.y,
            3 => -to.y,
            4 => DIAGONAL * (to.x + to.y),
            5 => DIAGONAL * (to.x - to.y),
            6 => DIAGONAL * (to.y - to.x),
            _ => -DIAGONAL * (to.x + to.y),
        }
    };
    let (u, v) = (fade(within.x), fade(within.y));
    let sum = lerp(v, lerp(u, corner(0, 0), corner(1, 0)), lerp(u, corner(0, 1), corner(1, 1)));
    (sum * core::f64::consts::SQRT_2).clamp(-1.0, 1.0)
}

/// Noise in space in [−1, 1], 0 at whole coordinates, of wavelength about 1.
#[cfg(feature = "asteroids")]
pub(super) fn space(seed: u64, at: DVec3) -> f64 {
    let cell = at.floor();
    let (x, y, z) = (cell.x as i64, cell.y as i64, cell.z as i64);
    let within = at - cell;
    let corner = |dx: i64, dy: i64, dz: i64| {
        let gradient = hash(seed, [x + dx, y + dy, z + dz]);
        let to = within - DVec3::new(dx as f64, dy as f64, dz as f64);
        // The twelve directions to the middles of a cube's edges.
        let sign = |bit: u64| if gradient >> bit & 1 == 0 { 1.0 } else { -1.0 };
        let (a, b) = match (gradient >> 8) % 3 {
            0 => (to.x, to.y),
            1 => (to.y, to.z),
            _ => (to.z, to.x),
        };
        sign(0) * a + sign(1) * b
    };
    let (u, v, w) = (fade(within.x), fade(within.y), fade(within.z));
    let side =
        |dz: i64| lerp(v, lerp(u, corner(0, 0, dz), corner(1, 0, dz)), lerp(u, corner(0, 1, dz), corner(1, 1, dz)));
    lerp(w, side(0), side(1)).clamp(-1.0, 1.0)
}

#[cfg(all(test, feature = "terrain", feature = "asteroids"))]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn smooth_and_in_range(seed: u64, x in -1e6..1e6, y in -1e6..1e6, z in -1e6..1e6) {
            let (at, step) = (DVec3::new(x, y, z), 1e-4);
            let noises = [plane(seed, at.truncate()), space(seed, at)];
            let moved = [plane(seed, at.truncate() + step), space(seed, at + step)];
            for (noise, moved) in noises.into_iter().zip(moved) {
                prop_assert!(noise.abs() <= 1.0 && (noise - moved).abs() < 20.0 * step);
            }
            prop_assert_eq!(plane(seed, at.truncate().floor()), 0.0);
            prop_assert_eq!(space(seed, at.floor()), 0.0);
        }
    }
}
