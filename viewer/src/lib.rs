//! A client of the sidecar: flies through a world while it streams.
//!
//! [`session::fly`] is the client: a camera on a recorded path ([`camera`]), a WebSocket that is opened again when it breaks
//! ([`connection`]), requests over HTTP ([`fetch`]) or on a modelled link ([`modelled`]), and an account of its memory
//! ([`residency`]). [`crowd`] flies many at once.
//!
//! With the feature `draw`, `headless` draws a flight into files on a virtual clock, over a modelled link with the scheduler
//! in this program, and `measure`s what is seen.

pub mod camera;
pub mod clock;
pub mod connection;
#[cfg(feature = "window")]
pub mod controls;
pub mod crowd;
#[cfg(feature = "draw")]
pub mod draw;
pub mod events;
pub mod exchange;
pub mod fetch;
#[cfg(feature = "draw")]
pub mod gpu;
#[cfg(feature = "draw")]
pub mod headless;
#[cfg(feature = "draw")]
pub mod measure;
pub mod modelled;
#[cfg(feature = "draw")]
pub mod offscreen;
#[cfg(feature = "window")]
pub mod overlay;
pub mod residency;
#[cfg(feature = "draw")]
pub mod scene;
pub mod session;
pub mod statistics;
pub mod summary;
#[cfg(feature = "window")]
pub mod window;
