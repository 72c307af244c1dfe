//! Shapes: spheres whose radius is a sum of octaves of noise, meshed as octahedra of n segments an edge, 8n² triangles.
//!
//! Triangles of any two such meshes lie over each other as on the plane faces of the octahedron, seen from the centre. So
//! the distance between two of them along a ray is exact and cheap.

use std::io::Write;

use flate2::Compression;
use flate2::write::DeflateEncoder;
use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec3, I64Vec3};

use super::super::noise;

/// Octaves, the first of wavelength 2/3 of the mean radius and an amplitude of 0.4 of it, halved from each to the next.
const OCTAVES: u32 = 7;
const FIRST_AMPLITUDE: f64 = 0.4;
const FIRST_FREQUENCY: f64 = 1.5;
/// Steps of the quantisation over twice the largest radius.
const STEPS: f64 = 65535.0;
/// Bytes of an encoded mesh besides its vertices and triangles: counts, and the box that it is quantised in.
const HEADER: usize = 64;

/// A mesh of a shape of mean radius 1.
#[derive(Clone, Debug)]
pub(super) struct Mesh {
    pub(super) positions: Vec<DVec3>,
    /// Unit length.
    pub(super) normals: Vec<DVec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Distance of the surface from the centre along a unit vector, for a mean radius of 1.
fn radius(seed: u64, along: DVec3) -> f64 {
    let (mut frequency, mut amplitude, mut sum) = (FIRST_FREQUENCY, FIRST_AMPLITUDE, 1.0);
    for octave in 0..OCTAVES {
        sum += amplitude * noise::space(seed.wrapping_add(u64::from(octave)), frequency * along);
        frequency *= 2.0;
        amplitude *= 0.5;
    }
    sum
}

/// Place of a lattice point, whose coordinates' absolute values sum to n, on the surface.
fn on_surface(seed: u64, point: I64Vec3) -> DVec3 {
    let along = point.as_dvec3().normalize();
    along * radius(seed, along)
}

/// Index of a lattice point: rings of constant z from the lowest, each counted from +x towards +y.
fn index(n: i64, point: I64Vec3) -> u32 {
    let I64Vec3 { x, y, z } = point;
    // Rings below: 1 point, then 4, 8, … 4(n−1) and 4n at the equator, and falling again.
    let below = match z + n {
        0 => 0,
        level if level <= n => 1 + 2 * level * (level - 1),
        level => {
            let left = 2 * n - level;
            4 * n * n + 2 - (1 + 2 * left * (left + 1))
        }
    };
    let r = n - z.abs();
    let along = match () {
        () if r == 0 => 0,
        () if x > 0 && y >= 0 => y,
        () if x <= 0 && y > 0 => r - x,
        () if x < 0 && y <= 0 => 2 * r - y,
        () => 3 * r + x,
    };
    (below + along) as u32
}

/// Lattice points in the order of their indices.
fn lattice(n: i64) -> impl Iterator<Item = I64Vec3> {
    (-n..=n).flat_map(move |z| {
        let r = n - z.abs();
        (0..(4 * r).max(1)).map(move |along| {
            let part = if r == 0 { 0 } else { along % r };
            let (x, y) = match if r == 0 { 0 } else { along / r } {
                0 => (r - part, part),
                1 => (-part, r - part),
                2 => (part - r, -part),
                _ => (part, part - r),
            };
            I64Vec3::new(x, y, z)
        })
    })
}

/// Corners of the octants.
fn octants() -> impl Iterator<Item = I64Vec3> {
    (0..8).map(|bits: i64| I64Vec3::new(1 - 2 * (bits & 1), 1 - (bits & 2), 1 - (bits >> 1 & 2)))
}

/// The mesh of n segments an edge.
pub(super) fn mesh(seed: u64, n: i64) -> Mesh {
    let positions: Vec<DVec3> = lattice(n).map(|point| on_surface(seed, point)).collect();
    let mut triangles = Vec::with_capacity(8 * (n * n) as usize);
    for sign in octants() {
        let outward = sign.element_product() > 0;
        let vertex = |i: i64, j: i64| index(n, sign * I64Vec3::new(i, j, n - i - j));
        let mut add = |a: u32, b: u32, c: u32| triangles.push(if outward { [a, b, c] } else { [a, c, b] });
        for i in 0..n {
            for j in 0..n - i {
                add(vertex(i, j), vertex(i + 1, j), vertex(i, j + 1));
                if i + j + 2 <= n {
                    add(vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
                }
            }
        }
    }
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for &[a, b, c] in &triangles {
        let corner = |at: u32| positions[at as usize];
        let area = (corner(b) - corner(a)).cross(corner(c) - corner(a));
        for at in [a, b, c] {
            normals[at as usize] += area;
        }
    }
    let normals = normals.into_iter().map(|normal| normal.normalize_or(DVec3::Z)).collect();
    Mesh { positions, normals, triangles }
}

/// Distances from the centre of the vertices of the mesh of n segments.
pub(super) fn radii(seed: u64, n: i64) -> Vec<f64> {
    lattice(n).map(|point| radius(seed, point.as_dvec3().normalize())).collect()
}

/// Largest distance along rays from the centre between the mesh of n segments and the vertices of the one of `fine`
/// segments, which lie at `fine_radii`.
pub(super) fn error(seed: u64, n: i64, fine: i64, fine_radii: &[f64]) -> f64 {
    let coarse = radii(seed, n);
    let mut largest = 0.0_f64;
    for (point, fine_radius) in lattice(fine).zip(fine_radii) {
        let on_face = point.as_dvec3() / fine as f64;
        let sign = I64Vec3::new(
            1 - 2 * i64::from(point.x < 0),
            1 - 2 * i64::from(point.y < 0),
            1 - 2 * i64::from(point.z < 0),
        );
        let (u, v) = (on_face.x.abs() * n as f64, on_face.y.abs() * n as f64);
        let (i, j) = ((u as i64).min(n - 1), (v as i64).min(n - 1 - (u as i64).min(n - 1)));
        let (du, dv) = (u - i as f64, v - j as f64);
        let corners = if du + dv <= 1.0 || i + j + 2 > n {
            [(i, j, 1.0 - du - dv), (i + 1, j, du), (i, j + 1, dv)]
        } else {
            [(i + 1, j + 1, du + dv - 1.0), (i, j + 1, 1.0 - du), (i + 1, j, 1.0 - dv)]
        };
        // The plane through the displaced corners sᵢqᵢ meets the ray through p = Σ wᵢqᵢ at p / Σ (wᵢ/sᵢ).
        let mut sum = 0.0;
        for (i, j, weight) in corners {
            let q = sign * I64Vec3::new(i, j, n - i - j);
            let length = q.as_dvec3().length() / n as f64;
            sum += weight * length / coarse[index(n, q) as usize];
        }
        let distance = on_face.length() / sum;
        largest = largest.max((distance - fine_radius).abs());
    }
    largest
}

impl Mesh {
    /// The least box around the vertices.
    pub(super) fn bounds(&self) -> Aabb {
        self.positions.iter().fold(Aabb::EMPTY, |sum, &at| sum.union(Aabb { min: at, max: at }))
    }

    /// Bytes in memory: position and normal, f32, and three 32-bit indices a triangle.
    pub(super) fn decoded_bytes(&self) -> u32 {
        (24 * self.positions.len() + 12 * self.triangles.len()) as u32
    }

    /// Bytes on the wire: positions in 16 bits, normals in two bytes on the octahedron, and indices, each as the zigzag-coded
    /// difference from the one before, byte planes apart, deflated.
    pub(super) fn wire_bytes(&self) -> u32 {
        let bounds = self.bounds();
        let middle = bounds.centre();
        let scale = STEPS / (bounds.max - bounds.min).max_element().max(f64::MIN_POSITIVE);
        let mut coded: Vec<[u8; 4]> = Vec::with_capacity(5 * self.positions.len() + 3 * self.triangles.len());
        let mut channel = |values: &mut dyn Iterator<Item = i64>| {
            let mut last = 0;
            for value in values {
                let difference = (value - last) as i32;
                last = value;
                coded.push(((difference << 1) ^ (difference >> 31)).to_le_bytes());
            }
        };
        for axis in 0..3 {
            channel(&mut self.positions.iter().map(|at| ((at[axis] - middle[axis]) * scale).round() as i64));
        }
        for axis in 0..2 {
            channel(&mut self.normals.iter().map(|normal| (octahedral(*normal)[axis] * 127.0).round() as i64));
        }
        channel(&mut self.triangles.iter().flatten().map(|&index| i64::from(index)));
        let planes: Vec<u8> = (0..4).flat_map(|plane| coded.iter().map(move |word| word[plane])).collect();
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::new(6));
        // Writing into memory does not fail.
        encoder.write_all(&planes).unwrap_or_default();
        (HEADER + encoder.finish().unwrap_or_default().len()) as u32
    }
}

/// A unit vector on the square: the octahedron unfolded, each in −1 to 1.
fn octahedral(unit: DVec3) -> [f64; 2] {
    let flat = unit / (unit.x.abs() + unit.y.abs() + unit.z.abs());
    let folded = |a: f64, b: f64| (1.0 - b.abs()) * if a < 0.0 { -1.0 } else { 1.0 };
    if flat.z >= 0.0 { [flat.x, flat.y] } else { [folded(flat.x, flat.y), folded(flat.y, flat.x)] }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn meshes_are_closed_and_face_outward() {
        for n in [1, 2, 3, 6, 13] {
            for (at, point) in lattice(n).enumerate() {
                assert_eq!((index(n, point) as usize, point.abs().element_sum()), (at, n), "{point}");
            }
            let mesh = mesh(5, n);
            assert_eq!((mesh.positions.len() as i64, mesh.triangles.len() as i64), (4 * n * n + 2, 8 * n * n));
            let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
            let mut volume = 0.0;
            for &[a, b, c] in &mesh.triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *edges.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
                }
                let corner = |at: u32| mesh.positions[at as usize];
                volume += corner(a).dot(corner(b).cross(corner(c))) / 6.0;
            }
            assert!(edges.values().all(|&sum| sum == 0), "every edge is used once in each direction");
            assert!(volume > 0.5, "{n}: {volume}");
        }
    }

    #[test]
    fn errors_against_rays_through_every_triangle() {
        let (seed, n, fine) = (3, 4, 11);
        let coarse = mesh(seed, n);
        let mut expected = 0.0_f64;
        for point in lattice(fine) {
            let along = point.as_dvec3().normalize();
            let hits = coarse.triangles.iter().filter_map(|&[a, b, c]| {
                let [a, b, c] = [a, b, c].map(|at| coarse.positions[at as usize]);
                let normal = (b - a).cross(c - a);
                let at = along * (a.dot(normal) / along.dot(normal));
                let inside = [(a, b), (b, c), (c, a)]
                    .iter()
                    .all(|&(from, to)| (to - from).cross(at - from).dot(normal) >= -1e-9);
                (inside && at.dot(along) > 0.0).then(|| at.length())
            });
            expected = expected.max((hits.fold(0.0, f64::max) - radius(seed, along)).abs());
        }
        let error = |n: i64, fine: i64| error(seed, n, fine, &radii(seed, fine));
        assert!((error(n, fine) - expected).abs() < 1e-9, "{} {expected}", error(n, fine));
        assert!(error(n, n) < 1e-12 && error(8, 32) < error(2, 32));
    }

    #[test]
    fn sizes_fall_with_detail() {
        let sizes = [55, 27, 13, 6].map(|n| mesh(1, n).wire_bytes());
        assert!(sizes.is_sorted_by(|a, b| a > b), "{sizes:?}");
        let per_triangle = f64::from(sizes[0]) / (8.0 * 55.0 * 55.0);
        assert!((2.0..12.0).contains(&per_triangle), "{per_triangle}");
    }
}
