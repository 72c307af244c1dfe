//! What shaders know of a frame and of an item, as they lie in uniform buffers.

use super::pipelines::Layouts;
use super::relative::{Eye, narrow};
use super::settings::{Background, Light, RenderSettings, linear};
use crate::draw::list::{HIDDEN_MAX, Item};
use crate::scene::content::SplatImage;
use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec3, Vec3};

/// `Frame` of frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct FrameUniform {
    clip_from_relative: [[f32; 4]; 4],
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    sun: [f32; 4],
    zenith: [f32; 4],
    horizon: [f32; 4],
    ground: [f32; 4],
    world_up: [f32; 4],
    size: [u32; 4],
}

impl FrameUniform {
    pub(crate) fn new(eye: &Eye, settings: &RenderSettings, size: [u32; 2], keeps_srgb: bool) -> FrameUniform {
        let (sun, everywhere) = match settings.light {
            Light::Unlit => (DVec3::ZERO, 1.0),
            Light::Sun { towards, ambient } => (towards.normalize_or_zero(), ambient.clamp(0.0, 1.0)),
        };
        let (up, [zenith, horizon, ground]) = match settings.background {
            Background::Plain(colour) => (DVec3::Z, [colour; 3]),
            Background::Sky { up, zenith, horizon, ground } => (up.normalize_or(DVec3::Z), [zenith, horizon, ground]),
        };
        let four = |colour| Vec3::from_array(linear(colour)).extend(1.0).to_array();
        FrameUniform {
            clip_from_relative: eye.clip_from_relative.to_cols_array_2d(),
            right: eye.right.extend(eye.half_extent[0]).to_array(),
            up: eye.up.extend(eye.half_extent[1]).to_array(),
            forward: eye.forward.extend(eye.near).to_array(),
            sun: narrow(sun).extend(everywhere).to_array(),
            zenith: four(zenith),
            horizon: four(horizon),
            ground: four(ground),
            world_up: narrow(up).extend(0.0).to_array(),
            size: [size[0], size[1], settings.shape as u32, u32::from(!keeps_srgb)],
        }
    }
}

/// `Item` of item.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct ItemUniform {
    origin: [f32; 4],
    right: [f32; 4],
    up: [f32; 4],
    towards_eye: [f32; 4],
    tint: [f32; 4],
    size: [u32; 4],
    counts: [u32; 4],
    face: [f32; 4],
    hidden: [[f32; 4]; 2 * HIDDEN_MAX],
}

/// Where an orthoview's splats are: what of a [`SplatImage`] is kept beside its textures.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    origin: DVec3,
    right: DVec3,
    up: DVec3,
    towards_eye: DVec3,
    pixel: f64,
    /// Metres of a step of the depth.
    step: f64,
    size: [u32; 2],
    has_normals: bool,
    /// Of a face of an environment map.
    face: Option<Perspective>,
}

/// How the pixels of a face lie: at `origin + distance·(x·right + y·up − towards_eye)`, the pixel's tangents being
/// `first + pixel·(column, row)` and its distance `near`·65535/code.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Perspective {
    /// Tangents of the first pixel's middle.
    pub(crate) first: [f64; 2],
    /// Least distance along the face's axis, metres.
    pub(crate) near: f64,
    /// Radius of a sample's disc, in pixels.
    pub(crate) radius: f64,
}

impl Lattice {
    pub(crate) fn new(image: &SplatImage) -> Lattice {
        Lattice {
            origin: image.origin,
            right: image.right,
            up: image.up,
            towards_eye: image.towards_eye,
            pixel: image.pixel,
            step: image.range / 1023.0,
            size: image.size,
            has_normals: !image.normals.is_empty(),
            face: None,
        }
    }

    /// Of a face seen from `origin`, with unit vectors along columns, along rows, and into the face; `pixel` is a pixel's
    /// tangent.
    pub(crate) fn face(
        origin: DVec3,
        [right, up, forward]: [DVec3; 3],
        pixel: f64,
        size: [u32; 2],
        face: Perspective,
    ) -> Lattice {
        let towards_eye = -forward;
        Lattice { origin, right, up, towards_eye, pixel, step: 0.0, size, has_normals: false, face: Some(face) }
    }

    /// The box around the splats of a face's pixels from the middle of `low` to that of `high`, at distances from `near` to
    /// `far` along its axis.
    pub(crate) fn face_bounds(&self, low: [f64; 2], high: [f64; 2], near: f64, far: f64) -> Aabb {
        let reach = self.radius() * self.pixel;
        let first = self.face.map_or([0.0; 2], |face| face.first);
        let mut bounds = Aabb::EMPTY;
        for corner in 0..8 {
            let pick = |axis: usize| {
                let (at, margin) = if corner >> axis & 1 == 1 { (high[axis], reach) } else { (low[axis], -reach) };
                first[axis] + at * self.pixel + margin
            };
            let distance = if corner >> 2 == 1 { far } else { near };
            let point = self.origin + distance * (pick(0) * self.right + pick(1) * self.up - self.towards_eye);
            bounds = bounds.union(Aabb { min: point, max: point });
        }
        // A disc faces the camera: it reaches out of the face's own plane too.
        let reach = DVec3::splat(reach * far);
        Aabb { min: bounds.min - reach, max: bounds.max + reach }
    }

    /// Columns and rows of a tile: a quarter of the image's, rounded up.
    pub(crate) fn tile(&self) -> [u32; 2] {
        self.size.map(|side| side.div_ceil(4))
    }

    /// How far a splat reaches from its sample along the world's axes, metres, however steep it is.
    pub(crate) fn reach(&self) -> DVec3 {
        // SLOPE_MAX of splat.wgsl.
        let slope = 4.0;
        self.radius() * self.pixel * (self.right.abs() + self.up.abs() + slope * self.towards_eye.abs())
    }

    /// Radius of a disc that covers a pixel, in pixels: half the square's diagonal, and what the rounding of neighbours'
    /// depths can part them by, seen at 45° from the view.
    fn radius(&self) -> f64 {
        if let Some(face) = &self.face {
            return face.radius;
        }
        let rounding = if self.pixel > 0.0 { 0.5 * self.step / self.pixel } else { 0.0 };
        core::f64::consts::FRAC_1_SQRT_2 + rounding.clamp(0.0, 0.5)
    }
}

impl ItemUniform {
    fn common(item: &Item, eye: &Eye) -> ItemUniform {
        let tint = item.false_colour.map_or([0.0; 4], |colour| {
            let [red, green, blue] = linear(colour);
            [red, green, blue, 1.0]
        });
        let mut hidden = [[0.0; 4]; 2 * HIDDEN_MAX];
        let boxes = &item.hidden[..item.hidden.len().min(HIDDEN_MAX)];
        for (pair, bounds) in hidden.as_chunks_mut::<2>().0.iter_mut().zip(boxes) {
            *pair = [eye.relative(bounds.min), eye.relative(bounds.max)].map(|corner| corner.extend(0.0).to_array());
        }
        ItemUniform {
            origin: [0.0; 4],
            right: [0.0; 4],
            up: [0.0; 4],
            towards_eye: [0.0; 4],
            tint,
            size: [1; 4],
            counts: [boxes.len() as u32, 0, 0, 0],
            face: [0.0; 4],
            hidden,
        }
    }

    pub(crate) fn of_mesh(item: &Item, eye: &Eye, origin: DVec3) -> ItemUniform {
        ItemUniform { origin: eye.relative(origin).extend(0.0).to_array(), ..ItemUniform::common(item, eye) }
    }

    pub(crate) fn of_splats(item: &Item, eye: &Eye, lattice: &Lattice) -> ItemUniform {
        let mut uniform = ItemUniform::common(item, eye);
        let axis = |axis: DVec3, w: f64| narrow(axis).extend(w as f32).to_array();
        uniform.origin = eye.relative(lattice.origin).extend(lattice.pixel as f32).to_array();
        uniform.right = axis(lattice.right, lattice.step);
        uniform.up = axis(lattice.up, lattice.radius());
        uniform.towards_eye = axis(lattice.towards_eye, item.behind);
        let tile = lattice.tile();
        uniform.size = [lattice.size[0], lattice.size[1], tile[0], tile[1]];
        uniform.counts[1] = u32::from(lattice.has_normals);
        if let Some(face) = &lattice.face {
            uniform.counts[2] = 1;
            uniform.face = [face.first[0] as f32, face.first[1] as f32, face.near as f32, 0.0];
        }
        uniform
    }
}

/// The uniforms of a frame's items, one behind the other.
#[derive(Debug)]
pub(crate) struct Items {
    buffer: wgpu::Buffer,
    pub(crate) group: wgpu::BindGroup,
    /// Bytes from one item's uniforms to the next's.
    stride: usize,
}

/// Items of a frame that a first buffer takes; it is doubled as needed.
const ITEMS_FIRST: usize = 256;

impl Items {
    pub(crate) fn new(device: &wgpu::Device, layouts: &Layouts) -> Items {
        let stride = size_of::<ItemUniform>()
            .next_multiple_of(device.limits().min_uniform_buffer_offset_alignment.max(16) as usize);
        Items::of(device, layouts, stride, ITEMS_FIRST)
    }

    fn of(device: &wgpu::Device, layouts: &Layouts, stride: usize, count: usize) -> Items {
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("items"),
            size: (stride * count) as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let size = core::num::NonZeroU64::new(size_of::<ItemUniform>() as u64);
        let resource = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: &buffer, offset: 0, size });
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("items"),
            layout: &layouts.item,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource }],
        });
        Items { buffer, group, stride }
    }

    /// Where the uniforms of the item with this number are.
    pub(crate) fn offset(&self, number: usize) -> u32 {
        (number * self.stride) as u32
    }

    /// Writes the uniforms of the items that come.
    pub(crate) fn write(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        layouts: &Layouts,
        uniforms: impl ExactSizeIterator<Item = ItemUniform>,
    ) {
        let count = uniforms.len();
        let mut bytes = vec![0u8; self.stride * count];
        for (place, uniform) in bytes.chunks_exact_mut(self.stride).zip(uniforms) {
            place[..size_of::<ItemUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
        }
        if bytes.len() as u64 > self.buffer.size() {
            *self = Items::of(device, layouts, self.stride, count.next_power_of_two());
        }
        queue.write_buffer(&self.buffer, 0, &bytes);
    }
}
