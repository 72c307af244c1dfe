//! The ground as a surface of triangles.

use std::sync::OnceLock;

use glam::{DVec2, DVec3};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

use super::across;

/// Triangles, and R-trees over them and their corners, seen along up, that are built at the first use.
#[derive(Clone, Debug)]
pub struct GroundSurface {
    triangles: Vec<[DVec3; 3]>,
    index: OnceLock<Index>,
}

#[derive(Clone, Debug)]
struct Index {
    triangles: RTree<GeomWithData<Rectangle<[f64; 2]>, u32>>,
    corners: RTree<GeomWithData<[f64; 2], f64>>,
}

impl GroundSurface {
    /// Triangles with finite corners, metres; a point is a triangle of three equal corners. At most 2³² of them.
    pub fn new(triangles: Vec<[DVec3; 3]>) -> GroundSurface {
        GroundSurface { triangles, index: OnceLock::new() }
    }

    /// Height along the unit vector `up` of the lowest triangle under or over `at`; where there is none, that of the nearest
    /// corner, seen along `up`. `None` without triangles.
    pub(super) fn height(&self, up: DVec3, at: DVec3) -> Option<f64> {
        let index = self.index.get_or_init(|| self.build(up));
        let point = across(up, at);
        let around = index.triangles.locate_all_at_point(point.to_array());
        let below = around.filter_map(|candidate| height_on(self.triangles[candidate.data as usize], up, point));
        let nearest = || index.corners.nearest_neighbor(point.to_array()).map(|corner| corner.data);
        below.min_by(f64::total_cmp).or_else(nearest)
    }

    fn build(&self, up: DVec3) -> Index {
        let boxes = self.triangles.iter().zip(0..).map(|(corners, number)| {
            let [a, b, c] = corners.map(|corner| across(up, corner));
            let rectangle = AABB::from_corners(a.min(b).min(c).to_array(), a.max(b).max(c).to_array());
            GeomWithData::new(Rectangle::from_aabb(rectangle), number)
        });
        let corners = self.triangles.iter().flatten();
        let corners = corners.map(|&corner| GeomWithData::new(across(up, corner).to_array(), corner.dot(up)));
        Index { triangles: RTree::bulk_load(boxes.collect()), corners: RTree::bulk_load(corners.collect()) }
    }
}

/// The height of a triangle at a point of the plane across `up`; `None` beside it, or if it stands upright.
fn height_on(corners: [DVec3; 3], up: DVec3, point: DVec2) -> Option<f64> {
    let [a, b, c] = corners.map(|corner| across(up, corner) - point);
    // Twice the areas opposite each corner.
    let parts = [b.perp_dot(c), c.perp_dot(a), a.perp_dot(b)];
    let whole: f64 = parts.iter().sum();
    let weights = parts.map(|part| part / whole);
    let is_inside = whole != 0.0 && weights.iter().all(|weight| (0.0..=1.0).contains(weight));
    is_inside.then(|| weights.iter().zip(corners).map(|(weight, corner)| weight * corner.dot(up)).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_below_else_the_nearest_corner() {
        let far = DVec3::new(2.7e6, 1.2e6, 0.0);
        let at = |x: f64, y: f64, z: f64| far + DVec3::new(x, y, z);
        let slope = [at(0.0, 0.0, 10.0), at(10.0, 0.0, 20.0), at(0.0, 10.0, 10.0)];
        let upright = [at(0.0, 0.0, -5.0), at(10.0, 0.0, -5.0), at(10.0, 0.0, 5.0)];
        let bridge = [at(0.0, 0.0, 50.0), at(10.0, 0.0, 50.0), at(0.0, 10.0, 50.0)];
        let ground = GroundSurface::new(vec![bridge, upright, slope]);
        let height = |x: f64, y: f64| ground.height(DVec3::Z, at(x, y, 99.0)).unwrap();
        assert!((height(2.0, 3.0) - 12.0).abs() < 1e-6);
        assert!((height(5.0, 1.0) - 15.0).abs() < 1e-6);
        assert_eq!(height(-3.0, 12.0), 50.0);
        assert_eq!(GroundSurface::new(vec![[at(1.0, 1.0, 7.0); 3]]).height(DVec3::Z, far), Some(7.0));
        assert_eq!(GroundSurface::new(Vec::new()).height(DVec3::Z, far), None);
    }
}
