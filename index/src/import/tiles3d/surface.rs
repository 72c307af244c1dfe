//! What a tileset's finest contents look like: triangles with their materials, a content a piece.

use std::path::Path;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DMat4, DVec3};

use super::Tiles3dError;
use super::content::ContentError;
use super::contents::Reader;
use super::limits::MAX_TRIANGLES;
use super::resolve::Folder;
use super::walk::{NONE, Walk, Walked};
use crate::surface::{Piece, SurfaceSource};
use crate::world::Georeference;

/// The finest contents of a tileset.
pub struct FinestContents {
    folder: Folder,
    walked: Walked,
    items: Vec<Item>,
    /// Files that the world is read from, in order.
    files: Vec<String>,
    up: DVec3,
    georeference: Option<Georeference>,
}

/// A content in its place.
#[derive(Clone, Copy, Debug)]
struct Item {
    node: u32,
    bounds: Aabb,
}

impl FinestContents {
    /// Opens the tileset `file`: every content that no other replaces.
    ///
    /// # Errors
    /// As [`super::open`].
    pub fn open(file: &Path) -> Result<FinestContents, Tiles3dError> {
        let loaded = super::load(file, super::MAX_TILES, false)?;
        let (up, georeference, files) = (loaded.world.up, loaded.world.georeference, loaded.files);
        let (path, name) = super::parted(file)?;
        let manifest = super::manifest_beside(&path)?;
        let folder = Folder { source: super::Source::Files(path), manifest };
        let walked = Walk::run(&folder, name, super::MAX_TILES)?;
        let mut replaced = vec![false; walked.nodes.len()];
        // Preorder: from the last on, so that what lies beneath is known.
        for index in (0..walked.nodes.len()).rev() {
            let node = &walked.nodes[index];
            if node.parent != NONE && (node.variant != NONE || replaced[index]) {
                replaced[node.parent as usize] = true;
            }
        }
        let finest = walked.nodes.iter().enumerate().filter(|(i, node)| node.variant != NONE && !replaced[*i]);
        let items = finest.map(|(i, node)| Item { node: i as u32, bounds: node.declared }).collect();
        Ok(FinestContents { folder, walked, items, files, up, georeference })
    }

    fn variant(&self, index: usize) -> usize {
        self.walked.nodes[self.items[index].node as usize].variant as usize
    }

    /// Name of a content's file, relative to the tileset's folder.
    fn file(&self, index: usize) -> &str {
        &self.walked.files[self.walked.variants[self.variant(index)].file as usize]
    }
}

impl SurfaceSource for FinestContents {
    fn pieces(&self) -> usize {
        self.items.len()
    }

    fn declared(&self, piece: usize) -> Option<Aabb> {
        Some(self.items[piece].bounds)
    }

    fn name(&self, piece: usize) -> &str {
        self.file(piece)
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let node = &self.walked.nodes[self.items[piece].node as usize];
        let variant = self.walked.variants[node.variant as usize];
        let file = self.file(piece);
        let at = |fault: String| ContentError::new(file, fault);
        let bytes = self.folder.read(file).map_err(|error| at(format!("{error}; expected a content")))?;
        let linear = self.walked.linears[variant.linear as usize];
        let reader = Reader {
            folder: Some(&self.folder),
            tile: DMat4::from_translation(node.translation) * DMat4::from_mat3(linear),
            up: variant.up.rotation(),
            with_normals: false,
            triangles_max: MAX_TRIANGLES,
        };
        reader.read(file, &bytes)
    }

    fn up(&self) -> DVec3 {
        self.up
    }

    fn georeference(&self) -> Option<Georeference> {
        self.georeference
    }

    /// Over the names and bytes of the files that the world is read from.
    fn identity(&self) -> Result<[u8; 32], ContentError> {
        let mut hasher = blake3::Hasher::new();
        hasher.update(b"foresight-surfaces-tileset-1");
        for file in &self.files {
            let bytes = self.folder.source.read(file);
            let bytes = bytes.map_err(|error| ContentError::new(file.as_str(), format!("{error}; expected a file")))?;
            for part in [file.as_bytes(), &bytes] {
                hasher.update(&(part.len() as u64).to_le_bytes());
                hasher.update(part);
            }
        }
        Ok(*hasher.finalize().as_bytes())
    }
}
