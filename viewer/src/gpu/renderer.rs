//! What is uploaded, and frames of it.

use super::device::{Faults, Gpu, GpuError};
use super::distance::Distance;
use super::item::{FrameUniform, ItemUniform};
use super::meshes::{self, Triangles};
use super::occlusion::{self, Occlusion, OcclusionCounts};
use super::pipelines::{Layouts, Pipelines};
use super::relative::Eye;
use super::settings::RenderSettings;
use super::splats::{Splats, shared_indices};
use super::targets::{Targets, fitting};
use crate::draw::list::DrawList;
use crate::draw::tiles::tiles_in_view;
use crate::scene::content::Content;
use crate::scene::resident::Uploads;
use foresight_scheduler::benefit::frustum::Frustum;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;
use std::collections::BTreeMap;

/// Items of a frame that a first buffer takes; it is doubled as needed.
const ITEMS_FIRST: usize = 256;

/// What a frame was drawn with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Samples of orthoviews in tiles that the view meets, those that turned out to be hidden too ([`Renderer::occlusion`]).
    pub points: u64,
    /// Triangles of meshes.
    pub triangles: u64,
    /// Draw calls for both.
    pub draws: u64,
}

/// What is uploaded of a representation.
#[derive(Clone, Debug)]
enum Uploaded {
    Splats(Box<Splats>),
    Triangles(Triangles),
    Empty,
}

impl Uploaded {
    fn bytes(&self) -> u64 {
        match self {
            Uploaded::Splats(splats) => splats.bytes,
            Uploaded::Triangles(triangles) => triangles.bytes,
            Uploaded::Empty => 0,
        }
    }
}

/// Keeps contents on the GPU and draws them.
#[derive(Debug)]
pub struct Renderer {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) faults: Faults,
    pub(crate) format: wgpu::TextureFormat,
    settings: RenderSettings,
    layouts: Layouts,
    /// By samples a pixel; made when first needed.
    pipelines: BTreeMap<u32, (Pipelines, Distance)>,
    meshes: meshes::Shared,
    corners: wgpu::Buffer,
    frame: wgpu::Buffer,
    pub(crate) frame_group: wgpu::BindGroup,
    items: wgpu::Buffer,
    items_group: wgpu::BindGroup,
    /// Bytes from one item's uniforms to the next's.
    stride: usize,
    targets: Option<Targets>,
    /// Whether the adapter can cull by occlusion at all.
    can_cull: bool,
    occlusion: Option<Occlusion>,
    uploaded: BTreeMap<RepId, Uploaded>,
    bytes: u64,
}

fn items_buffer(device: &wgpu::Device, layouts: &Layouts, bytes: usize) -> (wgpu::Buffer, wgpu::BindGroup) {
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("items"),
        size: bytes as u64,
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
    (buffer, group)
}

impl Renderer {
    /// A renderer into targets of a format. Into one without `Srgb` in its name it writes sRGB all the same.
    pub fn new(gpu: &Gpu, settings: RenderSettings, format: wgpu::TextureFormat) -> Renderer {
        let device = gpu.device.clone();
        let layouts = Layouts::new(&device);
        let stride = size_of::<ItemUniform>()
            .next_multiple_of(device.limits().min_uniform_buffer_offset_alignment.max(16) as usize);
        let frame = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("frame"),
            size: size_of::<FrameUniform>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let frame_group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("frame"),
            layout: &layouts.frame,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: frame.as_entire_binding() }],
        });
        let (items, items_group) = items_buffer(&device, &layouts, stride * ITEMS_FIRST);
        Renderer {
            corners: shared_indices(&device),
            queue: gpu.queue.clone(),
            faults: gpu.faults.clone(),
            device,
            format,
            settings,
            layouts,
            pipelines: BTreeMap::new(),
            meshes: meshes::Shared::new(&gpu.device, &gpu.queue),
            frame,
            frame_group,
            items,
            items_group,
            stride,
            targets: None,
            can_cull: gpu.adapter.get_downlevel_capabilities().flags.contains(occlusion::NEEDS),
            occlusion: None,
            uploaded: BTreeMap::new(),
            bytes: 0,
        }
    }

    /// How things are drawn, to be changed for the frames to come.
    pub fn settings(&mut self) -> &mut RenderSettings {
        &mut self.settings
    }

    /// Uploads a content in place of what was there, and gives its bytes on the GPU.
    ///
    /// # Errors
    /// A content beyond the adapter's limits or at odds with itself, no memory left, a lost device: then the
    /// representation is not there.
    pub fn upload(&mut self, rep: RepId, content: &Content) -> Result<u64, GpuError> {
        self.remove(rep);
        self.faults.check("before an upload")?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let (device, queue) = (&self.device, &self.queue);
        let made = match content {
            Content::Splats(image) => Splats::upload(device, queue, &self.layouts, image, self.settings.compression)
                .map(|splats| splats.map(|splats| Uploaded::Splats(Box::new(splats)))),
            Content::Mesh(mesh) => {
                Triangles::upload(device, queue, &self.layouts, &self.meshes, mesh, self.settings.compression)
                    .map(|triangles| triangles.map(Uploaded::Triangles))
            }
            Content::Empty => Ok(None),
        };
        if let Some(error) = pollster::block_on(memory.pop()) {
            return Err(GpuError::Refused { what: "no memory for an upload", reason: error.to_string() });
        }
        let made = made?.unwrap_or(Uploaded::Empty);
        self.faults.check("an upload")?;
        let bytes = made.bytes();
        self.bytes += bytes;
        self.uploaded.insert(rep, made);
        Ok(bytes)
    }

    /// Frees what is uploaded of a representation, if anything is.
    pub fn remove(&mut self, rep: RepId) {
        if let Some(uploaded) = self.uploaded.remove(&rep) {
            self.bytes -= uploaded.bytes();
        }
    }

    /// Whether a representation is uploaded.
    pub fn contains(&self, rep: RepId) -> bool {
        self.uploaded.contains_key(&rep)
    }

    /// Bytes of all that is uploaded.
    pub fn gpu_bytes(&self) -> u64 {
        self.bytes
    }

    /// Boxes around the splats of an orthoview's 4 × 4 tiles, row by row upwards, metres in the world; empty where a
    /// tile shows nothing. `None` for what is not uploaded, or no orthoview.
    pub fn tile_bounds(&self, rep: RepId) -> Option<&[Aabb; 16]> {
        match self.uploaded.get(&rep)? {
            Uploaded::Splats(splats) => Some(&splats.tile_bounds),
            _ => None,
        }
    }

    /// Samples of an orthoview's tiles that show something; `None` as for [`Renderer::tile_bounds`].
    pub fn tile_points(&self, rep: RepId) -> Option<&[u32; 16]> {
        match self.uploaded.get(&rep)? {
            Uploaded::Splats(splats) => Some(&splats.tile_points),
            _ => None,
        }
    }

    /// What was drawn of the orthoviews of the last frame of which that is known; `None` without occlusion culling.
    pub fn occlusion(&mut self) -> Option<OcclusionCounts> {
        let occlusion = self.occlusion.as_mut()?;
        drop(self.device.poll(wgpu::PollType::Poll));
        occlusion.take_answers();
        occlusion.counts()
    }

    /// Draws a list into a target of `size` pixels and of the renderer's format, the renderer's own depths beside it, and
    /// hands the work to the device. What is not uploaded is left out. The picture has the size's proportions.
    ///
    /// # Errors
    /// A view that no camera can have, a target without pixels or too large, a lost device.
    pub fn draw(
        &mut self,
        view: &View,
        list: &DrawList,
        target: &wgpu::TextureView,
        size: [u32; 2],
    ) -> Result<FrameCounts, GpuError> {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let counts = self.encode(&mut encoder, view, list, target, size)?;
        self.queue.submit([encoder.finish()]);
        self.faults.check("a frame")?;
        Ok(counts)
    }

    /// As [`Renderer::draw`], without handing it to the device.
    pub(crate) fn encode(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        view: &View,
        list: &DrawList,
        target: &wgpu::TextureView,
        size: [u32; 2],
    ) -> Result<FrameCounts, GpuError> {
        View { viewport: [1, 1], ..*view }.check()?;
        self.faults.check("before a frame")?;
        let samples = fitting(&self.device.limits(), size, self.settings.samples)?;
        if !self.targets.as_ref().is_some_and(|targets| targets.size == size && targets.samples == samples) {
            self.targets = None;
            self.targets = Some(Targets::new(&self.device, self.format, size, samples));
        }
        if !self.pipelines.contains_key(&samples) {
            let pipelines = Pipelines::new(&self.device, &self.layouts, self.format, samples);
            let distance = Distance::new(&self.device, &self.layouts, samples);
            self.pipelines.insert(samples, (pipelines, distance));
        }
        let eye = Eye::new(view, size, self.settings.near);
        let frustum = Frustum::new(&View { viewport: size, ..*view });
        let uniform = FrameUniform::new(&eye, &self.settings, size, self.format.is_srgb());
        self.queue.write_buffer(&self.frame, 0, bytemuck::bytes_of(&uniform));
        let drawn: Vec<_> = list.items.iter().filter_map(|item| Some((item, self.uploaded.get(&item.rep)?))).collect();
        let mut uniforms = vec![0u8; self.stride * drawn.len()];
        for (place, (item, uploaded)) in uniforms.chunks_exact_mut(self.stride).zip(&drawn) {
            let uniform = match uploaded {
                Uploaded::Splats(splats) => ItemUniform::of_splats(item, &eye, &splats.lattice),
                Uploaded::Triangles(triangles) => ItemUniform::of_mesh(item, &eye, triangles.origin),
                Uploaded::Empty => continue,
            };
            place[..size_of::<ItemUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
        }
        if uniforms.len() as u64 > self.items.size() {
            let bytes = self.stride * drawn.len().next_power_of_two();
            (self.items, self.items_group) = items_buffer(&self.device, &self.layouts, bytes);
        }
        self.queue.write_buffer(&self.items, 0, &uniforms);

        let (Some(targets), Some((pipelines, _))) = (&self.targets, self.pipelines.get(&samples)) else {
            return Ok(FrameCounts::default());
        };
        if self.can_cull && self.settings.occlusion {
            drop(self.device.poll(wgpu::PollType::Poll));
            let occlusion = self.occlusion.get_or_insert_with(|| Occlusion::new(&self.device));
            occlusion.begin();
        } else {
            self.occlusion = None;
        }
        let mut pass = targets.pass(encoder, target, true, self.occlusion.is_none());
        pass.set_bind_group(0, &self.frame_group, &[]);
        let mut counts = FrameCounts::default();
        // What is left of items after the test.
        let mut rests = Vec::new();
        for (place, (item, uploaded)) in drawn.iter().enumerate() {
            let offset = (place * self.stride) as u32;
            pass.set_bind_group(1, &self.items_group, &[offset]);
            match uploaded {
                Uploaded::Splats(splats) => {
                    let seen = tiles_in_view(&frustum, item, &splats.tile_bounds);
                    let mut tiles = seen;
                    if let Some(occlusion) = &mut self.occlusion {
                        let rest;
                        (tiles, rest) = occlusion.add(item.rep, seen, splats, &eye);
                        counts.points += splats.points(seen & !tiles);
                        rests.push((offset, splats, rest));
                    }
                    pass.set_pipeline(&pipelines.splats);
                    pass.set_bind_group(2, &splats.group, &[]);
                    pass.set_index_buffer(self.corners.slice(..), wgpu::IndexFormat::Uint32);
                    let [points, draws] = splats.draw(&mut pass, tiles);
                    counts.points += points;
                    counts.draws += draws;
                }
                Uploaded::Triangles(mesh) => {
                    let [triangles, draws] = mesh.draw(&mut pass, pipelines);
                    counts.triangles += triangles;
                    counts.draws += draws;
                }
                Uploaded::Empty => {}
            }
        }
        if let Some(occlusion) = &mut self.occlusion {
            drop(pass);
            occlusion.test(&self.device, &self.queue, encoder, targets, &eye);
            pass = targets.pass(encoder, target, false, true);
            pass.set_bind_group(0, &self.frame_group, &[]);
            pass.set_pipeline(&pipelines.splats);
            pass.set_index_buffer(self.corners.slice(..), wgpu::IndexFormat::Uint32);
            for (offset, splats, rest) in rests.into_iter().filter(|(_, _, rest)| !rest.is_empty()) {
                pass.set_bind_group(1, &self.items_group, &[offset]);
                pass.set_bind_group(2, &splats.group, &[]);
                counts.draws += occlusion.draw_rest(&mut pass, rest);
            }
        }
        pass.set_pipeline(&pipelines.sky);
        pass.draw(0..3, 0..1);
        Ok(counts)
    }

    /// Writes the distances of the frame encoded last into a texture of [`super::distance::FORMAT`] and the same size.
    pub(crate) fn encode_distances(&self, encoder: &mut wgpu::CommandEncoder, into: &wgpu::TextureView) {
        if let Some(targets) = &self.targets
            && let Some((_, distance)) = self.pipelines.get(&targets.samples)
        {
            distance.write(&self.device, encoder, &self.frame_group, targets, into);
        }
    }
}

impl Uploads for Renderer {
    fn upload(&mut self, rep: RepId, content: &Content) -> Result<u64, String> {
        Renderer::upload(self, rep, content).map_err(|error| error.to_string())
    }

    fn remove(&mut self, rep: RepId) {
        Renderer::remove(self, rep);
    }
}
