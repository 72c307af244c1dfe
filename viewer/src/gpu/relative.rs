//! From the world to the camera: the one place where f64 becomes f32.
//!
//! Positions are made relative to the eye in f64 first. A metre from the eye an f32 keeps 10⁻⁷ m, a kilometre from it
//! 10⁻⁴ m, however far both are from the world's origin.

use foresight_scheduler::view::View;
use glam::{DMat4, DQuat, DVec3, DVec4, Mat4, Vec3};

/// Narrows what is small already: a direction, or a length near the eye.
#[expect(clippy::disallowed_methods, reason = "the narrowing itself, of what is relative to the eye")]
pub fn narrow(vector: DVec3) -> Vec3 {
    vector.as_vec3()
}

/// A view as the GPU takes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    position: DVec3,
    /// From world axes relative to the eye to clip space: depth is near/distance, 1 at the near plane, 0 at infinity.
    pub clip_from_relative: Mat4,
    /// To the right of the picture, unit, world space.
    pub right: Vec3,
    /// Upwards in the picture, unit, world space.
    pub up: Vec3,
    /// Into the picture, unit, world space.
    pub forward: Vec3,
    /// Half the picture's width and height at distance 1.
    pub half_extent: [f32; 2],
    /// Metres.
    pub near: f32,
}

impl Eye {
    /// The view on a picture of `size` pixels, whatever its own viewport is.
    pub fn new(view: &View, size: [u32; 2], near: f64) -> Eye {
        let half_height = libm::tan(0.5 * view.fov_y);
        let half_width = half_height * f64::from(size[0].max(1)) / f64::from(size[1].max(1));
        let near = if near.is_finite() && near > 0.0 { near.max(1e-6) } else { 0.1 };
        let clip_from_camera = DMat4::from_cols(
            DVec4::new(1.0 / half_width, 0.0, 0.0, 0.0),
            DVec4::new(0.0, 1.0 / half_height, 0.0, 0.0),
            DVec4::new(0.0, 0.0, 0.0, -1.0),
            DVec4::new(0.0, 0.0, near, 0.0),
        );
        let camera_from_world: DQuat = view.orientation.conjugate();
        let axis = |axis: DVec3| narrow(view.orientation * axis);
        Eye {
            position: view.position,
            clip_from_relative: (clip_from_camera * DMat4::from_quat(camera_from_world)).as_mat4(),
            right: axis(DVec3::X),
            up: axis(DVec3::Y),
            forward: axis(DVec3::NEG_Z),
            half_extent: [half_width as f32, half_height as f32],
            near: near as f32,
        }
    }

    /// A point relative to the eye, world axes.
    pub fn relative(&self, point: DVec3) -> Vec3 {
        narrow(point - self.position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planet_away_positions_keep_their_millimetres() {
        let position = DVec3::new(6.4e6, -6.4e6, 123_456.789);
        let view = View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [640, 480] };
        let eye = Eye::new(&view, view.viewport, 0.1);
        let near = DVec3::new(3.001, -2.002, -10.003);
        let relative = eye.relative(position + near);
        assert!((relative.as_dvec3() - near).length() < 2e-6, "{relative}");
    }

    #[test]
    fn depth_is_near_over_distance_and_corners_are_at_the_corners() {
        let orientation = DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.3);
        let view = View { position: DVec3::ZERO, orientation, fov_y: 1.0, viewport: [640, 480] };
        let eye = Eye::new(&view, view.viewport, 0.5);
        for distance in [0.5f32, 1.0, 1e3, 1e7] {
            let [width, height] = eye.half_extent;
            let point = (eye.forward + eye.right * width + eye.up * height) * distance;
            let clip = eye.clip_from_relative * point.extend(1.0);
            let device = clip / clip.w;
            assert!((device.x - 1.0).abs() < 1e-5 && (device.y - 1.0).abs() < 1e-5, "{device}");
            assert!((device.z * distance / 0.5 - 1.0).abs() < 1e-5, "{device}");
        }
    }
}
