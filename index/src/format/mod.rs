//! Bytes of the formats that a world is served in.

#[cfg(feature = "cityjson")]
pub mod glb;
