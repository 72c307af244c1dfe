//! What is uploaded, and frames of it.

use super::device::{Faults, Gpu, GpuError};
use super::distance::Distance;
use super::item::{FrameUniform, ItemUniform, Items};
use super::meshes::{self, Triangles};
use super::occlusion::{self, Key, Occlusion, OcclusionCounts};
use super::pipelines::{Layouts, Pipelines};
use super::relative::Eye;
use super::settings::RenderSettings;
use super::splats::{Splats, shared_indices};
use super::targets::{Targets, fitting};
use crate::draw::list::{ALL_TILES, DrawList, Item};
use crate::draw::tiles::tiles_in_view;
use crate::scene::compress::Compression;
use crate::scene::content::Content;
use crate::scene::resident::Uploads;
use foresight_scheduler::benefit::frustum::Frustum;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;
use std::collections::BTreeMap;

/// The first of the keys of faces: greater than any representation's.
const FACES: Key = 1 << 32;

/// What a frame was drawn with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// Samples of orthoviews in tiles that the view meets, those that turned out to be hidden too ([`Renderer::occlusion`]).
    pub points: u64,
    /// Of these, samples of environment maps.
    pub map_points: u64,
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
    pub(crate) layouts: Layouts,
    /// By samples a pixel; made when first needed.
    pipelines: BTreeMap<u32, (Pipelines, Distance)>,
    meshes: meshes::Shared,
    corners: wgpu::Buffer,
    frame: wgpu::Buffer,
    pub(crate) frame_group: wgpu::BindGroup,
    items: Items,
    targets: Option<Targets>,
    /// Whether the adapter can cull by occlusion, and make environment maps, at all.
    pub(crate) can_compute: bool,
    occlusion: Option<Occlusion>,
    uploaded: BTreeMap<RepId, Uploaded>,
    /// Faces of environment maps, by their numbers.
    pub(crate) faces: BTreeMap<u32, Splats>,
    bytes: u64,
}

/// What of a list is drawn.
struct Drawn<'a> {
    item: &'a Item,
    key: Key,
    what: Drawable<'a>,
}

#[derive(Clone, Copy)]
enum Drawable<'a> {
    Splats(&'a Splats),
    Triangles(&'a Triangles),
}

impl Drawn<'_> {
    fn uniform(&self, eye: &Eye) -> ItemUniform {
        match self.what {
            Drawable::Splats(splats) => ItemUniform::of_splats(self.item, eye, &splats.lattice),
            Drawable::Triangles(triangles) => ItemUniform::of_mesh(self.item, eye, triangles.origin),
        }
    }
}

/// What of items is uploaded and shows anything.
fn drawn<'a>(uploaded: &'a BTreeMap<RepId, Uploaded>, items: &'a [Item]) -> Vec<Drawn<'a>> {
    let of = |item: &'a Item| {
        let what = match uploaded.get(&item.rep)? {
            Uploaded::Splats(splats) => Drawable::Splats(splats),
            Uploaded::Triangles(triangles) => Drawable::Triangles(triangles),
            Uploaded::Empty => return None,
        };
        Some(Drawn { item, key: u64::from(item.rep.0), what })
    };
    items.iter().filter_map(of).collect()
}

/// A face of an environment map while it is drawn.
pub(crate) struct FacePass<'a> {
    pub(crate) pipelines: &'a Pipelines,
    pub(crate) targets: &'a Targets,
    pub(crate) colours: &'a wgpu::TextureView,
    /// Square, 90° wide.
    pub(crate) view: View,
    /// What is nearer along the face's axis is not drawn, metres.
    pub(crate) near: f64,
    /// Nothing in it is drawn.
    pub(crate) cube: Aabb,
    /// Whether this is the first part of it.
    pub(crate) is_first: bool,
}

impl Renderer {
    /// A renderer into targets of a format. Into one without `Srgb` in its name it writes sRGB all the same.
    pub fn new(gpu: &Gpu, settings: RenderSettings, format: wgpu::TextureFormat) -> Renderer {
        let device = gpu.device.clone();
        let layouts = Layouts::new(&device);
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
        let items = Items::new(&device, &layouts);
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
            targets: None,
            can_compute: gpu.adapter.get_downlevel_capabilities().flags.contains(occlusion::NEEDS),
            occlusion: None,
            uploaded: BTreeMap::new(),
            faces: BTreeMap::new(),
            bytes: 0,
        }
    }

    /// How things are drawn, to be changed for the frames to come.
    pub fn settings(&mut self) -> &mut RenderSettings {
        &mut self.settings
    }

    /// What contents may be compressed to for this renderer, if `wanted` is wished for.
    pub fn compression(&self, wanted: Compression) -> Compression {
        let has_blocks = self.device.features().contains(wgpu::Features::TEXTURE_COMPRESSION_BC);
        if has_blocks { wanted } else { Compression::None }
    }

    /// Uploads a content in place of what was there, as it is kept, and gives its bytes on the GPU.
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
            Content::Splats(image) => Splats::upload(device, queue, &self.layouts, image)
                .map(|splats| splats.map(|splats| Uploaded::Splats(Box::new(splats)))),
            Content::Mesh(mesh) => Triangles::upload(device, queue, &self.layouts, &self.meshes, mesh)
                .map(|triangles| triangles.map(Uploaded::Triangles)),
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
        let mut drawn = drawn(&self.uploaded, &list.items);
        let whole =
            Item { rep: RepId(u32::MAX), hidden: Vec::new(), behind: 0.0, tiles: ALL_TILES, false_colour: None };
        drawn.extend(list.faces.iter().filter_map(|number| {
            let what = Drawable::Splats(self.faces.get(number)?);
            Some(Drawn { item: &whole, key: FACES | u64::from(*number), what })
        }));
        let uniforms = drawn.iter().map(|drawn| drawn.uniform(&eye));
        self.items.write(&self.device, &self.queue, &self.layouts, uniforms);

        let (Some(targets), Some((pipelines, _))) = (&self.targets, self.pipelines.get(&samples)) else {
            return Ok(FrameCounts::default());
        };
        if self.can_compute && self.settings.occlusion {
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
        for (place, Drawn { item, key, what }) in drawn.iter().enumerate() {
            let offset = self.items.offset(place);
            pass.set_bind_group(1, &self.items.group, &[offset]);
            match what {
                Drawable::Splats(splats) => {
                    let seen = tiles_in_view(&frustum, item, &splats.tile_bounds);
                    let before = counts.points;
                    let mut tiles = seen;
                    if let Some(occlusion) = &mut self.occlusion {
                        let rest;
                        (tiles, rest) = occlusion.add(*key, seen, splats, &eye);
                        counts.points += splats.points(seen & !tiles);
                        rests.push((offset, *splats, rest));
                    }
                    pass.set_pipeline(&pipelines.splats);
                    pass.set_bind_group(2, &splats.group, &[]);
                    pass.set_index_buffer(self.corners.slice(..), wgpu::IndexFormat::Uint32);
                    let [points, draws] = splats.draw(&mut pass, tiles);
                    counts.points += points;
                    counts.draws += draws;
                    if key & FACES != 0 {
                        counts.map_points += counts.points - before;
                    }
                }
                Drawable::Triangles(mesh) => {
                    let [triangles, draws] = mesh.draw(&mut pass, pipelines);
                    counts.triangles += triangles;
                    counts.draws += draws;
                }
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
                pass.set_bind_group(1, &self.items.group, &[offset]);
                pass.set_bind_group(2, &splats.group, &[]);
                counts.draws += occlusion.draw_rest(&mut pass, rest);
            }
        }
        pass.set_pipeline(&pipelines.sky);
        pass.draw(0..3, 0..1);
        Ok(counts)
    }

    /// Draws a face of an environment map, or goes on with it: items in their order, until `budget` points and triangles are
    /// drawn; at least one. How many items were taken, and what they were.
    pub(crate) fn compose(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        face: &FacePass<'_>,
        items: &[Item],
        budget: u64,
    ) -> (usize, FrameCounts) {
        let FacePass { pipelines, targets, view, cube, .. } = face;
        let eye = Eye::new(view, targets.size, face.near);
        let frustum = Frustum::new(view);
        let uniform = FrameUniform::new(&eye, &self.settings, targets.size, true);
        self.queue.write_buffer(&self.frame, 0, bytemuck::bytes_of(&uniform));
        let drawn = drawn(&self.uploaded, items);
        let uniforms = drawn.iter().map(|drawn| drawn.uniform(&eye));
        self.items.write(&self.device, &self.queue, &self.layouts, uniforms);
        let mut pass = targets.pass(encoder, face.colours, face.is_first, true);
        pass.set_bind_group(0, &self.frame_group, &[]);
        let mut counts = FrameCounts::default();
        for (place, Drawn { item, what, .. }) in drawn.iter().enumerate() {
            if place > 0 && counts.points + counts.triangles >= budget {
                let taken = items.iter().position(|one| std::ptr::eq(one, *item)).unwrap_or(place);
                return (taken, counts);
            }
            pass.set_bind_group(1, &self.items.group, &[self.items.offset(place)]);
            let [points, triangles, draws] = match what {
                Drawable::Splats(splats) => {
                    let mut tiles = tiles_in_view(&frustum, item, &splats.tile_bounds);
                    for (tile, bounds) in splats.tile_bounds.iter().enumerate() {
                        let is_near = bounds.min.cmpgt(cube.min).all() && bounds.max.cmplt(cube.max).all();
                        tiles &= !(u16::from(is_near) << tile);
                    }
                    pass.set_pipeline(&pipelines.splats);
                    pass.set_bind_group(2, &splats.group, &[]);
                    pass.set_index_buffer(self.corners.slice(..), wgpu::IndexFormat::Uint32);
                    let [points, draws] = splats.draw(&mut pass, tiles);
                    [points, 0, draws]
                }
                Drawable::Triangles(mesh) => {
                    let [triangles, draws] = mesh.draw(&mut pass, pipelines);
                    [0, triangles, draws]
                }
            };
            counts.points += points;
            counts.triangles += triangles;
            counts.draws += draws;
        }
        (items.len(), counts)
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
