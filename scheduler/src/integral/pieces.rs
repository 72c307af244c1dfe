//! What a rule is applied to: the whole span, or its pieces between events.

use super::{AddedBenefit, events};

/// Consecutive pieces of the span of an integral.
pub(super) struct Pieces {
    ends: Vec<f64>,
    /// Evaluations that finding the events took.
    pub(super) evaluations: u32,
}

impl Pieces {
    /// The span as one piece, or split.
    pub(super) fn of(benefit: &AddedBenefit, split: bool) -> Pieces {
        let (from, to) = (benefit.from_s(), benefit.to_s());
        let mut ends = vec![from];
        let mut evaluations = 0;
        if split {
            let found = events(&benefit.leg, &benefit.target, &benefit.cut, from, to);
            ends.extend(found.times);
            evaluations = found.evaluations;
        }
        ends.push(to);
        Pieces { ends, evaluations }
    }

    /// (from, to) of each piece that has a length, seconds.
    pub(super) fn iter(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.ends.windows(2).map(|w| (w[0], w[1])).filter(|(from, to)| to > from)
    }
}
