//! Terrain from a grid of heights: a quadtree of tiles of 64 × 64 cells over the grid as it is, not resampled.
//!
//! A tile of level l (0 the finest) takes every 2ˡ-th sample and the last one of each row and column. Each cell is two
//! triangles that meet on the diagonal from its first to its last corner, so that fine cells divide coarse ones.

#[cfg(feature = "orthoviews")]
mod contents;
mod encode;
mod field;
mod tiles;

#[cfg(feature = "orthoviews")]
pub use contents::tile_surface;
pub use encode::{EncodeError, decode_heights, encode_heights};
pub use field::{Frame, HeightField, HeightFieldError, MAX_SAMPLES};
pub use tiles::{TILE_CELLS, TerrainError, terrain};

pub(crate) use encode::decoded_bytes;
pub(crate) use field::on_cell;
pub(crate) use tiles::{Level, measure};
