//! Bytes of the formats that a world is served in.

pub mod glb;
#[cfg(feature = "geometry")]
pub mod glb_compressed;
#[cfg(feature = "orthoviews")]
pub mod orthoview;
#[cfg(feature = "orthoviews")]
pub mod prediction;
