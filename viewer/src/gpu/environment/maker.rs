//! One face of an environment map: drawn over some frames into a scratch image, counted, and cut to what it shows.

use super::super::device::GpuError;
use super::super::item::{Lattice, Perspective};
use super::super::pipelines::Pipelines;
use super::super::renderer::{FacePass, Renderer};
use super::super::splats::Splats;
use super::super::targets::Targets;
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

/// Bytes of a pixel of a face, and of its scratch image, which has a depth besides.
pub(super) const PIXEL_BYTES: u64 = 4 + 2;
const SCRATCH_BYTES: u64 = 4 + 2 + 4;

/// Blocks along a face's side, by which it is cut: `BLOCKS` of environment.wgsl.
const BLOCKS: u32 = 16;
const BLOCK_COUNT: usize = (BLOCKS * BLOCKS) as usize;

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
    colours: wgpu::Texture,
    colours_view: wgpu::TextureView,
    codes: wgpu::Texture,
    codes_view: wgpu::TextureView,
    encode: wgpu::RenderPipeline,
    count: wgpu::ComputePipeline,
    blocks: wgpu::Buffer,
    /// What splats without normals have in their place.
    normals: wgpu::TextureView,
}

/// `Block` of environment.wgsl.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    points: u32,
    least: u32,
    most: u32,
}

/// A face that is being made.
#[derive(Debug)]
pub(super) struct Making {
    pub(super) vertex: Vertex,
    pub(super) face: usize,
    pub(super) list: Vec<Item>,
    /// What was resident when the list was chosen.
    pub(super) residents: Arc<BTreeSet<RepId>>,
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
    /// It is there; nothing where it shows nothing.
    Done(Option<Box<Splats>>),
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
        Making { vertex, face, list, residents, next: 0, answer: None }
    }
}

impl Maker {
    pub(super) fn new(renderer: &Renderer, side: u32, bias: f64) -> Result<Maker, GpuError> {
        let device = &renderer.device;
        let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let texture = |label, format, side, usage| {
            device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            })
        };
        let whole = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        let drawn = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let colours = texture("face colours", COLOURS, side, drawn);
        let codes = texture("face codes", CODES, side, drawn | wgpu::TextureUsages::TEXTURE_BINDING);
        let normals = texture("no normals", wgpu::TextureFormat::Rg8Unorm, 1, wgpu::TextureUsages::TEXTURE_BINDING);
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("environment"),
            source: wgpu::ShaderSource::Wgsl(CODE.into()),
        });
        let options = wgpu::PipelineCompilationOptions::default();
        let maker = Maker {
            side,
            bias,
            pipelines: Pipelines::new(device, &renderer.layouts, COLOURS, 1),
            targets: Targets::new(device, COLOURS, [side; 2], 1),
            colours_view: whole(&colours),
            colours,
            codes_view: whole(&codes),
            codes,
            encode: device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("face codes"),
                layout: None,
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vertex"),
                    compilation_options: options.clone(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: None,
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some("encode"),
                    compilation_options: options.clone(),
                    targets: &[Some(CODES.into())],
                }),
                multiview_mask: None,
                cache: None,
            }),
            count: device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some("face counts"),
                layout: None,
                module: &module,
                entry_point: Some("count"),
                compilation_options: options,
                cache: None,
            }),
            blocks: device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("face counts"),
                size: (12 * BLOCK_COUNT) as u64,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            }),
            normals: whole(&normals),
        };
        match pollster::block_on(memory.pop()) {
            Some(error) => Err(GpuError::Refused { what: "no memory for environment maps", reason: error.to_string() }),
            None => Ok(maker),
        }
    }

    pub(super) fn bytes(&self) -> u64 {
        scratch_bytes(self.side)
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
                THERE => match blocks(answer) {
                    Some(blocks) => Step::Done(self.cut(renderer, settings, making, &blocks).map(Box::new)),
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
            making.answer = Some(self.ask(&renderer.device, &mut encoder));
        }
        renderer.queue.submit([encoder.finish()]);
        Step::Drawn(counts.points + counts.triangles)
    }

    /// Encodes codes and counts of the scratch image.
    fn ask(&self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder) -> (wgpu::Buffer, Arc<AtomicU8>) {
        let view = |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = |label, layout: &wgpu::BindGroupLayout, entries: &[wgpu::BindGroupEntry<'_>]| {
            device.create_bind_group(&wgpu::BindGroupDescriptor { label: Some(label), layout, entries })
        };
        let depths = group("face codes", &self.encode.get_bind_group_layout(0), &[view(0, &self.targets.depth)]);
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

    /// Copies what of the scratch image shows something; nothing where nothing does.
    fn cut(
        &self,
        renderer: &Renderer,
        settings: &EnvironmentSettings,
        making: &Making,
        blocks: &[Block],
    ) -> Option<Splats> {
        let cut = Cut::of(blocks)?;
        let block = self.side / BLOCKS;
        let [from, size] = [cut.first, cut.blocks].map(|blocks| blocks.map(|blocks| blocks * block));
        let device = &renderer.device;
        let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("face") });
        let scratch = [("map colours", &self.colours), ("map codes", &self.codes)];
        let [colours, codes] = scratch.map(|(label, scratch)| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: scratch.format(),
                usage: wgpu::TextureUsages::COPY_DST | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            let origin = wgpu::Origin3d { x: from[0], y: from[1], z: 0 };
            let scratch = wgpu::TexelCopyTextureInfo { origin, ..scratch.as_image_copy() };
            encoder.copy_texture_to_texture(scratch, texture.as_image_copy(), texture.size());
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        });
        renderer.queue.submit([encoder.finish()]);
        let entry =
            |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("map"),
            layout: &renderer.layouts.splats,
            entries: &[entry(0, &colours), entry(1, &codes), entry(2, &self.normals)],
        });
        let pixel = 2.0 / f64::from(self.side);
        let (forward, up) = AXES[making.face];
        let near = settings.distance();
        // Half a pixel's diagonal, and as much more as samples come apart within the cell.
        let radius = core::f64::consts::FRAC_1_SQRT_2 * (1.0 + 3f64.sqrt() / settings.multiple);
        let first = from.map(|from| (f64::from(from) + 0.5) * pixel - 1.0);
        let face = Perspective { first, near, radius };
        // Rows of what is drawn go downwards.
        let axes = [forward.cross(up), -up, forward];
        let lattice = Lattice::face(place(making.vertex, settings.side), axes, pixel, size, face);
        let mut tile_bounds = [Aabb::EMPTY; 16];
        let tile_points = core::array::from_fn(|tile| {
            let within = cut.tile(blocks, tile);
            if within.points > 0 {
                let corner = [tile as u32 % 4, tile as u32 / 4];
                let low = core::array::from_fn(|axis| f64::from(corner[axis] * size[axis] / 4));
                let high = core::array::from_fn(|axis| f64::from((corner[axis] + 1) * size[axis] / 4 - 1));
                // Codes are rounded by half a step.
                let distance = |code: f64| near * 65_535.0 / code;
                let (nearest, farthest) = (f64::from(within.most) + 0.5, f64::from(within.least) - 0.5);
                tile_bounds[tile] = lattice.face_bounds(low, high, distance(nearest), distance(farthest));
            }
            within.points
        });
        let bytes = PIXEL_BYTES * u64::from(size[0]) * u64::from(size[1]);
        Some(Splats { lattice, group, tile_bounds, tile_points, bytes })
    }
}

/// The part of a face that is kept: its first block, and how many, columns and rows; a multiple of four each, so that tiles
/// are whole blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cut {
    first: [u32; 2],
    blocks: [u32; 2],
}

impl Cut {
    /// Around all blocks with points; `None` if there are none.
    fn of(blocks: &[Block]) -> Option<Cut> {
        let (mut low, mut high) = ([u32::MAX; 2], [0; 2]);
        for (at, _) in blocks.iter().enumerate().filter(|(_, block)| block.points > 0) {
            for (axis, at) in [at as u32 % BLOCKS, at as u32 / BLOCKS].into_iter().enumerate() {
                (low[axis], high[axis]) = (low[axis].min(at), high[axis].max(at + 1));
            }
        }
        if low[0] == u32::MAX {
            return None;
        }
        let count = [0, 1].map(|axis| (high[axis] - low[axis]).next_multiple_of(4));
        Some(Cut { first: [0, 1].map(|axis| low[axis].min(BLOCKS - count[axis])), blocks: count })
    }

    /// All of a tile's blocks as one.
    fn tile(&self, blocks: &[Block], tile: usize) -> Block {
        let [columns, rows] = self.blocks.map(|count| count / 4);
        let (column, row) = (tile as u32 % 4, tile as u32 / 4);
        let mut all = Block { points: 0, least: 65_535, most: 0 };
        for y in self.first[1] + row * rows..self.first[1] + (row + 1) * rows {
            for x in self.first[0] + column * columns..self.first[0] + (column + 1) * columns {
                let block = blocks[(y * BLOCKS + x) as usize];
                if block.points > 0 {
                    all.points += block.points;
                    all.least = all.least.min(block.least);
                    all.most = all.most.max(block.most);
                }
            }
        }
        all
    }
}

fn blocks(answer: &wgpu::Buffer) -> Option<Vec<Block>> {
    let mapped = answer.get_mapped_range(..).ok()?;
    let words: Vec<u32> = mapped.as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
    let blocks = words.as_chunks::<3>().0.iter().map(|&[points, least, most]| Block { points, least, most });
    Some(blocks.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_hold_all_points_in_tiles_of_whole_blocks() {
        let nothing = Block { points: 0, least: 65_535, most: 0 };
        let mut blocks = vec![nothing; BLOCK_COUNT];
        assert_eq!(Cut::of(&blocks), None);
        blocks[15 * 16 + 15] = Block { points: 3, least: 7, most: 9 };
        let corner = Cut { first: [12, 12], blocks: [4, 4] };
        assert_eq!(Cut::of(&blocks), Some(corner));
        assert_eq!(corner.tile(&blocks, 15), blocks[15 * 16 + 15]);
        blocks[14 * 16 + 3] = Block { points: 2, least: 5, most: 5 };
        let wide = Cut { first: [0, 12], blocks: [16, 4] };
        assert_eq!(Cut::of(&blocks), Some(wide));
        let points: u32 = (0..16).map(|tile| wide.tile(&blocks, tile).points).sum();
        assert_eq!(points, 5);
        let full = vec![Block { points: 1, least: 1, most: 65_535 }; BLOCK_COUNT];
        let all = Cut::of(&full).expect("a cut");
        assert_eq!((all, all.tile(&full, 5).points), (Cut { first: [0, 0], blocks: [16, 16] }, 16));
    }

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
