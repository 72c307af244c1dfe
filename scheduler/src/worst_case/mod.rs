//! What is left if the prediction fails: the worst case W of the objective (ARCHITECTURE.md), reading `union` (\[ZK\] §5).
//!
//! Everything that some view reachable within ε could see counts with its whole solid angle from where the camera is,
//! shown from the nearest point that the camera could reach; the sum is scaled to at most the frustum, so that α keeps
//! its meaning as ωε grows.

use crate::benefit::cut::{Cut, CutSettings, Region};
use crate::lod_tree::LodTree;
use crate::predict::motion::Speeds;
use crate::view::View;

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
}

impl Default for Reach {
    fn default() -> Reach {
        Reach { linear_max: f64::MAX, angular_max: core::f64::consts::TAU, stand_off: 0.5, declared: None }
    }
}

impl Reach {
    /// Everything reachable from a view within `epsilon` seconds at `speeds`, or those declared, capped.
    pub fn region(&self, speeds: Speeds, epsilon: f64) -> Region {
        let speeds = self.declared.unwrap_or(speeds);
        Region::Reachable {
            angle: speeds.angular.min(self.angular_max) * epsilon,
            reach: speeds.linear.min(self.linear_max) * epsilon,
            stand_off: self.stand_off,
        }
    }
}

/// Makes the cut of the reachable region around `view`; its weights are scaled like any other cut's.
pub fn union_cut(cut: &mut Cut, tree: &LodTree, view: &View, region: Region, settings: &CutSettings) {
    cut.make(tree, view, region, &CutSettings { centre_falloff: 0.0, ..*settings });
}
