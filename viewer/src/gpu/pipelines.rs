//! Layouts and pipelines.

use super::targets::DEPTH_FORMAT;
use crate::scene::content::Vertex;

const SPLAT: &str = concat!(
    include_str!("../shader/frame.wgsl"),
    include_str!("../shader/item.wgsl"),
    include_str!("../shader/splat.wgsl"),
    include_str!("../shader/links.wgsl")
);
const MESH: &str = concat!(
    include_str!("../shader/frame.wgsl"),
    include_str!("../shader/item.wgsl"),
    include_str!("../shader/mesh.wgsl")
);
const SKY: &str = concat!(include_str!("../shader/frame.wgsl"), include_str!("../shader/sky.wgsl"));

/// What bind groups look like.
#[derive(Clone, Debug)]
pub(crate) struct Layouts {
    /// A frame's uniforms.
    pub(crate) frame: wgpu::BindGroupLayout,
    /// An item's, at an offset.
    pub(crate) item: wgpu::BindGroupLayout,
    /// Colours, shapes and normals of an orthoview.
    pub(crate) splats: wgpu::BindGroupLayout,
    /// A part's uniforms, texture and sampler.
    pub(crate) part: wgpu::BindGroupLayout,
}

fn uniform(binding: u32, has_dynamic_offset: bool) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset,
            min_binding_size: None,
        },
        count: None,
    }
}

/// A texture that a stage reads.
pub(crate) fn texture(
    binding: u32,
    visibility: wgpu::ShaderStages,
    sample_type: wgpu::TextureSampleType,
    multisampled: bool,
) -> wgpu::BindGroupLayoutEntry {
    let view_dimension = wgpu::TextureViewDimension::D2;
    let ty = wgpu::BindingType::Texture { sample_type, view_dimension, multisampled };
    wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

/// A pass over every pixel of a picture by one triangle, without depth: entry points `vertex` and `fragment` of `code`.
pub(crate) fn whole_picture(
    device: &wgpu::Device,
    label: &str,
    code: &str,
    layouts: &[Option<&wgpu::BindGroupLayout>],
    targets: &[Option<wgpu::ColorTargetState>],
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(code.into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: layouts,
        immediate_size: 0,
    });
    over_all(device, label, Some(&layout), &module, "fragment", targets)
}

/// As [`whole_picture`], of a module; with the layout that its code implies if none is given.
pub(crate) fn over_all(
    device: &wgpu::Device,
    label: &str,
    layout: Option<&wgpu::PipelineLayout>,
    module: &wgpu::ShaderModule,
    fragment: &str,
    targets: &[Option<wgpu::ColorTargetState>],
) -> wgpu::RenderPipeline {
    let options = wgpu::PipelineCompilationOptions::default();
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(label),
        layout,
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vertex"),
            compilation_options: options.clone(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(fragment),
            compilation_options: options,
            targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

impl Layouts {
    pub(crate) fn new(device: &wgpu::Device) -> Layouts {
        let layout = |label, entries: &[_]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let vertex = wgpu::ShaderStages::VERTEX;
        let fragment = wgpu::ShaderStages::FRAGMENT;
        let exact = wgpu::TextureSampleType::Float { filterable: false };
        Layouts {
            frame: layout("frame", &[uniform(0, false)]),
            item: layout("item", &[uniform(0, true)]),
            splats: layout(
                "splats",
                &[
                    texture(0, vertex, exact, false),
                    texture(1, vertex, wgpu::TextureSampleType::Uint, false),
                    texture(2, vertex, exact, false),
                ],
            ),
            part: layout(
                "part",
                &[
                    uniform(0, true),
                    texture(1, fragment, wgpu::TextureSampleType::Float { filterable: true }, false),
                    wgpu::BindGroupLayoutEntry {
                        binding: 2,
                        visibility: fragment,
                        ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering),
                        count: None,
                    },
                ],
            ),
        }
    }
}

/// Pipelines for one number of samples.
#[derive(Clone, Debug)]
pub(crate) struct Pipelines {
    pub(crate) splats: wgpu::RenderPipeline,
    /// Triangles seen from the front, and from both sides.
    pub(crate) meshes: [wgpu::RenderPipeline; 2],
    pub(crate) sky: wgpu::RenderPipeline,
}

struct Kind<'a> {
    label: &'static str,
    code: &'static str,
    layouts: &'a [Option<&'a wgpu::BindGroupLayout>],
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    constants: &'a [(&'a str, f64)],
    cull_mode: Option<wgpu::Face>,
    writes_depth: bool,
    /// Whether opacity says how many of a pixel's samples are covered.
    covers: bool,
}

impl Pipelines {
    pub(crate) fn new(
        device: &wgpu::Device,
        layouts: &Layouts,
        format: wgpu::TextureFormat,
        samples: u32,
    ) -> Pipelines {
        let make = |kind: Kind<'_>| {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(kind.label),
                source: wgpu::ShaderSource::Wgsl(kind.code.into()),
            });
            let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(kind.label),
                bind_group_layouts: kind.layouts,
                immediate_size: 0,
            });
            let options = wgpu::PipelineCompilationOptions { constants: kind.constants, ..Default::default() };
            let compare = if kind.writes_depth { wgpu::CompareFunction::Greater } else { wgpu::CompareFunction::Equal };
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(kind.label),
                layout: Some(&layout),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some("vertex"),
                    compilation_options: options.clone(),
                    buffers: kind.buffers,
                },
                primitive: wgpu::PrimitiveState { cull_mode: kind.cull_mode, ..Default::default() },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH_FORMAT,
                    depth_write_enabled: Some(kind.writes_depth),
                    depth_compare: Some(compare),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState {
                    count: samples,
                    alpha_to_coverage_enabled: kind.covers && samples > 1,
                    ..Default::default()
                },
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some("fragment"),
                    compilation_options: options,
                    // Pictures are opaque, whatever covers their samples.
                    targets: &[Some(wgpu::ColorTargetState {
                        write_mask: if kind.covers { wgpu::ColorWrites::COLOR } else { wgpu::ColorWrites::ALL },
                        ..format.into()
                    })],
                }),
                multiview_mask: None,
                cache: None,
            })
        };
        let vertex = wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x2, 3 => Unorm8x4],
        };
        let mesh = |cull_mode| {
            make(Kind {
                label: "mesh",
                code: MESH,
                layouts: &[Some(&layouts.frame), Some(&layouts.item), Some(&layouts.part)],
                buffers: &[Some(vertex.clone())],
                constants: &[("SAMPLES", f64::from(samples))],
                cull_mode,
                writes_depth: true,
                covers: true,
            })
        };
        Pipelines {
            splats: make(Kind {
                label: "splats",
                code: SPLAT,
                layouts: &[Some(&layouts.frame), Some(&layouts.item), Some(&layouts.splats)],
                buffers: &[],
                constants: &[("SAMPLES", f64::from(samples))],
                cull_mode: None,
                writes_depth: true,
                covers: false,
            }),
            meshes: [mesh(Some(wgpu::Face::Back)), mesh(None)],
            sky: make(Kind {
                label: "sky",
                code: SKY,
                layouts: &[Some(&layouts.frame)],
                buffers: &[],
                constants: &[],
                cull_mode: None,
                writes_depth: false,
                covers: false,
            }),
        }
    }
}
