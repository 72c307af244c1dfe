//! Decoded contents, as the GPU takes them.

use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use std::sync::Arc;

/// What is drawn for a representation.
#[derive(Clone, Debug)]
pub enum Content {
    /// An orthoview: one splat a pixel that shows something.
    Splats(SplatImage),
    /// Triangles.
    Mesh(Mesh),
    /// Nothing that could be drawn: an empty tile.
    Empty,
}

impl Content {
    /// Bytes that it takes in memory, and nearly those on the GPU. A texture that several meshes show counts for each.
    pub fn bytes(&self) -> u64 {
        let bytes = match self {
            Content::Splats(image) => image.colours.len() + 2 * image.shapes.len() + image.normals.len(),
            Content::Mesh(mesh) => {
                let textures: usize = mesh.textures.iter().map(|texture| texture.texels.len()).sum();
                size_of_val(mesh.vertices.as_slice()) + size_of_val(mesh.indices.as_slice()) + textures
            }
            Content::Empty => 0,
        };
        bytes as u64
    }
}

/// An orthoview. Pixel (column, row), rows growing upwards, with its depth's code d is at
/// `origin + pixel·(column·right + row·up) − d/1023·range·towards_eye`.
#[derive(Clone, Debug, PartialEq)]
pub struct SplatImage {
    /// From the content to the eye.
    pub direction: Direction,
    /// The middle of the first pixel at depth 0, metres in the world.
    pub origin: DVec3,
    /// Unit vectors along columns and rows, and to the eye, world space.
    pub right: DVec3,
    /// Along rows, upwards.
    pub up: DVec3,
    /// To the eye.
    pub towards_eye: DVec3,
    /// Side of a pixel, metres.
    pub pixel: f64,
    /// Metres from depth's code 0 to 1023.
    pub range: f64,
    /// Columns and rows.
    pub size: [u32; 2],
    /// sRGB, four bytes a pixel, the fourth 255; or blocks of them.
    pub colours: Vec<u8>,
    /// How the colours are kept: plain, BC1 or BC7.
    pub colours_kept: Texels,
    /// Low ten bits: steps of the depth; upper six: [`foresight_index::orthoview::connectivity::Links::bits`]. One a pixel.
    pub shapes: Vec<u16>,
    /// On the octahedron, two bytes a pixel, or blocks of them; empty where the file has none.
    pub normals: Vec<u8>,
    /// How the normals are kept: plain or BC5.
    pub normals_kept: Texels,
    /// Box of the cell, metres in the world.
    pub bounds: Aabb,
}

/// Triangles with their materials.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// What vertices are relative to, metres in the world.
    pub origin: DVec3,
    /// All parts' vertices.
    pub vertices: Vec<Vertex>,
    /// Three a triangle, counter-clockwise from the front.
    pub indices: Vec<u32>,
    /// Runs of indices by material.
    pub parts: Vec<Part>,
    /// By number.
    pub textures: Vec<Arc<TextureImage>>,
    /// Box around the vertices, metres in the world.
    pub bounds: Aabb,
}

/// A corner of a triangle.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Vertex {
    /// Metres from the mesh's origin.
    pub position: [f32; 3],
    /// Unit, world space; zero where the file has none: then the face's own counts.
    pub normal: [f32; 3],
    /// Texture coordinates; (0, 0) is the first texel's corner.
    pub uv: [f32; 2],
    /// sRGB, multiplied with the material's colour in linear light; the fourth is 255.
    pub tint: [u8; 4],
}

/// Triangles that look alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// First index, and how many.
    pub indices: std::ops::Range<u32>,
    /// Linear light, multiplied with the texture.
    pub base: [f32; 3],
    /// Which of the mesh's textures.
    pub texture: Option<usize>,
    /// What is less opaque than this is a hole; 0 where nothing is.
    pub cutoff: f32,
    /// Whether backs are seen too.
    pub two_sided: bool,
}

/// An image on triangles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextureImage {
    /// Columns and rows.
    pub size: [u32; 2],
    /// sRGB and opacity, four bytes a texel, first row first, or blocks of them; behind the finest level its mips
    /// ([`TextureImage::levels`]).
    pub texels: Vec<u8>,
    /// How they are kept: plain, BC1, BC3 or BC7.
    pub kept: Texels,
}

/// How a plane's texels are kept. A block is of 4 × 4 texels; the last column and row are repeated to whole blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Texels {
    /// One after the other.
    #[default]
    Plain,
    /// Opaque colours, 8 bytes a block.
    Bc1,
    /// Colours and opacity, 16 bytes a block.
    Bc3,
    /// Two numbers, 16 bytes a block.
    Bc5,
    /// Colours and opacity, finer, 16 bytes a block.
    Bc7,
}

impl Texels {
    /// Bytes of so many columns and rows, with `each` bytes of a plain texel.
    pub fn bytes(self, size: [u32; 2], each: u64) -> u64 {
        let area = |size: [u32; 2]| u64::from(size[0]) * u64::from(size[1]);
        let blocks = area(size.map(|side| side.div_ceil(4)));
        match self {
            Texels::Plain => area(size).saturating_mul(each),
            Texels::Bc1 => 8 * blocks,
            Texels::Bc3 | Texels::Bc5 | Texels::Bc7 => 16 * blocks,
        }
    }
}
