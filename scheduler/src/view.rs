//! A view: where the camera is, where it looks, how wide, and on how many pixels.

use glam::{DQuat, DVec3};

/// One view of the world: v = (p, q, fov, viewport).
///
/// `orientation` turns camera space into world space; the camera looks along −z, +y is up, +x is right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Eye in world space, metres.
    pub position: DVec3,
    /// Unit quaternion, world from camera.
    pub orientation: DQuat,
    /// Vertical field of view, radians, in (0, π).
    pub fov_y: f64,
    /// Width and height in pixels.
    pub viewport: [u32; 2],
}

/// Farthest coordinate accepted, metres: beyond the observable universe, and squares of squares of distances are finite.
pub const POSITION_MAX: f64 = 1e30;

/// What a view may not be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ViewError {
    /// A coordinate is NaN, or beyond [`POSITION_MAX`].
    #[error("the view's position is {0}; expected coordinates within ±1e30 m")]
    Position(DVec3),
    /// The quaternion is not of length 1 within 10⁻⁶.
    #[error("the view's orientation {0} has length {1}; expected 1 within 1e-6")]
    Orientation(DQuat, f64),
    /// The vertical field of view is outside (0, π).
    #[error("the vertical field of view is {0} rad; expected more than 0 and less than π")]
    FieldOfView(f64),
    /// A side of the viewport has no pixels.
    #[error("the viewport is {0}×{1} px; expected at least 1×1")]
    Viewport(u32, u32),
}

impl View {
    /// Refuses what no estimator could give a finite answer for.
    pub fn check(&self) -> Result<(), ViewError> {
        if !(self.position.abs().max_element() <= POSITION_MAX && self.position.is_finite()) {
            return Err(ViewError::Position(self.position));
        }
        let length = self.orientation.length();
        if length.is_nan() || (length - 1.0).abs() > 1e-6 {
            return Err(ViewError::Orientation(self.orientation, length));
        }
        if !(self.fov_y > 0.0 && self.fov_y < core::f64::consts::PI) {
            return Err(ViewError::FieldOfView(self.fov_y));
        }
        let [width, height] = self.viewport;
        if width == 0 || height == 0 {
            return Err(ViewError::Viewport(width, height));
        }
        Ok(())
    }

    /// Unit vector along which the camera looks, world space.
    pub fn forward(&self) -> DVec3 {
        self.orientation * DVec3::NEG_Z
    }

    /// Pixels per metre at one metre: viewport height / (2 tan(fov/2)). At distance d, divide by d.
    pub fn pixels_per_radian(&self) -> f64 {
        self.viewport[1] as f64 / (2.0 * libm::tan(0.5 * self.fov_y))
    }
}
