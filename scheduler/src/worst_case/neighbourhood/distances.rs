//! How near a reachable eye gets to a box, and at which angles it sees it.

use super::super::view_box::Views;
use super::{Neighbourhood, Shape};
use crate::benefit::cut::Region;
use crate::lod_tree::Aabb;
use core::f64::consts::PI;
use glam::DVec3;

impl Neighbourhood {
    /// Least distance from a reachable eye to the box, metres, without the stand-off; never too large.
    pub fn nearest(&self, bounds: &Aabb) -> f64 {
        let (centre, half) = (bounds.centre() - self.view.position, 0.5 * (bounds.max - bounds.min));
        let gap = (centre.abs() - half).max(DVec3::ZERO);
        match &self.shape {
            Shape::Free => (gap.length() - self.reach).max(0.0),
            Shape::Walking { up, step, .. } => match along_axis(*up) {
                Some(axis) => flat_and_high(gap, axis, self.reach, *step),
                None => (gap.length() - libm::hypot(self.reach, *step)).max(0.0),
            },
            _ => self
                .pieces()
                .map(|v| {
                    let gap = ((bounds.centre() - v.eye).abs() - half).max(DVec3::ZERO);
                    let boxed = (gap - v.half).max(DVec3::ZERO).length();
                    boxed.max(gap.length() - v.radius)
                })
                .fold(f64::INFINITY, f64::min),
        }
    }

    /// Greatest that [`Neighbourhood::nearest`] can be for a box that lies within `bounds`, metres.
    pub fn nearest_at_most(&self, bounds: &Aabb) -> f64 {
        let (centre, half) = (bounds.centre() - self.view.position, 0.5 * (bounds.max - bounds.min));
        let far = centre.abs() + half;
        match &self.shape {
            Shape::Free => (far.length() - self.reach).max(0.0),
            Shape::Walking { up, step, .. } => match along_axis(*up) {
                Some(axis) => flat_and_high(far, axis, self.reach, *step),
                None => far.length(),
            },
            _ => self
                .pieces()
                .map(|v| ((bounds.centre() - v.eye).abs() + half).length() + v.radius)
                .fold(f64::INFINITY, f64::min),
        }
    }

    /// Interval of the angle, radians, between the direction from the box's middle to a reachable eye and the unit
    /// vector `direction`.
    pub fn angles(&self, bounds: &Aabb, direction: DVec3) -> (f64, f64) {
        let centre = bounds.centre() - self.view.position;
        let Region::Reachable { reach, .. } = self.region() else { return (0.0, PI) };
        let distance = centre.length();
        if distance <= reach {
            return (0.0, PI);
        }
        let angle = libm::acos((-centre / distance).dot(direction).clamp(-1.0, 1.0));
        let spread = libm::asin((reach / distance).min(1.0));
        ((angle - spread).max(0.0), (angle + spread).min(PI))
    }

    fn pieces(&self) -> impl Iterator<Item = Views> + '_ {
        // Halving by position only: an angle counts as nothing.
        let mut parts = vec![self.whole()];
        for _ in 0..4 {
            let axis = (0..3).max_by(|&a, &b| parts[0].half[a].total_cmp(&parts[0].half[b])).unwrap_or(0);
            parts = parts.iter().flat_map(|part| part.split(axis)).collect();
        }
        parts.into_iter().map(|part| self.views(&part))
    }
}

/// The coordinate axis that `up` is, if it is one.
fn along_axis(up: DVec3) -> Option<usize> {
    (0..3).find(|&axis| up[axis].abs() == 1.0)
}

/// Distance from a cylinder of radius `reach` and half height `step` along `axis` to what is `off` from its middle.
fn flat_and_high(off: DVec3, axis: usize, reach: f64, step: f64) -> f64 {
    let flat = libm::hypot(off[(axis + 1) % 3], off[(axis + 2) % 3]);
    libm::hypot((flat - reach).max(0.0), (off[axis] - step).max(0.0))
}
