//! Against popping: the frame before, seen from here, fades into this one (\[HIBR\] §5.3).
//!
//! A pixel's place in the world is looked up in the frame before; if that showed something at the same distance, within a
//! threshold, the colour is now·(1 − a) + before·a with a = exp(−Δt/τ), Δt being the time since. A swap of representations
//! so takes about τ instead of one frame, and what was hidden, or outside the picture, is shown as it is. The price is some
//! sharpness while the camera moves: each frame samples the last between its pixels.

use super::device::GpuError;
use super::distance;
use super::picture::Picture;
use super::pipelines::{texture, whole_picture};
use super::relative::{Eye, narrow};
use super::renderer::{FrameCounts, Renderer};
use crate::draw::list::DrawList;
use foresight_scheduler::view::View;

const CODE: &str = include_str!("../shader/reproject.wgsl");

/// What is kept of frames: more digits than the picture, or a fade would stop short of its end.
const KEPT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;

/// Pictures with more do not fade: what is kept takes 28 bytes a pixel.
const PIXELS_MAX: u64 = 1 << 24;

/// How frames fade.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FadeSettings {
    /// τ, seconds: after it 1/e of what was is left. 0 for none at all.
    pub time_s: f64,
    /// Share of its distance by which a surface may seem to have moved.
    pub depth_threshold: f32,
}

impl Default for FadeSettings {
    fn default() -> FadeSettings {
        FadeSettings { time_s: 0.15, depth_threshold: 0.02 }
    }
}

/// `Change` of reproject.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct Change {
    clip_before: [[f32; 4]; 4],
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    moved: [f32; 4],
}

/// Colours and distances of a frame.
#[derive(Debug)]
struct Frame {
    colours: wgpu::TextureView,
    distances: wgpu::TextureView,
}

/// The frame drawn now, and twice what is kept: of the frame before, and of this one.
#[derive(Debug)]
struct Frames {
    size: [u32; 2],
    colours: wgpu::TextureView,
    kept: [Frame; 2],
    /// Which of the two is of the frame before.
    before: usize,
    /// The view of the frame before; none before the first.
    view: Option<View>,
}

/// Fading for one renderer.
#[derive(Debug)]
pub struct Reprojection {
    /// How frames fade, to be changed between two of them.
    pub settings: FadeSettings,
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
    change: wgpu::Buffer,
    frames: Option<Frames>,
}

fn plane(device: &wgpu::Device, format: wgpu::TextureFormat, [width, height]: [u32; 2]) -> wgpu::TextureView {
    let texture = device.create_texture(&wgpu::TextureDescriptor {
        label: Some("frame before"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    });
    texture.create_view(&wgpu::TextureViewDescriptor::default())
}

impl Frames {
    fn new(device: &wgpu::Device, format: wgpu::TextureFormat, size: [u32; 2]) -> Frames {
        let kept =
            || Frame { colours: plane(device, KEPT_FORMAT, size), distances: plane(device, distance::FORMAT, size) };
        Frames { size, colours: plane(device, format, size), kept: [kept(), kept()], before: 0, view: None }
    }
}

impl Reprojection {
    /// For frames of a renderer.
    pub fn new(renderer: &Renderer, settings: FadeSettings) -> Reprojection {
        let device = &renderer.device;
        let exact = wgpu::TextureSampleType::Float { filterable: false };
        let plane = |binding| texture(binding, wgpu::ShaderStages::FRAGMENT, exact, false);
        let uniform = wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Uniform,
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("reproject"),
            entries: &[uniform, plane(1), plane(2), plane(3), plane(4)],
        });
        let targets = [Some(renderer.format.into()), Some(KEPT_FORMAT.into())];
        let pipeline = whole_picture(device, "reproject", CODE, &[Some(&layout)], &targets);
        let change = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("change"),
            size: size_of::<Change>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Reprojection { settings, layout, pipeline, change, frames: None }
    }

    /// Forgets the frame before: after a cut, or when time stood still.
    pub fn forget(&mut self) {
        if let Some(frames) = &mut self.frames {
            frames.view = None;
        }
    }

    /// As [`Renderer::draw`], `elapsed_s` seconds after the frame before.
    ///
    /// # Errors
    /// Those of [`Renderer::draw`].
    pub fn draw(
        &mut self,
        renderer: &mut Renderer,
        view: &View,
        list: &DrawList,
        elapsed_s: f64,
        target: &wgpu::TextureView,
        size: [u32; 2],
    ) -> Result<FrameCounts, GpuError> {
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("frame") };
        let mut encoder = renderer.device.create_command_encoder(&descriptor);
        let counts = self.encode(renderer, &mut encoder, view, list, elapsed_s, target, size)?;
        renderer.queue.submit([encoder.finish()]);
        renderer.faults.check("a frame")?;
        Ok(counts)
    }

    /// As [`Renderer::picture`], `elapsed_s` seconds after the frame before.
    ///
    /// # Errors
    /// Those of [`Renderer::picture`].
    pub fn picture(
        &mut self,
        renderer: &mut Renderer,
        view: &View,
        list: &DrawList,
        elapsed_s: f64,
    ) -> Result<(Picture, FrameCounts), GpuError> {
        let size = view.viewport;
        renderer.read_back(size, |renderer, encoder, target| {
            self.encode(renderer, encoder, view, list, elapsed_s, target, size)
        })
    }

    #[expect(clippy::too_many_arguments, reason = "what draw takes, and where to")]
    pub(crate) fn encode(
        &mut self,
        renderer: &mut Renderer,
        encoder: &mut wgpu::CommandEncoder,
        view: &View,
        list: &DrawList,
        elapsed_s: f64,
        target: &wgpu::TextureView,
        size: [u32; 2],
    ) -> Result<FrameCounts, GpuError> {
        let settings = self.settings;
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        let fades = settings.time_s > 0.0 && settings.time_s.is_finite() && pixels <= PIXELS_MAX;
        super::targets::fitting(&renderer.device.limits(), size, 1)?;
        if !fades {
            self.frames = None;
            return renderer.encode(encoder, view, list, target, size);
        }
        if self.frames.as_ref().is_none_or(|frames| frames.size != size) {
            self.frames = Some(Frames::new(&renderer.device, renderer.format, size));
        }
        let Some(frames) = &mut self.frames else {
            return Ok(FrameCounts::default());
        };
        let counts = renderer.encode(encoder, view, list, &frames.colours, size)?;
        let (before, now) = (&frames.kept[frames.before], &frames.kept[1 - frames.before]);
        renderer.encode_distances(encoder, &now.distances);

        let near = renderer.settings().near;
        let eye = Eye::new(view, size, near);
        let keeps = match frames.view {
            Some(_) if elapsed_s >= 0.0 => libm::exp(-elapsed_s / settings.time_s),
            _ => 0.0,
        };
        let view_before = frames.view.replace(*view).unwrap_or(*view);
        let moved = narrow(view.position - view_before.position);
        let change = Change {
            clip_before: Eye::new(&view_before, size, near).clip_from_relative.to_cols_array_2d(),
            right: eye.right.extend(eye.half_extent[0]).to_array(),
            up: eye.up.extend(eye.half_extent[1]).to_array(),
            forward: eye.forward.extend(keeps as f32).to_array(),
            moved: moved.extend(settings.depth_threshold).to_array(),
        };
        renderer.queue.write_buffer(&self.change, 0, bytemuck::bytes_of(&change));
        let entry =
            |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = renderer.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("reproject"),
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.change.as_entire_binding() },
                entry(1, &frames.colours),
                entry(2, &now.distances),
                entry(3, &before.colours),
                entry(4, &before.distances),
            ],
        });
        let into = |view| {
            Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("reproject"),
            color_attachments: &[into(target), into(&now.colours)],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        frames.before = 1 - frames.before;
        Ok(counts)
    }
}
