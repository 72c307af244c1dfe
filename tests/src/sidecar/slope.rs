//! Whether something grows: a line through samples that are not independent of each other.

/// Blocks into which samples are cut: their means are taken as independent.
const BLOCKS: usize = 12;
/// Student's t of 10 degrees of freedom, two-sided 95 %.
const T_10: f64 = 2.228;

/// Growth with its 95 % confidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slope {
    /// Least squares through the means of 12 blocks in order of time.
    pub per_second: f64,
    /// Half the width of its interval.
    pub half_width: f64,
}

/// Of (seconds, value) samples in order of time. `None` with fewer than two a block.
pub fn of(samples: &[(f64, f64)]) -> Option<Slope> {
    let size = samples.len() / BLOCKS;
    if size < 2 {
        return None;
    }
    let mean = |values: &mut dyn Iterator<Item = f64>, count: usize| values.sum::<f64>() / count as f64;
    let blocks: Vec<(f64, f64)> = samples
        .chunks_exact(size)
        .take(BLOCKS)
        .map(|block| (mean(&mut block.iter().map(|s| s.0), size), mean(&mut block.iter().map(|s| s.1), size)))
        .collect();
    let (x, y) = (mean(&mut blocks.iter().map(|b| b.0), BLOCKS), mean(&mut blocks.iter().map(|b| b.1), BLOCKS));
    let spread: f64 = blocks.iter().map(|b| (b.0 - x) * (b.0 - x)).sum();
    let per_second = blocks.iter().map(|b| (b.0 - x) * (b.1 - y)).sum::<f64>() / spread;
    let residual = |b: &(f64, f64)| b.1 - y - per_second * (b.0 - x);
    let variance = blocks.iter().map(|b| residual(b) * residual(b)).sum::<f64>() / (BLOCKS - 2) as f64;
    Some(Slope { per_second, half_width: T_10 * (variance / spread).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_and_its_interval_holds_it() {
        let noise = |i: u64| ((i * 7919) % 101) as f64 - 50.0;
        let samples: Vec<(f64, f64)> = (0..600).map(|i| (i as f64, 1e6 + 3.0 * i as f64 + noise(i))).collect();
        let slope = of(&samples).expect("enough samples");
        assert!((slope.per_second - 3.0).abs() <= slope.half_width.max(1e-9), "{slope:?}");
        assert!(slope.half_width < 0.1);
        assert_eq!(of(&samples[..20]), None);
    }
}
