//! Composite Gauss–Legendre rules of 1 to 8 nodes.

use super::AddedBenefit;
use super::pieces::Pieces;
use crate::estimate::Estimate;

/// Most nodes in a panel.
pub(super) const NODES_MAX: u32 = 8;

/// (node, weight) on [−1, 1] for 1 to 8 nodes: the zeros x of Pₙ and 2/((1−x²)·Pₙ′(x)²).
#[rustfmt::skip]
const RULES: [&[(f64, f64)]; NODES_MAX as usize] = [
    &[(0.0, 2.0)],
    &[(-0.5773502691896257, 1.0), (0.5773502691896257, 1.0)],
    &[(-0.7745966692414834, 0.5555555555555556), (0.0, 0.8888888888888888), (0.7745966692414834, 0.5555555555555556)],
    &[(-0.8611363115940526, 0.34785484513745385), (-0.33998104358485626, 0.6521451548625461),
      (0.33998104358485626, 0.6521451548625461), (0.8611363115940526, 0.34785484513745385)],
    &[(-0.906179845938664, 0.23692688505618908), (-0.5384693101056831, 0.47862867049936647), (0.0, 0.5688888888888889),
      (0.5384693101056831, 0.47862867049936647), (0.906179845938664, 0.23692688505618908)],
    &[(-0.932469514203152, 0.17132449237917036), (-0.6612093864662645, 0.3607615730481386),
      (-0.2386191860831969, 0.46791393457269104), (0.2386191860831969, 0.46791393457269104),
      (0.6612093864662645, 0.3607615730481386), (0.932469514203152, 0.17132449237917036)],
    &[(-0.9491079123427585, 0.1294849661688697), (-0.7415311855993945, 0.27970539148927664),
      (-0.4058451513773972, 0.3818300505051189), (0.0, 0.4179591836734694), (0.4058451513773972, 0.3818300505051189),
      (0.7415311855993945, 0.27970539148927664), (0.9491079123427585, 0.1294849661688697)],
    &[(-0.9602898564975363, 0.10122853629037626), (-0.7966664774136267, 0.22238103445337448),
      (-0.525532409916329, 0.31370664587788727), (-0.1834346424956498, 0.362683783378362),
      (0.1834346424956498, 0.362683783378362), (0.525532409916329, 0.31370664587788727),
      (0.7966664774136267, 0.22238103445337448), (0.9602898564975363, 0.10122853629037626)],
];

/// The rule of `nodes` nodes, 1 to 8; beyond that, the nearest.
pub(super) fn rule(nodes: u32) -> &'static [(f64, f64)] {
    RULES[(nodes.clamp(1, NODES_MAX) - 1) as usize]
}

/// Applies the rule on `panels` equal panels of the whole, or of each piece between events. The error estimate is the
/// distance to the rule that takes, of each panel, the node next to its middle alone; for one node it is the value.
pub(super) fn integrate(benefit: &AddedBenefit, nodes: u32, panels: u32, split: bool) -> Estimate {
    let pieces = Pieces::of(benefit, split);
    let rule = rule(nodes);
    let mut evaluations = pieces.evaluations;
    let (mut fine, mut coarse) = (0.0, 0.0);
    for (from, to) in pieces.iter() {
        let width = (to - from) / f64::from(panels);
        for panel in 0..panels {
            let middle = from + width * (f64::from(panel) + 0.5);
            for (i, &(x, weight)) in rule.iter().enumerate() {
                let value = benefit.value(middle + 0.5 * width * x);
                fine += 0.5 * width * weight * value;
                if nodes > 1 && i == rule.len() / 2 {
                    coarse += width * value;
                }
                evaluations += 1;
            }
        }
    }
    Estimate { value: fine, error_estimate: (fine - coarse).abs(), evaluations }
}
