//! A tree beside a wall, as in \[HIBR\] Figure 8: what is connected and what is not, in one cell.

use foresight_index::format::orthoview::planes;
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::raster::{self, Drawn, Plain, Surface, Triangle};
use foresight_index::orthoview::{Direction, Lattice};
use foresight_scheduler::lod_tree::Aabb;
use foresight_viewer::scene::content::{Mesh, Part, SplatImage, Texels, Vertex};
use glam::{DQuat, DVec2, DVec3};

/// Side of the cell, metres.
pub(crate) const SIDE: f64 = 16.0;

/// What is looked at: between the tree and the wall.
pub(crate) const MIDDLE: DVec3 = DVec3::new(7.5, 8.0, 3.6);

/// Numbers in 0..1 from a seed, the same everywhere.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    /// A colour whose brightness varies by ± `by`.
    fn tinted(&mut self, colour: [u8; 3], by: f64) -> [u8; 3] {
        let factor = 1.0 + by * (2.0 * self.next() - 1.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
        colour.map(|c| (f64::from(c) * factor).clamp(0.0, 255.0) as u8)
    }
}

fn quad(out: &mut Vec<Triangle>, corner: DVec3, [u, v]: [DVec3; 2], colour: [u8; 3], two_sided: bool) {
    let at = [corner, corner + u, corner + u + v, corner + v];
    for corners in [[at[0], at[1], at[2]], [at[0], at[2], at[3]]] {
        out.push(Triangle { corners, uv: [DVec2::ZERO; 3], material: 0, tint: [colour; 3], two_sided });
    }
}

/// A wall of bricks with mortar between them.
pub(crate) fn wall() -> Vec<Triangle> {
    let mut numbers = Numbers(8);
    let mut out = Vec::new();
    let (left, width, high, front) = (3.0, 11.0, 7.0, 10.5);
    quad(&mut out, DVec3::new(left, front, 0.2), [width * DVec3::X, high * DVec3::Z], [168, 164, 158], false);
    quad(&mut out, DVec3::new(left, front, 0.2 + high), [width * DVec3::X, 0.5 * DVec3::Y], [150, 146, 140], false);
    for row in 0..23 {
        for brick in 0..18 {
            let shift = if row % 2 == 0 { 0.0 } else { 0.3 };
            let corner =
                DVec3::new(left + 0.05 + shift + 0.6 * f64::from(brick), front - 0.02, 0.25 + 0.3 * f64::from(row));
            let colour = numbers.tinted([164, 84, 62], 0.25);
            quad(&mut out, corner, [0.54 * DVec3::X, 0.24 * DVec3::Z], colour, false);
        }
    }
    out
}

/// A trunk and some 3,600 leaves.
pub(crate) fn tree() -> Vec<Triangle> {
    let mut numbers = Numbers(9);
    let mut out = Vec::new();
    let trunk = DVec3::new(6.0, 7.0, 0.2);
    for side in 0..8 {
        let around = |k: i32| {
            let angle = core::f64::consts::TAU * f64::from(k) / 8.0;
            trunk + 0.22 * DVec3::new(libm::cos(angle), libm::sin(angle), 0.0)
        };
        let (a, b) = (around(side), around(side + 1));
        quad(&mut out, a, [b - a, 4.2 * DVec3::Z], numbers.tinted([92, 66, 44], 0.2), false);
    }
    for _ in 0..7000 {
        let mut unit =
            || DVec3::new(numbers.between(-1.0, 1.0), numbers.between(-1.0, 1.0), numbers.between(-1.0, 1.0));
        let (place, turn) = (unit(), unit());
        if place.length_squared() > 1.0 {
            continue;
        }
        let about = turn.normalize_or(DVec3::Z);
        let turn = DQuat::from_axis_angle(about, numbers.between(0.0, core::f64::consts::TAU));
        let size = numbers.between(0.08, 0.2);
        let corner = trunk + DVec3::new(0.0, 0.0, 5.0) + place * DVec3::new(2.7, 2.7, 2.3);
        let colour = numbers.tinted([70, 120, 44], 0.45);
        quad(&mut out, corner, [turn * DVec3::X * size, turn * DVec3::Y * 0.6 * size], colour, true);
    }
    out
}

/// Both.
pub(crate) fn tree_beside_wall() -> Vec<Triangle> {
    let mut both = wall();
    both.extend(tree());
    both
}

/// The scene as triangles on the GPU.
pub(crate) fn mesh(triangles: &[Triangle]) -> Mesh {
    let mut mesh = Mesh {
        origin: MIDDLE,
        vertices: Vec::new(),
        indices: Vec::new(),
        parts: Vec::new(),
        textures: Vec::new(),
        bounds: Aabb { min: DVec3::ZERO, max: DVec3::splat(SIDE) },
    };
    for two_sided in [false, true] {
        let first = mesh.indices.len() as u32;
        for triangle in triangles.iter().filter(|t| t.two_sided == two_sided) {
            let [a, b, c] = triangle.corners;
            #[expect(clippy::cast_possible_truncation, reason = "metres within the cell")]
            let narrow = |v: DVec3| v.to_array().map(|v| v as f32);
            let normal = narrow((b - a).cross(c - a).normalize_or_zero());
            for (corner, [red, green, blue]) in triangle.corners.into_iter().zip(triangle.tint) {
                mesh.indices.push(mesh.vertices.len() as u32);
                let position = narrow(corner - mesh.origin);
                mesh.vertices.push(Vertex { position, normal, uv: [0.0; 2], tint: [red, green, blue, 255] });
            }
        }
        let indices = first..mesh.indices.len() as u32;
        mesh.parts.push(Part { indices, base: [1.0; 3], texture: None, cutoff: 0.0, two_sided });
    }
    mesh
}

/// The scene as an orthoview of `pixels` a side of the cell, as a file would hold it. `None` if nothing is seen.
pub(crate) fn orthoview(triangles: &[Triangle], direction: Direction, pixels: u32) -> Option<SplatImage> {
    let octree = Octree::of(DVec3::ZERO, SIDE, [0; 3])?;
    let cell = Cell { level: 0, place: [0; 3] };
    let lattice = Lattice { direction, origin: octree.origin(), pitch: SIDE / f64::from(pixels) };
    let plain = Plain([1.0; 3]);
    let meshes = [(triangles, &plain as &dyn Surface)];
    let view = raster::leaf(&octree, cell, &lattice, meshes, &mut Drawn::default())?;
    let planes = planes(&view, &links(&view, &lattice, &Thresholds::default()))?;
    let middle = planes.rect.min.as_dvec2() + 0.5;
    let [right, up] = direction.image_axes();
    Some(SplatImage {
        direction,
        origin: lattice.unproject(middle.extend(view.near)),
        right,
        up,
        towards_eye: direction.towards_eye(),
        pixel: lattice.pitch,
        range: view.range,
        size: [planes.rect.width() as u32, planes.rect.height() as u32],
        colours: planes.colours.as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect(),
        shapes: planes.depths.iter().zip(&planes.links).map(|(depth, links)| depth | u16::from(*links) << 10).collect(),
        normals: planes.normals,
        colours_kept: Texels::Plain,
        normals_kept: Texels::Plain,
        bounds: octree.bounds(cell),
    })
}
