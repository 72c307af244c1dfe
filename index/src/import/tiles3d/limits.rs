//! Bounds on what a tileset may make the importer do.

/// Most tiles of one world, its external tilesets and implicit tiles included.
pub const MAX_TILES: usize = 1 << 23;
/// Most external tilesets inside each other.
pub(crate) const MAX_EXTERNAL_DEPTH: usize = 64;
/// Most vertices of one content that are transformed one by one; beyond, the corners of its accessors' boxes stand in.
pub(crate) const MAX_POINTS: usize = 1 << 23;
/// Most files that one note is written for; the rest is counted.
pub(crate) const MAX_NOTED_FILES: usize = 16;
/// Most triangles of one content whose area is summed.
pub(crate) const MAX_TRIANGLES: usize = 1 << 25;
/// Most bytes that a compressed file may unfold to.
pub(crate) const MAX_INFLATED: u64 = 1 << 30;
