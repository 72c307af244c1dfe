//! The rival policies, driven through the scheduler.

mod lookahead;
mod session;
mod tiles_renderer;
