//! From tileset documents to one list of nodes: external tilesets are read once and instanced, refinement and
//! transforms are inherited, contents are resolved to files.

use std::cell::RefCell;
use std::collections::BTreeMap;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DMat3, DMat4, DVec3};

use super::Tiles3dError;
use super::document::{self, Content, DocumentError, GltfUp, Refine, Tile, TilesetDocument};
use super::implicit;
use super::limits::{MAX_EXTERNAL_DEPTH, MAX_NOTED_FILES};
use super::resolve::{Folder, Target, folder_of};
use super::volume::{Volume, largest_scale};
use crate::uris::UriTableBuilder;
use crate::world::{Note, Severity};

/// No content, no parent.
pub(crate) const NONE: u32 = u32::MAX;

/// A node of the tree to be, with at most one representation.
#[derive(Clone, Debug)]
pub(crate) struct Placement {
    /// The node above, [`NONE`] for the root.
    pub(crate) parent: u32,
    /// Its content under a linear transform: an index in [`Walked::variants`], [`NONE`] without content.
    pub(crate) variant: u32,
    /// Address, as ids of the table's strings.
    pub(crate) uri: (u32, u32),
    /// Metres.
    pub(crate) error: f32,
    /// Added to what the variant shows.
    pub(crate) translation: DVec3,
    /// Box of the declared volume.
    pub(crate) declared: Aabb,
}

/// A file under the linear part of a transform.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Variant {
    /// Index in [`Walked::files`].
    pub(crate) file: u32,
    /// Up axis of its document.
    pub(crate) up: GltfUp,
    /// Index in [`Walked::linears`].
    pub(crate) linear: u32,
    /// True if the file only stands in for another.
    pub(crate) stand_in: bool,
}

/// What a walk found.
#[derive(Debug, Default)]
pub(crate) struct Walked {
    /// Preorder.
    pub(crate) nodes: Vec<Placement>,
    pub(crate) variants: Vec<Variant>,
    pub(crate) linears: Vec<DMat3>,
    /// Content files, relative to the folder.
    pub(crate) files: Vec<String>,
    /// Documents and subtrees, relative to the folder.
    pub(crate) other_files: Vec<String>,
    pub(crate) uris: UriTableBuilder,
    pub(crate) notes: Vec<Note>,
    /// True if some tile is bounded by a region: its coordinates are Earth-centred.
    pub(crate) has_region: bool,
    /// Geometric error of the root tile, metres.
    pub(crate) root_error: f64,
    /// Up axis of the root document.
    pub(crate) gltf_up: GltfUp,
    /// Version of the root document.
    pub(crate) version: String,
    /// Whose the whole is, as the root document says.
    pub(crate) credit: Option<String>,
}

/// A document, read and expanded.
struct Loaded {
    file: String,
    document: TilesetDocument,
}

/// What the contents of a document lead to, in one place of the folder.
type Links = std::rc::Rc<[Link]>;

#[derive(Clone, Copy, Debug)]
enum Link {
    /// A file and the tail of its address.
    Content { file: u32, tail: u32, stand_in: bool },
    /// Another document.
    External { document: u32 },
    /// Nothing that can be had.
    Nothing,
}

/// A document being walked.
struct Frame {
    document: u32,
    links: Links,
    /// The folder of its address and the string's id.
    base: String,
    prefix: u32,
    next: u32,
    /// What its root hangs below.
    above: Above,
    /// Tiles that were begun: their end and what their children inherit.
    open: Vec<(u32, Above)>,
    /// Documents that it lies in.
    inside: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
struct Above {
    node: u32,
    transform: DMat4,
    refine: Refine,
}

pub(crate) struct Walk<'a> {
    folder: &'a Folder,
    out: Walked,
    documents: Vec<Loaded>,
    document_of: BTreeMap<String, u32>,
    /// By document and the real place of its folder.
    links_of: BTreeMap<(u32, bool, String), Links>,
    file_of: BTreeMap<String, u32>,
    linear_of: BTreeMap<[u64; 9], u32>,
    last_linear: Option<([u64; 9], u32)>,
    variant_of: BTreeMap<Variant, u32>,
    stack: Vec<Frame>,
    missing: usize,
    most: usize,
}

impl<'a> Walk<'a> {
    /// Walks the tileset `name` in `folder` and all that it includes, `most` nodes at most.
    pub(crate) fn run(folder: &'a Folder, name: &str, most: usize) -> Result<Walked, Tiles3dError> {
        let mut walk = Walk {
            folder,
            out: Walked::default(),
            documents: Vec::new(),
            document_of: BTreeMap::new(),
            links_of: BTreeMap::new(),
            file_of: BTreeMap::new(),
            linear_of: BTreeMap::new(),
            last_linear: None,
            variant_of: BTreeMap::new(),
            stack: Vec::new(),
            missing: 0,
            most,
        };
        let bytes = folder.read(name).map_err(|source| Tiles3dError::Io { file: folder.at(name), source })?;
        let root = walk.load(name, "", &bytes)?;
        let document = &walk.documents[root as usize].document;
        if document.tiles[0].refine.is_none() {
            let (file, place) = (name.to_owned(), "$.root.refine".to_owned());
            let text = "not given, though the root's must be: taken as REPLACE".to_owned();
            walk.out.notes.push(Note { severity: Severity::Repair, file, place, text });
        }
        (walk.out.root_error, walk.out.gltf_up) = (document.tiles[0].geometric_error, document.gltf_up);
        walk.out.version = document.version.clone();
        walk.out.credit = document.credit.clone();
        let above = Above { node: NONE, transform: DMat4::IDENTITY, refine: Refine::Replace };
        walk.enter(root, String::new(), above, Vec::new())?;
        while let Some(mut frame) = walk.stack.pop() {
            let tile = frame.next;
            if (tile as usize) < walk.documents[frame.document as usize].document.tiles.len() {
                frame.next += 1;
                walk.tile(frame, tile)?;
            }
        }
        if walk.missing > MAX_NOTED_FILES {
            let text = format!("{} more contents or tilesets are missing", walk.missing - MAX_NOTED_FILES);
            walk.out.notes.push(Note {
                severity: Severity::Missing,
                file: name.to_owned(),
                place: String::new(),
                text,
            });
        }
        Ok(walk.out)
    }

    /// Parses a document and expands its implicit tilings.
    fn load(&mut self, file: &str, base: &str, bytes: &[u8]) -> Result<u32, Tiles3dError> {
        let place = || self.folder.at(file);
        let document = document::parse_tileset(bytes)
            .map_err(|source: DocumentError| Tiles3dError::Document { file: place(), source })?;
        let subtrees = RefCell::new(Vec::new());
        let fetch = |uri: &str| {
            let (file, bytes) = self.folder.fetch(base, uri)?;
            subtrees.borrow_mut().push(file);
            Some(bytes)
        };
        let document = implicit::expand(document, &fetch)
            .map_err(|source| Tiles3dError::Implicit { file: place(), source: Box::new(source) })?;
        self.out.has_region |= document.tiles.iter().any(|tile| matches!(tile.volume, Volume::Region(_)));
        self.out.other_files.push(file.to_owned());
        self.out.other_files.append(&mut subtrees.take());
        for name in &document.unknown_extensions {
            let text = format!("needs the extension {name:?}, which is not read: what it says is not there");
            let place = "$.extensionsRequired".to_owned();
            self.out.notes.push(Note { severity: Severity::Trap, file: file.to_owned(), place, text });
        }
        let id = self.documents.len() as u32;
        self.documents.push(Loaded { file: file.to_owned(), document });
        self.document_of.insert(file.to_owned(), id);
        Ok(id)
    }

    /// Puts a document on the stack.
    fn enter(&mut self, document: u32, base: String, above: Above, inside: Vec<u32>) -> Result<(), Tiles3dError> {
        let links = self.links(document, &base)?;
        let prefix = self.out.uris.intern(&base);
        let mut inside = inside;
        inside.push(document);
        self.stack.push(Frame { document, links, base, prefix, next: 0, above, open: Vec::new(), inside });
        Ok(())
    }

    /// Resolves the contents of a document at `base`. Instances that a manifest leads to one folder share the result.
    fn links(&mut self, document: u32, base: &str) -> Result<Links, Tiles3dError> {
        let mapped = self.folder.manifest.as_ref().and_then(|manifest| {
            let (prefix, folder) = manifest.folder(base)?;
            Some(format!("{folder}{}", &base[prefix.len()..]))
        });
        let key = (document, mapped.is_some(), mapped.unwrap_or_else(|| base.to_owned()));
        if let Some(links) = self.links_of.get(&key) {
            return Ok(links.clone());
        }
        let contents: Vec<String> =
            self.documents[document as usize].document.contents.iter().map(|content| content.uri.clone()).collect();
        let mut links = Vec::with_capacity(contents.len());
        for uri in &contents {
            links.push(self.link(document, base, uri)?);
        }
        let links: Links = links.into();
        self.links_of.insert(key, links.clone());
        Ok(links)
    }

    fn link(&mut self, document: u32, base: &str, uri: &str) -> Result<Link, Tiles3dError> {
        let within = self.documents[document as usize].file.clone();
        let (file, stand_in) = match self.folder.resolve(base, uri) {
            Target::File { file, stand_in } => (file, stand_in),
            Target::Elsewhere => {
                let text =
                    format!("{:?} lies on another host or inline; its tile is without it", document::shortened(uri));
                self.missing(within, text);
                return Ok(Link::Nothing);
            }
            Target::Outside => {
                return Err(Tiles3dError::Outside { file: self.folder.at(&within), uri: document::shortened(uri) });
            }
        };
        if !self.folder.is_document(&file) {
            let tail = self.out.uris.intern(uri);
            let next = self.file_of.len() as u32;
            let id = *self.file_of.entry(file.clone()).or_insert(next);
            if id == next {
                self.out.files.push(file);
            }
            return Ok(Link::Content { file: id, tail, stand_in });
        }
        if let Some(&document) = self.document_of.get(&file) {
            return Ok(Link::External { document });
        }
        match self.folder.read(&file) {
            Ok(bytes) => {
                let base = folder_of(&format!("{base}{uri}")).to_owned();
                Ok(Link::External { document: self.load(&file, &base, &bytes)? })
            }
            Err(error) => {
                let text = format!("external tileset, {error}; the world is without it");
                self.missing(file, text);
                Ok(Link::Nothing)
            }
        }
    }

    /// Notes something that is missing; after the first few it is only counted.
    fn missing(&mut self, file: String, text: String) {
        self.missing += 1;
        if self.missing <= MAX_NOTED_FILES {
            self.out.notes.push(Note { severity: Severity::Missing, file, place: String::new(), text });
        }
    }

    /// Adds the nodes of one tile, and puts its frame and those of its external tilesets back on the stack.
    fn tile(&mut self, mut frame: Frame, index: u32) -> Result<(), Tiles3dError> {
        while frame.open.last().is_some_and(|&(end, _)| end <= index) {
            frame.open.pop();
        }
        let above = frame.open.last().map_or(frame.above, |&(_, above)| above);
        let loaded = &self.documents[frame.document as usize];
        let tile: &Tile = &loaded.document.tiles[index as usize];
        let transform = match &tile.transform {
            Some(local) => above.transform * **local,
            None => above.transform,
        };
        if !transform.is_finite() {
            let place = tile_path(&loaded.document, index);
            return Err(Tiles3dError::Transform { file: self.folder.at(&loaded.file), place });
        }
        let refine = tile.refine.unwrap_or(above.refine);
        let is_leaf = tile.subtree_end == index + 1;
        let volume = tile.volume;
        let up = loaded.document.gltf_up;
        let scaled_error = tile.geometric_error * largest_scale(&transform);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "metres to 7 digits; what exceeds f32 is cut off at its end"
        )]
        let error = scaled_error.min(f64::from(f32::MAX)) as f32;
        let subtree_end = tile.subtree_end;
        let (first, end) = tile.contents;
        let declared = volume.bounds(&transform);
        let contents = &loaded.document.contents[first as usize..end as usize];
        let own_bounds = |content: &Content| content.volume.map_or(declared, |volume| volume.bounds(&transform));
        let volumes: Vec<Aabb> = contents.iter().map(own_bounds).collect();

        let node = self.push(Placement {
            parent: above.node,
            variant: NONE,
            uri: (0, 0),
            error,
            translation: transform.w_axis.truncate(),
            declared,
        })?;
        let links = frame.links.clone();
        let links = &links[first as usize..end as usize];
        let files = links.iter().filter(|link| matches!(link, Link::Content { .. })).count();
        // One content that the children replace, or that has no children, is the tile's own representation. Otherwise a
        // representation would not show everything beneath the tile: what ADD keeps beside the children becomes a leaf
        // beside them. Of several contents that the children replace the first is the tile's, the others are leaves.
        let has_own = if is_leaf { files == 1 && links.len() == 1 } else { refine == Refine::Replace };
        let mut own_is_free = has_own;
        for (link, declared) in links.iter().zip(volumes) {
            match *link {
                Link::Nothing | Link::External { .. } => {}
                Link::Content { file, tail, stand_in } => {
                    let linear = self.linear(DMat3::from_mat4(transform));
                    let variant = self.variant(Variant { file, up, linear, stand_in });
                    let uri = (frame.prefix, tail);
                    if std::mem::take(&mut own_is_free) {
                        let own = &mut self.out.nodes[node as usize];
                        (own.variant, own.uri, own.declared) = (variant, uri, declared);
                    } else {
                        // Nothing refines what ADD keeps: its tile's error is what is missing without the children.
                        let error = if is_leaf || refine == Refine::Replace { error } else { 0.0 };
                        let translation = transform.w_axis.truncate();
                        self.push(Placement { parent: node, variant, uri, error, translation, declared })?;
                    }
                }
            }
        }
        let inherited = Above { node, transform, refine };
        if !is_leaf {
            frame.open.push((subtree_end, inherited));
        }
        // Entered last to first, so that they are walked first to last, before the tile's children.
        let mut entered = Vec::new();
        for (at, link) in links.iter().enumerate().rev() {
            if let Link::External { document } = *link {
                entered.push(self.external(&frame, first as usize + at, document)?);
            }
        }
        self.stack.push(frame);
        for (document, base, inside) in entered {
            self.enter(document, base, inherited, inside)?;
        }
        Ok(())
    }

    /// What is needed to enter an external tileset that content `content` of the frame's document leads to.
    fn external(&self, frame: &Frame, content: usize, external: u32) -> Result<(u32, String, Vec<u32>), Tiles3dError> {
        if frame.inside.contains(&external) {
            let chain = frame.inside.iter().chain([&external]).map(|&id| self.documents[id as usize].file.as_str());
            return Err(Tiles3dError::Cycle { chain: chain.collect::<Vec<_>>().join(" → ") });
        }
        if frame.inside.len() >= MAX_EXTERNAL_DEPTH {
            return Err(Tiles3dError::TooDeep { file: self.folder.at(&self.documents[external as usize].file) });
        }
        let uri = &self.documents[frame.document as usize].document.contents[content].uri;
        Ok((external, folder_of(&format!("{}{uri}", frame.base)).to_owned(), frame.inside.clone()))
    }

    fn push(&mut self, node: Placement) -> Result<u32, Tiles3dError> {
        if self.out.nodes.len() >= self.most {
            return Err(Tiles3dError::TooMany { limit: self.most });
        }
        self.out.nodes.push(node);
        Ok(self.out.nodes.len() as u32 - 1)
    }

    fn linear(&mut self, linear: DMat3) -> u32 {
        let key = linear.to_cols_array().map(f64::to_bits);
        if let Some((_, id)) = self.last_linear.filter(|&(last, _)| last == key) {
            return id;
        }
        let next = self.linear_of.len() as u32;
        let id = *self.linear_of.entry(key).or_insert(next);
        if id == next {
            self.out.linears.push(linear);
        }
        self.last_linear = Some((key, id));
        id
    }

    fn variant(&mut self, variant: Variant) -> u32 {
        let next = self.variant_of.len() as u32;
        let id = *self.variant_of.entry(variant).or_insert(next);
        if id == next {
            self.out.variants.push(variant);
        }
        id
    }
}

/// JSON path of a tile.
fn tile_path(document: &TilesetDocument, index: u32) -> String {
    let mut children = Vec::new();
    let mut at = index;
    while let Some(tile) = document.tiles.get(at as usize) {
        if tile.parent == NONE {
            break;
        }
        children.push(format!(".children[{}]", tile.child));
        at = tile.parent;
    }
    children.push("$.root".to_owned());
    children.reverse();
    document::shortened(&children.concat())
}
