//! Triangles into a cell's image, on the CPU: the same pixels on every machine. Coverage is reckoned in whole numbers, row by
//! row; depths and texture coordinates in f64.

use super::composite;
use super::image::{Frame, Lattice, Orthoview, Pixel};
use super::texture::linear;
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
    /// Triangles left out because a corner is not finite, or 2⁴⁶ pixels away.
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

/// A cell's image, drawn from its content with twice the resolution and brought down. Only what is inside the cell is drawn,
/// so that neighbours share nothing. `None` where nothing is. Leaves are made this way; of other cells it is what a
/// composited image stands for.
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
    draw(octree, cell, lattice, 0.5 * side, meshes, &mut double, drawn);
    if double.is_empty() {
        return None;
    }
    composite::halved(&double, &mut view, side);
    Some(view)
}

/// Draws what a cell holds over an image whose pixels are `side` metres wide: a sample in the middle of each pixel, the
/// nearest stays.
pub fn draw<'t>(
    octree: &Octree,
    cell: Cell,
    lattice: &Lattice,
    side: f64,
    meshes: impl IntoIterator<Item = (&'t [Triangle], &'t dyn Surface)>,
    target: &mut Orthoview,
    drawn: &mut Drawn,
) {
    let level_side = lattice.pitch * (1u64 << cell.level) as f64;
    let mut canvas = Canvas {
        frame: lattice.frame(),
        holds: octree.holds(cell, 1e-6 * level_side),
        to_pixels: lattice.pitch / side,
        base: target.rect.min.as_dvec2(),
        size: target.rect.max - target.rect.min,
        image: target,
    };
    for (triangles, surface) in meshes {
        for triangle in triangles {
            canvas.draw(triangle, surface, drawn);
        }
    }
}

/// Steps of a pixel that corners are moved to: from there on coverage is exact, and triangles that share an edge leave no
/// gap and cover no sample twice.
const STEPS: i64 = 1 << 12;
/// Corners within this many steps of the image's corner are reckoned with in 64 bits, others in 128.
const NEAR: f64 = (1u64 << 29) as f64;
/// Corners beyond this many steps are not drawn.
const FAR: f64 = (1u64 << 58) as f64;

/// An image that is drawn on.
struct Canvas<'a> {
    frame: Frame,
    holds: Aabb,
    /// Pixels per pixel of the lattice.
    to_pixels: f64,
    base: DVec2,
    size: I64Vec2,
    image: &'a mut Orthoview,
}

/// A corner in the image: steps along x and y.
type Corner<N> = [N; 2];

impl Canvas<'_> {
    fn draw(&mut self, triangle: &Triangle, surface: &dyn Surface, drawn: &mut Drawn) {
        drawn.triangles += 1;
        let [a, b, c] = triangle.corners;
        if !(a.is_finite() && b.is_finite() && c.is_finite()) {
            drawn.not_finite += 1;
            return;
        }
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        if low.cmpgt(self.holds.max).any() || high.cmplt(self.holds.min).any() {
            return;
        }
        // In pixels of the target, from its first; so the numbers stay small far from the origin.
        let corners = triangle.corners.map(|corner| {
            let at = self.frame.project(corner);
            (at.truncate() * self.to_pixels - self.base).extend(at.z - self.image.near)
        });
        let steps = corners.map(|c| (c.truncate() * STEPS as f64).round());
        let most = steps.iter().map(|c| c.abs().max_element()).fold(0.0, f64::max);
        if most < NEAR {
            self.cover::<i64>(triangle, surface, corners, steps, drawn);
        } else if most < FAR {
            self.cover::<i128>(triangle, surface, corners, steps, drawn);
        } else {
            drawn.not_finite += 1;
        }
    }

    /// Draws the samples of a triangle: `corners` in pixels and with their depths, `steps` in whole steps. Reckons in `N`.
    #[expect(clippy::cast_possible_truncation, reason = "whole steps within FAR")]
    fn cover<N: Whole>(
        &mut self,
        triangle: &Triangle,
        surface: &dyn Surface,
        corners: [DVec3; 3],
        steps: [DVec2; 3],
        drawn: &mut Drawn,
    ) {
        let whole = |at: DVec2| [N::from(at.x as i64), N::from(at.y as i64)];
        let [a, b, c] = steps.map(whole);
        let area = cross(a, b, c);
        let zero = N::from(0);
        if area == zero {
            drawn.degenerate += 1;
            return;
        }
        let turned = area < zero;
        if turned && !triangle.two_sided {
            return;
        }
        // Pixels whose middle, at n + ½, can be inside.
        let half = STEPS / 2;
        let pixels = |of: fn(DVec2) -> f64, end: i64| {
            let [a, b, c] = steps.map(of);
            let (low, high) = (a.min(b).min(c) as i64, a.max(b).max(c) as i64);
            let first = (low - half + STEPS - 1).div_euclid(STEPS);
            [first.clamp(0, end), ((high - half).div_euclid(STEPS) + 1).clamp(0, end)]
        };
        let ([x0, x1], [y0, y1]) = (pixels(|c| c.x, self.size.x), pixels(|c| c.y, self.size.y));
        if x0 >= x1 || y0 >= y1 {
            return;
        }
        // Counter-clockwise in the image.
        let (p, q) = if turned { (c, b) } else { (b, c) };
        let edges = [Edge::new(a, p), Edge::new(p, q), Edge::new(q, a)];
        let mut shade: Option<Shade> = None;
        for y in y0..y1 {
            let (mut from, mut to) = (x0, x1);
            for edge in &edges {
                edge.narrow(y, &mut from, &mut to);
            }
            if from < to {
                let shade = shade.get_or_insert_with(|| Shade::new(triangle, corners, steps, turned, &self.holds));
                self.span(y, [from, to], triangle.material, shade, surface, drawn);
            }
        }
    }

    /// Draws the pixels from..to of a row.
    #[expect(clippy::cast_possible_truncation, reason = "relative to the cell")]
    fn span(
        &mut self,
        y: i64,
        [from, to]: [i64; 2],
        material: u32,
        shade: &Shade,
        surface: &dyn Surface,
        drawn: &mut Drawn,
    ) {
        let row = (y * self.size.x) as usize;
        let near = self.image.near;
        for x in from..to {
            let pixel = &mut self.image.pixels[row + x as usize];
            let at = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let depth = shade.depth.at(at).clamp(shade.depths[0], shade.depths[1]);
            if depth as f32 >= pixel.depth {
                continue;
            }
            if !shade.is_within {
                let point = self.frame.unproject(((at + self.base) / self.to_pixels).extend(depth + near));
                if !(point.cmpge(self.holds.min).all() && point.cmple(self.holds.max).all()) {
                    continue;
                }
            }
            let uv = DVec2::new(shade.u.at(at), shade.v.at(at));
            let Some(mut colour) = surface.colour(material, uv, shade.footprint) else { continue };
            if let Some(tint) = &shade.tint {
                for (channel, value) in colour.iter_mut().enumerate() {
                    *value *= tint[channel].at(at).clamp(0.0, 1.0) as f32;
                }
            }
            drawn.samples += 1;
            *pixel = Pixel { depth: depth as f32, colour, normal: shade.normal };
        }
    }
}

/// Numbers that coverage is reckoned with.
trait Whole:
    Copy
    + Ord
    + From<i64>
    + TryInto<i64>
    + std::ops::Add<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
{
    /// Rounded down; `by` is positive.
    fn divided_down(self, by: Self) -> Self {
        let quotient = self / by;
        if quotient * by > self { quotient - Self::from(1) } else { quotient }
    }
}
impl Whole for i64 {}
impl Whole for i128 {}

/// Twice the area of a triangle, positive if counter-clockwise.
fn cross<N: Whole>(a: Corner<N>, b: Corner<N>, c: Corner<N>) -> N {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

/// An edge with the inside to its left: inside is where e + s·x ≥ 0 for the pixel x of a row.
struct Edge<N> {
    /// Along the edge.
    along: Corner<N>,
    from: Corner<N>,
    /// What a sample on the edge is short of being inside: a pixel on an edge belongs to the triangle whose edge goes down,
    /// or to the left if it is level.
    bias: N,
}

impl<N: Whole> Edge<N> {
    fn new(from: Corner<N>, to: Corner<N>) -> Edge<N> {
        let along = [to[0] - from[0], to[1] - from[1]];
        let zero = N::from(0);
        let owns = along[1] < zero || (along[1] == zero && along[0] < zero);
        Edge { along, from, bias: N::from(i64::from(!owns)) }
    }

    /// Narrows a row's pixels to those inside.
    fn narrow(&self, y: i64, from: &mut i64, to: &mut i64) {
        let (zero, half) = (N::from(0), N::from(STEPS / 2));
        let up = N::from(y) * N::from(STEPS) + half - self.from[1];
        let e = self.along[0] * up - self.along[1] * (half - self.from[0]) - self.bias;
        let within = |x: N, to: i64| x.clamp(N::from(0), N::from(to)).try_into().unwrap_or(to);
        let falls = self.along[1] * N::from(STEPS);
        if falls == zero {
            if e < zero {
                *to = *from;
            }
        } else if falls < zero {
            // Inside from some pixel on: the least x with e ≥ falls·x.
            let rises = zero - falls;
            let first = zero - e.divided_down(rises);
            *from = (*from).max(within(first, *to));
        } else {
            let last = e.divided_down(falls);
            *to = (*to).min(within(last + N::from(1), *to));
        }
    }
}

/// A value that is linear over a triangle.
#[derive(Clone, Copy)]
struct Plane {
    at: DVec2,
    value: f64,
    slope: DVec2,
}

impl Plane {
    fn at(&self, point: DVec2) -> f64 {
        self.value + self.slope.dot(point - self.at)
    }
}

/// What the samples of a triangle have in common.
struct Shade {
    depth: Plane,
    /// Least and largest.
    depths: [f64; 2],
    u: Plane,
    v: Plane,
    /// Red, green and blue that colours are multiplied with; `None` for white.
    tint: Option<[Plane; 3]>,
    /// Side of the square in texture coordinates that a pixel covers.
    footprint: f64,
    normal: [f32; 3],
    /// No part of it is outside of the cell.
    is_within: bool,
}

impl Shade {
    #[expect(clippy::cast_possible_truncation, reason = "a unit vector")]
    fn new(triangle: &Triangle, corners: [DVec3; 3], steps: [DVec2; 3], turned: bool, holds: &Aabb) -> Shade {
        let area_of = |[a, b, c]: [DVec2; 3]| (b - a).perp_dot(c - a);
        // The planes of the corners as they are, unless they are all but in line: then of those that were moved.
        let (exact, moved) = (corners.map(DVec3::truncate), steps.map(|s| s / STEPS as f64));
        let keeps = area_of(exact) * area_of(moved) > 0.0 && area_of(exact).abs() > 0.5 * area_of(moved).abs();
        let [a, b, c] = if keeps { exact } else { moved };
        let area = area_of([a, b, c]);
        let plane = |values: [f64; 3]| {
            let (rb, rc) = (values[1] - values[0], values[2] - values[0]);
            let slope = DVec2::new(rb * (c.y - a.y) - rc * (b.y - a.y), rc * (b.x - a.x) - rb * (c.x - a.x)) / area;
            Plane { at: a, value: values[0], slope }
        };
        let depths = corners.map(|c| c.z);
        let [first, second, third] = triangle.corners;
        let normal = (second - first).cross(third - first);
        let normal = if turned { -normal } else { normal };
        let [u, v, w] = triangle.uv;
        let texture = (v - u).perp_dot(w - u).abs();
        let (low, high) = (first.min(second).min(third), first.max(second).max(third));
        Shade {
            depth: plane(depths),
            depths: [
                depths.into_iter().fold(f64::INFINITY, f64::min),
                depths.into_iter().fold(-f64::INFINITY, f64::max),
            ],
            u: plane([u.x, v.x, w.x]),
            v: plane([u.y, v.y, w.y]),
            tint: (triangle.tint != Triangle::WHITE).then(|| {
                [0, 1, 2].map(|channel| plane(triangle.tint.map(|corner| f64::from(linear(corner[channel])))))
            }),
            footprint: (texture / area.abs()).sqrt(),
            normal: normal.normalize_or_zero().to_array().map(|v| v as f32),
            is_within: low.cmpge(holds.min).all() && high.cmple(holds.max).all(),
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

    /// A square of `count` × `count` cells, each of two triangles, its inner corners off the grid.
    fn ragged(count: usize, side: f64, height: f64, off: impl Fn(usize, usize) -> [f64; 2]) -> Vec<Triangle> {
        let pitch = side / count as f64;
        let at = |i: usize, j: usize| {
            let inner = |k: usize| if k == 0 || k == count { 0.0 } else { 0.2 * pitch };
            let [x, y] = off(i, j);
            [i as f64 * pitch + inner(i) * x, j as f64 * pitch + inner(j) * y, height]
        };
        (0..count * count)
            .flat_map(|k| {
                let (i, j) = (k % count, k / count);
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                [triangle([a, b, c]), triangle([a, c, d])]
            })
            .collect()
    }

    #[test]
    fn far_corners_cover_the_same_samples_as_near_ones() {
        // One half of the plane from a corner a million metres away, in 128 bits, and from one near by, in 64.
        let octree = octree(8.0, 8.0);
        let lattice = lattice(nine()[0], 0.25);
        let drawn_by = |reach: f64| {
            let at = |t: f64| [4.1 + t, 3.9 + t, 2.0];
            let slope = [triangle([at(-reach), at(reach), [-reach, reach, 2.0]])];
            let view = leaf(
                &octree,
                octree.root(),
                &lattice,
                [(&slope[..], &Plain([1.0; 3]) as &dyn Surface)],
                &mut Drawn::default(),
            );
            view.expect("half of it").pixels.iter().map(Pixel::is_some).collect::<Vec<_>>()
        };
        let near = drawn_by(64.0);
        assert!(near.iter().filter(|some| **some).count() > 400);
        assert_eq!(near, drawn_by(1e6));
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
        fn triangles_that_share_edges_leave_no_gap_and_overlap_nowhere(
            offs in prop::collection::vec(prop::array::uniform2(-1.0..1.0f64), 121), count in 2..10usize, which in 0..26usize,
        ) {
            // Seen from above and from the corners; an overlap would be drawn twice if the later triangle were nearer.
            let direction = Direction::all().nth(which).expect("one of 26");
            prop_assume!(direction.signs()[2] > 0);
            let octree = octree(8.0, 8.0);
            let lattice = lattice(direction, 0.25);
            let content = ragged(count, 8.0, 4.0, |i, j| offs[i * 11 + j]);
            let plain = Plain([1.0; 3]);
            let mut drawn = Drawn::default();
            let mut ragged = composite::doubled(&Orthoview::empty(&lattice, &octree.bounds(octree.root()), 0));
            let mut whole = ragged.clone();
            for (k, t) in content.iter().enumerate() {
                // Each a little nearer than the one before.
                let raised = Triangle { corners: t.corners.map(|c| c + direction.towards_eye() * 1e-3 * k as f64), ..*t };
                draw(&octree, octree.root(), &lattice, 0.125, [(&[raised][..], &plain as &dyn Surface)], &mut ragged, &mut drawn);
            }
            let floor = floor(0.0, 0.0, 4.0, 8.0);
            let mut once = Drawn::default();
            draw(&octree, octree.root(), &lattice, 0.125, [(&floor[..], &plain as &dyn Surface)], &mut whole, &mut once);
            let shown = |view: &Orthoview| view.pixels.iter().map(Pixel::is_some).collect::<Vec<_>>();
            prop_assert_eq!(shown(&ragged), shown(&whole));
            prop_assert_eq!(drawn.samples, once.samples);
        }

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
            let plain = Plain([1.0; 3]);
            draw(&octree, cell, &lattice, 0.25, [(&triangles[..], &plain as &dyn Surface)], &mut double, &mut Drawn::default());
            let mut differing = 0;
            for (index, pixel) in double.pixels.iter().enumerate() {
                let at = (double.rect.at(index).as_dvec2() + 0.5) * 0.5;
                let from = lattice.unproject(at.extend(double.near - 1.0));
                let hit = cast(&triangles, from, -direction.towards_eye());
                match (hit, pixel.is_some()) {
                    (Some(way), true) if (way - 1.0 - f64::from(pixel.depth)).abs() < 1e-4 => {}
                    (None, false) => {}
                    // A ray on an edge may go either way: into nothing, or to what lies behind.
                    _ => differing += 1,
                }
            }
            prop_assert!(differing * 500 <= double.pixels.len(), "{differing} of {}", double.pixels.len());
        }
    }
}
