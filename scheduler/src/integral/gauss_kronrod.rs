//! Adaptive Gauss–Kronrod (7, 15), after QUADPACK's QAG (Piessens et al. 1983).

use super::AddedBenefit;
use crate::estimate::Estimate;

/// (node, Kronrod weight, Gauss weight or 0) for x ≥ 0 on [−1, 1].
#[rustfmt::skip]
const RULE: [(f64, f64, f64); 8] = [
    (0.0, 0.20948214108472782, 0.4179591836734694),
    (0.20778495500789848, 0.20443294007529889, 0.0),
    (0.4058451513773972, 0.19035057806478542, 0.3818300505051189),
    (0.5860872354676911, 0.1690047266392679, 0.0),
    (0.7415311855993945, 0.14065325971552592, 0.27970539148927664),
    (0.8648644233597691, 0.10479001032225019, 0.0),
    (0.9491079123427585, 0.06309209262997856, 0.1294849661688697),
    (0.9914553711208126, 0.022935322010529224, 0.0),
];

struct Part {
    from: f64,
    to: f64,
    value: f64,
    error: f64,
}

/// Bisects the part whose two rules differ most until the sum of the differences is within `tolerance` of the value, or
/// another bisection would need more than `evaluations_max` evaluations.
pub(super) fn integrate(benefit: &AddedBenefit, tolerance: f64, evaluations_max: u32) -> Estimate {
    let mut evaluations = 0u32;
    let mut part = |from: f64, to: f64| {
        let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
        let (mut kronrod, mut gauss) = (0.0, 0.0);
        for &(x, k, g) in &RULE {
            let value = if x == 0.0 {
                evaluations += 1;
                benefit.value(middle)
            } else {
                evaluations += 2;
                benefit.value(middle - half * x) + benefit.value(middle + half * x)
            };
            kronrod += k * value;
            gauss += g * value;
        }
        (Part { from, to, value: half * kronrod, error: half * (kronrod - gauss).abs() }, evaluations)
    };
    let (first, mut used) = part(benefit.from_s(), benefit.to_s());
    let mut parts = vec![first];
    loop {
        let value: f64 = parts.iter().map(|p| p.value).sum();
        let error_estimate: f64 = parts.iter().map(|p| p.error).sum();
        let worst = (0..parts.len()).max_by(|&a, &b| parts[a].error.total_cmp(&parts[b].error)).unwrap_or(0);
        let Part { from, to, .. } = parts[worst];
        let middle = 0.5 * (from + to);
        let is_exhausted = used.saturating_add(30) > evaluations_max || middle <= from || middle >= to;
        if error_estimate <= tolerance * value.abs() || is_exhausted {
            return Estimate { value, error_estimate, evaluations: used };
        }
        let (left, _) = part(from, middle);
        let (right, now) = part(middle, to);
        used = now;
        parts[worst] = left;
        parts.push(right);
    }
}
