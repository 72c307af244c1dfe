//! The composite trapezoid rule.

use super::AddedBenefit;
use super::pieces::Pieces;
use crate::estimate::Estimate;

/// Applies the rule on `intervals` equal intervals of the whole, or of each piece between events. The error estimate is
/// a third of the distance to the rule with half as many intervals (Richardson), where that is whole; otherwise the value.
pub(super) fn integrate(benefit: &AddedBenefit, intervals: u32, split: bool) -> Estimate {
    let pieces = Pieces::of(benefit, split);
    let (mut fine, mut coarse) = (0.0, 0.0);
    let mut evaluations = pieces.evaluations;
    for (from, to) in pieces.iter() {
        let width = (to - from) / f64::from(intervals);
        for i in 0..=intervals {
            // Just inside the piece: at an event the integrand may jump.
            let at = if i == 0 {
                from.next_up()
            } else if i == intervals {
                to.next_down()
            } else {
                from + width * f64::from(i)
            };
            let value = benefit.value(at.clamp(from, to));
            let half = if i == 0 || i == intervals { 0.5 } else { 1.0 };
            fine += half * width * value;
            if i % 2 == 0 {
                coarse += 2.0 * half * width * value;
            }
            evaluations += 1;
        }
    }
    let error_estimate = if intervals.is_multiple_of(2) { (fine - coarse).abs() / 3.0 } else { fine.abs() };
    Estimate { value: fine, error_estimate, evaluations }
}
