//! What a representation is once it is decoded: splats or triangles, in memory, ready to be uploaded.

pub mod compress;
pub mod content;
pub mod decode;
pub mod loader;
pub mod resident;
pub mod source;
mod texture;
