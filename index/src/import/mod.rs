//! Readers of formats that others define.

#[cfg(feature = "cityjson")]
pub mod cityjson;
#[cfg(feature = "elevation")]
pub mod elevation;
#[cfg(feature = "tiles3d")]
pub mod tiles3d;
