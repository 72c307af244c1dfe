//! Faces of any number of corners as triangles.

use earcut::Earcut;
use glam::DVec3;

/// Cuts faces into triangles in their own planes; keeps its buffers.
#[derive(Default)]
pub(super) struct Polygons {
    earcut: Option<Earcut<f64>>,
    plane: Vec<[f64; 2]>,
    found: Vec<u32>,
}

impl Polygons {
    /// Hands on the corners of each triangle of a face: a fan if the face turns one way at each corner, else ears. There are
    /// always two fewer than corners, some of them perhaps without area.
    pub(super) fn cut(&mut self, corners: &[DVec3], mut triangle: impl FnMut([usize; 3])) {
        let count = corners.len();
        if count < 3 {
            return;
        }
        let normal = area_vector(corners);
        let turns = |at: usize| {
            let [a, b, c] = [corners[at], corners[(at + 1) % count], corners[(at + 2) % count]];
            (b - a).cross(c - b).dot(normal)
        };
        // Whatever is not finite is fanned out too, and left out as triangles.
        if count == 3 || !normal.is_finite() || (0..count).all(|at| turns(at) >= 0.0) {
            return (2..count).for_each(|at| triangle([0, at - 1, at]));
        }
        let Some(unit) = normal.try_normalize() else {
            return (2..count).for_each(|at| triangle([0, at - 1, at]));
        };
        let right = unit.any_orthonormal_vector();
        let forward = unit.cross(right);
        self.plane.clear();
        self.plane.extend(corners.iter().map(|&c| [(c - corners[0]).dot(right), (c - corners[0]).dot(forward)]));
        self.earcut.get_or_insert_with(Earcut::new).earcut_slice(&self.plane, &[], &mut self.found);
        let plane = &self.plane;
        let mut left = count - 2;
        for ear in self.found.chunks_exact(3).take(left) {
            let [a, b, c] = [ear[0] as usize, ear[1] as usize, ear[2] as usize];
            let side = |p: usize, q: usize| [plane[q][0] - plane[p][0], plane[q][1] - plane[p][1]];
            let (u, v) = (side(a, b), side(a, c));
            triangle(if u[0] * v[1] - u[1] * v[0] >= 0.0 { [a, b, c] } else { [a, c, b] });
            left -= 1;
        }
        (0..left).for_each(|_| triangle([0; 3]));
    }
}

/// Twice the area vector of a closed polygon (Newell), about its first corner.
fn area_vector(corners: &[DVec3]) -> DVec3 {
    let from = corners[0];
    corners.windows(2).fold(DVec3::ZERO, |sum, side| sum + (side[0] - from).cross(side[1] - from))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(corners: &[DVec3]) -> (f64, usize) {
        let (mut sum, mut count) = (DVec3::ZERO, 0);
        Polygons::default().cut(corners, |[a, b, c]| {
            let own = (corners[b] - corners[a]).cross(corners[c] - corners[a]);
            assert!(own.z >= -1e-12, "turned over");
            (sum, count) = (sum + 0.5 * own, count + 1);
        });
        (sum.z, count)
    }

    #[test]
    fn areas_are_kept_and_nothing_is_turned_over() {
        let at = |points: &[[f64; 2]]| points.iter().map(|&[x, y]| DVec3::new(x, y, 0.5 * x)).collect::<Vec<_>>();
        assert_eq!(area(&at(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])), (2.0, 2));
        // An arrow: its notch is a corner that turns the other way.
        let arrow = at(&[[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [3.0, 1.0], [0.0, 4.0]]);
        let (found, count) = area(&arrow);
        assert!((found - 10.0).abs() < 1e-12 && count == 3, "{found}");
        // The same from each corner on.
        for start in 0..5 {
            let turned: Vec<_> = (0..5).map(|at| arrow[(start + at) % 5]).collect();
            assert!((area(&turned).0 - 10.0).abs() < 1e-12, "from corner {start}");
        }
        assert_eq!(area(&at(&[[0.0, 0.0], [1.0, 0.0]])), (0.0, 0));
        assert_eq!(area(&at(&[[0.0, 0.0]; 6])), (0.0, 4));
        let mut count = 0;
        Polygons::default().cut(&[DVec3::NAN, DVec3::ZERO, DVec3::X, DVec3::Y], |_| count += 1);
        assert_eq!(count, 2);
    }
}
