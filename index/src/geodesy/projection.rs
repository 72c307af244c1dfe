//! Projected coordinate systems. Projections come from proj4rs, which takes its transcendental functions from the
//! platform: results are rounded to about a micrometre, so that machines agree.

use super::Geodetic;
use glam::DVec3;
use proj4rs::Proj;
use proj4rs::transform::transform;

/// Why a position has no coordinates in a system.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GeodesyError {
    /// No such system, or one that cannot be computed.
    #[error("EPSG:{code}: {message}; expected a projected system in metres")]
    System {
        /// As given.
        code: u32,
        /// What is wrong with it.
        message: String,
    },
    /// A position outside of what the system can express.
    #[error("EPSG:{code}: {message}")]
    Position {
        /// Of the system.
        code: u32,
        /// What was to be converted, and why it cannot be.
        message: String,
    },
}

/// A projected coordinate system by its EPSG code: x east, y north, z height over the ellipsoid of its own datum, metres.
///
/// Datum shifts are those of the EPSG registry's `TOWGS84` parameters, accurate to about a metre. The ellipsoid of an
/// old national datum lies close to sea level there, that of WGS 84 does not: 40 to 55 m off in Europe.
#[derive(Debug)]
pub struct Projection {
    code: u32,
    system: Proj,
    wgs84: Proj,
}

impl Projection {
    /// The system of this code; of a compound system its horizontal part.
    ///
    /// # Errors
    /// An unknown code, a geographic or geocentric system, one in other units than metres, one that is not implemented.
    pub fn from_epsg(code: u32) -> Result<Projection, GeodesyError> {
        let wrong = |message: String| GeodesyError::System { code, message };
        let definition = u16::try_from(code).ok().and_then(crs_definitions::from_code);
        let definition = definition.ok_or_else(|| wrong("is not known".to_owned()))?;
        let system = Proj::from_proj_string(definition.proj4).map_err(|error| wrong(error.to_string()))?;
        if system.is_latlong() || system.is_geocent() {
            return Err(wrong(format!("is {}", if system.is_latlong() { "geographic" } else { "geocentric" })));
        }
        if system.to_meter() != 1.0 || !system.is_normalized_axis() {
            return Err(wrong(format!("has units of {} m or axes other than east, north, up", system.to_meter())));
        }
        let wgs84 = Proj::from_proj_string(crs_definitions::EPSG_4326.proj4).map_err(|e| wrong(e.to_string()))?;
        Ok(Projection { code, system, wgs84 })
    }

    /// Its EPSG code.
    pub fn code(&self) -> u32 {
        self.code
    }

    /// Coordinates in the system, metres.
    ///
    /// # Errors
    /// A position outside of where the projection is defined.
    pub fn forward(&self, at: Geodetic) -> Result<DVec3, GeodesyError> {
        let mut point = (at.longitude, at.latitude, at.height);
        let refused = |why: String| {
            let (latitude, longitude) = (at.latitude.to_degrees(), at.longitude.to_degrees());
            let message = format!("latitude {latitude}°, longitude {longitude}°: {why}");
            GeodesyError::Position { code: self.code, message }
        };
        transform(&self.wgs84, &self.system, &mut point).map_err(|error| refused(error.to_string()))?;
        let made = DVec3::new(rounded(point.0, METRES), rounded(point.1, METRES), rounded(point.2, METRES));
        if made.is_finite() { Ok(made) } else { Err(refused("no finite coordinates there".to_owned())) }
    }

    /// The position that has these coordinates in the system.
    ///
    /// # Errors
    /// Coordinates that no position has, as far as the projection can tell: it goes there and back within a metre.
    pub fn inverse(&self, at: DVec3) -> Result<Geodetic, GeodesyError> {
        let refused = |why: String| {
            let message = format!("x {} m, y {} m: {why}", at.x, at.y);
            GeodesyError::Position { code: self.code, message }
        };
        let mut point = (at.x, at.y, at.z);
        transform(&self.system, &self.wgs84, &mut point).map_err(|error| refused(error.to_string()))?;
        let [longitude, latitude] = [point.0, point.1].map(|angle| rounded(angle, RADIANS));
        let found = Geodetic { latitude, longitude, height: rounded(point.2, METRES) };
        let is_angle = latitude.abs() <= core::f64::consts::FRAC_PI_2 && longitude.is_finite();
        if !(is_angle && found.height.is_finite()) {
            return Err(refused(format!("no latitude and longitude there, but {latitude} and {longitude} radians")));
        }
        let back = self.forward(found)?;
        let off = (back - at).truncate().length();
        if off <= 1.0 {
            Ok(found)
        } else {
            Err(refused(format!("outside of the system: there and back is {off} m off")))
        }
    }
}

/// Steps per metre and per radian that results are rounded to, powers of two.
const METRES: f64 = 1_048_576.0;
const RADIANS: f64 = 8_796_093_022_208.0;

fn rounded(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps
}

#[cfg(test)]
mod tests {
    use super::super::WGS84_A;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn known_projections() {
        // On a central meridian at the equator UTM is 500 000, 0; the scale there is 0.9996.
        let utm = Projection::from_epsg(32633).unwrap();
        let origin = utm.forward(Geodetic::from_degrees(0.0, 15.0, 30.0)).unwrap();
        assert!((origin - DVec3::new(500_000.0, 0.0, 30.0)).length() < 1e-6, "{origin}");
        let east = utm.forward(Geodetic::from_degrees(0.0, 15.0 + 1e-4, 0.0)).unwrap();
        assert!(((east.x - 500_000.0) / (0.9996 * WGS84_A * 1e-4_f64.to_radians()) - 1.0).abs() < 1e-7);
        // The Old Observatory of Bern, fundamental point of LV95 (swisstopo): 46° 57′ 3.9″ N 7° 26′ 19.1″ E on WGS 84.
        let lv95 = Projection::from_epsg(2056).unwrap();
        let bern = lv95.inverse(DVec3::new(2_600_000.0, 1_200_000.0, 0.0)).unwrap();
        assert!((bern.latitude.to_degrees() - 46.951_08).abs() < 2e-5, "{}", bern.latitude.to_degrees());
        assert!((bern.longitude.to_degrees() - 7.438_64).abs() < 2e-5, "{}", bern.longitude.to_degrees());
        // The tower of Our Lady in Amersfoort, origin of RD: 52° 9′ 18.6″ N 5° 23′ 13.9″ E, and its compound system.
        for code in [28992, 7415] {
            let tower = Projection::from_epsg(code).unwrap().inverse(DVec3::new(155_000.0, 463_000.0, 0.0)).unwrap();
            assert!((tower.latitude.to_degrees() - 52.155_17).abs() < 2e-5, "{}", tower.latitude.to_degrees());
            assert!((tower.longitude.to_degrees() - 5.387_20).abs() < 2e-5, "{}", tower.longitude.to_degrees());
        }
    }

    #[test]
    fn what_is_no_projection_and_what_is_outside() {
        for code in [0, 4326, 4978, 4979, 99_999, 70_000, 2225] {
            let message = Projection::from_epsg(code).unwrap_err().to_string();
            assert!(message.contains(&format!("EPSG:{code}: ")), "{message}");
        }
        let utm = Projection::from_epsg(32734).unwrap();
        // Twice the northing of a place in the Cape.
        let message = utm.inverse(DVec3::new(553_000.0, 12_580_000.0, 0.0)).map(|at| at.latitude.to_degrees());
        assert!(message.as_ref().map_or(true, |latitude| *latitude > 20.0), "{message:?}");
        for bad in [f64::NAN, f64::INFINITY, 1e300, -1e300] {
            assert!(utm.inverse(DVec3::splat(bad)).is_err());
            assert!(utm.forward(Geodetic { latitude: bad, longitude: 0.3, height: 0.0 }).is_err());
        }
    }

    proptest! {
        #[test]
        fn projected_there_and_back(x in 200_000.0..800_000.0f64, y in 0.0..9_000_000.0f64, z in -100.0..9000.0f64) {
            let utm = Projection::from_epsg(32632).unwrap();
            let at = DVec3::new(x, y, z);
            let back = utm.forward(utm.inverse(at).unwrap()).unwrap();
            prop_assert!((back - at).length() < 1e-3, "{at} {back}");
        }
    }
}
