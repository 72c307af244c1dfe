//! How good what is on the GPU makes the view, and what each of it is worth.

use foresight_index::world::World;
use foresight_scheduler::benefit::accuracy::accuracy;
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use std::collections::{BTreeMap, BTreeSet};

/// Quality Q of a view with `resident`, and the share of it that each is worth: Σ w·a of what it shows, over Σ w.
pub(super) fn judge(world: &World, resident: &BTreeSet<RepId>, view: &View) -> (Option<f64>, BTreeMap<RepId, f64>) {
    let tree = &world.tree;
    let mut coverage = Coverage::new(tree, Refinement::Partial);
    for &rep in resident {
        coverage.insert(tree, rep);
    }
    let mut cut = Cut::default();
    cut.make(tree, view, Region::Frustum, &CutSettings { centre_falloff: 0.0, ..CutSettings::default() });
    let mut worth: BTreeMap<RepId, f64> = BTreeMap::new();
    let quality = evaluate(tree, &cut, &coverage, |part| {
        let Some(owner) = part.owner else { return };
        let by = tree.own(owner).find(|&rep| coverage.contains(rep) && part.is_by(tree, rep));
        if let Some(rep) = by {
            *worth.entry(rep).or_default() += part.weight * accuracy(f64::from(part.error), part.sharpness);
        }
    });
    if quality.weight > 0.0 {
        worth.values_mut().for_each(|worth| *worth /= quality.weight);
    }
    (quality.mean(), worth)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use std::sync::Arc;

    #[test]
    fn what_each_is_worth_adds_up_to_the_quality() {
        let world = foresight_index::specification::open("city:blocks=3", &(Arc::new(|_, _| {}) as _)).unwrap();
        let view = View {
            position: DVec3::new(-300.0, 0.0, 120.0),
            orientation: DQuat::from_rotation_z(-1.5) * DQuat::from_rotation_x(1.2),
            fov_y: 1.0,
            viewport: [640, 480],
        };
        let all: BTreeSet<RepId> = (0..world.tree.representations() as u32).map(RepId).collect();
        for resident in [BTreeSet::new(), all.iter().copied().step_by(3).collect(), all] {
            let (quality, worth) = judge(&world, &resident, &view);
            let sum: f64 = worth.values().sum();
            assert!((quality.unwrap() - sum).abs() < 1e-9, "{quality:?} {sum}");
            assert!(worth.keys().all(|rep| resident.contains(rep)));
        }
    }
}
