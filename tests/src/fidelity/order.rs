//! Rank correlations.

/// Kendall's τ-b: (concordant − discordant pairs) / √((n₀ − n₁)(n₀ − n₂)), n₀ all pairs, n₁ and n₂ those tied in the
/// first and in the second. In O(n²). `None` where it is undefined: no pair, or all tied.
pub fn kendall(a: &[f64], b: &[f64]) -> Option<f64> {
    let sign = |d: f64| i64::from(d > 0.0) - i64::from(d < 0.0);
    let (mut difference, mut untied_a, mut untied_b) = (0_i64, 0_i64, 0_i64);
    for (i, (a_i, b_i)) in a.iter().zip(b).enumerate() {
        for (a_j, b_j) in a[..i].iter().zip(&b[..i]) {
            let (in_a, in_b) = (sign(a_i - a_j), sign(b_i - b_j));
            difference += in_a * in_b;
            untied_a += in_a.abs();
            untied_b += in_b.abs();
        }
    }
    let scale = (untied_a as f64 * untied_b as f64).sqrt();
    (scale > 0.0).then(|| difference as f64 / scale)
}

/// Spearman's ρ: the correlation of the ranks, ties sharing the mean of theirs. `None` where it is undefined: fewer than
/// two, or all tied.
pub fn spearman(a: &[f64], b: &[f64]) -> Option<f64> {
    let (a, b) = (ranks(a), ranks(b));
    let middle = (a.len() as f64 + 1.0) / 2.0;
    let moment = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - middle) * (y - middle)).sum::<f64>();
    let scale = (moment(&a, &a) * moment(&b, &b)).sqrt();
    (scale > 0.0).then(|| moment(&a, &b) / scale)
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut ranks = vec![0.0; values.len()];
    let mut begin = 0;
    for tied in order.chunk_by(|&i, &j| values[i] == values[j]) {
        let rank = begin as f64 + (tied.len() as f64 + 1.0) / 2.0;
        for &i in tied {
            ranks[i] = rank;
        }
        begin += tied.len();
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 5] = [1.0, 2.0, 3.0, 4.0, 5.0];

    #[test]
    fn equal_and_opposite_orders() {
        let down: Vec<f64> = UP.iter().map(|x| -x).collect();
        for correlation in [kendall, spearman] {
            assert_eq!(correlation(&UP, &UP), Some(1.0));
            assert_eq!(correlation(&UP, &down), Some(-1.0));
            assert_eq!(correlation(&UP, &[7.0; 5]), None);
            assert_eq!(correlation(&[1.0], &[1.0]), None);
        }
    }

    /// One exchange of neighbours among n: τ = 1 − 4/(n(n−1)), ρ = 1 − 12/(n(n²−1)).
    #[test]
    fn one_exchange_of_neighbours() {
        let b = [1.0, 2.0, 4.0, 3.0, 5.0];
        assert!((kendall(&UP, &b).unwrap() - 0.8).abs() < 1e-12);
        assert!((spearman(&UP, &b).unwrap() - 0.9).abs() < 1e-12);
    }

    /// By hand: of 6 pairs 4 are concordant, none discordant, one tied in each: 4/√(5·5). Ranks 1, 2.5, 2.5, 4 and
    /// 1, 2, 3.5, 3.5: moments 4.5, 4.5 and 3.75.
    #[test]
    fn ties() {
        let (a, b) = ([1.0, 2.0, 2.0, 3.0], [1.0, 2.0, 3.0, 3.0]);
        assert!((kendall(&a, &b).unwrap() - 0.8).abs() < 1e-12);
        assert!((spearman(&a, &b).unwrap() - 3.75 / 4.5).abs() < 1e-12);
    }
}
