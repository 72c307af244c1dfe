//! Meshes of what stands in a city. Distances between levels are the tree's errors or less: a box leaves out a parapet of
//! [`PARAPET`], which is less than 1 m; textured walls leave out recesses of [`RECESS`], less than 0.15 m.

use glam::{DVec2, DVec3};

use super::Rectangle;
use super::facade::{PANES, WINDOW};
use crate::format::glb::narrowed;

/// Height of the wall around a roof, metres.
const PARAPET: f64 = 0.8;
/// Its thickness, metres.
const PARAPET_WIDTH: f64 = 0.3;
/// How far windows lie behind the wall, metres.
const RECESS: f64 = 0.12;
/// Height of a storey and width of a pane, metres, unless a wall would have more than [`PANES_MAX`] of them.
const STOREY: f64 = 3.0;
/// Most storeys, and most panes in a storey.
const PANES_MAX: f64 = 40.0;

/// Triangles of one material, relative to an origin.
#[derive(Clone, Debug, Default)]
pub(super) struct Shell {
    positions: Vec<DVec3>,
    normals: Vec<DVec3>,
    uv: Vec<[f32; 2]>,
    triangles: Vec<[u32; 3]>,
}

/// A shell as a file holds it.
pub(super) struct Narrowed {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) uv: Vec<[f32; 2]>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Shell {
    pub(super) fn narrowed(&self) -> Narrowed {
        let Shell { positions, normals, uv, triangles } = self;
        let (uv, triangles) = (uv.clone(), triangles.clone());
        Narrowed { positions: narrowed(positions), normals: narrowed(normals), uv, triangles }
    }

    /// The corners of each triangle with their texture coordinates.
    #[cfg(feature = "orthoviews")]
    pub(super) fn faces(&self) -> impl Iterator<Item = ([DVec3; 3], [[f32; 2]; 3])> {
        let corners = |triangle: &[u32; 3]| {
            (triangle.map(|at| self.positions[at as usize]), triangle.map(|at| self.uv[at as usize]))
        };
        self.triangles.iter().map(corners)
    }

    /// Adds another's triangles.
    pub(super) fn join(&mut self, other: Shell) {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        self.normals.extend(other.normals);
        self.uv.extend(other.uv);
        self.triangles.extend(other.triangles.iter().map(|triangle| triangle.map(|index| first + index)));
    }

    /// A rectangle from `at` along two edges; its front is where their cross product points. Texture coordinates run from
    /// `uv[0]` to `uv[1]`, the second edge upwards.
    #[expect(clippy::cast_possible_truncation, reason = "texture coordinates")]
    fn quad(&mut self, at: DVec3, right: DVec3, up: DVec3, uv: [DVec2; 2]) {
        let first = self.positions.len() as u32;
        let normal = right.cross(up).normalize_or(DVec3::Z);
        for (i, j) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            self.positions.push(at + right * i + up * j);
            self.normals.push(normal);
            // Images begin at their upper end.
            let (u, v) = (uv[0].x + (uv[1].x - uv[0].x) * i, uv[1].y + (uv[0].y - uv[1].y) * j);
            self.uv.push([u as f32, v as f32]);
        }
        self.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }
}

/// Walls and roof of a building.
#[derive(Clone, Debug, Default)]
pub(super) struct Building {
    pub(super) walls: Shell,
    pub(super) roof: Shell,
}

/// How much of a building there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Detail {
    /// Four walls and a roof.
    Box,
    /// And the parapet.
    Parapet,
    /// And recessed windows.
    Windows,
}

/// The four walls of a box: a lower corner and the way along the wall, outside to its right.
fn walls(footprint: Rectangle, low: f64) -> [(DVec3, DVec3); 4] {
    let Rectangle { min, max } = footprint;
    let size = max - min;
    [
        (min.extend(low), DVec3::new(size.x, 0.0, 0.0)),
        (DVec3::new(max.x, min.y, low), DVec3::new(0.0, size.y, 0.0)),
        (max.extend(low), DVec3::new(-size.x, 0.0, 0.0)),
        (DVec3::new(min.x, max.y, low), DVec3::new(0.0, -size.y, 0.0)),
    ]
}

/// A building on the ground; `footprint` relative to the mesh's origin.
pub(super) fn building(footprint: Rectangle, height: f64, detail: Detail) -> Building {
    let mut building = Building::default();
    let top = if detail == Detail::Box { height } else { height - PARAPET };
    let panes = |length: f64| (length / STOREY).round().clamp(1.0, PANES_MAX);
    let storeys = panes(top);
    for (at, along) in walls(footprint, 0.0) {
        let columns = panes(along.length());
        if detail == Detail::Windows {
            windows(&mut building.walls, at, along / columns, DVec3::Z * (top / storeys), [columns, storeys]);
        } else {
            let end = DVec2::new(columns, storeys) / f64::from(PANES);
            building.walls.quad(at, along, DVec3::Z * top, [DVec2::ZERO, end]);
        }
    }
    let flat = [DVec2::ZERO, DVec2::splat(0.1)];
    let covered = if detail == Detail::Box { footprint } else { footprint.inset(PARAPET_WIDTH) };
    let (size, corner) = (covered.size(), covered.min.extend(top));
    building.roof.quad(corner, DVec3::X * size.x, DVec3::Y * size.y, flat);
    if detail > Detail::Box {
        let inner = footprint.inset(PARAPET_WIDTH);
        let up = DVec3::Z * PARAPET;
        for ((at, along), (inside, inner_along)) in walls(footprint, top).into_iter().zip(walls(inner, top)) {
            building.roof.quad(at, along, up, flat);
            building.roof.quad(inside + inner_along, -inner_along, up, flat);
            // The top: a trapezium.
            let first = building.roof.positions.len() as u32;
            for corner in [at, at + along, inside + inner_along, inside] {
                building.roof.positions.push(corner + up);
                building.roof.normals.push(DVec3::Z);
                building.roof.uv.push([0.05, 0.05]);
            }
            building.roof.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    building
}

/// A wall of panes with a recessed window in each.
fn windows(shell: &mut Shell, corner: DVec3, right: DVec3, up: DVec3, [columns, storeys]: [f64; 2]) {
    let [left, end, from_top, bottom] = WINDOW;
    let (low, high) = (1.0 - bottom, 1.0 - from_top);
    let back = up.cross(right).normalize_or(DVec3::Z) * RECESS;
    let whole = f64::from(PANES);
    for storey in 0..storeys as u32 {
        for column in 0..columns as u32 {
            let (column, storey) = (f64::from(column), f64::from(storey));
            let at = corner + right * column + up * storey;
            let mut part = |x: [f64; 2], y: [f64; 2], depth: DVec3| {
                // v grows downwards: the first row of the texture is the highest.
                let v = |y: f64| (storeys - storey - y) / whole;
                let uv = [DVec2::new((column + x[0]) / whole, v(y[1])), DVec2::new((column + x[1]) / whole, v(y[0]))];
                shell.quad(at + right * x[0] + up * y[0] + depth, right * (x[1] - x[0]), up * (y[1] - y[0]), uv);
            };
            part([0.0, 1.0], [0.0, low], DVec3::ZERO);
            part([0.0, 1.0], [high, 1.0], DVec3::ZERO);
            part([0.0, left], [low, high], DVec3::ZERO);
            part([end, 1.0], [low, high], DVec3::ZERO);
            part([left, end], [low, high], back);
            let edge = [DVec2::ZERO, DVec2::splat(0.02)];
            let (wide, tall) = (right * (end - left), up * (high - low));
            let lower = at + right * left + up * low;
            shell.quad(lower, wide, back, edge);
            shell.quad(lower + tall + back, wide, -back, edge);
            shell.quad(lower, back, tall, edge);
            shell.quad(lower + wide + back, -back, tall, edge);
        }
    }
}

/// The ground of a block: level at 0, `texture` metres to a repetition.
pub(super) fn ground(whole: Rectangle, texture: f64) -> Shell {
    let mut shell = Shell::default();
    let size = whole.size();
    shell.quad(whole.min.extend(0.0), DVec3::X * size.x, DVec3::Y * size.y, [DVec2::ZERO, size / texture]);
    shell
}

/// A tree: a trunk, and a crown that is an icosahedron divided so many times.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    pub(super) trunk: Shell,
    pub(super) crown: Shell,
}

/// A tree at `at`; the crown is an ellipsoid over the upper three quarters of its height.
pub(super) fn tree(at: DVec2, radius: f64, height: f64, divisions: u32) -> Tree {
    let mut tree = Tree::default();
    let thickness = 0.08 * radius;
    let stem = Rectangle { min: at - thickness, max: at + thickness };
    for (corner, along) in walls(stem, 0.0) {
        tree.trunk.quad(corner, along, DVec3::Z * (0.4 * height), [DVec2::ZERO, DVec2::ONE]);
    }
    let half = 0.375 * height;
    let (centre, axes) = (at.extend(height - half), DVec3::new(radius, radius, half));
    for triangle in sphere(divisions) {
        let first = tree.crown.positions.len() as u32;
        for point in triangle {
            tree.crown.positions.push(centre + axes * point);
            tree.crown.normals.push((point / axes).normalize_or(DVec3::Z));
            #[expect(clippy::cast_possible_truncation, reason = "texture coordinates")]
            tree.crown.uv.push([(point.x + point.y) as f32, (point.z - point.y) as f32]);
        }
        tree.crown.triangles.push([first, first + 1, first + 2]);
    }
    tree
}

/// The unit sphere from an icosahedron, each triangle divided in four so many times.
fn sphere(divisions: u32) -> Vec<[DVec3; 3]> {
    let g = 0.5 * (1.0 + 5f64.sqrt());
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z).normalize();
    let c = [
        corner(-1.0, g, 0.0),
        corner(1.0, g, 0.0),
        corner(-1.0, -g, 0.0),
        corner(1.0, -g, 0.0),
        corner(0.0, -1.0, g),
        corner(0.0, 1.0, g),
        corner(0.0, -1.0, -g),
        corner(0.0, 1.0, -g),
        corner(g, 0.0, -1.0),
        corner(g, 0.0, 1.0),
        corner(-g, 0.0, -1.0),
        corner(-g, 0.0, 1.0),
    ];
    let faces = [
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    let mut triangles: Vec<[DVec3; 3]> = faces.iter().map(|face| face.map(|i| c[i])).collect();
    for _ in 0..divisions {
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twice the signed volume's sixfold sum: closed shells have their volume, whatever the origin.
    fn volume(shells: &[&Shell]) -> f64 {
        let sum = |shell: &&Shell| -> f64 {
            let at = |i: u32| shell.positions[i as usize];
            shell.triangles.iter().map(|&[a, b, c]| at(a).dot(at(b).cross(at(c)))).sum()
        };
        shells.iter().map(sum).sum::<f64>() / 6.0
    }

    #[test]
    fn fronts_face_outwards_and_levels_differ_by_what_they_say() {
        let footprint = Rectangle { min: DVec2::new(-10.0, -6.0), max: DVec2::new(10.0, 6.0) };
        let shape = |detail| building(footprint, 30.0, detail);
        // Without their floors, which lie at 0 and add nothing to the sum.
        let volumes = [Detail::Box, Detail::Parapet, Detail::Windows].map(|detail| {
            let building = shape(detail);
            volume(&[&building.walls, &building.roof])
        });
        assert!((volumes[0] - 20.0 * 12.0 * 30.0).abs() < 1e-6, "{volumes:?}");
        let parapet = (20.0 * 12.0 - 19.4 * 11.4) * PARAPET;
        assert!((volumes[1] - (20.0 * 12.0 * 29.2 + parapet)).abs() < 1e-6, "{volumes:?}");
        let glass = volumes[1] - volumes[2];
        // 48 % of the width times 54 % of the height of each pane, all around.
        let expected = RECESS * 0.48 * 0.54 * 29.2 * 64.0;
        assert!((glass / expected - 1.0).abs() < 1e-9, "{glass} {expected}");
        for shell in [&shape(Detail::Windows).walls, &shape(Detail::Windows).roof] {
            assert!(
                shell
                    .positions
                    .iter()
                    .all(|p| p.z <= 30.0 + 1e-9 && p.x.abs() <= 10.0 + 1e-9 && p.y.abs() <= 6.0 + 1e-9)
            );
        }
        let crown = tree(DVec2::ZERO, 3.0, 8.0, 4).crown;
        let ellipsoid = 4.0 / 3.0 * core::f64::consts::PI * 3.0 * 3.0 * 3.0;
        assert!((volume(&[&crown]) / ellipsoid - 1.0).abs() < 0.01);
    }
}
