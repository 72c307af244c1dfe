//! How far the client could get: ϑε and ωε.

use super::neighbourhood::{Neighbourhood, NeighbourhoodKind};
use super::{COORDINATE_MAX, WorstCaseError, within};
use crate::benefit::cut::Region;
use crate::lod_tree::{LodTree, NodeId};
use crate::predict::motion::Speeds;
use crate::view::View;
use glam::DVec3;

/// How far the client could get, whatever its recent motion says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reach {
    /// Greatest speed that the client can have, m/s.
    pub linear_max: f64,
    /// Greatest turning rate, rad/s.
    pub angular_max: f64,
    /// Nobody looks from closer than this, metres.
    pub stand_off: f64,
    /// Speeds that the client declares instead of those that its recent motion shows: what is reachable then does not
    /// wait for the first sudden turn.
    pub declared: Option<Speeds>,
    /// The velocity limit that grows with emptiness (\[HIBR\] §3): the client moves at most this many times its distance
    /// from the nearest content a second, s⁻¹. `None` for a client without such a limit.
    pub clearance_rate: Option<f64>,
    /// Unit vector away from the ground: what walking and orbiting clients keep to.
    pub up: DVec3,
}

impl Default for Reach {
    fn default() -> Reach {
        Reach {
            linear_max: f64::MAX,
            angular_max: core::f64::consts::TAU,
            stand_off: 0.5,
            declared: None,
            clearance_rate: None,
            up: DVec3::Y,
        }
    }
}

impl Reach {
    /// Everything reachable from a view within `epsilon` seconds at `speeds`, or those declared, capped.
    pub fn region(&self, speeds: Speeds, epsilon: f64) -> Region {
        let (reach, angle) = self.reached(speeds, epsilon, None);
        Region::Reachable { angle, reach, stand_off: self.stand_off }
    }

    /// ϑε (m) and ωε (rad). `clearance` is the distance from the nearest content, metres: at a limit of rate × clearance
    /// and a clearance that grows at most as fast as the client moves, it gets clearance·(exp(rate·ε) − 1) far.
    fn reached(&self, speeds: Speeds, epsilon: f64, clearance: Option<f64>) -> (f64, f64) {
        let speeds = self.declared.unwrap_or(speeds);
        let mut reach = speeds.linear.min(self.linear_max) * epsilon;
        if let (Some(rate), Some(clearance)) = (self.clearance_rate, clearance) {
            let limit = clearance * libm::expm1(rate * epsilon);
            // 0·∞: the client touches content, and does not move.
            reach = reach.min(if limit.is_nan() { 0.0 } else { limit });
        }
        (reach, speeds.angular.min(self.angular_max) * epsilon)
    }

    /// N(v, ε) of a client that moves like `kind`. `track` is where a path-bound client may go, in order; the tree is
    /// searched only if there is a limit by clearance.
    pub fn neighbourhood(
        &self,
        kind: NeighbourhoodKind,
        view: &View,
        tree: &LodTree,
        speeds: Speeds,
        epsilon: f64,
        track: &[DVec3],
    ) -> Result<Neighbourhood, WorstCaseError> {
        self.check()?;
        view.check()?;
        within("epsilon", epsilon, 0.0, 1e9, "seconds from 0 to 1e9")?;
        let given = self.declared.unwrap_or(speeds);
        within("speed", given.linear, 0.0, f64::MAX, "m/s, not negative")?;
        within("turning rate", given.angular, 0.0, f64::MAX, "rad/s, not negative")?;
        let clearance = self.clearance_rate.map(|_| clearance(tree, view.position));
        let (reach, angle) = self.reached(speeds, epsilon, clearance);
        let (reach, angle) = (reach.min(COORDINATE_MAX), angle.min(core::f64::consts::PI));
        let made = match kind {
            NeighbourhoodKind::Free => Neighbourhood::free(*view, reach, angle),
            NeighbourhoodKind::Walk { step, pitch_max } => {
                Neighbourhood::walking(*view, reach, angle, self.up, step.min(reach), pitch_max)
            }
            NeighbourhoodKind::Orbit => Neighbourhood::orbiting(*view, tree.centre(tree.root()), self.up, reach, angle),
            NeighbourhoodKind::Path => Neighbourhood::path_bound(*view, track, reach, angle),
        };
        made.map(|n| n.with_stand_off(self.stand_off))
    }

    /// Refuses what no neighbourhood could be made of.
    pub fn check(&self) -> Result<(), WorstCaseError> {
        within("linear_max", self.linear_max, 0.0, f64::MAX, "m/s, not negative")?;
        within("angular_max", self.angular_max, 0.0, f64::MAX, "rad/s, not negative")?;
        within("stand_off", self.stand_off, 0.0, COORDINATE_MAX, "metres, not negative")?;
        if let Some(rate) = self.clearance_rate {
            within("clearance_rate", rate, 0.0, 1e9, "1/s from 0 to 1e9")?;
        }
        Ok(())
    }
}

/// Distance (m) from `position` to the nearest content box of a leaf; 0 within one. Nodes that lie farther than the
/// nearest found are not looked into.
pub fn clearance(tree: &LodTree, position: DVec3) -> f64 {
    let distance = |node: NodeId| ((tree.centre(node) - position).abs() - tree.half(node)).max(DVec3::ZERO).length();
    let mut nearest = f64::INFINITY;
    let mut stack = vec![(distance(tree.root()), tree.root())];
    let mut children = Vec::new();
    while let Some((bound, node)) = stack.pop() {
        if bound >= nearest {
            continue;
        }
        if tree.is_leaf(node) {
            nearest = bound;
            continue;
        }
        children.clear();
        children.extend(tree.children(node).map(|child| (distance(child), child)).filter(|(d, _)| *d < nearest));
        // Nearest last, so that it is looked into first.
        children.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
        stack.append(&mut children);
    }
    nearest
}
