//! What every representation by itself would gain under a sampled objective.

use foresight_scheduler::benefit::accuracy::accuracy;
use foresight_scheduler::benefit::coverage::Coverage;
use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::select::horizon::Horizon;

/// ΔJ of each representation beside `planned`, by its id, counted from `offset` seconds on; what lies beneath a patch is
/// taken to be shown as the patch is.
pub(super) fn of_each(tree: &LodTree, horizon: &Horizon, planned: &Coverage, offset: f64) -> Vec<f64> {
    let mut gains = vec![0.0; tree.representations()];
    horizon.for_each(tree, planned, offset, |patch, share, chain, _| {
        let shown = accuracy(f64::from(chain.best), patch.sharpness);
        for rep in tree.ancestors(patch.node).flat_map(|node| tree.own(node)) {
            let error = tree.error(rep);
            if error < f64::from(chain.best) && !planned.contains(rep) {
                gains[rep.index()] += share * patch.weight * (accuracy(error, patch.sharpness) - shown);
            }
        }
    });
    gains
}
