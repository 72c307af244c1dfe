//! The point of a triangle nearest to another.

use glam::DVec3;

/// The corners of a triangle, metres.
pub(crate) type Triangle = [DVec3; 3];

/// The point of a segment nearest to `point`.
fn closest_on_segment(a: DVec3, b: DVec3, point: DVec3) -> DVec3 {
    let along = b - a;
    let square = along.length_squared();
    if square > 0.0 { a + along * ((point - a).dot(along) / square).clamp(0.0, 1.0) } else { a }
}

/// The point of a triangle nearest to `point`: inside if its projection falls there, else on an edge.
pub(crate) fn closest(&[a, b, c]: &Triangle, point: DVec3) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let (uu, uv, vv) = (ab.length_squared(), ab.dot(ac), ac.length_squared());
    let (up, vp) = (ab.dot(ap), ac.dot(ap));
    let (v, w, whole) = (vv * up - uv * vp, uu * vp - uv * up, uu * vv - uv * uv);
    if whole > 0.0 && v >= 0.0 && w >= 0.0 && v + w <= whole {
        return a + ab * (v / whole) + ac * (w / whole);
    }
    let edges = [(a, b), (b, c), (c, a)].map(|(from, to)| closest_on_segment(from, to, point));
    let nearer = |one: DVec3, other: DVec3| {
        if (other - point).length_squared() < (one - point).length_squared() { other } else { one }
    };
    nearer(nearer(edges[0], edges[1]), edges[2])
}
