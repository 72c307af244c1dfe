//! Orthoviews: a cell's content seen along a canonical direction in parallel projection, with colour, depth and normal
//! (\[HIBR\] §4.1).
//!
//! All images of a direction share one lattice: a pixel of level ℓ is 2^ℓ leaf pixels wide and high, anchored at the
//! octree's origin. A parent's pixel covers exactly four of its children's, whatever the cells' shapes are, so that
//! compositing needs no resampling. Leaves are drawn at twice the resolution and brought down by the same rule.

#[cfg(feature = "orthoviews")]
pub mod build;
#[cfg(feature = "orthoviews")]
pub mod composite;
#[cfg(feature = "orthoviews")]
pub mod connectivity;
pub mod direction;
#[cfg(feature = "orthoviews")]
pub mod error;
pub mod image;
#[cfg(feature = "orthoviews")]
pub mod raster;
#[cfg(feature = "orthoviews")]
pub mod texture;

pub use direction::Direction;
/// Error of an orthoview that hides nothing, in sides of its pixels, on the scale of the errors of meshes. A tile whose
/// geometric error is 16 px has texels of about a pixel or two; samples of two pixels lose as much, as pictures say
/// (`pictures quality`).
pub const SAMPLE_ERROR: f64 = 8.0;

pub use image::{Lattice, Orthoview, Pixel, Rect};
