//! Worlds of any size, made up from a seed or from a small real world.

#[cfg(feature = "city")]
pub mod city;
#[cfg(feature = "tiles3d")]
pub mod mosaic;
#[cfg(feature = "city")]
mod random;
#[cfg(any(feature = "city", feature = "tiles3d"))]
mod staging;
