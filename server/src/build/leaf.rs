//! What is in a leaf: its triangles cut to the leaf's box, measured.

use foresight_index::orthoview::raster::Triangle;
use foresight_index::stored::page::Leaf;
use foresight_scheduler::benefit::element::{self, ELEMENTS};
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

/// A polygon of a triangle cut by six planes has at most nine corners.
type Polygon = Vec<DVec3>;

/// The part of a triangle inside a box (Sutherland and Hodgman 1974); empty if there is none.
fn cut(corners: [DVec3; 3], bounds: &Aabb, polygon: &mut Polygon, spare: &mut Polygon) {
    polygon.clear();
    polygon.extend(corners);
    for axis in 0..3 {
        for (plane, sign) in [(bounds.min[axis], 1.0), (bounds.max[axis], -1.0)] {
            if plane.is_infinite() {
                continue;
            }
            spare.clear();
            for (i, &to) in polygon.iter().enumerate() {
                let from = polygon[if i == 0 { polygon.len() - 1 } else { i - 1 }];
                let (a, b) = (sign * (from[axis] - plane), sign * (to[axis] - plane));
                if (a < 0.0) != (b < 0.0) {
                    let mut at = from + (to - from) * (a / (a - b));
                    at[axis] = plane;
                    spare.push(at);
                }
                if b >= 0.0 {
                    spare.push(to);
                }
            }
            std::mem::swap(polygon, spare);
        }
    }
}

/// Measures what `holds` holds of triangles; `None` if that has no extent. `up` is away from the ground.
///
/// The ground is where a quarter of what faces up lies below, by area: terrain and floors rather than roofs.
pub(super) fn measure<'t>(triangles: impl Iterator<Item = &'t Triangle>, holds: &Aabb, up: DVec3) -> Option<Leaf> {
    let (mut polygon, mut spare) = (Polygon::new(), Polygon::new());
    let mut bounds = Aabb::EMPTY;
    let mut areas = [0.0f64; ELEMENTS];
    let mut upward: Vec<(f64, f64)> = Vec::new();
    for triangle in triangles.filter(|t| t.corners.iter().all(|c| c.is_finite())) {
        let [a, b, c] = triangle.corners;
        let (min, max) = (a.min(b).min(c), a.max(b).max(c));
        if min.cmpgt(holds.max).any() || max.cmplt(holds.min).any() {
            continue;
        }
        cut(triangle.corners, holds, &mut polygon, &mut spare);
        let [first, rest @ ..] = polygon.as_slice() else { continue };
        let twice: DVec3 = rest.windows(2).map(|pair| (pair[0] - *first).cross(pair[1] - *first)).sum();
        let area = 0.5 * twice.length();
        if !(area.is_finite() && area > 0.0) {
            continue;
        }
        bounds = polygon.iter().fold(bounds, |bounds, &at| bounds.union(Aabb { min: at, max: at }));
        let normal = 0.5 * twice / area;
        let middle = polygon.iter().sum::<DVec3>() / polygon.len() as f64;
        let sides: &[DVec3] = if triangle.two_sided { &[normal, -normal] } else { &[normal] };
        for &side in sides {
            areas[element::nearest(side)] += area / sides.len() as f64;
            let across = side.dot(up) * area;
            if across > 0.0 {
                upward.push((middle.dot(up), across));
            }
        }
    }
    if bounds.is_empty() {
        return None;
    }
    let total: f64 = areas.iter().sum();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of 65535")]
    let shares = areas.iter().map(|area| (area / total * 65535.0).round() as u16).collect();
    let lowest = (0..8).map(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 1 { bounds.max[axis] } else { bounds.min[axis] };
        DVec3::new(pick(0), pick(1), pick(2)).dot(up)
    });
    let ground = quarter(&mut upward).unwrap_or_else(|| lowest.fold(f64::INFINITY, f64::min));
    Some(Leaf { bounds, ground, shares })
}

/// The height below which a quarter of the area lies.
fn quarter(heights: &mut [(f64, f64)]) -> Option<f64> {
    heights.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let total: f64 = heights.iter().map(|(_, area)| area).sum();
    let mut below = 0.0;
    heights.iter().find_map(|&(height, area)| {
        below += area;
        (below >= 0.25 * total).then_some(height)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    fn triangle(corners: [[f64; 3]; 3]) -> Triangle {
        Triangle {
            corners: corners.map(DVec3::from_array),
            uv: [DVec2::ZERO; 3],
            material: 0,
            two_sided: false,
            ..Triangle::default()
        }
    }

    #[test]
    fn a_floor_and_a_wall_through_a_leaf() {
        let holds = Aabb { min: DVec3::ZERO, max: DVec3::splat(10.0) };
        // A floor far beyond the leaf, at 2 m; a wall at x = 4 from 2 to 12 m, facing +x.
        let floor = [
            triangle([[-90.0, -90.0, 2.0], [90.0, -90.0, 2.0], [90.0, 90.0, 2.0]]),
            triangle([[-90.0, -90.0, 2.0], [90.0, 90.0, 2.0], [-90.0, 90.0, 2.0]]),
        ];
        let wall = [
            triangle([[4.0, 0.0, 2.0], [4.0, 10.0, 2.0], [4.0, 10.0, 12.0]]),
            triangle([[4.0, 0.0, 2.0], [4.0, 10.0, 12.0], [4.0, 0.0, 12.0]]),
        ];
        let leaf = measure(floor.iter().chain(&wall), &holds, DVec3::Z).expect("something is there");
        assert_eq!(leaf.bounds, Aabb { min: DVec3::new(0.0, 0.0, 2.0), max: DVec3::splat(10.0) });
        assert_eq!(leaf.ground, 2.0);
        let share = |normal| f64::from(leaf.shares[element::nearest(normal)]) / 65535.0;
        assert!((share(DVec3::Z) - 100.0 / 180.0).abs() < 1e-4);
        assert!((share(DVec3::X) - 80.0 / 180.0).abs() < 1e-4);
    }

    #[test]
    fn nothing_makes_no_leaf() {
        let holds = Aabb { min: DVec3::ZERO, max: DVec3::ONE };
        let far = triangle([[5.0, 5.0, 5.0], [6.0, 5.0, 5.0], [5.0, 6.0, 5.0]]);
        let line = triangle([[0.1; 3], [0.5; 3], [0.9; 3]]);
        let broken = triangle([[f64::NAN; 3], [0.5; 3], [0.9; 3]]);
        assert_eq!(measure([far, line, broken].iter(), &holds, DVec3::Z), None);
    }
}
