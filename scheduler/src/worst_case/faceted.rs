//! Targets of a world with directions: their surfaces by element, each with the error that it is shown with.

use super::bounds::{Interval, Item};
use super::view_box::Views;
use crate::benefit::coverage::Coverage;
use crate::benefit::element::{self, ELEMENTS, Errors};
use crate::lod_tree::{LodTree, NodeId};
use glam::DVec3;

/// A surface by element, m², with the errors that it is shown with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Faceted {
    surface: [f64; ELEMENTS],
    errors: Errors,
}

/// Adds the parts of a node that are shown with one error each.
pub(super) fn add(parts: &mut Vec<Faceted>, tree: &LodTree, coverage: &Coverage, node: NodeId) {
    let errors = coverage.elements_above(tree, node).errors;
    if !coverage.any_beneath(node) {
        parts.push(Faceted { surface: tree.surface(node), errors });
        return;
    }
    let mut stack = vec![(node, errors)];
    while let Some((inner, errors)) = stack.pop() {
        for child in tree.children(inner) {
            let errors = element::least(&errors, &coverage.elements_at(child).errors);
            if coverage.any_beneath(child) {
                stack.push((child, errors));
            } else {
                parts.push(Faceted { surface: tree.surface(child), errors });
            }
        }
    }
}

/// Mean of a deficit over what faces an eye of a box with its middle at `centre`; `None` where nothing does.
pub(super) fn mean(parts: &[Faceted], centre: DVec3, half: DVec3, deficit: impl Fn(f32) -> f64) -> Option<f64> {
    let facing = element::facing(centre, half, 0.0);
    let (mut sum, mut whole) = (0.0, 0.0);
    for part in parts {
        for (s, m) in facing.iter().enumerate() {
            let weight = part.surface[s] * m;
            if weight > 0.0 {
                whole += weight;
                sum += weight * deficit(part.errors[s]);
            }
        }
    }
    (whole > 0.0).then(|| sum / whole)
}

/// Bounds of the same over a set of views around the middle eye, and whether something faces every one of them; `None`
/// if nothing faces any.
pub(super) fn bounds(
    parts: &[Faceted],
    centre: DVec3,
    half: DVec3,
    views: &Views,
    deficit: impl Fn(f32) -> Interval,
) -> Option<(Interval, bool)> {
    // Heights over a plane change by at most as much as the eye moves.
    let spread = views.half.length().min(views.radius);
    let slack = spread * (1.0 + 1e-12) + 1e-12 * (centre.length() + half.length());
    let [most, least] = [slack, -slack].map(|by| element::facing(centre, half, by));
    let mut items = Vec::new();
    for part in parts {
        for s in (0..ELEMENTS).filter(|&s| part.surface[s] * most[s] > 0.0) {
            let weight = Interval { lo: part.surface[s] * least[s], hi: part.surface[s] * most[s] };
            items.push(Item { weight, share: deficit(part.errors[s]) });
        }
    }
    if items.is_empty() {
        return None;
    }
    let always = items.iter().any(|item| item.weight.lo > 0.0);
    Some((mean_bounds(&mut items), always))
}

/// Bounds of Σ w·s / Σ w over weights and shares in the items' intervals: the greatest mean gives the greatest weights to
/// the greatest shares.
fn mean_bounds(items: &mut [Item]) -> Interval {
    let extreme = |items: &[Item], share: fn(&Item) -> f64, better: fn(f64, f64) -> f64| {
        let mut weight: f64 = items.iter().map(|item| item.weight.lo).sum();
        let mut sum: f64 = items.iter().map(|item| item.weight.lo * share(item)).sum();
        let mut best = (weight > 0.0).then(|| sum / weight);
        for item in items {
            weight += item.weight.width();
            sum += item.weight.width() * share(item);
            if weight > 0.0 {
                best = Some(best.map_or(sum / weight, |best| better(best, sum / weight)));
            }
        }
        best
    };
    items.sort_by(|a, b| b.share.hi.total_cmp(&a.share.hi));
    let hi = extreme(items, |item| item.share.hi, f64::max).unwrap_or(1.0);
    items.sort_by(|a, b| a.share.lo.total_cmp(&b.share.lo));
    let lo = extreme(items, |item| item.share.lo, f64::min).unwrap_or(0.0);
    Interval { lo: lo * (1.0 - 1e-12), hi: hi * (1.0 + 1e-12) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Means of what is picked from the intervals lie within.
        #[test]
        fn means_lie_within(raw in prop::collection::vec(prop::array::uniform6(0.0..1.0f64), 1..8)) {
            let mut items: Vec<Item> = raw.iter().map(|r| Item {
                weight: Interval { lo: r[0].min(r[1]), hi: r[0].max(r[1]) },
                share: Interval { lo: r[2].min(r[3]), hi: r[2].max(r[3]) },
            }).collect();
            let pick = |i: Interval, t: f64| i.lo + t * i.width();
            let picked = items.iter().zip(&raw).map(|(i, r)| (pick(i.weight, r[4]), pick(i.share, r[5])));
            let (weight, sum) = picked.fold((0.0, 0.0), |(w, s), (a, b)| (w + a, s + a * b));
            let found = mean_bounds(&mut items);
            prop_assert!(weight <= 0.0 || found.lo <= sum / weight && sum / weight <= found.hi);
        }
    }
}
