//! Dynamic screen-space error: CesiumJS, and loaders.gl after it, let far tiles be coarser when the view is level.
//!
//! Error on screen is less by 24 px · (1 − exp(−(ρd)²)) at the distance d, where
//! ρ = 2·10⁻⁴/m · (1 − |forward · up|) · (1 − t) and t rises from 0 to 1 as the eye rises from a quarter of the
//! tileset's height to its top.
//!
//! As shipped, a tileset whose middle is further from the origin than the Earth's polar radius is taken for one in
//! Earth-centred coordinates: up is away from the origin, and its height runs from 0 to twice its middle's height above
//! the ellipsoid. Any other has +z up, whatever its content has, and the height of its box. Where a height range is
//! empty, t is 0 beneath and 1 above.

use crate::lod_tree::{LodTree, NodeId};
use crate::view::View;
use glam::DVec3;

/// `dynamicScreenSpaceErrorDensity`, per metre.
const DENSITY: f64 = 2e-4;
/// `dynamicScreenSpaceErrorFactor`, pixels.
const FACTOR_PX: f64 = 24.0;
/// `dynamicScreenSpaceErrorHeightFalloff`.
const HEIGHT_FALLOFF: f64 = 0.25;
/// WGS 84, metres.
const EQUATORIAL_RADIUS: f64 = 6_378_137.0;
const POLAR_RADIUS: f64 = 6_356_752.314_245_179;

/// ρ of one view.
#[derive(Clone, Copy, Debug)]
pub(in crate::policy) struct Fog {
    density: f64,
}

impl Fog {
    pub(in crate::policy) fn new(tree: &LodTree, view: &View) -> Fog {
        let (centre, half) = (tree.centre(NodeId(0)), tree.half(NodeId(0)));
        let (up, height, bottom, top) = if centre.length() > POLAR_RADIUS {
            let top = 2.0 * geodetic_height(centre);
            (view.position.normalize_or(DVec3::Z), geodetic_height(view.position), 0.0, top)
        } else {
            (DVec3::Z, view.position.z, centre.z - half.z, centre.z + half.z)
        };
        let close = bottom + HEIGHT_FALLOFF * (top - bottom);
        let t = if top > close { ((height - close) / (top - close)).clamp(0.0, 1.0) } else { f64::from(height >= top) };
        let level = 1.0 - view.forward().dot(up).abs().min(1.0);
        Fog { density: DENSITY * level * (1.0 - t) }
    }

    /// What is taken off the error on screen at a distance in metres, pixels.
    pub(in crate::policy) fn relief_px(&self, distance: f64) -> f64 {
        let depth = self.density * distance;
        // Beneath this the relief is less than 10⁻⁸ px.
        if depth < 1e-5 { 0.0 } else { -FACTOR_PX * libm::expm1(-depth * depth) }
    }
}

/// Height above the ellipsoid, metres, by one step of Bowring's formula: to less than a millimetre within 10⁴ km.
fn geodetic_height(p: DVec3) -> f64 {
    let (a, b) = (EQUATORIAL_RADIUS, POLAR_RADIUS);
    let e2 = 1.0 - (b * b) / (a * a);
    let across = libm::hypot(p.x, p.y);
    let (sin, cos) = libm::sincos(libm::atan2(p.z * a, across * b));
    let latitude = libm::atan2(p.z + (a * a / b - b) * sin * sin * sin, across - e2 * a * cos * cos * cos);
    let (sin, cos) = libm::sincos(latitude);
    across * cos + p.z * sin - a * (1.0 - e2 * sin * sin).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod_tree::{Aabb, LodTreeBuilder};
    use glam::DQuat;

    fn tree(min: DVec3, max: DVec3) -> LodTree {
        let mut b = LodTreeBuilder::default();
        b.open().unwrap();
        b.close(Some(Aabb { min, max }), 1.0).unwrap();
        b.finish().unwrap()
    }

    fn view(position: DVec3, towards: DVec3) -> View {
        let orientation = DQuat::from_rotation_arc(DVec3::NEG_Z, towards);
        View { position, orientation, fov_y: 1.0, viewport: [100, 100] }
    }

    #[test]
    fn level_views_are_relieved_and_steep_or_high_ones_are_not() {
        let tree = tree(DVec3::ZERO, DVec3::new(1e4, 1e4, 100.0));
        // ρd = 1 at 5 km: 24·(1 − 1/e) px.
        let level = Fog::new(&tree, &view(DVec3::new(0.0, 0.0, 20.0), DVec3::X));
        assert!((level.relief_px(5000.0) - 24.0 * (1.0 - libm::exp(-1.0))).abs() < 1e-9);
        assert_eq!(level.relief_px(0.0), 0.0);
        let steep = Fog::new(&tree, &view(DVec3::new(0.0, 0.0, 20.0), DVec3::NEG_Z));
        assert!(steep.relief_px(1e6) < 1e-9);
        // Halfway from 25 m to 100 m the density is halved.
        let high = Fog::new(&tree, &view(DVec3::new(0.0, 0.0, 62.5), DVec3::X));
        assert!((high.relief_px(1e4) - 24.0 * (1.0 - libm::exp(-1.0))).abs() < 1e-9);
    }

    #[test]
    fn earth_centred_tilesets_have_their_up_away_from_the_centre() {
        let at = DVec3::new(EQUATORIAL_RADIUS + 100.0, 0.0, 0.0);
        let tree = tree(at - 50.0, at + 50.0);
        assert!((geodetic_height(at) - 100.0).abs() < 1e-6);
        assert!((geodetic_height(DVec3::new(0.0, 0.0, POLAR_RADIUS + 7.0)) - 7.0).abs() < 1e-6);
        // Latitude 45°, height 1 km: N = a/√(1 − e²/2).
        let e2 = 1.0 - (POLAR_RADIUS / EQUATORIAL_RADIUS) * (POLAR_RADIUS / EQUATORIAL_RADIUS);
        let n = EQUATORIAL_RADIUS / (1.0 - 0.5 * e2).sqrt();
        let p = 0.5f64.sqrt() * DVec3::new(n + 1000.0, 0.0, n * (1.0 - e2) + 1000.0);
        assert!((geodetic_height(p) - 1000.0).abs() < 1e-3);
        let level = Fog::new(&tree, &view(at - DVec3::X * 90.0, DVec3::Z));
        assert!((level.relief_px(5000.0) - 24.0 * (1.0 - libm::exp(-1.0))).abs() < 1e-9);
        let down = Fog::new(&tree, &view(at, DVec3::NEG_X));
        assert!(down.relief_px(1e6) < 1e-6);
    }
}
