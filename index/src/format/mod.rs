//! Bytes of the formats that a world is served in.

pub mod glb;
#[cfg(feature = "orthoviews")]
pub mod orthoview;
