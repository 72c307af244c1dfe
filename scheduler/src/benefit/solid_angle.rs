//! Solid angles of boxes, exact.

use super::frustum::Frustum;
use glam::DVec3;

/// A polygon on the sphere of directions: the outline of a box has at most 6 corners, and each plane adds at most one.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [DVec3; 10],
    count: usize,
}

/// Solid angle (sr) of a box seen from outside or inside, no frustum: 4π from within.
/// `centre` is relative to the eye, `half` the half sides, metres.
pub fn of_box(centre: DVec3, half: DVec3) -> f64 {
    outline(centre, half).map_or(4.0 * core::f64::consts::PI, |outline| outline.solid_angle())
}

/// Solid angle (sr) of the part of a box inside a frustum; from within the box, all of the frustum.
/// `straddled` names the planes that may cut the box, as [`super::frustum::Side::Straddles`] does.
pub fn of_box_in_frustum(centre: DVec3, half: DVec3, frustum: &Frustum, straddled: u8) -> f64 {
    let Some(mut outline) = outline(centre, half) else { return frustum.solid_angle };
    for (i, plane) in frustum.planes.iter().enumerate() {
        if straddled & (1 << i) != 0 {
            clip(&mut outline, *plane);
        }
    }
    outline.solid_angle().clamp(0.0, frustum.solid_angle)
}

/// Solid angle (sr) of what a frustum narrower than a hemisphere shows on the inner side of all `planes`: normals of planes
/// through the eye, at most six.
pub(crate) fn of_frustum_within(frustum: &Frustum, planes: &[DVec3]) -> f64 {
    let [left, right, bottom, top] = frustum.planes;
    let mut view = Polygon { corners: [DVec3::ZERO; 10], count: 4 };
    for (place, (a, b)) in view.corners.iter_mut().zip([(left, bottom), (right, bottom), (right, top), (left, top)]) {
        let ray = a.cross(b).normalize_or_zero();
        *place = if ray.dot(frustum.forward) < 0.0 { -ray } else { ray };
    }
    for plane in planes {
        clip(&mut view, *plane);
    }
    view.solid_angle().clamp(0.0, frustum.solid_angle)
}

/// Inward unit normals of the planes through the eye and the edges of a box's outline, and how many; `None` from within, and
/// where the ends of an edge are seen less than a milliradian apart, or opposite each other.
pub(crate) fn outline_planes(centre: DVec3, half: DVec3) -> Option<([DVec3; 6], usize)> {
    let outline = outline(centre, half)?;
    let (mut planes, mut count) = ([DVec3::ZERO; 6], 0);
    for k in 0..outline.count {
        let (a, b) = (outline.corners[k], outline.corners[(k + 1) % outline.count]);
        // The sides of what is flat.
        if a == b {
            continue;
        }
        let normal = a.try_normalize()?.cross(b.try_normalize()?);
        let length = normal.length();
        if length <= 1e-3 || length.is_nan() {
            return None;
        }
        planes[count] = if normal.dot(centre) < 0.0 { -normal / length } else { normal / length };
        count += 1;
    }
    Some((planes, count))
}

/// The corners of a box's outline in order, and how many; `None` from within.
pub(crate) fn outline_of_box(centre: DVec3, half: DVec3) -> Option<([DVec3; 10], usize)> {
    outline(centre, half).map(|outline| (outline.corners, outline.count))
}

/// The outline of a box seen from the origin, corner by corner; `None` from within. Its edges are seen as arcs of great
/// circles, and what they enclose is convex.
fn outline(centre: DVec3, half: DVec3) -> Option<Polygon> {
    // Faces are turned towards the eye across the axes along which the eye lies beyond them.
    let beyond = centre.abs().cmpgt(half);
    let towards = DVec3::new(-centre.x.signum(), -centre.y.signum(), -centre.z.signum());
    let near = towards * half;
    let far = -near;
    // A corner by which of its coordinates are on the far side: bits x, y, z.
    let corner = |bits: u8| {
        let pick = |bit: u8, near: f64, far: f64| if bits & bit != 0 { far } else { near };
        centre + DVec3::new(pick(1, near.x, far.x), pick(2, near.y, far.y), pick(4, near.z, far.z))
    };
    let bits = outline_corners(beyond.bitmask());
    if bits.is_empty() {
        return None;
    }
    let mut polygon = Polygon { corners: [DVec3::ZERO; 10], count: bits.len() };
    for (place, &bits) in polygon.corners.iter_mut().zip(bits) {
        *place = corner(bits);
    }
    Some(polygon)
}

/// The corners of a box's outline in order, each by which of its coordinates are on the far side (bits x, y, z).
/// `beyond` has the bits of the axes along which the eye lies beyond the box; none from within.
pub(crate) fn outline_corners(beyond: u32) -> &'static [u8] {
    // Two faces share an edge; the outline goes round both. Three share the nearest corner; the outline visits all
    // others but the farthest. Neighbours differ in one coordinate.
    match beyond {
        0b000 => &[],
        0b001 => &[0, 2, 6, 4],
        0b010 => &[0, 1, 5, 4],
        0b100 => &[0, 1, 3, 2],
        0b011 => &[2, 6, 4, 5, 1, 0],
        0b101 => &[4, 6, 2, 3, 1, 0],
        0b110 => &[4, 5, 1, 3, 2, 0],
        _ => &[1, 3, 2, 6, 4, 5],
    }
}

/// Sutherland–Hodgman against one half-space through the eye: where a chord meets the plane, its arc does too.
fn clip(polygon: &mut Polygon, plane: DVec3) {
    let count = polygon.count;
    let mut sides = [0.0; 10];
    let mut within = 0;
    for (side, corner) in sides.iter_mut().zip(&polygon.corners[..count]) {
        *side = plane.dot(*corner);
        within += usize::from(*side >= 0.0);
    }
    if within == count || within == 0 {
        polygon.count = within;
        return;
    }
    let corners = polygon.corners;
    let mut kept = 0;
    let mut push = |corner: DVec3| {
        if let Some(place) = polygon.corners.get_mut(kept) {
            *place = corner;
            kept += 1;
        }
    };
    let (mut a, mut da) = (corners[count - 1], sides[count - 1]);
    for (&b, &db) in corners[..count].iter().zip(&sides) {
        if (da >= 0.0) != (db >= 0.0) {
            push(a + (b - a) * (da / (da - db)));
        }
        if db >= 0.0 {
            push(b);
        }
        (a, da) = (b, db);
    }
    polygon.count = kept;
}

impl Polygon {
    /// The solid angle enclosed, sr: the triangles of a fan after Van Oosterom and Strackee (1983), each half angle the
    /// argument of a complex number. The numbers are multiplied, so that one arc tangent serves the whole polygon;
    /// their angles sum to less than π.
    fn solid_angle(&self) -> f64 {
        let corners = &self.corners[..self.count];
        if corners.len() < 3 {
            return 0.0;
        }
        // Unit vectors first: near and far corners then weigh alike, whatever the world's scale.
        let first = corners[0].normalize_or_zero();
        let mut previous = corners[1].normalize_or_zero();
        let (mut re, mut im) = (1.0, 0.0);
        for corner in &corners[2..] {
            let next = corner.normalize_or_zero();
            let y = first.dot(previous.cross(next)).abs();
            let x = 1.0 + first.dot(previous) + previous.dot(next) + next.dot(first);
            // At most 4√2 long each: eight of them do not overflow.
            (re, im) = (re * x - im * y, re * y + im * x);
            previous = next;
        }
        let angle = libm::atan2(im, re);
        // Rounding can turn an angle of nothing, or of all, a hair below zero.
        2.0 * if angle > -1e-9 { angle.max(0.0) } else { angle + 2.0 * core::f64::consts::PI }
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
