//! The Gauss–Legendre rule of ten nodes in double-double.

use super::double::{double, ratio};
use std::sync::LazyLock;
use twofloat::TwoFloat;

const NODES: usize = 10;

/// (P, P′) of degree [`NODES`] by Bonnet's recursion.
fn legendre(x: TwoFloat) -> (TwoFloat, TwoFloat) {
    let (mut before, mut now) = (double(1.0), x);
    for k in 2..=NODES {
        let k = k as f64;
        let next = (x * now * (2.0 * k - 1.0) - before * (k - 1.0)) / k;
        (before, now) = (now, next);
    }
    (now, ratio((x * now - before) * NODES as f64, x * x - 1.0))
}

/// (node, weight) on [−1, 1], ascending.
pub(super) fn rule() -> &'static [(TwoFloat, TwoFloat)] {
    static RULE: LazyLock<Vec<(TwoFloat, TwoFloat)>> = LazyLock::new(|| {
        (0..NODES)
            .rev()
            .map(|i| {
                // Tricomi's guess, then Newton.
                let mut x = double(libm::cos(core::f64::consts::PI * (i as f64 + 0.75) / (NODES as f64 + 0.5)));
                for _ in 0..6 {
                    let (p, slope) = legendre(x);
                    x -= ratio(p, slope);
                }
                let (_, slope) = legendre(x);
                (x, ratio(double(2.0), (double(1.0) - x * x) * slope * slope))
            })
            .collect()
    });
    &RULE
}

/// What the interpolant through values at the nodes takes at −1 and at 1.
pub(super) fn at_ends(values: &[f64]) -> [f64; 2] {
    static ENDS: LazyLock<Vec<[f64; 2]>> = LazyLock::new(|| {
        let nodes: Vec<f64> = rule().iter().map(|(node, _)| node.hi()).collect();
        let lagrange = |i: usize, at: f64| {
            (0..NODES).filter(|&j| j != i).map(|j| (at - nodes[j]) / (nodes[i] - nodes[j])).product::<f64>()
        };
        (0..NODES).map(|i| [lagrange(i, -1.0), lagrange(i, 1.0)]).collect()
    });
    ENDS.iter().zip(values).fold([0.0; 2], |sum, (l, value)| [sum[0] + l[0] * value, sum[1] + l[1] * value])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_of_degree_nineteen_are_exact() {
        for degree in 0..20u32 {
            let sum = rule().iter().fold(double(0.0), |sum, &(x, w)| sum + (0..degree).fold(w, |power, _| power * x));
            let exact = if degree % 2 == 0 { double(2.0) / f64::from(degree + 1) } else { double(0.0) };
            assert!((sum - exact).hi().abs() < 1e-30, "{degree}: {:e}", (sum - exact).hi());
        }
    }
}
