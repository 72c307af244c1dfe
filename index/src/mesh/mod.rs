//! Triangle meshes on their way into a tile: welded, simplified, and compared with what they stand for.

#[cfg(feature = "cityjson")]
pub(crate) mod distance;
#[cfg(feature = "cityjson")]
pub(crate) mod simplify;
pub(crate) mod triangle;
#[cfg(feature = "cityjson")]
mod welded;

pub(crate) use triangle::Triangle;
#[cfg(feature = "cityjson")]
pub(crate) use welded::{Mesh, Original};
