//! Quantiles of errors.

use super::outcome::GAIN_FLOOR;

/// |`value` − `truth`| ÷ max(|`truth`|, 10⁻⁴ × `best`): 0 for equals, ∞ for an error of what is not worth anything, or for NaN.
pub fn relative_error(value: f64, truth: f64, best: f64) -> f64 {
    share((value - truth).abs(), truth, best)
}

/// `width` ÷ max(|`truth`|, 10⁻⁴ × `best`), in the same way.
pub fn share(width: f64, truth: f64, best: f64) -> f64 {
    let whole = truth.abs().max(GAIN_FLOOR * best);
    if width == 0.0 {
        0.0
    } else if width.is_nan() || whole <= 0.0 {
        f64::INFINITY
    } else {
        width / whole
    }
}

/// Largest value, 99.9th percentile and median by nearest rank; zeros of nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quantiles {
    /// The largest.
    pub max: f64,
    /// The 99.9th percentile.
    pub p999: f64,
    /// The median.
    pub median: f64,
    /// The mean.
    pub mean: f64,
}

impl Quantiles {
    /// Of `values`, which are sorted.
    pub fn of(values: &mut [f64]) -> Quantiles {
        values.sort_by(f64::total_cmp);
        let rank = |per_mille: usize| {
            values.get((values.len() * per_mille).div_ceil(1000).saturating_sub(1)).copied().unwrap_or(0.0)
        };
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        Quantiles { max: values.last().copied().unwrap_or(0.0), p999: rank(999), median: rank(500), mean }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_and_floors() {
        let mut values: Vec<f64> = (1..=2000).rev().map(f64::from).collect();
        let q = Quantiles::of(&mut values);
        assert_eq!((q.max, q.p999, q.median, q.mean), (2000.0, 1998.0, 1000.0, 1000.5));
        assert_eq!(Quantiles::of(&mut []), Quantiles::default());
        assert_eq!(relative_error(1.1, 1.0, 1.0), (1.1f64 - 1.0).abs());
        assert!((relative_error(2e-6, 1e-6, 1.0) - 1e-2).abs() < 1e-12, "grazing gains count against the floor");
        assert_eq!(relative_error(0.0, 0.0, 0.0), 0.0);
        assert_eq!(relative_error(1.0, 0.0, 0.0), f64::INFINITY);
        assert_eq!(relative_error(f64::NAN, 1.0, 1.0), f64::INFINITY);
    }
}
