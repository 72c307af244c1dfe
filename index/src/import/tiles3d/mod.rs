//! 3D Tiles 1.0 and 1.1: explicit and implicit tilings, external tilesets, contents with their real sizes.
//!
//! A tile with a content that its children replace becomes a node with one representation; a tile with `ADD` gets a leaf of its own beside its children.
//! Bytes on the wire are those of the files. Bytes in memory and content bounds are read from the glTF inside.

mod assemble;
pub(crate) mod content;
#[cfg(feature = "orthoviews")]
mod contents;
mod declared;
mod document;
#[cfg(feature = "http")]
mod http;
mod implicit;
#[cfg(feature = "orthoviews")]
mod instances;
pub(crate) mod limits;
pub(crate) mod mesh;
mod resolve;
mod source;
mod subtree;
#[cfg(feature = "orthoviews")]
pub mod surface;
mod volume;
mod walk;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use foresight_scheduler::lod_tree::{LodTreeError, RepId};

pub use content::{ContentError, ContentKind, ContentSummary, content_summary};
#[cfg(feature = "orthoviews")]
pub use contents::{DRAWN_TRIANGLES_MAX, TileContents, content_surface};
pub use document::{Content, DocumentError, GltfUp, ImplicitTiling, Refine, Tile, TilesetDocument, parse_tileset};
#[cfg(feature = "http")]
pub use http::open as open_url;
pub use implicit::ImplicitError;
pub use limits::MAX_TILES;
pub use subtree::{Bits, Subtree, SubtreeError, parse_subtree};
pub use volume::Volume;

#[cfg(feature = "orthoviews")]
pub(crate) use resolve::{Folder as TilesetFolder, Target};
pub(crate) use source::{MOSAIC_SOURCE, Source};

use crate::manifest::{self, Manifest, ManifestError};
use crate::world::{Note, Severity, World, WorldKind};

/// Why a tileset cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum Tiles3dError {
    /// A file that must be there cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A tileset document is at fault.
    #[error("{}: {source}", file.display())]
    Document {
        /// The document.
        file: PathBuf,
        /// The fault.
        source: DocumentError,
    },
    /// An implicit tiling is at fault.
    #[error("{}: {source}", file.display())]
    Implicit {
        /// The document that declares it.
        file: PathBuf,
        /// The fault.
        source: Box<ImplicitError>,
    },
    /// The manifest beside the tileset is at fault.
    #[error("{}: {source}", file.display())]
    Manifest {
        /// The manifest.
        file: PathBuf,
        /// The fault.
        source: ManifestError,
    },
    /// Tilesets that include each other.
    #[error("external tilesets in a circle: {chain}; expected a tree")]
    Cycle {
        /// From the root to the repetition.
        chain: String,
    },
    /// Too many tilesets inside each other.
    #[error("{}: more than {} external tilesets inside each other; expected at most that", file.display(), limits::MAX_EXTERNAL_DEPTH)]
    TooDeep {
        /// The one that is too deep.
        file: PathBuf,
    },
    /// An address that leaves the tileset's folder.
    #[error("{}: the address {uri:?} leaves the tileset's folder; expected one inside it", file.display())]
    Outside {
        /// The document that holds it.
        file: PathBuf,
        /// The address.
        uri: String,
    },
    /// A chain of transforms that overflows.
    #[error("{}: {place}: the transforms down to this tile multiply beyond every number; expected finite ones", file.display())]
    Transform {
        /// The document.
        file: PathBuf,
        /// JSON path of the tile.
        place: String,
    },
    /// More nodes than one world may have.
    #[error("more than {limit} tiles; expected at most that")]
    TooMany {
        /// The most.
        limit: usize,
    },
    /// Not one content is there.
    #[error("{}: no content of any tile can be read; expected at least one{first}", file.display())]
    Empty {
        /// The root document.
        file: PathBuf,
        /// The first reason, if one is known.
        first: String,
    },
    /// The tree cannot be built.
    #[error("{}: {source}", file.display())]
    Tree {
        /// The root document.
        file: PathBuf,
        /// Why not.
        source: LodTreeError,
    },
}

/// Opens the world whose root tileset is `file`. A `manifest.json` of a mosaic beside it is followed.
pub fn open(file: &Path) -> Result<World, Tiles3dError> {
    Ok(load(file, MAX_TILES, false)?.world)
}

/// A world with the files that it was read from, relative to its folder, in order.
pub(crate) struct Loaded {
    pub(crate) world: World,
    pub(crate) files: Vec<String>,
    /// Geometric error of the root tile, metres.
    pub(crate) root_error: f64,
    /// Up axis of the root document.
    pub(crate) gltf_up: GltfUp,
    /// Version of the root document.
    pub(crate) version: String,
    /// File of the first representation.
    pub(crate) coarse_file: String,
    /// Where its contents stand, if that was asked for.
    #[cfg_attr(not(feature = "orthoviews"), expect(dead_code, reason = "for those who read the contents"))]
    pub(crate) places: Option<Places>,
    /// Its folder.
    #[cfg_attr(not(feature = "orthoviews"), expect(dead_code, reason = "for those who read the contents"))]
    pub(crate) folder: resolve::Folder,
}

/// Where the contents of a tileset stand.
#[derive(Clone, Debug, Default)]
#[cfg_attr(not(feature = "orthoviews"), expect(dead_code, reason = "for those who read the contents"))]
pub(crate) struct Places {
    /// Variant and translation by representation.
    pub(crate) representations: Vec<(u32, glam::DVec3)>,
    /// By number.
    pub(crate) variants: Vec<walk::Variant>,
    /// By number.
    pub(crate) linears: Vec<glam::DMat3>,
    /// Content files, relative to the folder.
    pub(crate) files: Vec<String>,
    /// Whose the whole is, as the root document says.
    pub(crate) credit: Option<String>,
}

/// Opens a tileset of `most` tiles at most, `placed` with where its contents stand.
pub(crate) fn load(file: &Path, most: usize, placed: bool) -> Result<Loaded, Tiles3dError> {
    let (path, name) = parted(file)?;
    let manifest = manifest_beside(&path)?;
    let stem = if name == "tileset.json" { named_folder(&path) } else { None };
    let mut loaded = load_from(Source::Files(path), manifest, name, most, placed)?;
    loaded.world.name = stem
        .unwrap_or_else(|| Path::new(name).file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned()));
    Ok(loaded)
}

/// The folder of a file, and its name.
fn parted(file: &Path) -> Result<(PathBuf, &str), Tiles3dError> {
    let unnamed = || std::io::Error::new(std::io::ErrorKind::InvalidInput, "not the name of a file");
    let Some(name) = file.file_name().and_then(|name| name.to_str()) else {
        return Err(Tiles3dError::Io { file: file.to_owned(), source: unnamed() });
    };
    Ok((file.parent().map_or_else(PathBuf::new, Path::to_path_buf), name))
}

/// The manifest of a mosaic in a folder. Only a mosaic's own counts; any other file of that name is none of ours.
fn manifest_beside(folder: &Path) -> Result<Option<Manifest>, Tiles3dError> {
    let file = folder.join("manifest.json");
    match std::fs::read(&file) {
        Ok(bytes) if bytes.windows(manifest::FORMAT.len()).any(|part| part == manifest::FORMAT.as_bytes()) => {
            let parsed = manifest::parse(&bytes);
            Ok(Some(parsed.map_err(|source| Tiles3dError::Manifest { file, source })?))
        }
        _ => Ok(None),
    }
}

/// Opens the tileset `name` of a source. The world is left without a name.
pub(crate) fn load_from(
    source: Source,
    manifest: Option<Manifest>,
    name: &str,
    most: usize,
    placed: bool,
) -> Result<Loaded, Tiles3dError> {
    let kind = if manifest.is_some() { WorldKind::Mosaic } else { WorldKind::Tiles3d };
    let folder = resolve::Folder { source, manifest };
    let walked = walk::Walk::run(&folder, name, most)?;
    let (root_error, gltf_up, version) = (walked.root_error, walked.gltf_up, walked.version.clone());
    let assemble::Assembled { mut world, mut files, places } = assemble::assemble(&folder, name, walked, placed)?;
    world.kind = kind;
    if let Some(manifest) = folder.manifest.as_ref().filter(|manifest| !manifest.stand_ins.is_empty()) {
        let text = format!(
            "{} tiles are synthetic: a content stands in for each, and only its size is meant",
            manifest.stand_ins.len()
        );
        let file = "manifest.json".to_owned();
        world.notes.push(Note { severity: Severity::Trap, file, place: "$.stand_ins".to_owned(), text });
    }
    #[cfg(feature = "http")]
    if let Source::Http(http) = &folder.source {
        world.notes.push(Note {
            severity: Severity::Trap,
            file: name.to_owned(),
            place: String::new(),
            text: http.sum(),
        });
    }
    files.sort();
    files.dedup();
    let coarse_file = match folder.resolve("", &world.uri(RepId(0))) {
        resolve::Target::File { file, .. } => file,
        resolve::Target::Elsewhere | resolve::Target::Outside => String::new(),
    };
    Ok(Loaded { world, files, root_error, gltf_up, version, coarse_file, places, folder })
}

/// The name of a folder, found even if it was given as `.`.
fn named_folder(path: &Path) -> Option<String> {
    let whole = if path.as_os_str().is_empty() { Path::new(".") } else { path };
    let whole = whole.canonicalize().ok()?;
    Some(whole.file_name()?.to_string_lossy().into_owned())
}
