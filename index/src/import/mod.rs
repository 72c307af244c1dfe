//! Readers of formats that others define.

#[cfg(feature = "cityjson")]
pub mod cityjson;
#[cfg(feature = "tiles3d")]
pub mod tiles3d;
