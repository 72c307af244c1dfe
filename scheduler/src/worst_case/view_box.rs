//! Boxes of the coordinates in which a neighbourhood is laid out, and the views that they hold.

use glam::{DQuat, DVec3};

/// Coordinates of a neighbourhood: at most three of position and two of orientation.
pub const DIMENSIONS: usize = 5;

/// A box of coordinates of one neighbourhood; what they mean depends on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewBox {
    /// Middle.
    pub mid: [f64; DIMENSIONS],
    /// Half sides; 0 along what does not vary.
    pub half: [f64; DIMENSIONS],
}

impl ViewBox {
    /// The two halves across dimension `axis`.
    pub fn split(&self, axis: usize) -> [ViewBox; 2] {
        let (mut low, mut high) = (*self, *self);
        let quarter = 0.5 * self.half[axis];
        for part in [&mut low, &mut high] {
            part.half[axis] = quarter;
        }
        low.mid[axis] -= quarter;
        high.mid[axis] += quarter;
        [low, high]
    }

    /// Whether halving any side would still change the coordinates that doubles can hold.
    pub fn is_divisible(&self, axis: usize) -> bool {
        let (mid, quarter) = (self.mid[axis], 0.5 * self.half[axis]);
        quarter > 0.0 && mid - quarter < mid && mid < mid + quarter
    }
}

/// Everything that the views of a box have in common: each has its eye within `half` of `eye` along the axes and
/// within `radius` of it, and its orientation is `orientation` turned by at most `turn`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Views {
    /// Middle of the eyes, metres.
    pub eye: DVec3,
    /// Half sides of a box around the eyes, metres.
    pub half: DVec3,
    /// Greatest distance of an eye from the middle, metres.
    pub radius: f64,
    /// World from camera.
    pub orientation: DQuat,
    /// Radians, at most π.
    pub turn: f64,
    /// Turning from `orientation` to any of them in unit time, the angular velocity about each of the camera's axes is
    /// always at most this, radians.
    pub turns: DVec3,
}
