//! Scenes with known pictures.

use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;
use foresight_viewer::draw::list::{ALL_TILES, DrawList, Item};
use foresight_viewer::gpu::{Background, Gpu, GpuSettings, RenderSettings, Renderer};
use foresight_viewer::scene::content::{Mesh, Part, SplatImage, Texels, Vertex};
use glam::{DMat3, DQuat, DVec3};

/// The adapter; `None` where there is none, which the continuous integration does not accept.
pub(crate) fn gpu() -> Option<Gpu> {
    match Gpu::open(&GpuSettings::default()) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{error}");
            println!("skipped: {error}");
            None
        }
    }
}

/// A renderer of pictures before pure blue, of all that is in the list.
pub(crate) fn renderer(gpu: &Gpu) -> Renderer {
    let settings =
        RenderSettings { background: Background::Plain([0, 0, 255]), occlusion: false, ..RenderSettings::default() };
    Renderer::new(gpu, settings, wgpu::TextureFormat::Rgba8UnormSrgb)
}

/// A camera at `from` that looks at `at`, z up unless it looks along z.
pub(crate) fn looking(from: DVec3, at: DVec3, viewport: [u32; 2]) -> View {
    let back = (from - at).normalize();
    let guide = if back.z.abs() > 0.999 { DVec3::Y } else { DVec3::Z };
    let right = guide.cross(back).normalize();
    let orientation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back)).normalize();
    View { position: from, orientation, fov_y: 1.0, viewport }
}

/// All of the representations with these numbers.
pub(crate) fn list(reps: impl IntoIterator<Item = u32>) -> DrawList {
    let item = |rep| Item { rep: RepId(rep), hidden: Vec::new(), behind: 0.0, tiles: ALL_TILES, false_colour: None };
    DrawList { items: reps.into_iter().map(item).collect(), ..DrawList::default() }
}

/// A rectangle in a plane.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plate {
    pub(crate) centre: DVec3,
    /// Unit, along its sides.
    pub(crate) axes: [DVec3; 2],
    /// Half its sides, metres.
    pub(crate) half: f64,
}

impl Plate {
    pub(crate) fn normal(&self) -> DVec3 {
        self.axes[0].cross(self.axes[1])
    }

    /// Metres along a ray to it; `None` where the ray misses it shrunk by `margin` metres (or grown, if negative).
    pub(crate) fn hit(&self, from: DVec3, along: DVec3, margin: f64) -> Option<f64> {
        let normal = self.normal();
        let distance = (self.centre - from).dot(normal) / along.dot(normal);
        let at = from + along * distance - self.centre;
        let inside = self.axes.iter().all(|axis| at.dot(*axis).abs() <= self.half - margin);
        (distance > 0.0 && distance.is_finite() && inside).then_some(distance)
    }
}

/// The ray through the middle of a pixel, 1 long along the view.
pub(crate) fn ray(view: &View, column: u32, row: u32) -> DVec3 {
    let [width, height] = view.viewport.map(f64::from);
    let half = libm::tan(0.5 * view.fov_y);
    let x = (2.0 * (f64::from(column) + 0.5) / width - 1.0) * half * width / height;
    let y = (1.0 - 2.0 * (f64::from(row) + 0.5) / height) * half;
    view.orientation * DVec3::new(x, y, -1.0)
}

/// A plate as two triangles, white and seen from both sides.
pub(crate) fn mesh(plate: &Plate) -> Mesh {
    let normal = plate.normal().to_array().map(|v| v as f32);
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let vertices = corners.map(|(x, y)| {
        let at = plate.half * (x * plate.axes[0] + y * plate.axes[1]);
        Vertex { position: at.to_array().map(|v| v as f32), normal, uv: [0.0; 2], tint: [255; 4] }
    });
    let points = corners.map(|(x, y)| plate.centre + plate.half * (x * plate.axes[0] + y * plate.axes[1]));
    let bounds = points.map(|min| Aabb { min, max: min }).into_iter().fold(Aabb::EMPTY, Aabb::union);
    let part = Part { indices: 0..6, base: [1.0; 3], texture: None, cutoff: 0.0, two_sided: true };
    let indices = vec![0, 1, 2, 0, 2, 3];
    Mesh { origin: plate.centre, vertices: vertices.to_vec(), indices, parts: vec![part], textures: Vec::new(), bounds }
}

fn octahedral(normal: DVec3) -> [u8; 2] {
    foresight_index::format::orthoview::octahedral(normal.to_array().map(|v| v as f32))
}

/// A plate seen from a direction as an orthoview of `side`² pixels over a cube of `cell` metres around `middle`: what a
/// file would hold, links included.
pub(crate) fn orthoview(plate: &Plate, direction: Direction, middle: DVec3, cell: f64, side: u32) -> SplatImage {
    let [right, up] = direction.image_axes();
    let towards_eye = direction.towards_eye();
    let extent = cell * 3f64.sqrt();
    let pixel = extent / f64::from(side);
    let corner = middle + 0.5 * extent * (towards_eye - right - up);
    let origin = corner + 0.5 * pixel * (right + up);
    let normal = plate.normal() * plate.normal().dot(towards_eye).signum();
    let mut image = SplatImage {
        direction,
        origin,
        right,
        up,
        towards_eye,
        pixel,
        range: extent,
        size: [side; 2],
        colours: Vec::new(),
        shapes: Vec::new(),
        normals: Vec::new(),
        colours_kept: Texels::Plain,
        normals_kept: Texels::Plain,
        bounds: Aabb { min: middle - 0.5 * cell, max: middle + 0.5 * cell },
    };
    let depth = |column: u32, row: u32| {
        let from = origin + pixel * (f64::from(column) * right + f64::from(row) * up);
        plate.hit(from, -towards_eye, 0.0).map(|depth| (depth / extent * 1023.0).round() as u16)
    };
    for row in 0..side {
        for column in 0..side {
            let bits = depth(column, row).map_or(0, |own| {
                // A plane's samples are of one surface; within the image all have eight neighbours but at the border.
                let mut links = 0;
                for (dx, dy) in [(1, 0), (0, 1), (-1, 1), (1, 1), (-1, 0), (0, -1), (1, -1), (-1, -1)] {
                    let [x, y] = [column.checked_add_signed(dx), row.checked_add_signed(dy)];
                    let there = x.zip(y).filter(|&(x, y)| x < side && y < side).and_then(|(x, y)| depth(x, y));
                    links += u32::from(there.is_some());
                }
                own | 0x8000 | if links > 4 { 0x4000 } else { 0 }
            });
            image.shapes.push(bits);
            image.colours.extend([200, 100, 50, 255]);
            image.normals.extend(octahedral(normal));
        }
    }
    image
}
