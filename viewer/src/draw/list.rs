//! What is drawn in a frame.

use foresight_scheduler::lod_tree::{Aabb, RepId};

/// Everything that is drawn in a frame, in an order that does not matter to the picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DrawList {
    /// Of resident representations, splats and triangles alike.
    pub items: Vec<Item>,
    /// Faces of environment maps, by what [`Environment`](crate::gpu::Environment) numbers them.
    pub faces: Vec<u32>,
}

/// One representation in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Item {
    /// Which.
    pub rep: RepId,
    /// What lies in one of these boxes is left out: others show it. At most [`HIDDEN_MAX`].
    pub hidden: Vec<Aabb>,
    /// Metres by which an orthoview stands back: finer ones are drawn over it, which do not show all of its sides.
    pub behind: f64,
    /// Of an orthoview's 4 × 4 tiles, those that may be seen: bit 4·row + column.
    pub tiles: u16,
    /// Tint for false colours, sRGB; `None` for the content's own.
    pub false_colour: Option<[u8; 3]>,
}

/// Most boxes that an item leaves out: the children of an octree's cell.
pub const HIDDEN_MAX: usize = 8;

/// All of an orthoview's tiles.
pub const ALL_TILES: u16 = u16::MAX;
