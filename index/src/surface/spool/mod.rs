//! Surfaces sorted into the leaves of an octree, in a folder, for worlds that do not fit in memory.
//!
//! Files: `triangles` (blocks, several to a leaf), `images` (as they were, each once), `index` (everything else, written
//! last: without it, or if it does not fit its files, the spool is unfinished). The same source and settings make the same
//! bytes on any number of threads.
//!
//! In memory while filling: [`SpoolSettings::memory`], and for each thread a piece and the leaves of its triangles; then, as
//! after opening, 48 bytes a block, of which a leaf has one for each time that the memory filled up between its triangles.

mod block;
mod fill;
mod index;
mod looks;
mod measure;
mod order;

#[cfg(test)]
mod tests;

pub use fill::Progress;
pub use measure::Repairs;

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use super::{SurfaceSource, Surfaces};
use crate::import::tiles3d::ContentError;
use crate::octree::{Cell, Octree, OctreeError};
use crate::orthoview::texture::{Material, Materials, Texture};
use index::Index;
use looks::{Decoded, Stored};

/// File of the triangles.
const TRIANGLES: &str = "triangles";
/// File of the images.
const IMAGES: &str = "images";

/// Most leaves that one triangle may meet.
pub const LEAVES_MAX: usize = 1 << 22;

/// How to sort.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpoolSettings {
    /// Side of a leaf, metres.
    pub leaf_side: f64,
    /// Bytes of triangles that wait in memory: less means more blocks to a leaf.
    pub memory: usize,
    /// Whether triangles far away from everything else are kept too.
    pub keep_strays: bool,
}

impl Default for SpoolSettings {
    /// Leaves of 64 m, 256 MiB.
    fn default() -> SpoolSettings {
        SpoolSettings { leaf_side: 64.0, memory: 256 << 20, keep_strays: false }
    }
}

/// Why there is no spool.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// A file of the spool cannot be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The source is at fault.
    #[error(transparent)]
    Content(#[from] ContentError),
    /// There is no octree over what is there.
    #[error(transparent)]
    Octree(#[from] OctreeError),
    /// Nothing is left.
    #[error(
        "{name}: no triangle that can be drawn ({} not finite, {} without area); expected a mesh",
        repairs.not_finite, repairs.degenerate
    )]
    Empty {
        /// The first piece.
        name: String,
        /// What was left out.
        repairs: Repairs,
    },
    /// A triangle is far larger than a leaf.
    #[error(
        "{name}: a triangle from {} to {} meets more than {LEAVES_MAX} leaves of {side} m; expected larger leaves",
        bounds.min, bounds.max
    )]
    SmallLeaves {
        /// The piece.
        name: String,
        /// Side of the leaves, metres.
        side: f64,
        /// The triangle's box.
        bounds: Aabb,
    },
}

impl SpoolError {
    fn io(file: &Path, source: io::Error) -> SpoolError {
        SpoolError::Io { file: file.to_owned(), source }
    }
}

/// What a source holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics {
    /// Triangles that are kept.
    pub triangles: u64,
    /// How often they are in leaves, one for each leaf that they meet.
    pub placed: u64,
    /// Box around them, metres.
    pub bounds: Aabb,
    /// Their area, m².
    pub area: f64,
    /// Area by unit normal, in at most 384 groups; of surfaces seen from both sides half each way.
    pub orientations: Vec<(DVec3, f64)>,
    /// What was put right.
    pub repairs: Repairs,
    /// What was left out, in words.
    pub left_out: Vec<String>,
    /// Bytes of the images as they are stored.
    pub image_bytes: u64,
    /// Bytes of the triangles as they are stored.
    pub triangle_bytes: u64,
}

/// What a source holds, found by reading it; nothing is sorted or written, so that it is in no leaf.
///
/// # Errors
/// A source that cannot be read or has no triangles.
pub fn inspect(source: &dyn SurfaceSource, progress: Progress<'_>) -> Result<Statistics, SpoolError> {
    fill::inspect(source, progress)
}

/// Triangles of one leaf that lie together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Block {
    leaf: u128,
    offset: u64,
    count: u32,
    flags: u8,
}

/// A filled spool.
pub struct Spool {
    folder: PathBuf,
    octree: Octree,
    index: Index,
    decoded: Decoded,
}

impl Spool {
    /// Sorts the triangles of `source` into `folder`, which is made if need be; an older spool in it is replaced.
    ///
    /// # Errors
    /// A source that cannot be read or has no triangles; leaves far too small; a folder that cannot be written.
    pub fn fill(
        source: &dyn SurfaceSource,
        folder: &Path,
        settings: &SpoolSettings,
        progress: Progress<'_>,
    ) -> Result<Spool, SpoolError> {
        fill::fill(source, folder, settings, progress)
    }

    /// Opens the spool in `folder` if it was finished and is of a source of this identity, with these settings.
    ///
    /// # Errors
    /// Files that are there and cannot be read.
    pub fn open(folder: &Path, identity: [u8; 32], settings: &SpoolSettings) -> Result<Option<Spool>, SpoolError> {
        let Some(index) = Index::read(folder)? else { return Ok(None) };
        let SpoolSettings { leaf_side, keep_strays, .. } = *settings;
        if index.identity != identity || index.leaf_side != leaf_side || index.keep_strays != keep_strays {
            return Ok(None);
        }
        let octree = Octree::over(index.statistics.bounds, leaf_side)?;
        Ok(Some(Spool::over(folder, octree, index)))
    }

    fn over(folder: &Path, octree: Octree, index: Index) -> Spool {
        Spool { folder: folder.to_owned(), octree, index, decoded: Decoded::default() }
    }

    /// The octree over the kept triangles.
    pub fn octree(&self) -> &Octree {
        &self.octree
    }

    /// What is in it.
    pub fn statistics(&self) -> &Statistics {
        &self.index.statistics
    }

    /// Hash of the source.
    pub fn identity(&self) -> [u8; 32] {
        self.index.identity
    }

    /// The blocks of the leaves beneath a cell.
    fn blocks(&self, cell: Cell) -> &[Block] {
        let (first, end) = order::beneath(&self.octree, cell);
        let blocks = &self.index.blocks;
        let at = |key: u128| blocks.partition_point(|block| block.leaf < key);
        &blocks[at(first)..at(end)]
    }

    /// Whether a triangle meets a cell.
    pub fn is_occupied(&self, cell: Cell) -> bool {
        let (first, end) = order::beneath(&self.octree, cell);
        let at = self.index.blocks.partition_point(|block| block.leaf < first);
        self.index.blocks.get(at).is_some_and(|block| block.leaf < end)
    }

    /// Number of triangles in the leaves beneath a cell; one that meets several counts for each.
    pub fn triangles(&self, cell: Cell) -> u64 {
        self.blocks(cell).iter().map(|block| u64::from(block.count)).sum()
    }

    /// The occupied leaves, in the order of a walk down the octree.
    pub fn leaves(&self) -> impl Iterator<Item = [u64; 3]> {
        let runs = self.index.blocks.chunk_by(|a, b| a.leaf == b.leaf);
        runs.map(|run| order::place(&self.octree, run[0].leaf))
    }

    /// The triangles that meet a leaf, whole, with the materials and textures that they have; none if it is empty. A texture
    /// that cannot be decoded is left out, and said.
    ///
    /// # Errors
    /// Files that cannot be read or have changed.
    pub fn leaf(&self, place: [u64; 3]) -> Result<Surfaces, SpoolError> {
        let blocks = self.blocks(Cell { level: 0, place });
        let mut out = Surfaces::default();
        if blocks.is_empty() {
            return Ok(out);
        }
        let path = self.folder.join(TRIANGLES);
        let io = |source| SpoolError::io(&path, source);
        let mut file = File::open(&path).map_err(io)?;
        let mut bytes = Vec::new();
        for block in blocks {
            bytes.resize(block.count as usize * block::stride(block.flags), 0);
            file.seek(SeekFrom::Start(block.offset)).map_err(io)?;
            file.read_exact(&mut bytes).map_err(io)?;
            block::take(&bytes, block.flags, &mut out.triangles);
        }
        self.look(&mut out)?;
        Ok(out)
    }

    /// Gives triangles that have the spool's materials their own few.
    fn look(&self, out: &mut Surfaces) -> Result<(), SpoolError> {
        let mut used: Vec<u32> = out.triangles.iter().map(|triangle| triangle.material).collect();
        used.sort_unstable();
        used.dedup();
        for triangle in &mut out.triangles {
            triangle.material = used.binary_search(&triangle.material).unwrap_or(0) as u32;
        }
        let materials: Vec<Material> =
            used.iter().map(|&at| self.index.materials.get(at as usize).copied().unwrap_or_default()).collect();
        let mut images: Vec<usize> = materials.iter().filter_map(|material| material.texture).collect();
        images.sort_unstable();
        images.dedup();
        let mut textures = Vec::with_capacity(images.len());
        for &image in &images {
            let texture = self.texture(image)?;
            if texture.is_none() {
                out.left_out.push("a texture that cannot be decoded".to_owned());
            }
            textures.push(texture);
        }
        let own = |material: &Material| Material {
            texture: material.texture.and_then(|texture| images.binary_search(&texture).ok()),
            ..*material
        };
        out.materials = Materials { materials: materials.iter().map(own).collect(), textures };
        Ok(())
    }

    fn texture(&self, image: usize) -> Result<Option<Arc<Texture>>, SpoolError> {
        let Some(&Stored { offset, length }) = self.index.images.get(image) else { return Ok(None) };
        let path = self.folder.join(IMAGES);
        let decoded = self.decoded.get(image as u32, || {
            let mut file = File::open(&path)?;
            file.seek(SeekFrom::Start(offset))?;
            let mut bytes = Vec::new();
            file.take(length).read_to_end(&mut bytes)?;
            Ok(Texture::decode(&bytes).ok().map(Arc::new))
        });
        decoded.map_err(|source| SpoolError::io(&path, source))
    }

    /// Removes the files.
    ///
    /// # Errors
    /// Files that cannot be removed.
    pub fn remove(self) -> Result<(), SpoolError> {
        Index::remove(&self.folder)?;
        for name in [TRIANGLES, IMAGES] {
            let file = self.folder.join(name);
            std::fs::remove_file(&file).map_err(|source| SpoolError::io(&file, source))?;
        }
        Ok(())
    }
}
