//! The rival policies, driven through the scheduler.

mod cesium;
mod cesium_native;
mod loaders_gl;
mod lookahead;
mod session;
mod tiles_renderer;
