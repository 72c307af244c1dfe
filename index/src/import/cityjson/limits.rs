//! Bounds on what a file may make the importer do.

/// Most triangles of one world, those of every level and of every template's instances included.
pub(crate) const MAX_TRIANGLES: usize = 1 << 23;
/// Most vertices of one world, those of templates' instances included.
pub(crate) const MAX_VERTICES: usize = 1 << 25;
/// Most vertices of one face, holes included: triangulation takes up to quadratic time.
pub(crate) const MAX_FACE_VERTICES: usize = 1 << 16;
/// Most objects above an object.
pub(crate) const MAX_PARENTS: usize = 32;
/// Most levels of detail of one file.
pub(crate) const MAX_LEVELS: usize = 64;
/// Farthest coordinate, metres: an area must still be an f32.
pub(crate) const FARTHEST: f64 = 1.0e12;
