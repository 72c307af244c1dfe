//! Worlds: their LOD trees, the importers that read them, and the generators that make them up.
//!
//! [`world::open`] takes whatever is recognised; [`world::World`] is what everything else works on. The crate decides
//! nothing about what to fetch and knows no clock.

#[cfg(feature = "catalogue")]
pub mod catalogue;
#[cfg(any(feature = "runs", feature = "sessions", feature = "catalogue"))]
pub mod database;
#[cfg(any(feature = "cityjson", feature = "terrain", feature = "asteroids", feature = "city", feature = "orthoviews"))]
pub mod format;
pub mod generate;
pub mod geodesy;
#[cfg(feature = "geometry")]
pub mod geometry;
pub mod ground;
pub mod import;
#[cfg(feature = "tiles3d")]
pub mod manifest;
#[cfg(any(feature = "cityjson", feature = "geometry"))]
mod mesh;
pub mod octree;
pub mod orthoview;
#[cfg(feature = "runs")]
pub mod runs;
#[cfg(feature = "sessions")]
pub mod sessions;
pub mod specification;
#[cfg(feature = "stored")]
pub mod stored;
#[cfg(feature = "orthoviews")]
pub mod surface;
#[cfg(feature = "terrain")]
pub mod terrain;
pub mod uris;
pub mod world;
