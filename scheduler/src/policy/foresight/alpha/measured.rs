//! W/Σw of what is resident, measured in parts: a region that holds thousands of residents is not one observation's work.

use super::Sampled;
use crate::benefit::coverage::Coverage;
use crate::benefit::cut::{Cut, CutSettings, Region};
use crate::benefit::quality::evaluate;
use crate::lod_tree::LodTree;
use crate::view::View;
use crate::worst_case::union_cut;

/// Patches that one part evaluates.
const PATCHES_AT_ONCE: usize = 16;

/// A worst case whose quality is being measured.
pub(super) struct Measured {
    worst: Vec<(f64, View, Region)>,
    settings: CutSettings,
    /// Seconds for which it stands.
    pub(super) seconds: f64,
    /// The α that was used at its end.
    pub(super) alpha: f64,
    /// The first of `worst` whose cut is still to be made.
    next: usize,
    /// The cut of the one before, and the first of its patches that is still to be evaluated.
    cut: Cut,
    patch: usize,
    /// Σ w and Σ w·q of the patches before.
    weight: f64,
    benefit: f64,
    /// Deficit and quality of the region with the largest deficit so far.
    largest: Option<(f64, f64)>,
}

impl Measured {
    /// Of what `sampled` calls the worst case, by cuts of the opening angle `opening`. `memory` is reused.
    pub(super) fn new(sampled: &Sampled, opening: f64, alpha: f64, seconds: f64, memory: Cut) -> Measured {
        let settings = CutSettings { opening, ..*sampled.cut };
        let mut cut = memory;
        cut.patches.clear();
        let (weight, benefit, largest) = (0.0, 0.0, None);
        let worst = sampled.worst.to_vec();
        Measured { worst, settings, seconds, alpha, next: 0, cut, patch: 0, weight, benefit, largest }
    }

    /// Does another part; true once all is done.
    pub(super) fn step(&mut self, tree: &LodTree, resident: &Coverage) -> bool {
        if self.patch < self.cut.patches.len() {
            let end = (self.patch + PATCHES_AT_ONCE).min(self.cut.patches.len());
            let Cut { ref patches, total_weight, scale, eye, reach } = self.cut;
            let part = Cut { patches: patches[self.patch..end].to_vec(), total_weight, scale, eye, reach };
            let quality = evaluate(tree, &part, resident, |_| {});
            self.weight += quality.weight;
            self.benefit += quality.benefit;
            self.patch = end;
            if end < self.cut.patches.len() {
                return false;
            }
            let deficit = (self.weight - self.benefit) * self.cut.scale;
            if self.weight > 0.0 && self.largest.is_none_or(|(most, _)| deficit > most) {
                self.largest = Some((deficit, (self.benefit / self.weight).clamp(0.0, 1.0)));
            }
            return self.next >= self.worst.len();
        }
        let Some((_, view, region)) = self.worst.get(self.next) else { return true };
        union_cut(&mut self.cut, tree, view, *region, &self.settings);
        self.next += 1;
        (self.patch, self.weight, self.benefit) = (0, 0.0, 0.0);
        self.cut.patches.is_empty() && self.next >= self.worst.len()
    }

    /// Quality of what is resident in the region with the largest deficit, `None` if nothing is in any; and the memory.
    pub(super) fn finish(self) -> (Option<f64>, Cut) {
        (self.largest.map(|(_, mean)| mean), self.cut)
    }
}
