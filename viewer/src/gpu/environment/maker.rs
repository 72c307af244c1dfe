//! One face of an environment map: drawn over some frames into a scratch image, without what the map's base shows as well,
//! counted, and made a list of points, block by block, so that a tile is a range of it.

use super::super::device::GpuError;
use super::super::item::{Lattice, Perspective};
use super::super::pipelines::{Pipelines, over_all};
use super::super::relative::narrow;
use super::super::renderer::{FacePass, Renderer};
use super::super::splats::{Splats, Tiles};
use super::super::targets::Targets;
use super::blocks::{self, BLOCK_COUNT, BLOCKS, Block, corner, layout, merged};
use crate::draw::environment::{EnvironmentSettings, Vertex, place};
use crate::draw::list::Item;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;
use glam::{DMat3, DQuat, DVec3};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

const CODE: &str = include_str!("../../shader/environment.wgsl");

/// sRGB, so that dark colours keep their digits.
const COLOURS: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;
const CODES: wgpu::TextureFormat = wgpu::TextureFormat::R16Uint;

/// Bytes of a point in a list, and of a pixel of the scratch image: colour, code and depth.
const POINT_BYTES: u64 = 8;
const SCRATCH_BYTES: u64 = 4 + 2 + 4;

/// Points in a row of a list.
const ROW: u32 = 1024;

/// What is left out of a map lies at most so many times farther apart in its base: √(1/`DENSE`) of environment.wgsl.
const SPARSE: f64 = 1.12;

const WAITING: u8 = 0;
const THERE: u8 = 1;
const FAILED: u8 = 2;

/// The axis along which each of a map's faces looks, and what is up in it.
const AXES: [(DVec3, DVec3); 6] = [
    (DVec3::X, DVec3::Z),
    (DVec3::NEG_X, DVec3::Z),
    (DVec3::Y, DVec3::Z),
    (DVec3::NEG_Y, DVec3::Z),
    (DVec3::Z, DVec3::Y),
    (DVec3::NEG_Z, DVec3::Y),
];

/// What all faces of a size are made with.
#[derive(Debug)]
pub(super) struct Maker {
    /// Pixels along a face's side.
    pub(super) side: u32,
    /// What is drawn is so many times coarser than a face could show, so that it is as fine as in the picture.
    pub(super) bias: f64,
    pipelines: Pipelines,
    targets: Targets,
    colours_view: wgpu::TextureView,
    codes: wgpu::Texture,
    codes_view: wgpu::TextureView,
    encode: wgpu::RenderPipeline,
    count: wgpu::ComputePipeline,
    fill: wgpu::ComputePipeline,
    blocks: wgpu::Buffer,
    starts: wgpu::Buffer,
    face: wgpu::Buffer,
    /// What splats of lists have in the places of colours and normals.
    nothing: wgpu::TextureView,
    /// The base of maps that have none.
    no_base: wgpu::TextureView,
}

/// `Face` of environment.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct FaceUniform {
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    moved: [f32; 4],
}

/// The codes of a map's faces, for others to leave out what it shows.
#[derive(Clone, Debug)]
pub(super) struct Codes {
    texture: wgpu::Texture,
    all: wgpu::TextureView,
    pub(super) bytes: u64,
}

/// A face that is being made.
#[derive(Debug)]
pub(super) struct Making {
    pub(super) vertex: Vertex,
    pub(super) face: usize,
    pub(super) list: Vec<Item>,
    /// What was resident when the list was chosen.
    pub(super) residents: Arc<BTreeSet<RepId>>,
    /// Whose map shows what is left out.
    pub(super) base: Option<(Vertex, Codes)>,
    /// Where the face's codes are kept.
    pub(super) keeps: Option<Codes>,
    /// Items drawn so far.
    next: usize,
    /// Once all are drawn: the blocks, on their way.
    answer: Option<(wgpu::Buffer, Arc<AtomicU8>)>,
}

/// How a face stands after a step.
pub(super) enum Step {
    /// It goes on, after so many points and triangles.
    Drawn(u64),
    /// The answer is not there yet.
    Waits,
    /// The counts were not to be had.
    Failed,
    /// It is there: the quarters that show anything, and their bytes.
    Done(Vec<Splats>, u64),
}

/// Bytes that making faces of a size takes.
pub(super) fn scratch_bytes(side: u32) -> u64 {
    SCRATCH_BYTES * u64::from(side) * u64::from(side)
}

/// The view of a face of `side`² pixels.
pub(super) fn face_view(vertex: Vertex, face: usize, settings: &EnvironmentSettings, side: u32) -> View {
    let (forward, up) = AXES[face];
    let orientation = DQuat::from_mat3(&DMat3::from_cols(forward.cross(up), up, -forward)).normalize();
    let fov_y = core::f64::consts::FRAC_PI_2;
    View { position: place(vertex, settings.side), orientation, fov_y, viewport: [side; 2] }
}

/// What the map at a vertex does not show.
pub(super) fn cube(vertex: Vertex, settings: &EnvironmentSettings) -> Aabb {
    let (at, distance) = (place(vertex, settings.side), settings.distance());
    Aabb { min: at - distance, max: at + distance }
}

impl Making {
    pub(super) fn new(vertex: Vertex, face: usize, list: Vec<Item>, residents: Arc<BTreeSet<RepId>>) -> Making {
        Making { vertex, face, list, residents, base: None, keeps: None, next: 0, answer: None }
    }
}

/// All layers of a texture.
fn layers(texture: &wgpu::Texture) -> wgpu::TextureView {
    let dimension = Some(wgpu::TextureViewDimension::D2Array);
    texture.create_view(&wgpu::TextureViewDescriptor { dimension, ..Default::default() })
}

impl Maker {
    pub(super) fn new(renderer: &Renderer, side: u32, bias: f64) -> Result<Maker, GpuError> {
        let device = &renderer.device;
        let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let texture = |label, format, side, layers, usage| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let whole = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("environment"),
            source: wgpu::ShaderSource::Wgsl(CODE.into()),
        });
        let read = wgpu::TextureUsages::TEXTURE_BINDING;
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT | read;
        let colours = texture("face colours", COLOURS, side, 1, drawn);
        let codes = texture("face codes", CODES, side, 1, drawn | wgpu::TextureUsages::COPY_SRC);
        let nothing = texture("no colours", wgpu::TextureFormat::Rg8Unorm, 1, 1, read);
        let no_base = texture("no base", CODES, 1, 6, read);
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        let compute = |entry_point| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry_point),
                layout: None,
                module: &module,
                entry_point: Some(entry_point),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                cache: None,
            })
        };
        let maker = Maker {
            side,
            bias,
            pipelines: Pipelines::new(device, &renderer.layouts, COLOURS, 1),
            targets: Targets::new(device, COLOURS, [side; 2], 1),
            colours_view: whole(&colours),
            codes_view: whole(&codes),
            codes,
            encode: over_all(device, "face codes", None, &module, "encode", &[Some(CODES.into())]),
            count: compute("count"),
            fill: compute("fill"),
            blocks: buffer(
                "face counts",
                (12 * BLOCK_COUNT) as u64,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
            ),
            starts: buffer(
                "face starts",
                (4 * BLOCK_COUNT) as u64,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            ),
            face: buffer(
                "face",
                size_of::<FaceUniform>() as u64,
                wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            ),
            nothing: whole(&nothing),
            no_base: layers(&no_base),
        };
        match pollster::block_on(memory.pop()) {
            Some(error) => Err(GpuError::Refused { what: "no memory for environment maps", reason: error.to_string() }),
            None => Ok(maker),
        }
    }

    pub(super) fn bytes(&self) -> u64 {
        scratch_bytes(self.side)
    }

    /// Room for the codes of a map.
    pub(super) fn codes(&self, renderer: &Renderer) -> Codes {
        let side = self.side;
        let texture = renderer.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("map codes"),
            size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 6 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: CODES,
            usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        Codes { all: layers(&texture), texture, bytes: 6 * 2 * u64::from(side) * u64::from(side) }
    }

    /// Goes on with a face: draws until `budget`, or fetches the counts and cuts it.
    pub(super) fn step(
        &self,
        renderer: &mut Renderer,
        settings: &EnvironmentSettings,
        making: &mut Making,
        budget: u64,
    ) -> Step {
        if let Some((answer, state)) = &making.answer {
            return match state.load(Ordering::Acquire) {
                WAITING => Step::Waits,
                THERE => match blocks::read(answer) {
                    Some(blocks) => self.fill(renderer, settings, making, &blocks),
                    None => Step::Failed,
                },
                _ => Step::Failed,
            };
        }
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("environment map") };
        let mut encoder = renderer.device.create_command_encoder(&descriptor);
        let pass = FacePass {
            pipelines: &self.pipelines,
            targets: &self.targets,
            colours: &self.colours_view,
            view: face_view(making.vertex, making.face, settings, self.side),
            near: settings.distance(),
            cube: cube(making.vertex, settings),
            is_first: making.next == 0,
        };
        let (taken, counts) = renderer.compose(&mut encoder, &pass, &making.list[making.next..], budget);
        making.next += taken;
        if making.next >= making.list.len() {
            making.answer = Some(self.ask(renderer, settings, making, &mut encoder));
        }
        renderer.queue.submit([encoder.finish()]);
        Step::Drawn(counts.points + counts.triangles)
    }

    /// Encodes codes and counts of the scratch image.
    fn ask(
        &self,
        renderer: &Renderer,
        settings: &EnvironmentSettings,
        making: &Making,
        encoder: &mut wgpu::CommandEncoder,
    ) -> (wgpu::Buffer, Arc<AtomicU8>) {
        let device = &renderer.device;
        let (forward, up) = AXES[making.face];
        let base = making.base.as_ref();
        let moved = base.map_or(DVec3::ZERO, |(base, _)| {
            let steps = core::array::from_fn(|axis| (making.vertex[axis] - base[axis]) as f64);
            DVec3::from_array(steps) * settings.side
        });
        let axis = |axis: DVec3, w: f64| narrow(axis).extend(w as f32).to_array();
        let face = FaceUniform {
            right: axis(forward.cross(up), 0.0),
            up: axis(up, 0.0),
            forward: axis(forward, settings.distance()),
            moved: axis(moved, f64::from(u8::from(base.is_some()))),
        };
        renderer.queue.write_buffer(&self.face, 0, bytemuck::bytes_of(&face));
        let view = |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = |label, layout: &wgpu::BindGroupLayout, entries: &[wgpu::BindGroupEntry<'_>]| {
            device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries })
        };
        let depths = group(
            "face codes",
            &self.encode.get_bind_group_layout(0),
            &[
                view(0, &self.targets.depth),
                wgpu::BindGroupEntry { binding: 3, resource: self.face.as_entire_binding() },
                view(4, base.map_or(&self.no_base, |(_, codes)| &codes.all)),
            ],
        );
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("face codes"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &self.codes_view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.encode);
        pass.set_bind_group(0, &depths, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        if let Some(Codes { texture, .. }) = &making.keeps {
            let origin = wgpu::Origin3d { z: making.face as u32, ..wgpu::Origin3d::ZERO };
            let layer = wgpu::TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
            encoder.copy_texture_to_texture(self.codes.as_image_copy(), layer, self.codes.size());
        }
        let blocks = wgpu::BindGroupEntry { binding: 2, resource: self.blocks.as_entire_binding() };
        let codes = group("face counts", &self.count.get_bind_group_layout(0), &[view(1, &self.codes_view), blocks]);
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.count);
        pass.set_bind_group(0, &codes, &[]);
        pass.dispatch_workgroups(BLOCKS, BLOCKS, 1);
        drop(pass);
        let answer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("face counts"),
            size: self.blocks.size(),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        encoder.copy_buffer_to_buffer(&self.blocks, 0, &answer, 0, answer.size());
        let state = Arc::new(AtomicU8::new(WAITING));
        let told = Arc::clone(&state);
        encoder.map_buffer_on_submit(&answer, wgpu::MapMode::Read, .., move |result| {
            told.store(if result.is_ok() { THERE } else { FAILED }, Ordering::Release);
        });
        (answer, state)
    }

    /// Makes the list of what is left of the scratch image.
    fn fill(&self, renderer: &Renderer, settings: &EnvironmentSettings, making: &Making, blocks: &[Block]) -> Step {
        let (starts, ranges, points) = layout(blocks);
        if points == 0 {
            return Step::Done(Vec::new(), 0);
        }
        let device = &renderer.device;
        let rows = points.div_ceil(ROW);
        let list = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("map points"),
            size: wgpu::Extent3d { width: ROW, height: rows, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rg32Uint,
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let list = list.create_view(&wgpu::TextureViewDescriptor::default());
        renderer.queue.write_buffer(&self.starts, 0, bytemuck::cast_slice(&starts));
        let entry =
            |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("map points"),
            layout: &self.fill.get_bind_group_layout(0),
            entries: &[
                entry(1, &self.codes_view),
                entry(5, &self.colours_view),
                wgpu::BindGroupEntry { binding: 6, resource: self.starts.as_entire_binding() },
                entry(7, &list),
            ],
        });
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("map points") });
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&self.fill);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(BLOCKS, BLOCKS, 1);
        drop(pass);
        renderer.queue.submit([encoder.finish()]);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("map"),
            layout: &renderer.layouts.splats,
            entries: &[entry(0, &self.nothing), entry(1, &list), entry(2, &self.nothing)],
        });
        let pixel = 2.0 / f64::from(self.side);
        let (forward, up) = AXES[making.face];
        let near = settings.distance();
        // Half a pixel's diagonal, and as much more as samples come apart.
        let radius = core::f64::consts::FRAC_1_SQRT_2 * SPARSE * (1.0 + 3f64.sqrt() / settings.multiple);
        let face = Perspective { first: [0.5 * pixel - 1.0; 2], near, radius };
        // Rows of what is drawn go downwards.
        let axes = [forward.cross(up), -up, forward];
        let lattice = Lattice::face(place(making.vertex, settings.side), axes, pixel, [points, 1], face);
        let across = f64::from(self.side / 8);
        let quarters = ranges.into_iter().enumerate().filter_map(|(quarter, tile_ranges)| {
            let mut tile_bounds = [Aabb::EMPTY; 16];
            for (tile, bounds) in tile_bounds.iter_mut().enumerate() {
                let [column, row] = corner(quarter, tile);
                let within = merged(blocks, [column, row]);
                if within.points > 0 {
                    let low = [column, row].map(|at| f64::from(at) * across);
                    // Codes are rounded by half a step.
                    let distance = |code: f64| near * 65_535.0 / code;
                    let (nearest, farthest) = (f64::from(within.most) + 0.5, f64::from(within.least) - 0.5);
                    let high = low.map(|low| low + across - 1.0);
                    *bounds = lattice.face_bounds(low, high, distance(nearest), distance(farthest));
                }
            }
            let tile_points = tile_ranges.clone().map(|range| range.end - range.start);
            let (lattice, group) = (lattice.clone(), group.clone());
            let is_empty = tile_points.iter().all(|&points| points == 0);
            let tiles = Tiles::Ranges(Box::new(tile_ranges));
            (!is_empty).then(|| Splats { lattice, group, tile_bounds, tile_points, tiles, bytes: 0 })
        });
        Step::Done(quarters.collect(), POINT_BYTES * u64::from(ROW) * u64::from(rows))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn six_faces_look_all_round() {
        let settings = EnvironmentSettings::with_side(2.0);
        for (face, (forward, up)) in AXES.into_iter().enumerate() {
            let view = face_view([1, 2, 3], face, &settings, 64);
            view.check().expect("a view");
            assert_eq!(view.position, DVec3::new(2.0, 4.0, 6.0));
            assert!((view.forward() - forward).length() < 1e-12);
            assert!((view.orientation * DVec3::Y - up).length() < 1e-12);
        }
        assert_eq!(AXES.iter().map(|(forward, _)| *forward).sum::<DVec3>(), DVec3::ZERO);
    }
}
