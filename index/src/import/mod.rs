//! Readers of formats that others define.

#[cfg(feature = "tiles3d")]
pub mod tiles3d;
