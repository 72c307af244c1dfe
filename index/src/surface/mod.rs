//! Where surfaces come from: meshes in files, tilesets, city models and generated worlds, a piece at a time.
//!
//! A [`SurfaceSource`] is cut into pieces, each of which fits in memory; [`open`] makes one of whatever is recognised.

pub(crate) mod gltf;
mod inputs;
mod lines;
mod obj;
pub mod overlap;
mod ply;
mod polygon;
mod source;
pub mod spool;

#[cfg(test)]
mod tests;

pub use gltf::{GltfFile, read_glb};
#[cfg(feature = "cityjson")]
pub(crate) use inputs::file_identity;
#[cfg(any(feature = "textures", feature = "terrain", feature = "asteroids"))]
pub(crate) use inputs::parameters_identity;
pub use obj::ObjFile;
pub use ply::PlyFile;
pub use source::{SurfaceError, is_mesh, open};

use std::sync::Arc;

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::{Material, Materials, Texture};
use crate::world::Georeference;

/// Most triangles of a piece, where a source is cut: 36 MB of them.
pub const PIECE_TRIANGLES: usize = 1 << 18;

/// The axis of a file that points away from the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Up {
    /// x.
    X,
    /// y.
    Y,
    /// z.
    #[default]
    Z,
}

impl Up {
    /// Turned so that it is z.
    fn to_z(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Up::X => [-z, y, x],
            Up::Y => [x, -z, y],
            Up::Z => [x, y, z],
        }
    }

    fn code(self) -> u8 {
        b'x' + self as u8
    }
}

/// Triangles in world space, ready to be drawn.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    /// Counter-clockwise from the front.
    pub triangles: Vec<Triangle>,
    /// What they look like.
    pub materials: Materials,
    /// What was left out, in words.
    pub left_out: Vec<String>,
}

impl Surfaces {
    /// Box around the finite corners; empty without any.
    pub fn bounds(&self) -> Aabb {
        let corners = self.triangles.iter().flat_map(|t| t.corners).filter(|c| c.is_finite());
        corners.fold(Aabb::EMPTY, |bounds, corner| bounds.union(Aabb { min: corner, max: corner }))
    }
}

/// A piece of a source: its images as their files hold them.
#[derive(Clone, Debug, Default)]
pub struct Piece {
    /// Counter-clockwise from the front, metres in the world.
    pub triangles: Vec<Triangle>,
    /// By number; their textures are numbers of images.
    pub materials: Vec<Material>,
    /// PNG, JPEG or WebP by number; absent where there is none to be had.
    pub images: Vec<Option<Arc<[u8]>>>,
    /// Unit normals at the corners, one a triangle, zero where the file has none; empty unless they were asked for.
    pub normals: Vec<[[f32; 3]; 3]>,
    /// Whose the content is, as it says itself.
    pub credit: Option<String>,
    /// What was left out, in words.
    pub left_out: Vec<String>,
}

impl Piece {
    /// Adds another piece. Credits that differ are told one after the other.
    pub(crate) fn append(&mut self, mut other: Piece) {
        let (materials, images) = (self.materials.len() as u32, self.images.len());
        other.triangles.iter_mut().for_each(|triangle| triangle.material += materials);
        other.materials.iter_mut().for_each(|material| material.texture = material.texture.map(|t| t + images));
        self.triangles.append(&mut other.triangles);
        self.materials.append(&mut other.materials);
        self.images.append(&mut other.images);
        self.normals.append(&mut other.normals);
        self.left_out.append(&mut other.left_out);
        self.credit = match (self.credit.take(), other.credit) {
            (Some(own), Some(other)) if own != other => Some(format!("{own}; {other}")),
            (own, other) => own.or(other),
        };
    }

    /// Decodes the images; one that cannot be is left out, and what it was on has its base colour.
    pub fn decoded(self) -> Surfaces {
        let Piece { triangles, materials, images, mut left_out, .. } = self;
        let textures = images.iter().map(|image| match Texture::decode(image.as_deref()?) {
            Ok(texture) => Some(Arc::new(texture)),
            Err(error) => {
                left_out.push(format!("a texture: {error}"));
                None
            }
        });
        let textures = textures.collect();
        Surfaces { triangles, materials: Materials { materials, textures }, left_out }
    }
}

/// Surfaces by the piece.
pub trait SurfaceSource: Send + Sync {
    /// Number of pieces. What is read of one is in memory at a time.
    fn pieces(&self) -> usize;

    /// Box around a piece as it is declared, which is not always that of what is in it; `None` if it is not known before
    /// the piece is read.
    fn declared(&self, piece: usize) -> Option<Aabb>;

    /// The file of a piece, and the part of it.
    fn name(&self, piece: usize) -> &str;

    /// Reads a piece with its images as they are stored.
    ///
    /// # Errors
    /// A file that cannot be read or holds no surfaces.
    fn read(&self, piece: usize) -> Result<Piece, ContentError>;

    /// Reads the triangles of a piece alone; their materials mean nothing.
    ///
    /// # Errors
    /// As [`SurfaceSource::read`].
    fn triangles(&self, piece: usize) -> Result<Vec<Triangle>, ContentError> {
        Ok(self.read(piece)?.triangles)
    }

    /// Reads a piece with its images decoded.
    ///
    /// # Errors
    /// As [`SurfaceSource::read`].
    fn load(&self, piece: usize) -> Result<Surfaces, ContentError> {
        Ok(self.read(piece)?.decoded())
    }

    /// Away from the ground, unit length.
    fn up(&self) -> DVec3;

    /// How world space lies on the Earth, if it does.
    fn georeference(&self) -> Option<Georeference>;

    /// The BLAKE3 hash over the bytes of all inputs, or over the parameters of what is generated: another where anything has
    /// changed.
    ///
    /// # Errors
    /// An input that cannot be read.
    fn identity(&self) -> Result<[u8; 32], ContentError>;
}
