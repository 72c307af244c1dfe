//! What of a node's own representations to draw.

use super::ChooseSettings;
use foresight_scheduler::benefit::accuracy::sharpness;
use foresight_scheduler::benefit::element::{self, ELEMENTS, Errors};
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;
use std::collections::BTreeSet;

/// How a node is seen.
pub(super) struct Sight {
    /// From the eye to the nearest point of the content box, metres, at least [`NEAREST`].
    distance: f64,
    /// From the middle of the box to the eye, unit length, or 0.
    towards_eye: DVec3,
    /// Share of each element; they sum to 1.
    shares: [f64; ELEMENTS],
    sharpness: f64,
    pixels_per_radian: f64,
}

/// Distances are floored here, metres.
const NEAREST: f64 = 1e-3;

impl Sight {
    /// Of the box with its middle at `centre` from the eye.
    pub(super) fn new(tree: &LodTree, node: NodeId, centre: DVec3, half: DVec3, pixels_per_radian: f64) -> Sight {
        let distance = (centre.abs() - half).max(DVec3::ZERO).length().max(NEAREST);
        let mut shares = [0.0; ELEMENTS];
        if tree.has_directions() {
            shares = element::shares(tree, node, centre, half, 0.0);
        }
        if shares.iter().all(|&share| share == 0.0) {
            // Nothing faces the eye: whatever shows any side will do.
            shares = [1.0 / ELEMENTS as f64; ELEMENTS];
        }
        Sight {
            distance,
            towards_eye: (-centre).normalize_or_zero(),
            shares,
            sharpness: sharpness(pixels_per_radian, distance),
            pixels_per_radian,
        }
    }

    /// Pixels that `error` metres cover.
    fn pixels(&self, error: f64) -> f64 {
        error * self.pixels_per_radian / self.distance
    }

    /// Σ share·accuracy of what shows the elements with these errors.
    pub(super) fn quality(&self, errors: &Errors) -> f64 {
        element::mean_accuracy(&self.shares, errors, self.sharpness)
    }
}

/// What to draw of a node's own.
pub(super) struct Own {
    /// At least one.
    pub(super) reps: Vec<RepId>,
    /// What they show together.
    pub(super) errors: Errors,
    /// Fine enough, and from all the directions wanted.
    pub(super) suffices: bool,
}

/// What is asked of a node.
pub(super) struct Limits<'a> {
    pub(super) settings: &'a ChooseSettings,
    /// Side of a pixel of the node's orthoviews, metres; their errors if not known.
    pub(super) sample: Option<f64>,
    /// Most pixels of a sample, and of an error of triangles.
    pub(super) sample_px: f64,
    pub(super) error_px: f64,
    /// What the frame before has drawn, ascending.
    pub(super) before: &'a [RepId],
}

/// The coarsest of what suffices, else the finest.
#[derive(Clone, Copy)]
struct Best {
    rep: RepId,
    error: f64,
    suffices: bool,
}

impl Best {
    fn better(self, other: Best) -> Best {
        let other_wins = match (self.suffices, other.suffices) {
            (true, true) => other.error > self.error,
            (false, false) => other.error < self.error,
            (_, suffices) => suffices,
        };
        if other_wins { other } else { self }
    }
}

/// Chooses among the representations that `node` owns; `None` if none of them can be drawn. Beyond r an orthoview is
/// preferred where it suffices, elsewhere triangles where they do, else what shows the node best.
pub(super) fn own(
    tree: &LodTree,
    resident: &BTreeSet<RepId>,
    node: NodeId,
    sight: &Sight,
    limits: &Limits<'_>,
) -> Option<Own> {
    let settings = limits.settings;
    let near = settings.geometry_radius.is_some_and(|radius| sight.distance < radius);
    let mut mesh: Option<Best> = None;
    // By the direction's code: whether there is one at all, and the best of those that can be drawn.
    let mut views: [(bool, Option<Best>); 27] = [(false, None); 27];
    for rep in tree.own(node) {
        let error = tree.error(rep);
        let drawable = is_drawable(tree, resident, rep);
        match tree.direction(rep).and_then(|code| views.get_mut(usize::from(code))) {
            Some((exists, best)) => {
                *exists = true;
                let side = limits.sample.unwrap_or(error);
                let found = Best { rep, error, suffices: !near && sight.pixels(side) <= limits.sample_px };
                if drawable {
                    *best = Some(best.map_or(found, |best| best.better(found)));
                }
            }
            None if drawable => {
                let found = Best { rep, error, suffices: sight.pixels(error) <= limits.error_px };
                mesh = Some(mesh.map_or(found, |mesh| mesh.better(found)));
            }
            None => {}
        }
    }
    let triangles = mesh.map(|best| of(tree, vec![best.rep], best.suffices));
    let splats = orthoviews(tree, &views, sight, limits);
    match (triangles, splats) {
        (Some(triangles), Some(splats)) => {
            let by_quality = sight.quality(&splats.errors) > sight.quality(&triangles.errors);
            let takes_splats = match (near, triangles.suffices, splats.suffices) {
                (false, _, true) => true,
                (_, true, _) => false,
                (true, false, _) => false,
                (false, false, false) => by_quality,
            };
            Some(if takes_splats { splats } else { triangles })
        }
        (triangles, splats) => triangles.or(splats),
    }
}

/// The orthoviews nearest by angle to the eye.
fn orthoviews(tree: &LodTree, views: &[(bool, Option<Best>); 27], sight: &Sight, limits: &Limits<'_>) -> Option<Own> {
    let wanted = limits.settings.directions.max(1);
    let mut ranked: Vec<(f64, Option<Best>)> = Vec::new();
    for (code, (_, best)) in (0u8..).zip(views).filter(|(_, (exists, _))| *exists) {
        let cosine = element::towards_eye(code).dot(sight.towards_eye);
        let drawn = best.is_some_and(|best| limits.before.binary_search(&best.rep).is_ok());
        ranked.push((cosine + if drawn { limits.settings.turn_margin } else { 0.0 }, *best));
    }
    // Stable: of equals, the lower code.
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let complete = ranked.iter().take(wanted).all(|(_, best)| best.is_some_and(|best| best.suffices));
    let reps: Vec<RepId> = ranked.iter().filter_map(|(_, best)| best.map(|best| best.rep)).take(wanted).collect();
    (!reps.is_empty()).then(|| of(tree, reps, complete))
}

fn of(tree: &LodTree, reps: Vec<RepId>, suffices: bool) -> Own {
    let errors = reps.iter().fold(element::NOTHING, |least, &rep| element::least(&least, &element::errors(tree, rep)));
    Own { reps, errors, suffices }
}

/// Whether a representation and all that it needs are there. Prerequisites were inserted earlier, so their chain ends.
fn is_drawable(tree: &LodTree, resident: &BTreeSet<RepId>, rep: RepId) -> bool {
    std::iter::successors(Some(rep), |&rep| tree.prerequisite(rep)).all(|rep| resident.contains(&rep))
}
