//! The worst case as the policy samples it.

use super::{AlphaRule, ForesightSettings};
use crate::benefit::coverage::Coverage;
use crate::benefit::cut::Region;
use crate::lod_tree::LodTree;
use crate::predict::motion::Speeds;
use crate::units::Time;
use crate::view::View;
use crate::worst_case::WorstCaseKind;
use crate::worst_case::minimum::worst_views;
use crate::worst_case::neighbourhood::NeighbourhoodKind;
use crate::worst_case::target::Targets;
use glam::DVec3;

/// Worst views that become terms of the objective under `minimum`.
const WORST_KEPT: usize = 3;
/// Weights fall by e while the deficit falls by this share of the largest.
const SOFTNESS: f64 = 0.1;
/// Corners of the announced path kept at most.
const TRACK_MAX: usize = 1 << 16;

/// The reachable region, and under `minimum` the worst views of a covering set with their weights. A client whose way of
/// moving contradicts where it is (a path-bound one off its path, or before it has announced one) is taken to fly.
pub(super) fn sampled(
    settings: &ForesightSettings,
    tree: &LodTree,
    plan: &Coverage,
    view: &View,
    speeds: Speeds,
    epsilon: f64,
    track: &[DVec3],
) -> (Region, Option<Vec<(f64, View)>>) {
    let reach = &settings.reach;
    let free = reach.region(speeds, epsilon);
    let is_plain = settings.neighbourhood == NeighbourhoodKind::Free && reach.clearance_rate.is_none();
    let is_without = settings.alpha >= 1.0 && settings.alpha_rule == AlphaRule::Fixed;
    if is_without || is_plain && settings.worst_case == WorstCaseKind::Union {
        return (free, None);
    }
    let made = reach
        .neighbourhood(settings.neighbourhood, view, tree, speeds, epsilon, track)
        .or_else(|_| reach.neighbourhood(NeighbourhoodKind::Free, view, tree, speeds, epsilon, track));
    let Ok(neighbourhood) = made else { return (free, None) };
    let region = neighbourhood.region();
    if settings.worst_case == WorstCaseKind::Union {
        return (region, None);
    }
    let Ok(targets) = Targets::new(tree, &neighbourhood, plan, &settings.cut) else { return (region, None) };
    (region, Some(worst_views(&targets, &neighbourhood, settings.worst_samples, WORST_KEPT, SOFTNESS)))
}

/// Appends what is newly announced; a path that does not begin near the end of the last replaces it.
pub(super) fn extend_track(track: &mut Vec<DVec3>, path: &[(Time, View)]) {
    let Some((_, first)) = path.first() else { return };
    let joins = track.iter().rposition(|corner| corner.distance(first.position) <= 1.0);
    match joins {
        Some(place) => track.truncate(place + 1),
        None => track.clear(),
    }
    track.extend(path.iter().map(|(_, view)| view.position));
    if track.len() > TRACK_MAX {
        track.drain(..track.len() - TRACK_MAX);
    }
}
