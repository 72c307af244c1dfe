//! What each step sees of what is shown as one: the targets of the problem over time, with the smallest taken out.

use super::seen::{Items, Patched, areas};
use foresight_scheduler::benefit::accuracy::accuracy;
use foresight_scheduler::lod_tree::LodTree;

/// Largest number of choices, (target, step, representation): the smallest targets are taken out until it is kept.
const CHOICES_MAX: usize = 1_500_000;

/// A closed item in a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Place of the item.
    pub(super) item: usize,
    /// Of its surface, in a world with directions; otherwise 0.
    pub(super) element: u8,
    /// Σ weight, and Σ weight × sharpness.
    pub(super) weight: [f64; 2],
    /// Least and greatest.
    pub(super) sharpness: [f64; 2],
}

impl Seen {
    /// An upper bound of the mean accuracy at an error, weighted as the frames are.
    pub(super) fn accuracy(&self, error: f64) -> f32 {
        let [least, greatest] = self.sharpness;
        let at = if greatest > least {
            ((self.weight[1] / self.weight[0] - least) / (greatest - least)).clamp(0.0, 1.0)
        } else {
            0.0
        };
        // The mean is off by a few units in the last place, the slope is at most 1 on this scale.
        let chord = accuracy(error, least) * (1.0 - at) + accuracy(error, greatest) * at + 1e-12;
        let narrow = chord.min(1.0) as f32;
        if f64::from(narrow) < chord { narrow.next_up() } else { narrow }
    }
}

/// What a step sees of the closed items.
pub(super) fn seen(tree: &LodTree, items: &Items, patches: &[Patched]) -> Vec<Seen> {
    let mut all: Vec<Seen> = Vec::new();
    for patch in patches {
        let closed = items.closed_beneath(tree, patch.node);
        for &(node, item) in &items.closed[closed] {
            let weight = if node == patch.node {
                patch.weight
            } else {
                let areas = areas(tree, node, patch.element);
                patch.density.map(|density| density.dot(areas))
            };
            if weight[0] > 0.0 {
                all.push(Seen { item, element: patch.element, weight, sharpness: patch.sharpness });
            }
        }
    }
    all.sort_by_key(|seen| (seen.item, seen.element));
    all.dedup_by(|next, first| {
        let same = (next.item, next.element) == (first.item, first.element);
        if same {
            first.weight = [first.weight[0] + next.weight[0], first.weight[1] + next.weight[1]];
            let [least, greatest] = first.sharpness;
            first.sharpness = [least.min(next.sharpness[0]), greatest.max(next.sharpness[1])];
        }
        same
    });
    all
}

/// Takes out the smallest targets until the choices of the others are few enough, and returns their weight by step.
pub(super) fn free(seen: &mut [Vec<Seen>], lengths: &[usize]) -> Vec<f64> {
    let mut order: Vec<(f64, usize)> = seen.iter().flatten().map(|s| (s.weight[0], lengths[s.item])).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut until = 0;
    let kept = order.iter().take_while(|(_, length)| {
        until += length;
        until <= CHOICES_MAX
    });
    let kept = kept.count();
    let least = order.get(kept).map_or(0.0, |next| next.0);
    let of_step = |seen: &mut Vec<Seen>| {
        let (mut free, before) = (0.0, seen.len());
        seen.retain(|s| {
            let keep = s.weight[0] > least;
            free += if keep { 0.0 } else { s.weight[0] };
            keep
        });
        seen.shrink_to_fit();
        if before == seen.len() { 0.0 } else { free }
    };
    seen.iter_mut().map(of_step).collect()
}

/// At least as many choices as the problem has.
pub(super) fn choices(tree: &LodTree, items: &Items, patches: &[Vec<Patched>]) -> usize {
    let mut chains = Vec::with_capacity(items.all.len());
    for (place, item) in items.all.iter().enumerate() {
        let above: usize = if item.parent == place { 0 } else { chains[item.parent] };
        chains.push(above + tree.own(item.node).len() + usize::from(item.beneath[0].is_finite()));
    }
    let mut until = vec![0];
    for &(_, item) in &items.closed {
        until.push(until[until.len() - 1] + chains[item]);
    }
    let of_patch = |patch: &Patched| {
        let closed = items.closed_beneath(tree, patch.node);
        until[closed.end] - until[closed.start]
    };
    patches.iter().flatten().map(of_patch).sum()
}
