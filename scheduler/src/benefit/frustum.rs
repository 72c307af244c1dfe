//! The pyramid of directions that a view shows.

use crate::view::View;
use glam::DVec3;

/// Where a box lies relative to a frustum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// No part is inside.
    Outside,
    /// Some part may be inside: the bits name the planes that cut the box.
    Straddles(u8),
    /// All of it is inside.
    Inside,
}

/// A view's frustum without near and far plane: four half-spaces through the eye.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    /// Eye, world space, metres.
    pub eye: DVec3,
    /// Unit vector through the centre of the view.
    pub forward: DVec3,
    /// Unit normals of the left, right, bottom and top planes, pointing inwards.
    pub planes: [DVec3; 4],
    /// Solid angle of the pyramid, sr.
    pub solid_angle: f64,
    /// Viewport height / (2 tan(fov/2)).
    pub pixels_per_radian: f64,
    /// Half the angle between opposite corners, radians: every direction shown is at most this far from `forward`.
    pub corner_angle: f64,
}

impl Frustum {
    /// The frustum of a view that has passed [`View::check`].
    pub fn new(view: &View) -> Frustum {
        let up_tan = libm::tan(0.5 * view.fov_y);
        let right_tan = up_tan * f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
        let (right, up) = (view.orientation * DVec3::X, view.orientation * DVec3::Y);
        let forward = view.forward();
        let plane = |axis: DVec3, tan: f64| (forward * tan + axis).normalize();
        let planes = [plane(right, right_tan), plane(-right, right_tan), plane(up, up_tan), plane(-up, up_tan)];
        // Solid angle of a rectangular pyramid with half-tangents a and b: 4 asin(ab / √((1+a²)(1+b²))), written with
        // atan2 so that it stays accurate for very narrow and very wide views.
        let ab = right_tan * up_tan;
        let solid_angle = 4.0 * libm::atan2(ab, (1.0 + right_tan * right_tan + up_tan * up_tan).sqrt());
        Frustum {
            eye: view.position,
            forward,
            planes,
            solid_angle,
            pixels_per_radian: view.pixels_per_radian(),
            corner_angle: libm::atan(libm::hypot(right_tan, up_tan)),
        }
    }

    /// Classifies a box by its centre relative to the eye and its half sides, metres. Conservative: a box near a
    /// corner of the pyramid may be called straddling although it is outside.
    pub fn side(&self, centre: DVec3, half: DVec3) -> Side {
        let mut straddled = 0u8;
        for (i, plane) in self.planes.iter().enumerate() {
            let distance = plane.dot(centre);
            let extent = plane.abs().dot(half);
            if distance < -extent {
                return Side::Outside;
            }
            if distance < extent {
                straddled |= 1 << i;
            }
        }
        if straddled == 0 { Side::Inside } else { Side::Straddles(straddled) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn view() -> View {
        View {
            position: DVec3::new(1.0, 2.0, 3.0),
            orientation: DQuat::IDENTITY,
            fov_y: core::f64::consts::FRAC_PI_2,
            viewport: [600, 600],
        }
    }

    #[test]
    fn a_sixth_of_the_sphere() {
        let frustum = Frustum::new(&view());
        assert!((frustum.solid_angle - 4.0 * core::f64::consts::PI / 6.0).abs() < 1e-12);
        assert!((frustum.corner_angle - libm::acos(1.0 / 3f64.sqrt())).abs() < 1e-12);
    }

    #[test]
    fn boxes_are_told_apart() {
        let frustum = Frustum::new(&view());
        let half = DVec3::splat(0.5);
        assert_eq!(frustum.side(DVec3::new(0.0, 0.0, -10.0), half), Side::Inside);
        assert_eq!(frustum.side(DVec3::new(0.0, 0.0, 10.0), half), Side::Outside);
        assert!(matches!(frustum.side(DVec3::new(10.0, 0.0, -10.0), half), Side::Straddles(_)));
        assert_eq!(frustum.side(DVec3::new(11.1, 0.0, -10.0), half), Side::Outside);
    }
}
