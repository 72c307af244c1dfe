//! Drawing with wgpu: splats and triangles, camera-relative, with a reversed, infinite depth.
//!
//! [`Gpu`] is an adapter and its device; a [`Renderer`] keeps what is uploaded and draws a
//! [`DrawList`](crate::draw::list::DrawList). World positions are f64 up to [`relative`], the one place that narrows them.

pub mod device;
mod distance;
pub mod environment;
mod item;
mod meshes;
mod occlusion;
mod picture;
mod pipelines;
pub mod relative;
pub mod renderer;
pub mod reproject;
pub mod settings;
mod splats;
mod targets;
mod texels;

pub use device::{Gpu, GpuError, GpuSettings};
pub use environment::{Environment, EnvironmentCounts, Share, Surroundings};
pub use occlusion::OcclusionCounts;
pub use picture::Picture;
pub use renderer::{FrameCounts, Renderer};
pub use reproject::{FadeSettings, Reprojection};
pub use settings::{Background, Light, RenderSettings, Sky, SplatShape};
