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
    /// among its children by projected area, as [`evaluate`] would do it; where that divides by element, in a world with
    /// directions, by area is a little less exact.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::benefit::coverage::Refinement;
    use crate::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, RepId, Representation};
    use crate::units::Time;
    use glam::{DQuat, DVec3};

    /// A square of the given corner and side, divided `depth` times; what is finer is less in error.
    fn square(b: &mut LodTreeBuilder, corner: DVec3, side: f64, depth: u32) -> Result<(), LodTreeError> {
        b.open()?;
        let error = if depth == 0 { 0.01 } else { side as f32 / 16.0 };
        b.add(Representation { wire_bytes: 100, decoded_bytes: 100, error, prerequisite: None, direction: None })?;
        if depth == 0 {
            return b.close(Some(Aabb { min: corner, max: corner + DVec3::new(side, side, 1.0) }), 1.0);
        }
        let half = 0.5 * side;
        for (x, y) in [(0.0, 0.0), (half, 0.0), (0.0, half), (half, half)] {
            square(b, corner + DVec3::new(x, y, 0.0), half, depth - 1)?;
        }
        b.close(None, 1.0)
    }

    #[test]
    fn a_far_group_of_many_residents_is_measured_in_parts_that_add_up() -> Result<(), LodTreeError> {
        let mut b = LodTreeBuilder::default();
        square(&mut b, DVec3::ZERO, 64.0, 7)?;
        let tree = b.finish()?;
        assert!(tree.nodes() > 4 * NODES_AT_ONCE as usize);
        let mut resident = Coverage::new(&tree, Refinement::Partial);
        for rep in (0..tree.representations() as u32).filter(|r| r % 7 == 0 || r % 11 == 3) {
            resident.insert(&tree, RepId(rep));
        }
        let position = DVec3::new(32.0, 32.0, 2000.0);
        let view = View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1920, 1080] };
        let region = Region::Reachable { angle: 0.2, reach: 1.0, stand_off: 1.0 };
        let cut = CutSettings::default();
        let mut whole = Cut::default();
        union_cut(&mut whole, &tree, &view, region, &cut);
        assert_eq!(whole.patches.len(), 1, "one group");
        let expected = evaluate(&tree, &whole, &resident, |_| {}).mean().expect("it is seen");

        let worst = [(1.0, view, region)];
        let sampled = Sampled { now: Time::ZERO, paths: &[], offsets: &[], worst: &worst, cut: &cut, attenuation: 0.0 };
        let mut measured = Measured::new(&sampled, cut.opening, 0.5, 1.0, Cut::default());
        let parts = 1 + (0..).take_while(|_| !measured.step(&tree, &resident)).count();
        assert!(parts > 4, "{parts}");
        let (quality, _) = measured.finish();
        let quality = quality.expect("it is seen");
        assert!((quality - expected).abs() < 1e-12, "{quality} {expected}");
        Ok(())
    }
}
