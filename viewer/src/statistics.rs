//! Distributions in little memory.

use serde::Serialize;

/// Buckets between a power of two and the next.
const STEPS: u64 = 64;

/// A histogram of nanoseconds whose buckets are at most 1/64 of their value wide; 30 kB however many it counts.
#[derive(Clone, Debug, Default)]
pub struct Histogram {
    counts: Vec<u64>,
    total: u64,
    max: u64,
}

/// Some of a distribution, milliseconds; zeros of nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// How many.
    pub count: u64,
    /// Median, rounded up to its bucket's end.
    pub p50: f64,
    /// 99th percentile, rounded up likewise.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Histogram {
    /// Counts a value.
    pub fn add(&mut self, nanos: u64) {
        let bucket = bucket(nanos);
        if self.counts.len() <= bucket {
            self.counts.resize(bucket + 1, 0);
        }
        self.counts[bucket] += 1;
        self.total += 1;
        self.max = self.max.max(nanos);
    }

    /// Counts what another has counted.
    pub fn merge(&mut self, other: &Histogram) {
        if self.counts.len() < other.counts.len() {
            self.counts.resize(other.counts.len(), 0);
        }
        for (count, more) in self.counts.iter_mut().zip(&other.counts) {
            *count += more;
        }
        self.total += other.total;
        self.max = self.max.max(other.max);
    }

    /// By nearest rank: the end of the bucket in which it lies, at most the largest value; 0 of nothing.
    pub fn percentile(&self, percent: u64) -> u64 {
        let rank = (self.total * percent).div_ceil(100).max(1);
        let mut seen = 0;
        for (bucket, count) in self.counts.iter().enumerate() {
            seen += count;
            if seen >= rank {
                return end(bucket).min(self.max);
            }
        }
        self.max
    }

    /// The figures that are reported.
    pub fn percentiles(&self) -> Percentiles {
        let ms = |nanos: u64| nanos as f64 / 1e6;
        Percentiles { count: self.total, p50: ms(self.percentile(50)), p99: ms(self.percentile(99)), max: ms(self.max) }
    }
}

fn bucket(nanos: u64) -> usize {
    if nanos < STEPS {
        return nanos as usize;
    }
    let power = u64::from(nanos.ilog2() - STEPS.ilog2());
    ((power + 1) * STEPS + (nanos >> power) - STEPS) as usize
}

/// The largest value of a bucket.
fn end(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    if bucket < STEPS {
        return bucket;
    }
    let power = bucket / STEPS - 1;
    let first = (bucket % STEPS + STEPS) << power;
    first + ((1 << power) - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_within_a_sixty_fourth() {
        let mut histogram = Histogram::default();
        let mut other = Histogram::default();
        for i in 1..=1000u64 {
            if i % 3 == 0 { other.add(i * 1_000_003) } else { histogram.add(i * 1_000_003) }
        }
        histogram.merge(&other);
        for percent in [1, 50, 99, 100] {
            let (exact, found) = (percent * 10 * 1_000_003, histogram.percentile(percent));
            assert!(found >= exact && found as f64 <= exact as f64 * (1.0 + 1.0 / 64.0), "{percent} %: {found}");
        }
        assert_eq!(Histogram::default().percentiles(), Percentiles::default());
    }

    proptest::proptest! {
        #[test]
        fn every_value_lies_in_its_bucket(nanos: u64) {
            let b = bucket(nanos);
            proptest::prop_assert!(nanos <= end(b));
            proptest::prop_assert!(b == 0 || nanos > end(b - 1));
        }
    }
}
