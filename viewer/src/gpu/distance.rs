//! Distances from depths: metres along the view, in a texture that can be copied and sampled.

use super::pipelines::{Layouts, texture, whole_picture};
use super::targets::Targets;

const FRAME: &str = include_str!("../shader/frame.wgsl");
const DISTANCE: &str = include_str!("../shader/distance.wgsl");

/// Of the texture.
pub(crate) const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;

/// The pass for one number of samples.
#[derive(Clone, Debug)]
pub(crate) struct Distance {
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

impl Distance {
    pub(crate) fn new(device: &wgpu::Device, layouts: &Layouts, samples: u32) -> Distance {
        let kind = if samples > 1 { "texture_depth_multisampled_2d" } else { "texture_depth_2d" };
        let code = format!("{FRAME}\nalias DEPTHS = {kind};\nconst COUNT = {samples};\n{DISTANCE}");
        let entry = texture(0, wgpu::ShaderStages::FRAGMENT, wgpu::TextureSampleType::Depth, samples > 1);
        let layout = device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("depths"), entries: &[entry] });
        let layouts = [Some(&layouts.frame), Some(&layout)];
        let pipeline = whole_picture(device, "distance", &code, &layouts, &[Some(FORMAT.into())]);
        Distance { layout, pipeline }
    }

    /// Writes the distances of what was drawn last into `into`, of the same size.
    pub(crate) fn write(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        frame: &wgpu::BindGroup,
        targets: &Targets,
        into: &wgpu::TextureView,
    ) {
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("depths"),
            layout: &self.layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&targets.depth),
            }],
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("distance"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: into,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, &group, &[]);
        pass.draw(0..3, 0..1);
    }
}
