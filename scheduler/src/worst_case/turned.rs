//! What a view shows of a box that is turned against it.
//!
//! Seen from a view that is turned by some rotation of at most t, a box is the box turned by its inverse: a plane with
//! unit normal n through the eye and an edge of the box's outline is turned to n′. Ω being the
//! integral of the angular velocity and L that of its length, |n′ − n + Ω×n| ≤ L²/2, so that |v·(n′ − n)| ≤ |Ω·(n×v)| + L²/2·|v|. The right side is convex in v: on the rectangle
//! v·f = 1 that the view shows, f forward, it is at most its greatest value κ at the four corners. So within the view what is
//! on the inner side of n′ has v·(n + κ·f) ≥ 0, and what has v·(n − κ·f) ≥ 0 is on the inner side of every n′. Of a box that is
//! larger than the view only the planes that the view sees count: where widening the view adds a strip at each of its
//! borders, this adds those along the box's edges alone.

use super::bounds::Lens;
use super::view_box::Views;
use crate::benefit::solid_angle::{of_frustum_within, outline_planes};
use glam::DVec3;

/// Half angle of a frustum to its corner beyond which there is no bound, radians.
const CORNER_MAX: f64 = 1.4;
/// Rounding of the normals, radians.
const BLUR: f64 = 1e-11;

/// The most (sr) that any of the views could show of a box with `sign` 1; with −1 the least that each of them shows.
/// `centre` is relative to the eye. `None` where nothing is known: from within the box, of what is very thin, and for very
/// wide views.
pub(super) fn solid_angle(lens: &Lens, centre: DVec3, half: DVec3, views: &Views, sign: f64) -> Option<f64> {
    let frustum = &lens.frustum;
    if frustum.corner_angle > CORNER_MAX {
        return None;
    }
    let (mut planes, count) = outline_planes(centre, half)?;
    // Corners, and axes about which views turn, in world space; the camera looks along −z.
    let ([x, y], z) = (lens.axes(), -frustum.forward);
    let corners = lens.corners();
    let second = 0.5 * views.turns.length_squared();
    let planes = &mut planes[..count];
    for plane in planes.iter_mut() {
        let moved = |corner: &DVec3| {
            let across = plane.cross(*corner);
            let by_axis = DVec3::new(across.dot(x), across.dot(y), across.dot(z)).abs().dot(views.turns);
            (by_axis + second * corner.length()).min(2.0 * libm::sin(0.5 * views.turn) * corner.length())
        };
        let most = corners.iter().map(moved).fold(0.0, f64::max);
        *plane += frustum.forward * (sign * (most * (1.0 + 1e-12) + BLUR));
    }
    Some(of_frustum_within(frustum, planes))
}

/// The directions in which every eye within `spread` of the origin sees the face of a box across `axis`, as a rectangle at
/// distance 1: its middle and half sides. `None` where some eye does not see the face, or there are no such directions.
pub(super) fn core_of_face(centre: DVec3, half: DVec3, spread: DVec3, axis: usize) -> Option<(DVec3, DVec3)> {
    let distance = centre[axis].abs() - half[axis];
    let (near, far) = (distance - spread[axis], distance + spread[axis]);
    if near <= 0.0 {
        return None;
    }
    let (mut middle, mut sides) = (DVec3::ZERO, DVec3::ZERO);
    middle[axis] = 1f64.copysign(centre[axis]);
    for across in [(axis + 1) % 3, (axis + 2) % 3] {
        let (low, high) =
            (centre[across] - half[across] + spread[across], centre[across] + half[across] - spread[across]);
        // The greatest of all begins and the least of all ends.
        let low = low / if low >= 0.0 { near } else { far };
        let high = high / if high >= 0.0 { far } else { near };
        if low >= high || low.is_nan() || high.is_nan() {
            return None;
        }
        middle[across] = 0.5 * (low + high);
        sides[across] = 0.5 * (high - low);
    }
    Some((middle, sides))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::benefit::frustum::Frustum;
    use crate::benefit::solid_angle::of_box_in_frustum;
    use crate::view::View;
    use glam::DQuat;
    use proptest::prelude::*;

    pub(in crate::worst_case) fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-limit..limit).prop_map(DVec3::from)
    }

    pub(in crate::worst_case) fn view(fov_y: f64, orientation: DQuat) -> View {
        View { position: DVec3::ZERO, orientation, fov_y, viewport: [1600, 900] }
    }

    fn turning(turn: f64, turns: DVec3) -> Views {
        Views { eye: DVec3::ZERO, half: DVec3::ZERO, radius: 0.0, orientation: DQuat::IDENTITY, turn, turns }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(4000) })]

        /// Every rotation shows no more and no less.
        #[test]
        fn rotations_lie_between(c in vector(12.0), h in vector(6.0), axis in vector(1.0), by in 0.0..1.0f64, turn in 0.0..0.6f64, fov in 0.2..1.6f64) {
            prop_assume!(axis.length() > 0.1);
            let half = h.abs();
            let lens = Lens::new(&view(fov, DQuat::IDENTITY));
            let axis = axis.normalize();
            let turned = Frustum::new(&view(fov, DQuat::from_axis_angle(axis, turn * by)));
            let seen = of_box_in_frustum(c, half, &turned, 0b1111);
            // Whatever is known about its axis.
            for turns in [DVec3::splat(turn), axis.abs() * turn] {
                let views = turning(turn, turns);
                if let Some(most) = solid_angle(&lens, c, half, &views, 1.0) {
                    prop_assert!(seen <= most + 1e-9, "{seen} {most}");
                }
                if let Some(least) = solid_angle(&lens, c, half, &views, -1.0) {
                    prop_assert!(least <= seen + 1e-9, "{seen} {least}");
                }
                let wide = lens.widened(turn, turns);
                if wide.corner_angle < 1.4 {
                    prop_assert!(seen <= of_box_in_frustum(c, half, &wide, 0b1111) + 1e-9);
                }
                if let Some(narrow) = lens.narrowed(turn, turns) {
                    prop_assert!(of_box_in_frustum(c, half, &narrow, 0b1111) <= seen + 1e-9);
                }
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(4000) })]

        /// Every eye sees at least the cores of the faces.
        #[test]
        fn cores_are_seen_from_everywhere(c in vector(8.0), h in vector(3.0), s in vector(1.0), t in vector(1.0), fov in 0.2..1.6f64) {
            let (half, spread) = (h.abs(), s.abs());
            let frustum = Frustum::new(&view(fov, DQuat::IDENTITY));
            let cores = (0..3).filter_map(|axis| core_of_face(c, half, spread, axis));
            let least: f64 = cores.map(|(c, h)| of_box_in_frustum(c, h, &frustum, 0b1111)).sum();
            let seen = of_box_in_frustum(c - t * spread, half, &frustum, 0b1111);
            prop_assert!(least <= seen + 1e-9, "{least} {seen}");
        }
    }

    #[test]
    fn what_fills_the_view_fills_it_when_turned_a_little() {
        let lens = Lens::new(&view(1.0, DQuat::IDENTITY));
        let views = turning(0.1, DVec3::new(0.1, 0.05, 0.0));
        let wall = (DVec3::new(0.0, 0.0, -2.0), DVec3::new(50.0, 50.0, 1.0));
        let least = solid_angle(&lens, wall.0, wall.1, &views, -1.0).expect("a wall seen from outside");
        assert!((least - lens.frustum.solid_angle).abs() < 1e-12);
        assert!(solid_angle(&lens, DVec3::ZERO, wall.1, &views, 1.0).is_none());
    }
}
