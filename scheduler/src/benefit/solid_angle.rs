//! Solid angles of boxes, exact.

use super::frustum::Frustum;
use glam::DVec3;

/// A polygon clipped by a few planes: a face has 4 corners, and each plane adds at most one.
type Polygon = ([DVec3; 10], usize);

/// Solid angle (sr) of a box seen from outside or inside, no frustum: 4π from within.
/// `centre` is relative to the eye, `half` the half sides, metres.
pub fn of_box(centre: DVec3, half: DVec3) -> f64 {
    if is_inside(centre, half) {
        return 4.0 * core::f64::consts::PI;
    }
    let mut product = Turn::NONE;
    for face in visible_faces(centre, half) {
        product.add_polygon(&face);
    }
    2.0 * product.angle()
}

/// Solid angle (sr) of the part of a box inside a frustum; from within the box, all of the frustum.
/// `straddled` names the planes that may cut the box, as [`super::frustum::Side::Straddles`] does.
pub fn of_box_in_frustum(centre: DVec3, half: DVec3, frustum: &Frustum, straddled: u8) -> f64 {
    if is_inside(centre, half) {
        return frustum.solid_angle;
    }
    let mut product = Turn::NONE;
    for face in visible_faces(centre, half) {
        if straddled == 0 {
            product.add_polygon(&face);
            continue;
        }
        let mut polygon: Polygon = ([DVec3::ZERO; 10], 4);
        polygon.0[..4].copy_from_slice(&face);
        for (i, plane) in frustum.planes.iter().enumerate() {
            if straddled & (1 << i) != 0 {
                polygon = clip(&polygon, *plane);
            }
        }
        product.add_polygon(&polygon.0[..polygon.1]);
    }
    (2.0 * product.angle()).clamp(0.0, frustum.solid_angle)
}

fn is_inside(centre: DVec3, half: DVec3) -> bool {
    centre.abs().cmple(half).all()
}

/// The faces turned towards the eye, counter-clockwise as seen from it.
fn visible_faces(centre: DVec3, half: DVec3) -> impl Iterator<Item = [DVec3; 4]> {
    [DVec3::X, DVec3::Y, DVec3::Z].into_iter().filter_map(move |axis| {
        let offset = axis.dot(centre);
        let extent = axis.dot(half);
        // The eye is at the origin: the face across `axis` towards it is visible if the eye lies beyond that face.
        if offset.abs() <= extent {
            return None;
        }
        let sign = -offset.signum();
        let middle = centre + axis * (sign * extent);
        let u = DVec3::new(axis.y, axis.z, axis.x);
        let v = DVec3::new(axis.z, axis.x, axis.y);
        let (u, v) = (u * u.dot(half) * sign, v * v.dot(half));
        Some([middle - u - v, middle + u - v, middle + u + v, middle - u + v])
    })
}

/// Sutherland–Hodgman against one half-space through the eye.
fn clip((corners, count): &Polygon, plane: DVec3) -> Polygon {
    let mut out: Polygon = ([DVec3::ZERO; 10], 0);
    let mut push = |corner: DVec3| {
        if out.1 < out.0.len() {
            out.0[out.1] = corner;
            out.1 += 1;
        }
    };
    for i in 0..*count {
        let (a, b) = (corners[i], corners[(i + 1) % count]);
        let (da, db) = (plane.dot(a), plane.dot(b));
        if da >= 0.0 {
            push(a);
        }
        if (da >= 0.0) != (db >= 0.0) {
            push(a + (b - a) * (da / (da - db)));
        }
    }
    out
}

/// A sum of angles kept as a product of complex numbers, so that one arc tangent serves a whole box. Each factor is
/// the half solid angle of a triangle after Van Oosterom and Strackee (1983); their sum stays below π.
struct Turn {
    re: f64,
    im: f64,
}

impl Turn {
    const NONE: Turn = Turn { re: 1.0, im: 0.0 };

    fn add_polygon(&mut self, corners: &[DVec3]) {
        if corners.len() < 3 {
            return;
        }
        // Unit vectors first: near and far corners then weigh alike, whatever the world's scale.
        let first = corners[0].normalize_or_zero();
        let mut previous = corners[1].normalize_or_zero();
        for &corner in &corners[2..] {
            let next = corner.normalize_or_zero();
            let im = first.dot(previous.cross(next));
            let re = 1.0 + first.dot(previous) + previous.dot(next) + next.dot(first);
            let product = Turn { re: self.re * re - self.im * im.abs(), im: self.re * im.abs() + self.im * re };
            let norm = (product.re * product.re + product.im * product.im).sqrt();
            if norm > 0.0 {
                *self = Turn { re: product.re / norm, im: product.im / norm };
            }
            previous = next;
        }
    }

    fn angle(&self) -> f64 {
        let angle = libm::atan2(self.im, self.re);
        if angle < 0.0 && angle > -1e-9 {
            0.0
        } else if angle < 0.0 {
            angle + 2.0 * core::f64::consts::PI
        } else {
            angle
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::View;
    use core::f64::consts::PI;
    use glam::DQuat;
    use proptest::prelude::*;

    fn frustum(orientation: DQuat) -> Frustum {
        Frustum::new(&View { position: DVec3::ZERO, orientation, fov_y: 1.0, viewport: [1600, 900] })
    }

    #[test]
    fn a_cube_face_at_its_own_distance_covers_a_sixth() {
        // The front face of a cube whose middle is 2 half sides away fills a sixth of the sphere seen from 1.
        let omega = of_box(DVec3::new(0.0, 0.0, -2.0), DVec3::ONE);
        assert!((omega - 4.0 * PI / 6.0).abs() < 1e-12, "{omega}");
    }

    #[test]
    fn a_rectangle_on_axis_has_the_closed_form() {
        let (a, b, d) = (3.0, 0.5, 2.0);
        let omega = of_box(DVec3::new(0.0, 0.0, -d), DVec3::new(a, b, 0.0));
        let exact = 4.0 * libm::asin(a * b / ((a * a + d * d) * (b * b + d * d)).sqrt());
        assert!((omega - exact).abs() < 1e-12);
    }

    #[test]
    fn extremes_are_finite() {
        for scale in [1e-9, 1.0, 1e9] {
            let omega = of_box(DVec3::new(2.0, 3.0, 4.0) * scale, DVec3::splat(0.5) * scale);
            assert!((omega - of_box(DVec3::new(2.0, 3.0, 4.0), DVec3::splat(0.5))).abs() < 1e-12);
        }
        let sliver = of_box(DVec3::new(0.0, 0.0, -1e6), DVec3::new(1e-3, 1e-3, 0.0));
        assert!((sliver - 4e-18).abs() < 4e-18 * 1e-3 || sliver < 1e-15);
        assert_eq!(of_box(DVec3::ZERO, DVec3::ONE), 4.0 * PI);
        // The eye in the plane of a flat tile sees nothing of it.
        assert_eq!(of_box(DVec3::new(5.0, 0.0, 0.0), DVec3::new(1.0, 0.0, 1.0)).abs(), 0.0);
        // The eye a hair above the middle of a huge tile sees a hemisphere.
        assert!((of_box(DVec3::new(0.0, -1e-6, 0.0), DVec3::new(1e3, 0.0, 1e3)) - 2.0 * PI).abs() < 1e-6);
    }

    proptest! {
        /// Against counting directions on a fine grid of the view.
        #[test]
        fn agrees_with_counting(c in prop::array::uniform3(-6.0..6.0f64), h in prop::array::uniform3(0.1..3.0f64),
                                 axis in prop::array::uniform3(-1.0..1.0f64), angle in 0.0..3.0f64) {
            let axis = DVec3::from(axis);
            prop_assume!(axis.length() > 0.1);
            let (centre, half) = (DVec3::from(c), DVec3::from(h));
            let frustum = frustum(DQuat::from_axis_angle(axis.normalize(), angle));
            let exact = of_box_in_frustum(centre, half, &frustum, 0b1111);
            let q = DQuat::from_axis_angle(axis.normalize(), angle);
            let (ty, n) = (libm::tan(0.5), 300);
            let tx = ty * 1600.0 / 900.0;
            let mut counted = 0.0;
            for i in 0..n { for j in 0..n {
                let x = tx * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
                let y = ty * (2.0 * (j as f64 + 0.5) / n as f64 - 1.0);
                let d = q * DVec3::new(x, y, -1.0);
                let (mut near, mut far) = (0.0f64, f64::INFINITY);
                for k in 0..3 {
                    let (a, b) = ((centre[k] - half[k]) / d[k], (centre[k] + half[k]) / d[k]);
                    near = near.max(a.min(b));
                    far = far.min(a.max(b));
                }
                if near <= far {
                    let r2 = 1.0 + x * x + y * y;
                    counted += 4.0 * tx * ty / (n * n) as f64 / (r2 * r2.sqrt());
                }
            }}
            prop_assert!((exact - counted).abs() < 0.02, "{exact} {counted}");
        }
    }
}
