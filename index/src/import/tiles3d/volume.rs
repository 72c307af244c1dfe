//! Bounding volumes of 3D Tiles, and the axis-aligned boxes around them.

use crate::geodesy::{WGS84_A, WGS84_B};
use foresight_scheduler::lod_tree::Aabb;
use glam::{DMat3, DMat4, DVec3};

/// A bounding volume as declared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Volume {
    /// A box by its centre and its three half axes, in the tile's space.
    Box {
        /// Middle.
        centre: DVec3,
        /// Half axes as columns.
        half_axes: DMat3,
    },
    /// A part of the WGS 84 ellipsoid: west, south, east, north in radians, then least and greatest height in metres.
    /// No tile transform applies to it.
    Region([f64; 6]),
    /// A sphere by its centre and radius, in the tile's space.
    Sphere {
        /// Middle.
        centre: DVec3,
        /// Radius, metres.
        radius: f64,
    },
}

impl Volume {
    /// The axis-aligned box around the volume once `transform` (affine) has been applied.
    pub fn bounds(&self, transform: &DMat4) -> Aabb {
        match *self {
            Volume::Box { centre, half_axes } => {
                let middle = transform.transform_point3(centre);
                let linear = DMat3::from_mat4(*transform) * half_axes;
                let half = linear.x_axis.abs() + linear.y_axis.abs() + linear.z_axis.abs();
                Aabb { min: middle - half, max: middle + half }
            }
            Volume::Sphere { centre, radius } => {
                let middle = transform.transform_point3(centre);
                let half = DVec3::splat(radius * largest_scale(transform));
                Aabb { min: middle - half, max: middle + half }
            }
            Volume::Region(region) => region_bounds(region),
        }
    }
}

/// The largest factor by which `transform` stretches one of the axes.
pub(crate) fn largest_scale(transform: &DMat4) -> f64 {
    let linear = DMat3::from_mat4(*transform);
    linear.x_axis.length_squared().max(linear.y_axis.length_squared()).max(linear.z_axis.length_squared()).sqrt()
}

/// Box of a region in Earth-centred coordinates. With ρ = (N + h) cos φ: x = ρ cos λ, y = ρ sin λ,
/// z = (N b²/a² + h) sin φ; ρ falls with |φ| and z rises with φ, so their extremes lie at the ends of the interval
/// or, for ρ, at the equator.
fn region_bounds([west, south, east, north, low, high]: [f64; 6]) -> Aabb {
    let east = if east < west { east + core::f64::consts::TAU } else { east };
    let radius = |latitude: f64| {
        let sine = libm::sin(latitude);
        WGS84_A / (1.0 - (1.0 - WGS84_B * WGS84_B / (WGS84_A * WGS84_A)) * sine * sine).sqrt()
    };
    let rho = |latitude: f64, height: f64| (radius(latitude) + height) * libm::cos(latitude).max(0.0);
    let z = |latitude: f64, height: f64| {
        (radius(latitude) * (WGS84_B * WGS84_B / (WGS84_A * WGS84_A)) + height) * libm::sin(latitude)
    };
    let nearest_equator = 0.0_f64.clamp(south.min(north), north.max(south));
    let rho_max = rho(nearest_equator, high);
    let rho_min = rho(south, low).min(rho(north, low));
    let product = |(least, greatest): (f64, f64)| {
        ((rho_min * least).min(rho_max * least), (rho_min * greatest).max(rho_max * greatest))
    };
    let x = product(cosine_range(west, east));
    let y = product(cosine_range(west - core::f64::consts::FRAC_PI_2, east - core::f64::consts::FRAC_PI_2));
    let z_min = z(south, low).min(z(south, high));
    let z_max = z(north, low).max(z(north, high));
    Aabb { min: DVec3::new(x.0, y.0, z_min), max: DVec3::new(x.1, y.1, z_max) }
}

/// Least and greatest cosine over an interval of angles.
fn cosine_range(from: f64, to: f64) -> (f64, f64) {
    use core::f64::consts::{PI, TAU};
    let ends = (libm::cos(from), libm::cos(to));
    // True if from ≤ phase + k·2π ≤ to for a whole number k.
    let holds = |phase: f64| ((to - phase) / TAU).floor() * TAU + phase >= from;
    let greatest = if holds(0.0) { 1.0 } else { ends.0.max(ends.1) };
    let least = if holds(PI) { -1.0 } else { ends.0.min(ends.1) };
    (least, greatest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesy::Geodetic;

    #[test]
    fn a_region_is_bounded_tightly() {
        for [west, south, east, north, low, high] in [
            [0.13, 0.82, 0.14, 0.83, -20.0, 900.0],
            [-0.3, -0.2, 0.4, 0.3, 0.0, 8000.0],
            [3.0, -1.2, -3.0, -1.1, 0.0, 100.0],
            [-core::f64::consts::PI, -1.5, core::f64::consts::PI, 1.5, -400.0, 9000.0],
        ] {
            let bounds = Volume::Region([west, south, east, north, low, high]).bounds(&DMat4::IDENTITY);
            let mut sampled = Aabb::EMPTY;
            let span = if east < west { east + core::f64::consts::TAU - west } else { east - west };
            for i in 0..=200 {
                for j in 0..=200 {
                    for height in [low, high] {
                        let longitude = west + span * f64::from(i) / 200.0;
                        let latitude = south + (north - south) * f64::from(j) / 200.0;
                        let point = Geodetic { latitude, longitude, height }.to_ecef();
                        sampled = sampled.union(Aabb { min: point, max: point });
                    }
                }
            }
            let slack = 1e-6;
            assert!(bounds.min.cmple(sampled.min + slack).all() && bounds.max.cmpge(sampled.max - slack).all());
            let size = (sampled.max - sampled.min).max_element();
            assert!((bounds.min - sampled.min).abs().max_element() < 1e-3 * size + 1.0, "{bounds:?} {sampled:?}");
            assert!((bounds.max - sampled.max).abs().max_element() < 1e-3 * size + 1.0, "{bounds:?} {sampled:?}");
        }
    }

    #[test]
    fn a_turned_box_and_a_scaled_sphere() {
        let half_axes = DMat3::from_diagonal(DVec3::new(1.0, 2.0, 3.0));
        let quarter =
            DMat4::from_cols_array(&[0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 9.0, 0.0, 0.0, 1.0]);
        let bounds = Volume::Box { centre: DVec3::new(1.0, 0.0, 0.0), half_axes }.bounds(&quarter);
        assert_eq!(bounds, Aabb { min: DVec3::new(7.0, 0.0, -3.0), max: DVec3::new(11.0, 2.0, 3.0) });
        let scaled = DMat4::from_scale(DVec3::new(1.0, 2.0, 0.5));
        let bounds = Volume::Sphere { centre: DVec3::ONE, radius: 3.0 }.bounds(&scaled);
        assert_eq!(bounds.max, DVec3::new(7.0, 8.0, 6.5));
    }
}
