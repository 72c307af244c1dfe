//! Bytes of the formats that a world is served in.

pub mod glb;
