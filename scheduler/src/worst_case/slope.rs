//! How the solid angle of a leaf changes over a set of views, to first order with a proven remainder.
//!
//! What a view shows of a box is bounded by the box's outline, edges P₁ + σE, and by the view's planes. Along the part of an
//! edge that is shown, with N = P₁ × E the inward normal of its plane, an eye that moves by δ gains
//! δ·N ∫dσ/r³, and a view that turns by ω gains −ω·(u₂ − u₁), u the directions of the ends of that part (the integral
//! of the tangent of a great circle). So the derivatives of every view of the set are bounded by the least and the
//! greatest part of each edge that any of them shows; the solid angle is that of the middle view, plus slope × motion, plus at most the
//! half widths of these bounds × motion. It is Lipschitz continuous while no eye reaches the plane of a face, so that the mean
//! value theorem holds. Summed over leaves, what one loses as the view moves another gains: bounds by first order cancel where
//! intervals add up.

use super::bounds::Lens;
use super::view_box::Views;
use crate::benefit::frustum::Frustum;
use crate::benefit::solid_angle::{of_box_in_frustum, outline_of_box};
use core::f64::consts::{FRAC_PI_2, FRAC_PI_3};
use glam::DVec3;

/// A solid angle (sr) over a set of views: within `rest` of `middle` + `moved`·δ + `turned`·ω, δ how far the eye is from the middle one
/// (m, world axes), ω the integrals of the angular velocity about the camera's axes on the way from the middle view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Slope {
    /// At the middle view.
    pub(super) middle: f64,
    /// Per metre.
    pub(super) moved: DVec3,
    /// Per radian.
    pub(super) turned: DVec3,
    /// Greatest error.
    pub(super) rest: f64,
}

impl Slope {
    /// Times a factor that is not negative.
    pub(super) fn times(self, factor: f64) -> Slope {
        let Slope { middle, moved, turned, rest } = self;
        Slope { middle: middle * factor, moved: moved * factor, turned: turned * factor, rest: rest * factor }
    }
}

/// How far views are from the middle one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    /// Of eyes along the axes, m.
    half: DVec3,
    /// Of eyes, m.
    radius: f64,
    /// About the camera's axes, radians.
    turns: DVec3,
}

impl Extent {
    /// Of a set of views.
    pub(super) fn of(views: &Views) -> Extent {
        Extent { half: views.half, radius: views.radius, turns: views.turns }
    }

    /// The greatest value of `moved`·δ + `turned`·ω.
    pub(super) fn most(&self, moved: DVec3, turned: DVec3) -> f64 {
        moved.abs().dot(self.half).min(moved.length() * self.radius) + turned.abs().dot(self.turns)
    }

    /// Where in the box of all δ and ω that value is greatest.
    pub(super) fn farthest(&self, moved: DVec3, turned: DVec3) -> (DVec3, DVec3) {
        (self.half * moved.signum(), self.turns * turned.signum())
    }
}

/// Half angle of a frustum to its corner beyond which there is no bound, radians.
const CORNER_MAX: f64 = 1.4;
/// Rounding of what is summed here, as a share of it.
const ROUNDING: f64 = 1e-10;
/// Sine of the angle under which an edge is seen below which nothing but its length is used.
const THIN: f64 = 1e-5;

/// Of the box at `centre` relative to the middle eye; `None` from within, where an eye may reach the plane of a face, and
/// for very wide views.
pub(super) fn slope(lens: &Lens, centre: DVec3, half: DVec3, views: &Views) -> Option<Slope> {
    let frustum = &lens.frustum;
    let beyond = centre.abs() - half;
    let margin = views.half + 1e-9 * (centre.abs() + half);
    if frustum.corner_angle > CORNER_MAX || !beyond.abs().cmpgt(margin).all() {
        return None;
    }
    let nearest = beyond.max(DVec3::ZERO).length();
    // Derivatives change by the cube of distances.
    if views.radius >= 0.5 * nearest {
        return None;
    }
    let (corners, count) = outline_of_box(centre, half)?;
    let corners = &corners[..count];
    let moves = Moves::new(lens, views);
    let (mut sum, mut chords) = (Sum::default(), Sum::default());
    let ends = |k: usize| (corners[k], corners[(k + 1) % count]);
    // Inward normals have the box's middle on their side; all edges go round it the same way.
    let way: f64 = (0..count).map(|k| ends(k).0.cross(ends(k).1).dot(centre)).sum();
    if way == 0.0 || !way.is_finite() {
        return None;
    }
    for k in 0..count {
        let (start, end) = ends(k);
        let edge = end - start;
        if edge == DVec3::ZERO {
            continue;
        }
        let Some(shown) = moves.shown(frustum, start, end) else { continue };
        let normal = start.cross(edge) * way.signum();
        let wander = DVec3::new(
            views.half.y * edge.z.abs() + views.half.z * edge.y.abs(),
            views.half.z * edge.x.abs() + views.half.x * edge.z.abs(),
            views.half.x * edge.y.abs() + views.half.y * edge.x.abs(),
        );
        let (least, most) = shown.by_cube(start, edge, views.radius)?;
        sum.middle += normal * (0.5 * (least + most));
        sum.rest += normal.abs() * (0.5 * (most - least) + ROUNDING * most) + wander * most;
        let (chord, rest) = shown.chord(start, edge, views.radius);
        chords.middle -= chord * way.signum();
        chords.rest += DVec3::splat(rest + 1e-13);
    }
    let [x, y] = lens.axes();
    let z = -frustum.forward;
    let turned = DVec3::new(chords.middle.dot(x), chords.middle.dot(y), chords.middle.dot(z));
    // About axes that turn with the camera.
    let rest = chords.rest.x + 2.0 * libm::sin(0.5 * views.turn) * (turned.length() + chords.rest.x);
    let cos = libm::cos(frustum.corner_angle);
    let whole = Extent::of(views).most(sum.middle, turned);
    let rest = sum.rest.dot(views.half) + rest * views.turns.length();
    let rest = rest * (1.0 + ROUNDING) + ROUNDING * whole + 1e-14 / (cos * cos * cos);
    let found = Slope { middle: of_box_in_frustum(centre, half, frustum, 0b1111), moved: sum.middle, turned, rest };
    (rest.is_finite() && whole.is_finite()).then_some(found)
}

/// A vector with the greatest error of its components.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    middle: DVec3,
    rest: DVec3,
}

/// By how much a view's planes can move against a point.
struct Moves<'a> {
    views: &'a Views,
    axes: [DVec3; 3],
    chord: f64,
    second: f64,
}

impl<'a> Moves<'a> {
    fn new(lens: &Lens, views: &'a Views) -> Moves<'a> {
        let [x, y] = lens.axes();
        let chord = 2.0 * libm::sin(0.5 * views.turn);
        Moves { views, axes: [x, y, -lens.frustum.forward], chord, second: 0.5 * views.turns.length_squared() }
    }

    /// Bound on the change of the signed distance of `point` from a plane of the view: |v·(n′ − n)| ≤ |Ω·(n×v)| + L²/2·|v| of the turn,
    /// then the eye's motion. Convex in `point`.
    fn of(&self, plane: DVec3, point: DVec3) -> f64 {
        let across = plane.cross(point);
        let by_axis = DVec3::new(across.dot(self.axes[0]), across.dot(self.axes[1]), across.dot(self.axes[2]));
        let turned = by_axis.abs().dot(self.views.turns) + self.second * point.length();
        let moved = plane.abs().dot(self.views.half).min(self.views.radius) + self.chord * self.views.radius;
        (turned + moved) * (1.0 + 1e-9) + 1e-13 * point.length()
    }

    /// The parts of the edge that some view and that every view shows; `None` where none shows any.
    fn shown(&self, frustum: &Frustum, start: DVec3, end: DVec3) -> Option<Shown> {
        let mut shown = Shown { outer: (0.0, 1.0), inner: Some((0.0, 1.0)) };
        for plane in &frustum.planes {
            let at = [(start, plane.dot(start)), (end, plane.dot(end))];
            let slack = at.map(|(point, _)| self.of(*plane, point));
            shown.outer = above(shown.outer, at[0].1 + slack[0], at[1].1 + slack[1])?;
            shown.inner = shown.inner.and_then(|inner| above(inner, at[0].1 - slack[0], at[1].1 - slack[1]));
        }
        Some(shown)
    }
}

/// The part of [a, b] where the linear function that is `start` at 0 and `end` at 1 is not negative.
fn above((a, b): (f64, f64), start: f64, end: f64) -> Option<(f64, f64)> {
    let root = start / (start - end);
    let part = match (start >= 0.0, end >= 0.0) {
        (true, true) => (a, b),
        (false, false) => return None,
        (true, false) => (a, b.min(root)),
        (false, true) => (a.max(root), b),
    };
    (part.0 <= part.1).then_some(part)
}

/// Parts of an edge, as shares of its length: `outer` holds what any view shows, `inner` is what all show.
struct Shown {
    outer: (f64, f64),
    inner: Option<(f64, f64)>,
}

impl Shown {
    /// Bounds of ∫dσ/r³ over what is shown, from eyes within `radius`.
    fn by_cube(&self, start: DVec3, edge: DVec3, radius: f64) -> Option<(f64, f64)> {
        let nearest = nearest(start, edge, self.outer);
        if nearest <= radius {
            return None;
        }
        let nearer = nearest / (nearest - radius);
        let farther = nearest / (nearest + radius);
        let length = edge.length_squared();
        let along = start.dot(edge);
        let normal = start.cross(edge).length_squared();
        if normal <= THIN * THIN * length * start.length_squared() {
            let crude = nearest - radius;
            return Some((0.0, (self.outer.1 - self.outer.0) / (crude * crude * crude)));
        }
        // The antiderivative is (|E|²σ + P₁·E) / (|N|²·r).
        let until = |share: f64| (length * share + along) / (start + edge * share).length();
        let over = |(a, b): (f64, f64)| ((until(b) - until(a)) / normal).max(0.0);
        let rounding = 16.0 * f64::EPSILON * (length + along.abs()) / (nearest * normal);
        let least = self.inner.map_or(0.0, |inner| over(inner) * farther * farther * farther - rounding);
        let most = over(self.outer) * nearer * nearer * nearer + rounding;
        Some((least.max(0.0), most))
    }

    /// u₂ − u₁ over what is shown, and the greatest length of its error. An end that every view shows is a corner, where the
    /// next edge goes on from wherever the eye sees it.
    fn chord(&self, start: DVec3, edge: DVec3, radius: f64) -> (DVec3, f64) {
        let point = |share: f64| start + edge * share;
        let towards = |share: f64| point(share).normalize_or_zero();
        // Greatest distance between the directions of one point of a part from two eyes.
        let parallax = |part: (f64, f64)| {
            let distance = nearest(start, edge, part);
            if distance > radius { radius / (distance - 0.5 * radius) } else { f64::INFINITY }
        };
        let (a, b) = self.outer;
        let Some((c, d)) = self.inner else {
            let chord = towards(b) - towards(a);
            return (0.5 * chord, 0.5 * arc(chord) + 2.0 * parallax(self.outer));
        };
        let mut rest = 0.0;
        let mut middle = towards(d) - towards(c);
        if c > 0.0 {
            let more = towards(c) - towards(a);
            middle += 0.5 * more;
            rest += 0.5 * arc(more) + parallax((a, c));
        }
        if d < 1.0 {
            let more = towards(b) - towards(d);
            middle += 0.5 * more;
            rest += 0.5 * arc(more) + parallax((d, b));
        }
        (middle, rest)
    }
}

/// Upper bound on the length of the arc of a great circle, at most π, over a chord.
fn arc(chord: DVec3) -> f64 {
    let length = chord.length();
    length * if length > 1.0 { FRAC_PI_2 } else { FRAC_PI_3 }
}

/// Distance from the origin to a part of an edge.
fn nearest(start: DVec3, edge: DVec3, (a, b): (f64, f64)) -> f64 {
    let share = (-start.dot(edge) / edge.length_squared()).clamp(a, b);
    (start + edge * share).length()
}

#[cfg(test)]
mod tests {
    use super::super::turned::tests::{vector, view};
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn views(half: DVec3, turns: DVec3) -> Views {
        let (radius, turn) = (half.length(), turns.length());
        Views { eye: DVec3::ZERO, half, radius, orientation: DQuat::IDENTITY, turn, turns }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(20_000) })]

        /// Every view of the set sees what the slope says, to within the remainder.
        #[test]
        fn slopes_hold(c in vector(12.0), h in vector(6.0), s in vector(1.0), t in vector(1.0), turns in vector(0.3), by in vector(1.0),
                       size in 0.0..1.0f64, fov in 0.2..1.6f64) {
            let (half, spread, turns) = (h.abs(), s.abs() * size, turns.abs() * size);
            let lens = Lens::new(&view(fov, DQuat::IDENTITY));
            let set = views(spread, turns);
            if let Some(found) = slope(&lens, c, half, &set) {
                let (eye, omega) = (t * spread, by * turns);
                let turned = Frustum::new(&view(fov, DQuat::from_scaled_axis(omega)));
                let seen = of_box_in_frustum(c - eye, half, &turned, 0b1111);
                let said = found.middle + found.moved.dot(eye) + found.turned.dot(omega);
                prop_assert!((seen - said).abs() <= found.rest + 1e-9, "{seen} {said} {found:?}");
                let most = Extent::of(&set).most(found.moved, found.turned);
                prop_assert!(found.moved.dot(eye) + found.turned.dot(omega) <= most * (1.0 + 1e-12));
            }
        }
    }

    #[test]
    fn remainders_fall_with_the_square_of_the_extent() {
        // Cut by the right and the lower border, none of its edges along one.
        let (centre, half) = (DVec3::new(5.0, -3.0, -9.0), DVec3::new(3.0, 2.5, 2.0));
        let lens = Lens::new(&view(0.8, DQuat::from_rotation_z(0.3)));
        let rest = |extent: f64| {
            let set = views(DVec3::splat(extent), DVec3::splat(0.1 * extent));
            slope(&lens, centre, half, &set).expect("seen from outside").rest
        };
        let whole = of_box_in_frustum(centre, half, &lens.frustum, 0b1111);
        assert!(whole > 0.05 && whole < 0.8 * crate::benefit::solid_angle::of_box(centre, half), "{whole}");
        assert!(rest(0.1) < 0.1 * whole && rest(0.01) < 0.015 * rest(0.1) && rest(0.001) < 0.012 * rest(0.01));
    }

    #[test]
    fn no_slope_where_an_eye_may_reach_a_face() {
        let lens = Lens::new(&view(1.0, DQuat::IDENTITY));
        let near = |gap: f64| {
            slope(&lens, DVec3::new(0.0, 0.0, -2.0 - gap), DVec3::splat(2.0), &views(DVec3::splat(0.1), DVec3::ZERO))
        };
        assert!(near(1.0).is_some() && near(0.05).is_none() && near(-1.0).is_none());
    }
}
