//! Ground truth: rays against triangles, apart from the rasteriser.

use foresight_index::orthoview::raster::{Surface, Triangle};
use foresight_index::orthoview::texture::Materials;
use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};

use super::scene::Holding;

/// Triangles in a leaf of the hierarchy at most, unless they cannot be parted.
const FEW: usize = 4;

/// Triangles under a hierarchy of boxes, halved at the median of the longest axis.
pub struct Rays<'a> {
    triangles: Vec<(&'a Triangle, &'a Materials)>,
    /// In preorder: box, end of the subtree, first and last triangle of a leaf.
    nodes: Vec<Node>,
    within: Aabb,
}

struct Node {
    bounds: Aabb,
    end: u32,
    first: u32,
    last: u32,
}

impl<'a> Rays<'a> {
    /// Over what a holding has inside of `within`: hits outside of it do not count.
    pub fn new(holding: &'a Holding, within: Aabb) -> Rays<'a> {
        let meets = |t: &Triangle| {
            let b = bounds(t);
            b.min.cmple(within.max).all() && b.max.cmpge(within.min).all()
        };
        let triangles: Vec<_> = holding
            .surfaces
            .iter()
            .flat_map(|s| s.triangles.iter().map(move |t| (t, &s.materials)))
            .filter(|(t, _)| meets(t))
            .collect();
        let mut rays = Rays { triangles, nodes: Vec::new(), within };
        rays.divide(0, rays.triangles.len());
        rays
    }

    /// Recursion halves the triangles: 32 deep at most.
    fn divide(&mut self, first: usize, last: usize) {
        let part = &mut self.triangles[first..last];
        let whole = part.iter().fold(Aabb::EMPTY, |all, (t, _)| all.union(bounds(t)));
        let node = self.nodes.len();
        self.nodes.push(Node { bounds: whole, end: 0, first: first as u32, last: last as u32 });
        if part.len() > FEW {
            let size = whole.max - whole.min;
            let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
            let middle = part.len() / 2;
            let at = |t: &Triangle| t.corners.iter().map(|c| c[axis]).sum::<f64>();
            part.select_nth_unstable_by(middle, |(a, _), (b, _)| at(a).total_cmp(&at(b)));
            self.nodes[node].last = first as u32;
            self.divide(first, first + middle);
            self.divide(first + middle, last);
        }
        self.nodes[node].end = self.nodes.len() as u32;
    }

    /// Way along the unit vector `along` from `from` to the nearest hit that is seen, metres. By Möller and Trumbore's
    /// formula; backs count where a triangle is two-sided; holes are looked up without filtering.
    pub fn cast(&self, from: DVec3, along: DVec3) -> Option<f64> {
        let mut nearest = f64::INFINITY;
        let mut next = 0;
        while let Some(node) = self.nodes.get(next) {
            if !meets(&node.bounds, from, along, nearest) {
                next = node.end as usize;
                continue;
            }
            for &(triangle, surface) in &self.triangles[node.first as usize..node.last as usize] {
                if let Some((way, uv)) = hit(triangle, from, along)
                    && way < nearest
                {
                    let at = from + along * way;
                    let inside = at.cmpge(self.within.min).all() && at.cmple(self.within.max).all();
                    if inside && surface.colour(triangle.material, uv, 0.0).is_some() {
                        nearest = way;
                    }
                }
            }
            next += 1;
        }
        (nearest < f64::INFINITY).then_some(nearest)
    }
}

fn bounds(triangle: &Triangle) -> Aabb {
    let [a, b, c] = triangle.corners;
    Aabb { min: a.min(b).min(c), max: a.max(b).max(c) }
}

/// Whether a ray meets a box before `nearest`, by slabs; a little wider against rounding.
fn meets(bounds: &Aabb, from: DVec3, along: DVec3, nearest: f64) -> bool {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, nearest);
    for axis in 0..3 {
        let (low, high) = (bounds.min[axis] - 1e-6 - from[axis], bounds.max[axis] + 1e-6 - from[axis]);
        if along[axis].abs() < 1e-15 {
            if low > 0.0 || high < 0.0 {
                return false;
            }
            continue;
        }
        let (a, b) = (low / along[axis], high / along[axis]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    enter <= leave
}

fn hit(triangle: &Triangle, from: DVec3, along: DVec3) -> Option<(f64, DVec2)> {
    let [a, b, c] = triangle.corners;
    let (e1, e2) = (b - a, c - a);
    let p = along.cross(e2);
    let det = e1.dot(p);
    if det.abs() < 1e-14 || (det < 0.0 && !triangle.two_sided) {
        return None;
    }
    let s = (from - a) / det;
    let (u, q) = (s.dot(p), s.cross(e1));
    let v = along.dot(q);
    let [ta, tb, tc] = triangle.uv;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then(|| (e2.dot(q), ta * (1.0 - u - v) + tb * u + tc * v))
}
