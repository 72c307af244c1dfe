//! How well an error on the screen shows what is there.

/// Error on the screen, pixels, at which the accuracy is one half: e₀ of ARCHITECTURE.md. 16 px then give 0.9.
pub const HALF_ACCURACY_PX: f64 = 48.0;

/// Error on the screen, pixels, that the rival viewers aim at.
pub const RIVALS_TARGET_PX: f64 = 16.0;

/// Accuracy a = 1 / (1 + g²·sharpness) ∈ [0, 1], for the geometric error `error` (m, ∞ for nothing at all) and
/// `sharpness` (m⁻²) = (pixels per metre / e₀)² at the distance of what is looked at.
///
/// Decreasing in both arguments; never NaN for errors in the range of f32 and finite sharpness.
pub fn accuracy(error: f64, sharpness: f64) -> f64 {
    if error == f64::INFINITY {
        return 0.0;
    }
    1.0 / (1.0 + error * error * sharpness)
}

/// (pixels per metre / e₀)² at distance `distance` (m, > 0), for `pixels_per_radian` of the view.
pub fn sharpness(pixels_per_radian: f64, distance: f64) -> f64 {
    let ratio = pixels_per_radian / (distance * HALF_ACCURACY_PX);
    ratio * ratio
}

/// Whether an error of `error` metres is at most `target_px` pixels wide on the screen.
pub fn is_within(error: f64, sharpness: f64, target_px: f64) -> bool {
    let limit = target_px / HALF_ACCURACY_PX;
    error * error * sharpness <= limit * limit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_pixels_give_nine_tenths() {
        // One metre of error at 1000 px/rad and 62.5 m is 16 px wide.
        let s = sharpness(1000.0, 62.5);
        assert!((accuracy(1.0, s) - 0.9).abs() < 1e-12);
        assert!(is_within(1.0, s, 16.0) && !is_within(1.001, s, 16.0));
    }

    #[test]
    fn extremes_stay_in_the_unit_interval() {
        for error in [0.0, 1e-38, 1.0, f64::from(f32::MAX), f64::INFINITY] {
            for s in [0.0, f64::MIN_POSITIVE, 1.0, 1e150] {
                assert!((0.0..=1.0).contains(&accuracy(error, s)), "{error} {s}");
            }
        }
    }
}
