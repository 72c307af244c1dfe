//! What a frame is drawn into besides its target: depths, and the samples that become pixels.

use super::device::GpuError;

/// Of depths: reversed, so that f32 keeps its digits far away.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

/// Most bytes of a frame's depths and samples: with more a large window has one sample a pixel, and then none at all.
const BYTES_MAX: u64 = 1 << 30;

/// Attachments of a size.
#[derive(Clone, Debug)]
pub(crate) struct Targets {
    pub(crate) size: [u32; 2],
    pub(crate) samples: u32,
    pub(crate) depth: wgpu::TextureView,
    /// Samples of the colours, where there are several a pixel.
    pub(crate) colours: Option<wgpu::TextureView>,
}

/// Samples a pixel that fit: 4 if asked for and within the bound, else 1.
///
/// # Errors
/// A picture without pixels, or too large.
pub(crate) fn fitting(limits: &wgpu::Limits, size: [u32; 2], samples: u32) -> Result<u32, GpuError> {
    let most = limits.max_texture_dimension_2d;
    let pixels = u64::from(size[0]) * u64::from(size[1]);
    let refused = GpuError::Size(size[0], size[1], most, BYTES_MAX >> 20);
    if pixels == 0 || size.iter().any(|&side| side > most) {
        return Err(refused);
    }
    match samples {
        4.. if pixels.saturating_mul(4 * (4 + 4)) <= BYTES_MAX => Ok(4),
        _ if pixels.saturating_mul(4 + 4) <= BYTES_MAX => Ok(1),
        _ => Err(refused),
    }
}

impl Targets {
    pub(crate) fn new(device: &wgpu::Device, format: wgpu::TextureFormat, size: [u32; 2], samples: u32) -> Targets {
        let make = |label, format, usage| {
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            });
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        };
        let attachment = wgpu::TextureUsages::RENDER_ATTACHMENT;
        Targets {
            size,
            samples,
            depth: make("depth", DEPTH_FORMAT, attachment | wgpu::TextureUsages::TEXTURE_BINDING),
            colours: (samples > 1).then(|| make("samples", format, attachment)),
        }
    }

    /// A pass into `target`. The first of a frame clears what was there, the last makes pixels of samples.
    pub(crate) fn pass<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        first: bool,
        last: bool,
    ) -> wgpu::RenderPass<'e> {
        let (view, resolve_target) = match &self.colours {
            Some(colours) => (colours, last.then_some(target)),
            None => (target, None),
        };
        let store = if resolve_target.is_some() { wgpu::StoreOp::Discard } else { wgpu::StoreOp::Store };
        let black = if first { wgpu::LoadOp::Clear(wgpu::Color::BLACK) } else { wgpu::LoadOp::Load };
        let far = if first { wgpu::LoadOp::Clear(0.0) } else { wgpu::LoadOp::Load };
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("frame"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target,
                ops: wgpu::Operations { load: black, store },
            })],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.depth,
                depth_ops: Some(wgpu::Operations { load: far, store: wgpu::StoreOp::Store }),
                stencil_ops: None,
            }),
            ..Default::default()
        })
    }
}
