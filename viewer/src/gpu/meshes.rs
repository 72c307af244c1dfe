//! Triangles on the GPU: a buffer of vertices, one of indices, and a texture a part.

use super::device::GpuError;
use super::pipelines::{Layouts, Pipelines};
use super::texels::{check_kept, format};
use crate::scene::content::{Mesh, Texels, TextureImage};
use glam::DVec3;
use wgpu::util::DeviceExt;

/// A mesh on the GPU.
#[derive(Clone, Debug)]
pub(crate) struct Triangles {
    pub(crate) origin: DVec3,
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    /// By texture, that without one last.
    groups: Vec<wgpu::BindGroup>,
    parts: Vec<DrawnPart>,
    pub(crate) bytes: u64,
}

#[derive(Clone, Debug)]
struct DrawnPart {
    indices: core::ops::Range<u32>,
    two_sided: bool,
    /// Number of its group.
    group: usize,
    /// Where its uniform is, bytes.
    uniform: u32,
}

/// What all meshes are drawn with.
#[derive(Clone, Debug)]
pub(crate) struct Shared {
    sampler: wgpu::Sampler,
    /// One texel, for parts without a texture.
    white: wgpu::TextureView,
}

impl Shared {
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Shared {
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("textures"),
            address_mode_u: wgpu::AddressMode::Repeat,
            address_mode_v: wgpu::AddressMode::Repeat,
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            mipmap_filter: wgpu::MipmapFilterMode::Linear,
            ..Default::default()
        });
        let image = TextureImage { size: [1, 1], texels: vec![255; 4], kept: Texels::Plain };
        Shared { sampler, white: texture(device, queue, &image).0 }
    }
}

/// An image with the mips that it has, and its bytes.
fn texture(device: &wgpu::Device, queue: &wgpu::Queue, image: &TextureImage) -> (wgpu::TextureView, u64) {
    let descriptor = wgpu::TextureDescriptor {
        label: Some("texture"),
        size: wgpu::Extent3d { width: image.size[0], height: image.size[1], depth_or_array_layers: 1 },
        mip_level_count: image.levels().count() as u32,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: format(image.kept),
        usage: wgpu::TextureUsages::TEXTURE_BINDING,
        view_formats: &[],
    };
    let order = wgpu::wgt::TextureDataOrder::LayerMajor;
    let texture = device.create_texture_with_data(queue, &descriptor, order, &image.texels);
    (texture.create_view(&wgpu::TextureViewDescriptor::default()), image.texels.len() as u64)
}

fn check(mesh: &Mesh, device: &wgpu::Device) -> Result<(), GpuError> {
    let limits = device.limits();
    let vertices = mesh.vertices.len() as u64;
    let buffers = [
        ("bytes of a mesh's vertices", size_of_val(mesh.vertices.as_slice()) as u64),
        ("bytes of a mesh's indices", size_of_val(mesh.indices.as_slice()) as u64),
    ];
    if let Some((what, found)) = buffers.into_iter().find(|&(_, found)| found > limits.max_buffer_size) {
        return Err(GpuError::TooLarge { what, found, most: limits.max_buffer_size });
    }
    if let Some(&index) = mesh.indices.iter().find(|&&index| u64::from(index) >= vertices) {
        return Err(GpuError::Content {
            what: "a mesh's index, beyond its vertices",
            found: index.into(),
            expected: vertices,
        });
    }
    for part in &mesh.parts {
        let most = mesh.indices.len() as u64;
        if part.indices.start > part.indices.end || u64::from(part.indices.end) > most {
            return Err(GpuError::Content {
                what: "the end of a part",
                found: part.indices.end.into(),
                expected: most,
            });
        }
        if part.texture.is_some_and(|texture| texture >= mesh.textures.len()) {
            let found = part.texture.unwrap_or_default() as u64;
            return Err(GpuError::Content { what: "a part's texture", found, expected: mesh.textures.len() as u64 });
        }
    }
    for texture in &mesh.textures {
        let kept = [Texels::Plain, Texels::Bc1, Texels::Bc3, Texels::Bc7];
        check_kept(device, "a texture", texture.kept, &kept)?;
        if texture.kept != Texels::Plain
            && let Some(side) = texture.size.into_iter().find(|side| !side.is_multiple_of(4))
        {
            let (found, expected) = (side.into(), side.next_multiple_of(4).into());
            return Err(GpuError::Content { what: "a side of a texture of blocks", found, expected });
        }
        let (found, expected) = (texture.texels.len(), texture.levels().map(|(_, texels)| texels.len()).sum::<usize>());
        if found != expected || expected == 0 {
            let (found, expected) = (found as u64, expected as u64);
            return Err(GpuError::Content { what: "bytes of a texture", found, expected });
        }
        let most = limits.max_texture_dimension_2d.into();
        let found = texture.size[0].max(texture.size[1]).into();
        if found > most {
            return Err(GpuError::TooLarge { what: "a side of a texture", found, most });
        }
    }
    Ok(())
}

impl Triangles {
    /// `None` for a mesh without triangles.
    pub(crate) fn upload(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        layouts: &Layouts,
        shared: &Shared,
        mesh: &Mesh,
    ) -> Result<Option<Triangles>, GpuError> {
        check(mesh, device)?;
        if mesh.indices.len() < 3 || mesh.parts.is_empty() {
            return Ok(None);
        }
        let mut bytes = 0;
        let mut buffer = |label, contents: &[u8], usage| {
            bytes += contents.len() as u64;
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: Some(label), contents, usage })
        };
        let vertices = buffer("vertices", bytemuck::cast_slice(&mesh.vertices), wgpu::BufferUsages::VERTEX);
        let indices = buffer("indices", bytemuck::cast_slice(&mesh.indices), wgpu::BufferUsages::INDEX);
        // A uniform a part in one buffer, a bind group a texture: what has many parts with few textures has few groups.
        let stride = device.limits().min_uniform_buffer_offset_alignment.max(16) as usize;
        let mut uniforms = vec![0; stride * mesh.parts.len()];
        for (place, part) in uniforms.chunks_exact_mut(stride).zip(&mesh.parts) {
            let [red, green, blue] = part.base;
            place[..16].copy_from_slice(bytemuck::bytes_of(&[red, green, blue, part.cutoff]));
        }
        let uniforms = buffer("parts", &uniforms, wgpu::BufferUsages::UNIFORM);
        let group = |view: &wgpu::TextureView| {
            let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
            let size = core::num::NonZeroU64::new(16);
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("parts"),
                layout: &layouts.part,
                entries: &[
                    entry(0, wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: &uniforms, offset: 0, size })),
                    entry(1, wgpu::BindingResource::TextureView(view)),
                    entry(2, wgpu::BindingResource::Sampler(&shared.sampler)),
                ],
            })
        };
        let mut groups: Vec<wgpu::BindGroup> = Vec::with_capacity(mesh.textures.len() + 1);
        for image in &mesh.textures {
            let (view, size) = texture(device, queue, image);
            groups.push(group(&view));
            bytes += size;
        }
        groups.push(group(&shared.white));
        let parts = mesh.parts.iter().enumerate().map(|(number, part)| DrawnPart {
            indices: part.indices.clone(),
            two_sided: part.two_sided,
            group: part.texture.unwrap_or(mesh.textures.len()),
            uniform: (number * stride) as u32,
        });
        let parts = parts.collect();
        Ok(Some(Triangles { origin: mesh.origin, vertices, indices, groups, parts, bytes }))
    }

    /// Draws all parts, and counts triangles and draws.
    pub(crate) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, pipelines: &Pipelines) -> [u64; 2] {
        pass.set_vertex_buffer(0, self.vertices.slice(..));
        pass.set_index_buffer(self.indices.slice(..), wgpu::IndexFormat::Uint32);
        let mut triangles = 0;
        for part in &self.parts {
            pass.set_pipeline(&pipelines.meshes[usize::from(part.two_sided)]);
            pass.set_bind_group(2, &self.groups[part.group], &[part.uniform]);
            pass.draw_indexed(part.indices.clone(), 0, 0..1);
            triangles += u64::from(part.indices.end - part.indices.start) / 3;
        }
        [triangles, self.parts.len() as u64]
    }
}
