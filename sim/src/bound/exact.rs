//! The best that any policy can reach on an instance small enough to go through all that it could do.
//!
//! The model: path and link are known. Transfers go over the link one after the other, each as fast as the link delivers,
//! and what the link delivers in between is lost. A representation counts from the moment when its last byte has come, if
//! with what is kept it fits into memory; what is not kept is discarded at that moment and has to be fetched again to
//! count again. There is no latency, no decoding, and what is on its way takes no memory: so nothing that the simulator
//! lets a policy do on such an instance is better. With at most one packet between two frames nothing is lost by deciding
//! at frames only.
//!
//! Backwards over the frames f: V_f(R) is the best sum of qualities from f on with R resident and the link idle,
//!
//! ```text
//! V_f(R) = max { Q_f(R) + V_{f+1}(R),   max over r ∉ R of Σ_{f≤h<g} Q_h(R) + max over kept K ⊆ R of V_g(K ∪ r) },
//! ```
//!
//! g being the frame by which r has come. The time is frames × sets × representations, and sets once more where memory is
//! short.

use super::tiny::Instance;
use foresight_scheduler::benefit::accuracy::accuracy;
use foresight_scheduler::benefit::element::errors;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::units::Time;
use foresight_traces::flight::{TICKS_PER_FRAME, tick_time};

/// Most representations that are gone through.
pub const REPRESENTATIONS_MAX: usize = 12;

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExactError {
    /// Too many sets.
    #[error("the instance has {0} representations; expected at most {REPRESENTATIONS_MAX}")]
    TooLarge(usize),
    /// Outside the model.
    #[error(
        "the instance has prerequisites or groups as targets; expected leaves and representations that need nothing first"
    )]
    Structure,
}

/// The greatest mean quality over the frames with something in view, and 0 if there are none.
pub fn exact(instance: &Instance) -> Result<f64, ExactError> {
    let Instance { tree, cuts, link, budget } = instance;
    let count = tree.representations();
    if count > REPRESENTATIONS_MAX {
        return Err(ExactError::TooLarge(count));
    }
    if tree.has_prerequisites() || cuts.iter().flat_map(|c| &c.patches).any(|p| !tree.is_leaf(p.node)) {
        return Err(ExactError::Structure);
    }
    let (frames, sets) = (cuts.len(), 1usize << count);
    let qualities: Vec<Vec<f64>> = (0..frames).map(|f| quality_of_sets(instance, f)).collect();
    // Sums of qualities over the frames before each, by set.
    let mut until = vec![vec![0.0; sets]];
    for quality in &qualities {
        let before = &until[until.len() - 1];
        until.push(before.iter().zip(quality).map(|(sum, q)| sum + q).collect());
    }
    let decoded: Vec<u64> = (0..sets).map(|set| bytes(tree, set, LodTree::decoded_bytes)).collect();
    let delivered: Vec<u64> =
        (0..frames as u64).map(|f| link.bytes_deliverable(Time::ZERO, tick_time(f * TICKS_PER_FRAME))).collect();
    let mut best = vec![vec![0.0; sets]; frames + 1];
    for frame in (0..frames).rev() {
        for set in (0..sets).filter(|&set| decoded[set] <= *budget) {
            let mut most = qualities[frame][set] + best[frame + 1][set];
            for rep in (0..count).filter(|rep| set >> rep & 1 == 0) {
                let needed = delivered[frame] + tree.wire_bytes(RepId(rep as u32));
                let comes = delivered.partition_point(|&by| by < needed);
                if comes >= frames || tree.decoded_bytes(RepId(rep as u32)) > *budget {
                    continue;
                }
                let meanwhile = until[comes][set] - until[frame][set];
                let kept = best_kept(&best[comes], &decoded, *budget, set, 1 << rep);
                most = most.max(meanwhile + kept);
            }
            best[frame][set] = most;
        }
    }
    let seen = cuts.iter().filter(|cut| cut.total_weight > 0.0).count();
    Ok(best[0][0] / seen.max(1) as f64)
}

/// The best value with `new` and what is kept of `set`; a value never falls with what is resident, so if all fits all is
/// kept.
fn best_kept(values: &[f64], decoded: &[u64], budget: u64, set: usize, new: usize) -> f64 {
    if decoded[set | new] <= budget {
        return values[set | new];
    }
    let mut best = f64::NEG_INFINITY;
    // Every subset, the empty one last.
    let mut kept = set;
    loop {
        if decoded[kept | new] <= budget {
            best = best.max(values[kept | new]);
        }
        if kept == 0 {
            return best;
        }
        kept = (kept - 1) & set;
    }
}

fn bytes(tree: &LodTree, set: usize, of: impl Fn(&LodTree, RepId) -> u64) -> u64 {
    (0..tree.representations()).filter(|rep| set >> rep & 1 != 0).map(|rep| of(tree, RepId(rep as u32))).sum()
}

/// Q of a frame for every set; 0 where nothing is in view.
fn quality_of_sets(instance: &Instance, frame: usize) -> Vec<f64> {
    let (tree, cut) = (&instance.tree, &instance.cuts[frame]);
    let sets = 1usize << tree.representations();
    let mut quality = vec![0.0; sets];
    for patch in &cut.patches {
        // What is told apart: the leaf, or each element of its surface.
        let shares = if tree.has_directions() { cut.shares(tree, patch.node).to_vec() } else { vec![1.0] };
        for (s, share) in shares.into_iter().enumerate().filter(|(_, share)| *share > 0.0) {
            let mut shows = vec![0.0; tree.representations()];
            for rep in tree.ancestors(patch.node).flat_map(|node| tree.own(node)) {
                let error = if tree.has_directions() { f64::from(errors(tree, rep)[s]) } else { tree.error(rep) };
                shows[rep.index()] = accuracy(error, patch.sharpness);
            }
            // The best of a set is that of the set without its first, or its first.
            let mut best = vec![0.0f64; sets];
            for set in 1..sets {
                let first = set.trailing_zeros() as usize;
                best[set] = best[set & (set - 1)].max(shows[first]);
                quality[set] += share * patch.weight / cut.total_weight * best[set];
            }
        }
    }
    quality
}
