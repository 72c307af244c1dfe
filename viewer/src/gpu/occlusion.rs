//! Occlusion culling by tiles of orthoviews (\[HIBR\] §6.1), within one frame and without waiting for the GPU.
//!
//! 1. What was seen in the last frame that is known of, and all triangles, are drawn.
//! 2. From their depths a pyramid of the farthest is made, and the boxes of all tiles are tested against it.
//! 3. Of the tiles not drawn yet, those that may be seen are: their draws are indirect, and the test has set the number of
//!    instances of the others to 0.
//!
//! A tile is left out only if something drawn in this very frame is nearer than its box in every pixel, and sample, that the
//! box reaches; so the picture is the one without culling, however wrong the guess of step 1 was. The test's answers are
//! read back when they are there, a frame or two later, and are the next guess. \[HIBR\] used hardware queries, whose
//! answers wgpu gives to the CPU only; they would cost either a wait or a frame of delay in which things pop.

use super::relative::Eye;
use super::splats::Splats;
use super::targets::Targets;
use crate::draw::tiles::TILES;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

const PYRAMID: &str = include_str!("../shader/pyramid.wgsl");
const OCCLUSION: &str = include_str!("../shader/occlusion.wgsl");

/// Most tiles that are tested in a frame; what is beyond is drawn untested. 1,000 orthoviews.
const TESTED_MAX: usize = 16_000;

/// What an adapter has to be able to do.
pub(crate) const NEEDS: wgpu::DownlevelFlags =
    wgpu::DownlevelFlags::COMPUTE_SHADERS.union(wgpu::DownlevelFlags::INDIRECT_EXECUTION);

/// What was drawn of a frame's orthoviews.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OcclusionCounts {
    /// Tiles with something in them that were in the view.
    pub tiles: u32,
    /// Those drawn.
    pub tiles_drawn: u32,
    /// Samples in the tiles of the view.
    pub points: u64,
    /// Those drawn.
    pub points_drawn: u64,
}

/// `Tile` of occlusion.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct TileRecord {
    low: [f32; 3],
    first: u32,
    high: [f32; 3],
    draws: u32,
}

/// `View` of occlusion.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
struct ViewRecord {
    clip_from_relative: [[f32; 4]; 4],
    size: [u32; 4],
    near: [f32; 4],
}

/// What tiles are of: a representation, or beyond those a face of an environment map.
pub(crate) type Key = u64;

/// A tile of the frame.
#[derive(Clone, Copy, Debug)]
struct Tested {
    key: Key,
    tile: u8,
    points: u32,
    /// Drawn before the test.
    at_once: bool,
}

/// A frame whose answers are on their way.
#[derive(Debug)]
struct Asked {
    answers: wgpu::Buffer,
    /// [`WAITING`], [`THERE`] or [`FAILED`].
    state: Arc<AtomicU8>,
    tested: Vec<Tested>,
}

const WAITING: u8 = 0;
const THERE: u8 = 1;
const FAILED: u8 = 2;

/// Frames whose answers are waited for at most.
const ASKED_MAX: usize = 3;

/// The depths' pyramid for a size.
#[derive(Debug)]
struct Pyramid {
    size: [u32; 2],
    samples: u32,
    all: wgpu::TextureView,
    levels: Vec<wgpu::TextureView>,
}

/// What is to be drawn of an item after the test: its tiles' indirect draws.
pub(crate) type Rest = std::ops::Range<u32>;

/// Occlusion culling of a renderer.
#[derive(Debug)]
pub(crate) struct Occlusion {
    reduce_levels: wgpu::ComputePipeline,
    /// By samples a pixel.
    reduce_depths: BTreeMap<u32, wgpu::ComputePipeline>,
    test: wgpu::ComputePipeline,
    view: wgpu::Buffer,
    pyramid: Option<Pyramid>,
    draws: Option<wgpu::Buffer>,
    asked: Vec<Asked>,
    /// Tiles seen in the last frame known.
    seen: BTreeMap<Key, u16>,
    counts: Option<OcclusionCounts>,
    tested: Vec<Tested>,
    records: Vec<TileRecord>,
    arguments: Vec<[u32; 5]>,
}

fn pipeline(device: &wgpu::Device, label: &str, code: String, entry_point: &str) -> wgpu::ComputePipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(code.into()),
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(label),
        layout: None,
        module: &module,
        entry_point: Some(entry_point),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}

/// The reduction of depths with so many samples, 0 for that of a level of the pyramid.
fn reduction(device: &wgpu::Device, samples: u32) -> wgpu::ComputePipeline {
    let (kind, load) = match samples {
        0 => ("texture_2d<f32>", "textureLoad(finer, at, 0).x"),
        1 => ("texture_depth_2d", "textureLoad(finer, at, 0)"),
        _ => ("texture_depth_multisampled_2d", "textureLoad(finer, at, i)"),
    };
    let code = format!("alias FINER = {kind};\nconst COUNT = {};\n{}", samples.max(1), PYRAMID.replace("LOAD", load));
    pipeline(device, "pyramid", code, "reduce")
}

impl Pyramid {
    fn new(device: &wgpu::Device, size: [u32; 2], samples: u32) -> Pyramid {
        let [width, height] = size.map(|side| side.div_ceil(2).next_power_of_two());
        let mip_level_count = width.max(height).ilog2() + 1;
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("pyramid"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::R32Float,
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let level = |base_mip_level| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                base_mip_level,
                mip_level_count: Some(1),
                ..Default::default()
            })
        };
        let all = texture.create_view(&wgpu::TextureViewDescriptor::default());
        Pyramid { size, samples, all, levels: (0..mip_level_count).map(level).collect() }
    }
}

fn buffer(device: &wgpu::Device, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
    device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes.max(64),
        usage,
        mapped_at_creation: false,
    })
}

impl Occlusion {
    pub(crate) fn new(device: &wgpu::Device) -> Occlusion {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        Occlusion {
            reduce_levels: reduction(device, 0),
            reduce_depths: BTreeMap::new(),
            test: pipeline(device, "occlusion", OCCLUSION.to_owned(), "test_tiles"),
            view: buffer(device, "occlusion", size_of::<ViewRecord>() as u64, usage),
            pyramid: None,
            draws: None,
            asked: Vec::new(),
            seen: BTreeMap::new(),
            counts: None,
            tested: Vec::new(),
            records: Vec::new(),
            arguments: Vec::new(),
        }
    }

    /// Of the last frame whose answers are known.
    pub(crate) fn counts(&self) -> Option<OcclusionCounts> {
        self.counts
    }

    /// Takes the answers that have arrived; `device` has been polled.
    pub(crate) fn take_answers(&mut self) {
        let arrived = self.asked.iter().rposition(|asked| asked.state.load(Ordering::Acquire) == THERE);
        if let Some(place) = arrived {
            // The latest counts; those before it are of no use any more.
            let mut asked = self.asked.drain(..=place);
            if let Some(latest) = asked.next_back() {
                let (seen, counts) = answers(&latest).unwrap_or_default();
                (self.seen, self.counts) = (seen, Some(counts));
            }
        }
        self.asked.retain(|asked| asked.state.load(Ordering::Acquire) != FAILED);
    }

    /// Begins a frame; the device has been polled.
    pub(crate) fn begin(&mut self) {
        self.take_answers();
        self.tested.clear();
        self.records.clear();
        self.arguments.clear();
    }

    /// Takes an item's tiles up: which are drawn at once, and the draws of the rest.
    pub(crate) fn add(&mut self, key: Key, tiles: u16, splats: &Splats, eye: &Eye) -> (u16, Rest) {
        let start = self.arguments.len() as u32;
        let guess = self.seen.get(&key).copied().unwrap_or(0);
        let mut at_once = 0;
        for tile in (0..TILES).filter(|tile| tiles >> tile & 1 == 1 && splats.tile_points[*tile] > 0) {
            let bit = 1 << tile;
            if self.tested.len() >= TESTED_MAX {
                at_once |= bit;
                continue;
            }
            let first = self.arguments.len() as u32;
            if guess & bit != 0 {
                at_once |= bit;
            } else {
                self.arguments.extend(splats.arguments(tile));
            }
            let bounds = &splats.tile_bounds[tile];
            let [low, high] = [bounds.min, bounds.max].map(|corner| eye.relative(corner));
            let draws = self.arguments.len() as u32 - first;
            self.records.push(TileRecord { low: low.to_array(), first, high: high.to_array(), draws });
            let points = splats.tile_points[tile];
            self.tested.push(Tested { key, tile: tile as u8, points, at_once: at_once & bit != 0 });
        }
        (at_once, start..self.arguments.len() as u32)
    }

    /// Tests all tiles against what has been drawn, and sees to it that the answers come back.
    pub(crate) fn test(
        &mut self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
        targets: &Targets,
        eye: &Eye,
    ) {
        if self.tested.is_empty() {
            return;
        }
        let samples = targets.samples;
        if !self.pyramid.as_ref().is_some_and(|p| p.size == targets.size && p.samples == samples) {
            self.pyramid = Some(Pyramid::new(device, targets.size, samples));
        }
        let reduce_depths = self.reduce_depths.entry(samples).or_insert_with(|| reduction(device, samples));
        let Some(pyramid) = &self.pyramid else {
            return;
        };
        let count = self.tested.len() as u32;
        let [width, height] = targets.size;
        let view = ViewRecord {
            clip_from_relative: eye.clip_from_relative.to_cols_array_2d(),
            size: [width, height, pyramid.levels.len() as u32, count],
            near: [eye.near, 0.0, 0.0, 0.0],
        };
        queue.write_buffer(&self.view, 0, bytemuck::bytes_of(&view));
        let upload = |label, bytes: &[u8], usage| {
            let made = buffer(device, label, bytes.len() as u64, usage | wgpu::BufferUsages::COPY_DST);
            queue.write_buffer(&made, 0, bytes);
            made
        };
        let storage = wgpu::BufferUsages::STORAGE;
        let tiles = upload("tiles", bytemuck::cast_slice(&self.records), storage);
        let indirect = storage | wgpu::BufferUsages::INDIRECT;
        let draws = upload("draws", bytemuck::cast_slice(&self.arguments), indirect);
        let seen = buffer(device, "seen", 4 * u64::from(count), storage | wgpu::BufferUsages::COPY_SRC);

        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        let mut finer = &targets.depth;
        for (level, coarser) in pyramid.levels.iter().enumerate() {
            let pipeline = if level == 0 { &*reduce_depths } else { &self.reduce_levels };
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("pyramid"),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &[
                    wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(finer) },
                    wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(coarser) },
                ],
            });
            let size = coarser.texture().size();
            let [columns, rows] = [size.width, size.height].map(|side| (side >> level).max(1).div_ceil(8));
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups(columns, rows, 1);
            finer = coarser;
        }
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("occlusion"),
            layout: &self.test.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.view.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: tiles.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 2, resource: draws.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 3, resource: seen.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 4, resource: wgpu::BindingResource::TextureView(&pyramid.all) },
            ],
        });
        pass.set_pipeline(&self.test);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(count.div_ceil(64), 1, 1);
        drop(pass);
        self.draws = Some(draws);
        self.ask(device, encoder, &seen);
    }

    fn ask(&mut self, device: &wgpu::Device, encoder: &mut wgpu::CommandEncoder, seen: &wgpu::Buffer) {
        if self.asked.len() >= ASKED_MAX {
            return;
        }
        let usage = wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ;
        let answers = buffer(device, "answers", seen.size(), usage);
        encoder.copy_buffer_to_buffer(seen, 0, &answers, 0, seen.size());
        let state = Arc::new(AtomicU8::new(WAITING));
        let told = Arc::clone(&state);
        encoder.map_buffer_on_submit(&answers, wgpu::MapMode::Read, .., move |result| {
            told.store(if result.is_ok() { THERE } else { FAILED }, Ordering::Release);
        });
        self.asked.push(Asked { answers, state, tested: self.tested.clone() });
    }

    /// Draws what is left of an item after the test; the number of draws.
    pub(crate) fn draw_rest(&self, pass: &mut wgpu::RenderPass<'_>, rest: Rest) -> u64 {
        if let Some(draws) = &self.draws {
            for draw in rest.clone() {
                pass.draw_indexed_indirect(draws, u64::from(draw) * size_of::<[u32; 5]>() as u64);
            }
        }
        u64::from(rest.end - rest.start)
    }
}

/// What was seen in a frame, by its answers.
fn answers(asked: &Asked) -> Option<(BTreeMap<Key, u16>, OcclusionCounts)> {
    let mapped = asked.answers.get_mapped_range(..).ok()?;
    let (mut seen, mut counts) = (BTreeMap::new(), OcclusionCounts::default());
    for (tested, answer) in asked.tested.iter().zip(mapped.as_chunks::<4>().0) {
        let is_seen = u32::from_le_bytes(*answer) != 0;
        let drawn = is_seen || tested.at_once;
        *seen.entry(tested.key).or_insert(0) |= u16::from(is_seen) << tested.tile;
        counts.tiles += 1;
        counts.tiles_drawn += u32::from(drawn);
        counts.points += u64::from(tested.points);
        counts.points_drawn += if drawn { u64::from(tested.points) } else { 0 };
    }
    Some((seen, counts))
}
