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
pub mod image;
#[cfg(feature = "orthoviews")]
pub mod raster;
#[cfg(feature = "orthoviews")]
pub mod texture;

pub use direction::Direction;
pub use image::{Lattice, Orthoview, Pixel, Rect};
