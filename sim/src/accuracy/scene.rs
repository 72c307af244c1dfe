//! Scenes: candidates that one decision would compare, for the integral.

use super::outcome::Kind;
use super::situation::Situation;
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::element::{ELEMENTS, errors};
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::integral::{AddedBenefit, Leg, Target};
use foresight_scheduler::lod_tree::{LodTree, NodeId};
use foresight_scheduler::policy::foresight::ForesightSettings;
use foresight_traces::random::SplitMix64;

/// Candidates that are compared with each other.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Names its rows.
    pub case: String,
    /// Where it comes from.
    pub kind: Kind,
    /// Each the legs of one path, from the arrival on; the gain is their sum.
    pub candidates: Vec<Vec<AddedBenefit>>,
}

/// Draws candidates of a situation: a path by its belief, what is seen along it (a third leaves and far groups alike, a
/// third what grazes the frustum, a third what only a coarser representation covers), and the errors of a representation
/// at or above it and of what is shown there now; in a world with directions of one element of its surface.
pub fn real(
    case: &str,
    tree: &LodTree,
    situation: &Situation,
    settings: &ForesightSettings,
    count: usize,
    random: &mut SplitMix64,
) -> Scene {
    let paths: Vec<Seen> = situation
        .ends
        .iter()
        .map(|path| Seen::new(tree, situation, &path.views, settings.cut, settings.attenuation))
        .collect();
    let mut candidates = Vec::with_capacity(count);
    for _ in 0..8 * count {
        if candidates.len() == count {
            break;
        }
        let mut left = random.uniform();
        let path = situation.ends.iter().zip(&paths).find(|(path, _)| {
            left -= path.weight;
            left <= 0.0
        });
        let Some(seen) = path.map(|(_, seen)| seen).or(paths.last()) else { break };
        candidates.extend(seen.draw(tree, situation, random));
    }
    Scene { case: case.to_owned(), kind: Kind::Real, candidates }
}

/// A path's legs, and what is seen along it.
struct Seen {
    legs: Vec<Leg>,
    cut: CutSettings,
    attenuation: f64,
    /// Nodes of the cuts at the ends of the legs, and whether they weigh as far.
    patches: Vec<(NodeId, bool)>,
    /// Those of them that some plane of some view cuts.
    grazing: Vec<(NodeId, bool)>,
}

impl Seen {
    fn new(
        tree: &LodTree,
        situation: &Situation,
        views: &[foresight_scheduler::view::View],
        cut: CutSettings,
        attenuation: f64,
    ) -> Seen {
        let mut legs = Vec::new();
        let (mut from, mut from_s) = (situation.view, 0.0);
        for (view, &to_s) in views.iter().zip(&situation.bounds[1..]) {
            // A predicted view is legal; what is not would be left out.
            legs.extend(Leg::between(&from, view, from_s, to_s));
            (from, from_s) = (*view, to_s);
        }
        let mut patches = Vec::new();
        let mut grazing = Vec::new();
        let mut made = Cut::default();
        for view in std::iter::once(&situation.view).chain(views) {
            made.make(tree, view, Region::Frustum, &cut);
            let frustum = Frustum::new(view);
            for patch in &made.patches {
                let (centre, half) = (tree.centre(patch.node) - frustum.eye, tree.half(patch.node));
                let is_far = half.length_squared() < cut.opening * cut.opening * centre.length_squared();
                let seen = (patch.node, is_far);
                if matches!(frustum.side(centre, half), Side::Straddles(_)) {
                    grazing.push(seen);
                }
                patches.push(seen);
            }
        }
        for list in [&mut patches, &mut grazing] {
            list.sort_unstable();
            list.dedup();
        }
        Seen { legs, cut, attenuation, patches, grazing }
    }

    fn draw(&self, tree: &LodTree, situation: &Situation, random: &mut SplitMix64) -> Option<Vec<AddedBenefit>> {
        let stratum = (random.uniform() * 3.0) as u32;
        let list = if stratum == 1 && !self.grazing.is_empty() { &self.grazing } else { &self.patches };
        let &(node, is_far) = list.get((random.uniform() * list.len() as f64) as usize)?;
        let owners: Vec<NodeId> = tree.ancestors(node).filter(|&n| tree.own(n).len() > 0).collect();
        let chosen = if stratum == 2 { random.uniform() } else { random.uniform() * random.uniform() };
        let owner = *owners.get((chosen * owners.len() as f64) as usize)?;
        let own = tree.own(owner);
        let rep = own.clone().nth((random.uniform() * own.len() as f64) as usize)?;
        let mut target = Target::of(tree, node, is_far);
        let (after, shown) = if tree.has_directions() {
            // One of the elements of which there is some.
            let surface = tree.surface(node);
            let elements: Vec<usize> = (0..ELEMENTS).filter(|&s| surface[s] > 0.0).collect();
            let s = *elements.get((random.uniform() * elements.len() as f64) as usize)?;
            target = target.element(tree, node, s);
            (errors(tree, rep)[s], situation.planned.elements_above(tree, node).errors[s])
        } else {
            (tree.error(rep) as f32, situation.planned.best_above(tree, node))
        };
        let (after, shown) = (f64::from(after), f64::from(shown));
        if after == f64::INFINITY {
            return None;
        }
        let before = if shown > after { shown } else { f64::INFINITY };
        let legs = self.legs.iter().filter(|leg| leg.to_s() > situation.arrival_s).map(|leg| AddedBenefit {
            leg: *leg,
            target,
            after,
            before,
            arrival_s: situation.arrival_s,
            cut: self.cut,
            attenuation: self.attenuation,
        });
        Some(legs.collect())
    }
}
