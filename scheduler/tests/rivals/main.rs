//! The rival policies, driven through the scheduler.

mod cesium;
mod cesium_native;
mod loaders_gl;
mod lookahead;
mod playcanvas;
mod potree;
mod session;
mod tiles_renderer;
mod two_phase;
mod weighted_proxy;
