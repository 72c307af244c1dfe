//! Stored worlds into memory.

use super::document::{self, Document, LeftOut};
use super::page::{self, Child, Kind, Node, PageError, PageReference, Stored};
use super::{StoredError, address};
use crate::ground::{Ground, LeafHeights};
use crate::octree::{Cell, Octree};
use crate::uris::UriTableBuilder;
use crate::world::{Note, Severity, World, WorldKind};
use foresight_scheduler::benefit::element::ELEMENTS;
use foresight_scheduler::lod_tree::{LodTreeBuilder, LodTreeError, Representation};
use glam::DVec3;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Reads the document of a world's folder.
///
/// # Errors
/// A file that cannot be read or is at fault.
pub fn open_document(folder: &Path) -> Result<Document, StoredError> {
    let file = folder.join(address::DOCUMENT);
    let bytes = read_at_most(&file, document::BYTES_MAX)?;
    document::parse(&bytes).map_err(|source| StoredError::Document { file, source })
}

/// At most one byte more than `most`.
fn read_at_most(file: &Path, most: usize) -> Result<Vec<u8>, StoredError> {
    let io = |source| StoredError::Io { file: file.to_owned(), source };
    let mut bytes = Vec::new();
    std::fs::File::open(file).map_err(io)?.take(most as u64 + 1).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

/// The pages in a world's folder.
#[derive(Clone, Debug)]
pub struct Pages {
    folder: PathBuf,
    octree: Octree,
}

impl Pages {
    /// Of a folder whose world has this octree.
    pub fn new(folder: &Path, octree: Octree) -> Pages {
        Pages { folder: folder.to_owned(), octree }
    }

    /// The octree.
    pub fn octree(&self) -> &Octree {
        &self.octree
    }

    /// Reads the page of the root by its name.
    ///
    /// # Errors
    /// A page that is not there or at fault.
    pub fn root(&self, name: &str) -> Result<Node, StoredError> {
        let node = self.read(name, None)?;
        let root = self.octree.root();
        if node.cell != root {
            let found = format!("cell {:?}", node.cell);
            return Err(self.fault(name, PageError { at: 6, found, expected: "the root's cell" }));
        }
        Ok(node)
    }

    /// Reads a page that another names.
    ///
    /// # Errors
    /// A page that is not there, at fault, or not the one that is named.
    pub fn page(&self, cell: Cell, reference: &PageReference) -> Result<Node, StoredError> {
        let name = address::page(cell, &reference.hash);
        let node = self.read(&name, Some(reference))?;
        if node.cell != cell {
            let found = format!("cell {:?}", node.cell);
            return Err(self.fault(&name, PageError { at: 6, found, expected: "the cell that its name says" }));
        }
        if node.summary() != reference.summary {
            let found = format!("{:?}", node.summary());
            return Err(self.fault(&name, PageError { at: 32, found, expected: "what the page above says of it" }));
        }
        Ok(node)
    }

    fn read(&self, name: &str, reference: Option<&PageReference>) -> Result<Node, StoredError> {
        let bytes = read_at_most(&self.folder.join(name), page::READ_MAX)?;
        // The fault by its byte says more than that the hash differs.
        let node = page::parse(&bytes, &self.octree).map_err(|source| self.fault(name, source))?;
        let hash = page::hash(&bytes);
        let named = match reference {
            Some(reference) => reference.hash == hash,
            None => name.contains(&address::digits(&hash)),
        };
        if !named {
            let found = format!("content of the hash {}", address::digits(&hash));
            return Err(self.fault(name, PageError { at: 0, found, expected: "the hash that its name says" }));
        }
        Ok(node)
    }

    fn fault(&self, name: &str, source: PageError) -> StoredError {
        StoredError::Page { page: self.folder.join(name), source }
    }

    /// Calls `visit` for every node from `node` on, parents first, reading the pages beneath one at a time. At most
    /// [`crate::octree::LEVELS_MAX`] calls deep.
    ///
    /// # Errors
    /// Those of the pages and of `visit`.
    pub fn visit<E: From<StoredError>>(
        &self,
        node: &Node,
        page: &str,
        visit: &mut impl FnMut(&Node, &str) -> Result<(), E>,
    ) -> Result<(), E> {
        visit(node, page)?;
        for child in &node.children {
            match child {
                Child::Node(node) => self.visit(node, page, visit)?,
                Child::Page(cell, reference) => {
                    let node = self.page(*cell, reference)?;
                    self.visit(&node, &address::page(*cell, &reference.hash), visit)?;
                }
            }
        }
        Ok(())
    }
}

/// Opens the world in a folder: its document and all its pages.
///
/// # Errors
/// A file that is not there or at fault, by its name and byte.
pub fn open(folder: &Path) -> Result<World, StoredError> {
    let document = open_document(folder)?;
    let file = folder.join(address::DOCUMENT);
    let tree_fault = |source: LodTreeError| StoredError::Tree { file: file.clone(), source };
    let Some(octree) = document.octree.octree() else {
        return Err(tree_fault(LodTreeError::Empty));
    };
    let pages = Pages::new(folder, octree);
    let mut builder = Builder {
        pages: &pages,
        tree: LodTreeBuilder::default(),
        uris: UriTableBuilder::default(),
        heights: Vec::new(),
        file: &file,
    };
    let root = pages.root(&document.root)?;
    let summary = root.summary();
    builder.node(&root)?;
    let Builder { tree, uris, heights, .. } = builder;
    let tree = tree.finish().map_err(tree_fault)?;
    let up = DVec3::from_array(document.up);
    let datum = summary.bounds.centre().dot(up);
    let notes = notes(&document);
    Ok(World {
        georeference: document.georeference(),
        root_sample: Some(document.orthoviews.pixel * (1u64 << root.cell.level) as f64),
        name: document.name,
        kind: WorldKind::Built,
        tree,
        uris: uris.finish(),
        up,
        ground: Ground::Leaves(LeafHeights::new(datum, heights)),
        notes,
    })
}

/// What the document says, as notes on the world.
fn notes(document: &Document) -> Vec<Note> {
    let note = |severity, place: &str, text: String| {
        let file = address::DOCUMENT.to_owned();
        Note { severity, file, place: place.to_owned(), text }
    };
    let left_out = document.left_out.iter().map(|left_out| {
        let LeftOut { what, because, figure, unit } = left_out;
        note(Severity::Missing, "left_out", format!("{what}: {because} ({figure} {unit})"))
    });
    left_out.chain(document.notes.iter().map(|text| note(Severity::Trap, "notes", text.clone()))).collect()
}

struct Builder<'a> {
    pages: &'a Pages,
    tree: LodTreeBuilder,
    uris: UriTableBuilder,
    heights: Vec<f64>,
    file: &'a Path,
}

impl Builder<'_> {
    /// At most [`crate::octree::LEVELS_MAX`] calls deep.
    fn node(&mut self, node: &Node) -> Result<(), StoredError> {
        self.open(node).map_err(|source| StoredError::Tree { file: self.file.to_owned(), source })?;
        for child in &node.children {
            match child {
                Child::Node(node) => self.node(node)?,
                Child::Page(cell, reference) => {
                    let node = self.pages.page(*cell, reference)?;
                    self.node(&node)?;
                }
            }
        }
        let bounds = node.leaf.as_ref().map(|leaf| leaf.bounds);
        self.tree.close(bounds, 1.0).map_err(|source| StoredError::Tree { file: self.file.to_owned(), source })
    }

    fn open(&mut self, node: &Node) -> Result<(), LodTreeError> {
        self.tree.open()?;
        if let Some(leaf) = &node.leaf {
            self.heights.push(leaf.ground);
            let shares: Option<[u16; ELEMENTS]> = leaf.shares.as_slice().try_into().ok();
            if let Some(shares) = shares.filter(|shares| shares.iter().any(|&share| share > 0)) {
                self.tree.surface(shares.map(f32::from))?;
            }
        }
        let mut reps: Vec<&Stored> = node.representations.iter().collect();
        reps.sort_by(|a, b| b.error.total_cmp(&a.error).then(a.kind.cmp(&b.kind)));
        for rep in reps {
            self.tree.add(Representation {
                wire_bytes: rep.wire_bytes,
                decoded_bytes: rep.decoded_bytes,
                error: rep.error,
                prerequisite: None,
                direction: match rep.kind {
                    Kind::Orthoview(direction) => Some(direction.code()),
                    Kind::Geometry(_) => None,
                },
            })?;
            if let Some(shown) = rep.shown {
                self.tree.shown(shown)?;
            }
            let (folder, name) = address::representation(node.cell, rep.kind, &rep.hash);
            let (folder, name) = (self.uris.intern(&folder), self.uris.intern(&name));
            self.uris.push(folder, name);
        }
        Ok(())
    }
}
