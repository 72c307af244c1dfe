//! Worlds of any size, made up from a seed or from a small real world.

#[cfg(feature = "asteroids")]
pub mod asteroids;
#[cfg(feature = "city")]
pub mod city;
#[cfg(feature = "generated")]
pub mod document;
#[cfg(feature = "tiles3d")]
pub mod mosaic;
#[cfg(any(feature = "asteroids", feature = "terrain"))]
mod noise;
#[cfg(any(feature = "city", feature = "terrain", feature = "asteroids"))]
mod random;
#[cfg(any(feature = "generated", feature = "tiles3d"))]
mod staging;
#[cfg(feature = "terrain")]
pub mod terrain;
#[cfg(any(feature = "asteroids", feature = "terrain", feature = "textures"))]
pub mod tileset;
