//! Whether a triangle meets a box, and which leaves of an octree it meets.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use crate::octree::{Cell, Octree};

/// Whether a triangle and a box have a point in common: they have unless one of the 13 directions parts them (the box's axes,
/// the triangle's normal, the cross products of their edges). Touching counts.
pub fn meets(corners: &[DVec3; 3], bounds: &Aabb) -> bool {
    let (centre, half) = (0.5 * (bounds.min + bounds.max), 0.5 * (bounds.max - bounds.min));
    let [a, b, c] = corners.map(|corner| corner - centre);
    if a.min(b).min(c).cmpgt(half).any() || a.max(b).max(c).cmplt(-half).any() {
        return false;
    }
    let edges = [b - a, c - b, a - c];
    let normal = edges[0].cross(edges[1]);
    if normal.dot(a).abs() > normal.abs().dot(half) {
        return false;
    }
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    edges.into_iter().all(|edge| {
        axes.into_iter().all(|axis| {
            let apart = axis.cross(edge);
            let [p, q, r] = [a, b, c].map(|corner| corner.dot(apart));
            let reach = apart.abs().dot(half);
            p.min(q).min(r) <= reach && p.max(q).max(r) >= -reach
        })
    })
}

/// Up to this many leaves are tried one by one.
const FEW: u64 = 27;

/// A triangle that meets more leaves than may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyLeaves;

/// Adds the leaves that a triangle meets, found down the octree; a leaf is taken `slack` metres larger, and what lies
/// outside the octree belongs to nothing. More than `most` are refused.
///
/// # Errors
/// [`TooManyLeaves`]; then some may have been added.
pub fn leaves(
    octree: &Octree,
    corners: &[DVec3; 3],
    slack: f64,
    most: usize,
    out: &mut Vec<[u64; 3]>,
) -> Result<(), TooManyLeaves> {
    let [a, b, c] = *corners;
    let bounds = Aabb { min: a.min(b).min(c) - slack, max: a.max(b).max(c) + slack };
    let [x, y, z] = octree.leaves(&bounds);
    let first = [x[0], y[0], z[0]];
    if first == [x[1], y[1], z[1]] {
        out.push(first);
        return Ok(());
    }
    let end = out.len().saturating_add(most);
    let enlarged = |cell: Cell| {
        let bounds = octree.bounds(cell);
        Aabb { min: bounds.min - slack, max: bounds.max + slack }
    };
    let count = [x, y, z].iter().fold(1_u64, |count, range| count.saturating_mul(range[1] - range[0] + 1));
    if count <= FEW {
        for z in z[0]..=z[1] {
            for y in y[0]..=y[1] {
                for x in x[0]..=x[1] {
                    if meets(corners, &enlarged(Cell { level: 0, place: [x, y, z] })) {
                        out.push([x, y, z]);
                    }
                }
            }
        }
        return if out.len() > end { Err(TooManyLeaves) } else { Ok(()) };
    }
    // The smallest cell over all of them.
    let (mut low, mut high) = (Cell { level: 0, place: first }, Cell { level: 0, place: [x[1], y[1], z[1]] });
    while low != high {
        match (octree.parent(low), octree.parent(high)) {
            (Some(above), Some(other)) => (low, high) = (above, other),
            _ => break,
        }
    }
    let mut waiting = vec![low];
    while let Some(cell) = waiting.pop() {
        if !meets(corners, &enlarged(cell)) {
            continue;
        }
        if cell.level == 0 {
            if out.len() >= end {
                return Err(TooManyLeaves);
            }
            out.push(cell.place);
        } else {
            waiting.extend(octree.children(cell));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Cuts a triangle to a box plane by plane (Sutherland and Hodgman): what is left is empty where they do not meet.
    fn clipped(corners: &[DVec3; 3], bounds: &Aabb) -> Vec<DVec3> {
        let mut polygon = corners.to_vec();
        for axis in 0..3 {
            for (sign, bound) in [(1.0, bounds.min[axis]), (-1.0, -bounds.max[axis])] {
                let depth = |p: &DVec3| sign * p[axis] - bound;
                let mut kept = Vec::new();
                for (i, from) in polygon.iter().enumerate() {
                    let to = &polygon[(i + 1) % polygon.len()];
                    if depth(from) >= 0.0 {
                        kept.push(*from);
                    }
                    if (depth(from) > 0.0 && depth(to) < 0.0) || (depth(from) < 0.0 && depth(to) > 0.0) {
                        kept.push(*from + (*to - *from) * (depth(from) / (depth(from) - depth(to))));
                    }
                }
                polygon = kept;
            }
        }
        polygon
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-40.0..140.0f64).prop_map(DVec3::from_array)
    }

    proptest! {
        #[test]
        fn a_triangle_meets_a_box_where_something_is_left_of_it(
            corners in prop::array::uniform3(vector()), at in vector(), half in prop::array::uniform3(0.5..30.0f64),
        ) {
            let half = DVec3::from_array(half);
            let bounds = Aabb { min: at - half, max: at + half };
            prop_assert_eq!(meets(&corners, &bounds), !clipped(&corners, &bounds).is_empty());
        }

        #[test]
        fn a_triangle_is_in_each_leaf_that_it_meets(corners in prop::array::uniform3(vector()), side in 9.0..60.0f64) {
            let world = Aabb { min: DVec3::splat(-40.0), max: DVec3::new(140.0, 140.0, 100.0) };
            let octree = Octree::over(world, side).expect("a box");
            let mut found = Vec::new();
            leaves(&octree, &corners, 0.0, 1 << 20, &mut found).expect("few");
            found.sort_unstable();
            let [nx, ny, nz] = octree.cells_at(0);
            let all = (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| [x, y, z])));
            let expected: Vec<_> = all.filter(|&place| meets(&corners, &octree.bounds(Cell { level: 0, place }))).collect();
            // A triangle within one leaf's range is that leaf's, whatever lies outside the world.
            if found.len() != 1 || !expected.is_empty() {
                prop_assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn a_triangle_over_too_many_leaves_is_refused() {
        let world = Aabb { min: DVec3::ZERO, max: DVec3::splat(1000.0) };
        let octree = Octree::over(world, 1.0).expect("a box");
        let floor = [DVec3::ZERO, DVec3::new(1000.0, 0.0, 0.0), DVec3::new(0.0, 1000.0, 0.0)];
        assert_eq!(leaves(&octree, &floor, 0.0, 1000, &mut Vec::new()), Err(TooManyLeaves));
        let mut found = Vec::new();
        assert_eq!(leaves(&octree, &floor, 0.0, 1 << 20, &mut found), Ok(()));
        // Half of 1000 × 1000, with those along the slope.
        assert!((500_000..=502_100).contains(&found.len()), "{}", found.len());
    }
}
