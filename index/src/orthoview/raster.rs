//! Triangles into a cell's image, on the CPU, in f64: the same pixels on every machine.

use super::image::{Lattice, Orthoview, Pixel};
use super::texture::linear;
use super::{composite, image::Rect};
use crate::octree::{Cell, Octree};
use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3, I64Vec2};

/// What a surface looks like: linear light at texture coordinates, with how many metres one unit of them spans left to
/// the surface to know.
pub trait Surface {
    /// Colour at `uv`, averaged over a square of `footprint` in texture coordinates; 0 to 1. `None` is a hole.
    fn colour(&self, material: u32, uv: DVec2, footprint: f64) -> Option<[f32; 3]>;
}

/// One colour for everything.
#[derive(Clone, Copy, Debug)]
pub struct Plain(pub [f32; 3]);

impl Surface for Plain {
    fn colour(&self, _: u32, _: DVec2, _: f64) -> Option<[f32; 3]> {
        Some(self.0)
    }
}

/// A triangle, counter-clockwise seen from its front.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Metres in the world.
    pub corners: [DVec3; 3],
    /// Texture coordinates of the corners.
    pub uv: [DVec2; 3],
    /// What it looks like.
    pub material: u32,
    /// Colours of the corners, sRGB, interpolated and multiplied with the material's in linear light.
    pub tint: [[u8; 3]; 3],
    /// Whether its back is seen too.
    pub two_sided: bool,
}

impl Triangle {
    /// The tint that leaves a material as it is.
    pub const WHITE: [[u8; 3]; 3] = [[255; 3]; 3];
}

impl Default for Triangle {
    /// A white point at the origin.
    fn default() -> Triangle {
        Triangle {
            corners: [DVec3::ZERO; 3],
            uv: [DVec2::ZERO; 3],
            material: 0,
            tint: Triangle::WHITE,
            two_sided: false,
        }
    }
}

/// What drawing did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Drawn {
    /// Triangles that were looked at.
    pub triangles: u64,
    /// Samples that were written, hidden ones included.
    pub samples: u64,
    /// Triangles left out because a corner is not finite.
    pub not_finite: u64,
    /// Triangles left out because they are lines or points from here.
    pub degenerate: u64,
}

impl Drawn {
    /// Adds the counts of another.
    pub fn add(&mut self, other: &Drawn) {
        self.triangles += other.triangles;
        self.samples += other.samples;
        self.not_finite += other.not_finite;
        self.degenerate += other.degenerate;
    }
}

/// A leaf's image: its content drawn with twice the resolution and brought down. Only what is inside the leaf is drawn, so
/// that neighbours share nothing. `None` where nothing is.
pub fn leaf<'t>(
    octree: &Octree,
    cell: Cell,
    lattice: &Lattice,
    meshes: impl IntoIterator<Item = (&'t [Triangle], &'t dyn Surface)>,
    drawn: &mut Drawn,
) -> Option<Orthoview> {
    let mut view = Orthoview::empty(lattice, &octree.bounds(cell), cell.level);
    let mut double = composite::doubled(&view);
    let side = lattice.pitch * (1u64 << cell.level) as f64;
    let holds = octree.holds(cell, 1e-6 * side);
    for (triangles, surface) in meshes {
        for triangle in triangles {
            draw(&holds, lattice, 0.5 * side, triangle, surface, &mut double, drawn);
        }
    }
    if double.is_empty() {
        return None;
    }
    composite::halved(&double, &mut view, side);
    Some(view)
}

/// Draws what `holds` holds of one triangle into pixels of `side` metres.
#[expect(clippy::cast_possible_truncation, reason = "clamped to the image, or relative to the cell")]
fn draw(
    holds: &Aabb,
    lattice: &Lattice,
    side: f64,
    triangle: &Triangle,
    surface: &dyn Surface,
    target: &mut Orthoview,
    drawn: &mut Drawn,
) {
    drawn.triangles += 1;
    if !triangle.corners.iter().all(|c| c.is_finite()) {
        drawn.not_finite += 1;
        return;
    }
    // In pixels of the target, from its first; so the numbers stay small far from the origin.
    let to_pixels = lattice.pitch / side;
    let base = target.rect.min.as_dvec2();
    let corners = triangle.corners.map(|corner| {
        let at = lattice.project(corner);
        DVec3::new(at.x * to_pixels - base.x, at.y * to_pixels - base.y, at.z - target.near)
    });
    let [a, b, c] = corners;
    let area = (b - a).truncate().perp_dot((c - a).truncate());
    if area.abs() < 1e-12 || !area.is_finite() {
        drawn.degenerate += 1;
        return;
    }
    if area < 0.0 && !triangle.two_sided {
        return;
    }
    let normal = {
        let n = (triangle.corners[1] - triangle.corners[0]).cross(triangle.corners[2] - triangle.corners[0]);
        let n = if area < 0.0 { -n } else { n };
        n.normalize_or_zero().to_array().map(|v| v as f32)
    };
    let [u, v, w] = triangle.uv;
    let footprint = {
        let texture = (v - u).perp_dot(w - u).abs();
        (texture / area.abs()).sqrt()
    };
    let tint = (triangle.tint != Triangle::WHITE).then(|| triangle.tint.map(|corner| corner.map(linear)));
    let size = Rect { min: I64Vec2::ZERO, max: target.rect.max - target.rect.min };
    let low = a.min(b).min(c);
    let high = a.max(b).max(c);
    // Centres of pixels at n + ½.
    let first = |v: f64, end: i64| (v - 0.5).ceil().clamp(0.0, end as f64) as i64;
    let (x0, x1) = (first(low.x, size.max.x), first(high.x + 1.0, size.max.x));
    let (y0, y1) = (first(low.y, size.max.y), first(high.y + 1.0, size.max.y));
    // Counter-clockwise in the image; a pixel on an edge belongs to the triangle whose edge is a left or top one.
    let (p, q) = if area > 0.0 { (b, c) } else { (c, b) };
    let edges = [(a, p), (p, q), (q, a)];
    let scale = 1.0 / area.abs();
    for y in y0..y1 {
        for x in x0..x1 {
            let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let mut shares = [0.0; 3];
            let mut inside = true;
            for (i, (from, to)) in edges.into_iter().enumerate() {
                let along = (to - from).truncate();
                let across = along.perp_dot(at - from.truncate());
                let owns_edge = along.y < 0.0 || (along.y == 0.0 && along.x < 0.0);
                inside &= across > 0.0 || (across == 0.0 && owns_edge);
                shares[(i + 2) % 3] = across * scale;
            }
            if !inside {
                continue;
            }
            let depth = shares[0] * a.z + shares[1] * p.z + shares[2] * q.z;
            let index = y as usize * size.width() + x as usize;
            if depth.is_nan() || depth as f32 >= target.pixels[index].depth {
                continue;
            }
            let image = (at + base) / to_pixels;
            let point = lattice.unproject(image.extend(depth + target.near));
            if !(point.cmpge(holds.min).all() && point.cmple(holds.max).all()) {
                continue;
            }
            // The shares belong to a, p and q.
            let [_, second, third] = if area > 0.0 { shares } else { [shares[0], shares[2], shares[1]] };
            let uv = u * shares[0] + v * second + w * third;
            let Some(mut colour) = surface.colour(triangle.material, uv, footprint) else { continue };
            if let Some([a, b, c]) = &tint {
                let shares = [shares[0], second, third].map(|share| share as f32);
                for (channel, value) in colour.iter_mut().enumerate() {
                    *value *= shares[0] * a[channel] + shares[1] * b[channel] + shares[2] * c[channel];
                }
            }
            drawn.samples += 1;
            target.pixels[index] = Pixel { depth: depth as f32, colour, normal };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::direction::{Direction, nine};
    use super::*;
    use proptest::prelude::*;

    fn triangle(corners: [[f64; 3]; 3]) -> Triangle {
        Triangle { corners: corners.map(DVec3::from_array), ..Triangle::default() }
    }

    /// A square of side `side` at height z, facing up.
    fn floor(x: f64, y: f64, z: f64, side: f64) -> [Triangle; 2] {
        let at = |i: f64, j: f64| [x + i * side, y + j * side, z];
        [triangle([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)]), triangle([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)])]
    }

    fn octree(extent: f64, side: f64) -> Octree {
        Octree::over(Aabb { min: DVec3::ZERO, max: DVec3::splat(extent) }, side).expect("a box")
    }

    fn lattice(direction: Direction, pitch: f64) -> Lattice {
        Lattice { direction, origin: DVec3::ZERO, pitch }
    }

    #[test]
    fn a_floor_covers_each_pixel_once_and_lies_at_its_height() {
        let octree = octree(8.0, 8.0);
        let above = lattice(nine()[0], 0.25);
        let mut drawn = Drawn::default();
        let view = leaf(
            &octree,
            octree.root(),
            &above,
            [(&floor(1.0, 2.0, 3.0, 4.0)[..], &Plain([0.5; 3]) as &dyn Surface)],
            &mut drawn,
        );
        let view = view.expect("something is there");
        // 4 m at 0.25 m, and 32 × 32 samples at twice the resolution: no seam counts twice along the diagonal.
        assert_eq!(view.pixels.iter().filter(|p| p.is_some()).count(), 256);
        assert_eq!(drawn, Drawn { triangles: 2, samples: 1024, not_finite: 0, degenerate: 0 });
        for (index, pixel) in view.pixels.iter().enumerate().filter(|(_, p)| p.is_some()) {
            let at = view.position(&above, index).expect("present");
            assert!((at.z - 3.0).abs() < 1e-6, "{at}");
            assert_eq!((pixel.colour, pixel.normal), ([0.5; 3], [0.0, 0.0, 1.0]));
        }
        let beneath = lattice(Direction::from_signs([0, 0, -1]).expect("canonical"), 0.25);
        let back = leaf(
            &octree,
            octree.root(),
            &beneath,
            [(&floor(1.0, 2.0, 3.0, 4.0)[..], &Plain([0.5; 3]) as &dyn Surface)],
            &mut drawn,
        );
        assert!(back.is_none(), "a back is not seen");
    }

    #[test]
    fn leaves_part_what_they_share_and_parents_put_it_together() {
        // A floor of 16 m over four leaves of 8 m, at an odd place and a height between two leaves' grids.
        let octree = octree(16.0, 8.0);
        let content = floor(0.0, 0.0, 8.0, 16.0);
        for direction in nine() {
            let lattice = lattice(direction, 0.25);
            let root = octree.root();
            let mut whole = Orthoview::empty(&lattice, &octree.bounds(root), root.level);
            let mut double = composite::doubled(&whole);
            let mut drawn = Drawn::default();
            for cell in octree.children(root) {
                if let Some(view) =
                    leaf(&octree, cell, &lattice, [(&content[..], &Plain([0.25; 3]) as &dyn Surface)], &mut drawn)
                {
                    composite::overlay(&mut double, &view);
                }
            }
            composite::halved(&double, &mut whole, 2.0 * lattice.pitch);
            let facing = direction.towards_eye().z;
            let seen = whole.pixels.iter().filter(|p| p.is_some()).count() as f64 * 0.25;
            if facing < 1e-9 {
                assert_eq!(seen, 0.0);
                continue;
            }
            // Projected area, with at most a pixel more along the outline.
            let expected = 256.0 * facing;
            assert!((seen - expected).abs() < 64.0 * 0.5 + 1.0, "{direction:?}: {seen} for {expected}");
            for index in 0..whole.pixels.len() {
                if let Some(at) = whole.position(&lattice, index) {
                    // The nearest quarter's depth at the pixel's middle: off by half a side along the slope.
                    assert!((at.z - 8.0).abs() < 0.5, "{direction:?}: {at}");
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_counted_and_left_out() {
        let octree = octree(8.0, 8.0);
        let mut drawn = Drawn::default();
        let bad = [
            triangle([[f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
            triangle([[1.0; 3], [1.0; 3], [2.0, 2.0, 2.0]]),
            triangle([[0.0, 0.0, 1.0], [f64::INFINITY, 0.0, 1.0], [0.0, 1.0, 1.0]]),
            triangle([[-1e6, -1e6, 1.0], [1e6, -1e6, 1.0], [0.0, 1e6, 1.0]]),
        ];
        let view = leaf(
            &octree,
            octree.root(),
            &lattice(nine()[0], 0.5),
            [(&bad[..], &Plain([1.0; 3]) as &dyn Surface)],
            &mut drawn,
        );
        assert_eq!((drawn.triangles, drawn.not_finite, drawn.degenerate), (4, 2, 1));
        assert!(view.expect("the large one covers all").pixels.iter().all(Pixel::is_some));
    }

    #[test]
    fn tints_are_interpolated_in_linear_light() {
        let octree = octree(8.0, 8.0);
        let mut lit = triangle([[0.0, 0.0, 1.0], [8.0, 0.0, 1.0], [0.0, 8.0, 1.0]]);
        lit.tint = [[0, 0, 0], [255, 0, 0], [0, 255, 0]];
        let above = lattice(nine()[0], 0.5);
        let surface = Plain([1.0, 0.5, 1.0]);
        // Turned over it is the same from its other side, which is then its front.
        let over = Triangle { corners: [lit.corners[0], lit.corners[2], lit.corners[1]], two_sided: true, ..lit };
        let over = Triangle { tint: [lit.tint[0], lit.tint[2], lit.tint[1]], ..over };
        for given in [lit, over] {
            let mesh = [(&[given][..], &surface as &dyn Surface)];
            let view = leaf(&octree, octree.root(), &above, mesh, &mut Drawn::default()).expect("something is there");
            for (index, pixel) in view.pixels.iter().enumerate().filter(|(_, p)| p.is_some()) {
                let at = view.position(&above, index).expect("present") / 8.0;
                if at.x + at.y < 0.9 {
                    let expected = [at.x, 0.5 * at.y, 0.0];
                    let off = (0..3).map(|c| (f64::from(pixel.colour[c]) - expected[c]).abs()).fold(0.0, f64::max);
                    assert!(off < 1e-5, "{at}: {:?}", pixel.colour);
                }
            }
        }
    }

    /// Nearest hit of a ray from the eye's side, by Möller and Trumbore's formula: apart from the rasteriser.
    fn cast(triangles: &[Triangle], from: DVec3, along: DVec3) -> Option<f64> {
        let hits = triangles.iter().filter_map(|t| {
            let [a, b, c] = t.corners;
            let (e1, e2) = (b - a, c - a);
            let p = along.cross(e2);
            let det = e1.dot(p);
            if det.abs() < 1e-12 || (det < 0.0 && !t.two_sided) {
                return None;
            }
            let s = (from - a) / det;
            let (u, q) = (s.dot(p), s.cross(e1));
            let v = along.dot(q);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then(|| e2.dot(q))
        });
        hits.min_by(f64::total_cmp)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn a_leaf_shows_what_rays_hit(
            corners in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(0.5..7.5f64)), 1..12), which in 0..26usize,
        ) {
            let octree = octree(8.0, 8.0);
            let direction = Direction::all().nth(which).expect("one of 26");
            let lattice = lattice(direction, 0.5);
            let triangles: Vec<_> = corners.into_iter().map(|c| Triangle { two_sided: true, ..triangle(c) }).collect();
            let cell = octree.root();
            let mut double = composite::doubled(&Orthoview::empty(&lattice, &octree.bounds(cell), 0));
            for t in &triangles {
                draw(&octree.holds(cell, 0.0), &lattice, 0.25, t, &Plain([1.0; 3]), &mut double, &mut Drawn::default());
            }
            let mut differing = 0;
            for (index, pixel) in double.pixels.iter().enumerate() {
                let at = (double.rect.at(index).as_dvec2() + 0.5) * 0.5;
                let from = lattice.unproject(at.extend(double.near - 1.0));
                let hit = cast(&triangles, from, -direction.towards_eye());
                match (hit, pixel.is_some()) {
                    (Some(way), true) => prop_assert!((way - 1.0 - f64::from(pixel.depth)).abs() < 1e-4),
                    (None, false) => {}
                    // A ray on an edge may go either way.
                    _ => differing += 1,
                }
            }
            prop_assert!(differing * 500 <= double.pixels.len(), "{differing} of {}", double.pixels.len());
        }
    }
}
