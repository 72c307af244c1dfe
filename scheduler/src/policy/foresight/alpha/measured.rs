//! W/Σw of what is resident, measured in parts: a region that holds thousands of residents is not one observation's work.

use super::Sampled;
use crate::benefit::coverage::Coverage;
use crate::benefit::cut::{Cut, CutSettings, Patch, Region, projected_area};
use crate::benefit::quality::evaluate;
use crate::lod_tree::LodTree;
use crate::view::View;
use crate::worst_case::union_cut;

/// Patches that one part evaluates, and nodes beneath them, of which residents may have to be looked for one by one.
const PATCHES_AT_ONCE: usize = 16;
const NODES_AT_ONCE: u32 = 4096;

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
    /// The cut of the one before. Its patches are those still to be evaluated, the first of them last.
    cut: Cut,
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
        Measured { worst, settings, seconds, alpha, next: 0, cut, weight, benefit, largest }
    }

    /// Does another part; true once all is done.
    pub(super) fn step(&mut self, tree: &LodTree, resident: &Coverage) -> bool {
        if !self.cut.patches.is_empty() {
            let part = self.part(tree, resident);
            let quality = evaluate(tree, &part, resident, |_| {});
            self.weight += quality.weight;
            self.benefit += quality.benefit;
            if !self.cut.patches.is_empty() {
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
        self.cut.patches.reverse();
        self.next += 1;
        (self.weight, self.benefit) = (0.0, 0.0);
        self.cut.patches.is_empty() && self.next >= self.worst.len()
    }

    /// Takes the next patches out of the cut. One beneath which there may be too many residents for one part is divided
    /// among its children by projected area, as [`evaluate`] would do it.
    fn part(&mut self, tree: &LodTree, resident: &Coverage) -> Cut {
        let Cut { ref mut patches, total_weight, scale, eye, reach } = self.cut;
        let (mut taken, mut nodes) = (Vec::new(), 0);
        while taken.len() < PATCHES_AT_ONCE && nodes < NODES_AT_ONCE {
            let Some(patch) = patches.pop() else { break };
            let Patch { node, weight, sharpness } = patch;
            if !resident.any_beneath(node) {
                taken.push(patch);
                continue;
            }
            let beneath = tree.subtree_end(node).0 - node.0;
            let direction = (tree.centre(node) - eye).normalize_or_zero();
            let whole = projected_area(tree, node, direction);
            if beneath <= NODES_AT_ONCE || whole <= 0.0 {
                taken.push(patch);
                nodes += beneath;
                continue;
            }
            let first = patches.len();
            patches.extend(tree.children(node).map(|child| {
                let share = projected_area(tree, child, direction) / whole;
                Patch { node: child, weight: weight * share, sharpness }
            }));
            patches[first..].reverse();
        }
        Cut { patches: taken, total_weight, scale, eye, reach }
    }

    /// Quality of what is resident in the region with the largest deficit, `None` if nothing is in any; and the memory.
    pub(super) fn finish(self) -> (Option<f64>, Cut) {
        (self.largest.map(|(_, mean)| mean), self.cut)
    }
}
