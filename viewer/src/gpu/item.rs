//! What shaders know of a frame and of an item, as they lie in uniform buffers.

use super::relative::{Eye, narrow};
use super::settings::{Background, Light, RenderSettings, linear};
use crate::draw::list::{HIDDEN_MAX, Item};
use crate::scene::content::SplatImage;
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
        }
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
        uniform.towards_eye = axis(lattice.towards_eye, 0.0);
        let tile = lattice.tile();
        uniform.size = [lattice.size[0], lattice.size[1], tile[0], tile[1]];
        uniform.counts[1] = u32::from(lattice.has_normals);
        uniform
    }
}
