//! Fewer points for the eye: what a series loses is finer than a pixel, and its dips and peaks stay.

/// Values beyond this are not drawn: differences of two of them stay finite.
const DRAWABLE: f64 = 1e30;

/// Whether a value can be drawn.
pub(super) fn drawable(value: f64) -> bool {
    value.abs() <= DRAWABLE
}

/// A series over an axis, cut into runs where it is `None` or cannot be drawn, of at most `limit` points together
/// (`limit` ≥ 2): the least and the greatest value of each of `limit`/2 equal stretches of indices. A gap shorter than
/// a stretch is bridged.
pub(super) fn extremes(x: &[f64], y: &[Option<f64>], limit: usize) -> Vec<Vec<[f64; 2]>> {
    let n = x.len().min(y.len());
    let buckets = if n <= limit { n } else { limit / 2 };
    let mut runs = Vec::new();
    let mut run = Vec::new();
    for bucket in 0..buckets {
        let (mut least, mut greatest): (Option<[f64; 2]>, Option<[f64; 2]>) = (None, None);
        for index in bucket * n / buckets..(bucket + 1) * n / buckets {
            let Some(value) = y[index].filter(|v| drawable(*v) && drawable(x[index])) else { continue };
            let point = [x[index], value];
            if least.is_none_or(|p| value < p[1]) {
                least = Some(point);
            }
            if greatest.is_none_or(|p| value > p[1]) {
                greatest = Some(point);
            }
        }
        match (least, greatest) {
            (Some(a), Some(b)) if a == b => run.push(a),
            (Some(a), Some(b)) => run.extend(if a[0] <= b[0] { [a, b] } else { [b, a] }),
            _ if !run.is_empty() => runs.push(std::mem::take(&mut run)),
            _ => {}
        }
    }
    if !run.is_empty() {
        runs.push(run);
    }
    runs
}

/// Means of at most `limit` equal stretches: `(start, end, mean)`, the axis in units of the index.
pub(super) fn means(values: &[f64], limit: usize) -> Vec<[f64; 3]> {
    let n = values.len();
    let buckets = n.min(limit);
    let stretch = |bucket: usize| {
        let (start, end) = (bucket * n / buckets, (bucket + 1) * n / buckets);
        let sum: f64 = values[start..end].iter().filter(|v| drawable(**v)).sum();
        [start as f64, end as f64, sum / (end - start) as f64]
    };
    (0..buckets).map(stretch).collect()
}

/// The empirical distribution: `(value, share of the values at most it)`, at no more than `limit` ranks (`limit` ≥ 2),
/// the least and the greatest among them.
pub(super) fn distribution(values: &[Option<f64>], limit: usize) -> Vec<[f64; 2]> {
    let mut sorted: Vec<f64> = values.iter().flatten().copied().filter(|v| drawable(*v)).collect();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len();
    let steps = n.min(limit);
    let rank = |step: usize| if steps < 2 { 0 } else { step * (n - 1) / (steps - 1) };
    let mut points: Vec<[f64; 2]> = Vec::with_capacity(steps);
    for step in 0..steps {
        let point = [sorted[rank(step)], (rank(step) + 1) as f64 / n as f64];
        match points.last_mut() {
            Some(last) if last[0] == point[0] => last[1] = point[1],
            _ => points.push(point),
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn one_dip_among_many_frames_stays() {
        let x: Vec<f64> = (0..100_000).map(f64::from).collect();
        let mut y = vec![Some(1.0); x.len()];
        y[43_210] = Some(0.25);
        let runs = extremes(&x, &y, 1000);
        assert_eq!(runs.len(), 1);
        assert!(runs[0].len() <= 1000);
        assert!(runs[0].contains(&[43_210.0, 0.25]));
    }

    #[test]
    fn frames_without_anything_in_view_part_the_curve() {
        let x = [0.0, 1.0, 2.0, 3.0];
        let runs = extremes(&x, &[Some(0.5), None, Some(f64::NAN), Some(0.75)], 1000);
        assert_eq!(runs, [[[0.0, 0.5]], [[3.0, 0.75]]]);
        assert!(extremes(&x, &[None; 4], 1000).is_empty());
        assert!(extremes(&[], &[], 1000).is_empty());
    }

    #[test]
    fn distribution_of_three() {
        assert_eq!(
            distribution(&[Some(0.5), None, Some(0.25), Some(0.5), Some(1.0)], 100),
            [[0.25, 0.25], [0.5, 0.75], [1.0, 1.0]]
        );
        assert_eq!(distribution(&[Some(0.5)], 100), [[0.5, 1.0]]);
        assert!(distribution(&[], 100).is_empty());
    }

    proptest! {
        #[test]
        fn means_keep_the_sum(values in proptest::collection::vec(0.0..1e9f64, 0..500), limit in 1usize..50) {
            let stretches = means(&values, limit);
            let sum: f64 = stretches.iter().map(|[start, end, mean]| (end - start) * mean).sum();
            let expected: f64 = values.iter().sum();
            prop_assert!((sum - expected).abs() <= 1e-9 * expected.max(1.0));
            prop_assert!(stretches.len() <= limit);
        }

        #[test]
        fn extremes_keep_the_range(values in proptest::collection::vec(-1.0..1.0f64, 1..2000), limit in 2usize..100) {
            let x: Vec<f64> = (0..values.len()).map(|i| i as f64).collect();
            let y: Vec<Option<f64>> = values.iter().copied().map(Some).collect();
            let drawn: Vec<[f64; 2]> = extremes(&x, &y, limit).concat();
            prop_assert!(drawn.len() <= limit);
            prop_assert!(drawn.is_sorted_by(|a, b| a[0] < b[0]));
            let least = values.iter().copied().fold(f64::INFINITY, f64::min);
            let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            prop_assert!(drawn.iter().any(|p| p[1] == least) && drawn.iter().any(|p| p[1] == greatest));
        }
    }
}
