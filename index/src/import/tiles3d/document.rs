//! One `tileset.json`, read without recursion, so that neither a deep tree nor deep extras can exhaust the stack.

use std::fmt::Display;
use std::io::Read;

use glam::{DMat3, DMat4, DVec3};
use serde::Deserialize;
use struson::reader::json_path::JsonPathPiece;
use struson::reader::{JsonReader, JsonReaderPosition, JsonStreamReader, ReaderError, ReaderSettings};
use struson::serde::DeserializerError;

use super::declared::{
    Asset, ContentJson, ExtensionsJson, ImplicitJson, KNOWN_EXTENSIONS, VolumeJson, content, implicit, transform,
    volume,
};
use super::limits::{MAX_NOTED_FILES, MAX_TILES};
use super::volume::Volume;

/// A tileset document: its tiles in preorder.
#[derive(Clone, Debug, Default)]
pub struct TilesetDocument {
    /// Which axis of glTF contents points up in the tile's space.
    pub gltf_up: GltfUp,
    /// `asset.version`.
    pub version: String,
    /// `asset.copyright`, if it is a text.
    pub credit: Option<String>,
    /// Preorder; the root is 0.
    pub tiles: Vec<Tile>,
    /// Contents of all tiles, in their order.
    pub contents: Vec<Content>,
    /// Extensions that a reader must know, by the document, and that this one does not.
    pub unknown_extensions: Vec<String>,
}

/// `asset.gltfUpAxis`: the axis of the glTF contents that becomes z of the tile.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum GltfUp {
    /// x.
    X,
    /// y, glTF's own.
    #[default]
    Y,
    /// z: contents are taken as they are.
    Z,
}

impl GltfUp {
    /// From glTF axes to the tile's axes.
    pub fn rotation(self) -> DMat3 {
        match self {
            GltfUp::X => DMat3::from_cols(DVec3::Z, DVec3::Y, DVec3::NEG_X),
            GltfUp::Y => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
            GltfUp::Z => DMat3::IDENTITY,
        }
    }
}

/// How children refine a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refine {
    /// They are shown in its stead.
    Replace,
    /// They are shown with it.
    Add,
}

/// A tile.
#[derive(Clone, Debug)]
pub struct Tile {
    /// The tile above, `u32::MAX` for the root.
    pub parent: u32,
    /// Which of its parent's children it is.
    pub child: u32,
    /// One past the last tile beneath.
    pub subtree_end: u32,
    /// Into the parent's space, if given.
    pub transform: Option<Box<DMat4>>,
    /// Around the tile's contents and those of its children.
    pub volume: Volume,
    /// Metres.
    pub geometric_error: f64,
    /// `None`: as the parent.
    pub refine: Option<Refine>,
    /// Its contents: a range in [`TilesetDocument::contents`].
    pub contents: (u32, u32),
    /// Set if the tile is the root of an implicit tiling.
    pub implicit: Option<Box<ImplicitTiling>>,
}

/// A content of a tile.
#[derive(Clone, Debug)]
pub struct Content {
    /// As written, relative to the document.
    pub uri: String,
    /// Tighter than the tile's, if given.
    pub volume: Option<Volume>,
}

/// `implicitTiling` of 3D Tiles 1.1.
#[derive(Clone, Debug)]
pub struct ImplicitTiling {
    /// Children per tile, 4 or 8.
    pub branching: u32,
    /// Levels per subtree.
    pub subtree_levels: u32,
    /// Levels with tiles.
    pub available_levels: u32,
    /// Template of the subtrees' addresses.
    pub subtrees: String,
}

/// A fault in a tileset document.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct DocumentError {
    /// JSON path, with line and column where they are known.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

/// Reads a tileset document.
pub fn parse_tileset(bytes: &[u8]) -> Result<TilesetDocument, DocumentError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    // Keeping track of the JSON path costs as much as reading: it is done only once a fault is known to be there.
    read_document(bytes, false).or_else(|_| read_document(bytes, true))
}

fn read_document(bytes: &[u8], track_path: bool) -> Result<TilesetDocument, DocumentError> {
    let settings = ReaderSettings {
        max_nesting_depth: None,
        restrict_number_values: false,
        track_path,
        ..ReaderSettings::default()
    };
    let mut reader = JsonStreamReader::new_custom(bytes, settings);
    let mut document = TilesetDocument::default();
    let mut asset = false;
    reader.begin_object()?;
    while reader.has_next()? {
        match reader.next_name()? {
            "asset" => {
                let given: Asset = value(&mut reader, "asset")?;
                if !matches!(given.version.as_str(), "0.0" | "1.0" | "1.1") {
                    let fault = format!("version {:?}; expected \"1.0\" or \"1.1\"", given.version);
                    return Err(DocumentError { place: "$.asset.version".to_owned(), fault });
                }
                document.gltf_up = match given.gltf_up_axis.as_deref().unwrap_or("Y") {
                    "X" | "x" => GltfUp::X,
                    "Y" | "y" => GltfUp::Y,
                    "Z" | "z" => GltfUp::Z,
                    other => {
                        let fault = format!("{other:?}; expected \"X\", \"Y\" or \"Z\"");
                        return Err(DocumentError { place: "$.asset.gltfUpAxis".to_owned(), fault });
                    }
                };
                document.version = given.version;
                let credit = given.copyright.as_ref().and_then(serde_json::Value::as_str);
                document.credit = credit.filter(|text| !text.trim().is_empty()).map(str::to_owned);
                asset = true;
            }
            "root" => {
                if !document.tiles.is_empty() {
                    return Err(fault(&reader, "a second root; expected one"));
                }
                read_tiles(&mut reader, &mut document)?;
            }
            "extensionsRequired" => {
                let given: Vec<String> = value(&mut reader, "extensionsRequired")?;
                let unknown = given.into_iter().filter(|name| !KNOWN_EXTENSIONS.contains(&name.as_str()));
                document.unknown_extensions.extend(unknown.take(MAX_NOTED_FILES));
            }
            _ => reader.skip_value()?,
        }
    }
    reader.end_object()?;
    reader.consume_trailing_whitespace()?;
    let missing = |member| {
        Err(DocumentError {
            place: "$".to_owned(),
            fault: format!("no member {member:?}; expected a 3D Tiles tileset"),
        })
    };
    match (asset, document.tiles.is_empty()) {
        (false, _) => missing("asset"),
        (_, true) => missing("root"),
        _ => Ok(document),
    }
}

/// What the reader is inside of.
enum Inside {
    /// A tile's object.
    Tile(Unfinished),
    /// The array of a tile's children: its index and how many were begun.
    Children(u32, u32),
}

/// A tile whose members are still being read.
struct Unfinished {
    index: u32,
    volume: bool,
    geometric_error: bool,
    children: bool,
    contents: Vec<Content>,
}

fn read_tiles<R: Read>(reader: &mut JsonStreamReader<R>, document: &mut TilesetDocument) -> Result<(), DocumentError> {
    let mut stack = vec![Inside::Tile(open(reader, document, u32::MAX, 0)?)];
    while let Some(inside) = stack.last_mut() {
        match inside {
            Inside::Children(parent, begun) => {
                if reader.has_next()? {
                    let (parent, child) = (*parent, *begun);
                    *begun += 1;
                    stack.push(Inside::Tile(open(reader, document, parent, child)?));
                } else {
                    reader.end_array()?;
                    stack.pop();
                }
            }
            Inside::Tile(tile) => {
                if reader.has_next()? {
                    if read_member(reader, document, tile)? {
                        let parent = tile.index;
                        stack.push(Inside::Children(parent, 0));
                    }
                } else {
                    close(reader, document, tile)?;
                    reader.end_object()?;
                    stack.pop();
                }
            }
        }
    }
    Ok(())
}

fn open<R: Read>(
    reader: &mut JsonStreamReader<R>,
    document: &mut TilesetDocument,
    parent: u32,
    child: u32,
) -> Result<Unfinished, DocumentError> {
    if document.tiles.len() >= MAX_TILES {
        return Err(fault(reader, format!("more than {MAX_TILES} tiles; expected at most that")));
    }
    reader.begin_object()?;
    let index = document.tiles.len() as u32;
    document.tiles.push(Tile {
        parent,
        child,
        subtree_end: 0,
        transform: None,
        volume: Volume::Sphere { centre: DVec3::ZERO, radius: 0.0 },
        geometric_error: 0.0,
        refine: None,
        contents: (0, 0),
        implicit: None,
    });
    Ok(Unfinished { index, volume: false, geometric_error: false, children: false, contents: Vec::new() })
}

/// Reads one member of a tile; true if it opened the array of children.
fn read_member<R: Read>(
    reader: &mut JsonStreamReader<R>,
    document: &mut TilesetDocument,
    unfinished: &mut Unfinished,
) -> Result<bool, DocumentError> {
    let tile = &mut document.tiles[unfinished.index as usize];
    match reader.next_name()? {
        "boundingVolume" => {
            let given: VolumeJson = value(reader, "boundingVolume")?;
            tile.volume = volume(&given).map_err(|text| member_fault(reader, "boundingVolume", text))?;
            unfinished.volume = true;
        }
        "geometricError" => {
            let given: f64 = value(reader, "geometricError")?;
            if !(given.is_finite() && given >= 0.0) {
                let text = format!("{given}; expected metres, finite and not negative");
                return Err(member_fault(reader, "geometricError", text));
            }
            tile.geometric_error = given;
            unfinished.geometric_error = true;
        }
        "refine" => {
            let given = reader.next_string()?;
            tile.refine = Some(match given.to_ascii_uppercase().as_str() {
                "REPLACE" => Refine::Replace,
                "ADD" => Refine::Add,
                _ => {
                    let text = format!("{given:?}; expected \"ADD\" or \"REPLACE\"");
                    return Err(member_fault(reader, "refine", text));
                }
            });
        }
        "transform" => {
            let given: Vec<f64> = value(reader, "transform")?;
            let matrix = transform(&given).map_err(|text| member_fault(reader, "transform", text))?;
            tile.transform = (matrix != DMat4::IDENTITY).then(|| Box::new(matrix));
        }
        "content" => {
            let given: ContentJson = value(reader, "content")?;
            let content = content(given).map_err(|text| member_fault(reader, "content", text))?;
            unfinished.contents.push(content);
        }
        "contents" => {
            for given in value::<_, Vec<ContentJson>>(reader, "contents")? {
                let content = content(given).map_err(|text| member_fault(reader, "contents", text))?;
                unfinished.contents.push(content);
            }
        }
        "extensions" => {
            let given: ExtensionsJson = value(reader, "extensions")?;
            if let Some(given) = given.implicit {
                let tiling = implicit(given).map_err(|text| member_fault(reader, "extensions", text))?;
                tile.implicit = Some(Box::new(tiling));
            }
            for given in given.contents.into_iter().flat_map(|given| given.contents) {
                let content = content(given).map_err(|text| member_fault(reader, "extensions", text))?;
                unfinished.contents.push(content);
            }
        }
        "implicitTiling" => {
            let given: ImplicitJson = value(reader, "implicitTiling")?;
            let tiling = implicit(given).map_err(|text| member_fault(reader, "implicitTiling", text))?;
            tile.implicit = Some(Box::new(tiling));
        }
        "children" => {
            if std::mem::replace(&mut unfinished.children, true) {
                return Err(member_fault(reader, "children", "given twice; expected once"));
            }
            reader.begin_array()?;
            return Ok(true);
        }
        _ => reader.skip_value()?,
    }
    Ok(false)
}

fn close<R: Read>(
    reader: &mut JsonStreamReader<R>,
    document: &mut TilesetDocument,
    unfinished: &mut Unfinished,
) -> Result<(), DocumentError> {
    if !unfinished.geometric_error {
        return Err(tile_fault(reader, "no member \"geometricError\"; expected metres"));
    }
    if !unfinished.volume {
        return Err(tile_fault(reader, "no member \"boundingVolume\"; expected a box, a region or a sphere"));
    }
    let end = document.tiles.len() as u32;
    let tile = &mut document.tiles[unfinished.index as usize];
    tile.subtree_end = end;
    if tile.implicit.is_some() && unfinished.children {
        return Err(tile_fault(reader, "both \"implicitTiling\" and \"children\"; expected one of them"));
    }
    let first = document.contents.len() as u32;
    document.contents.append(&mut unfinished.contents);
    tile.contents = (first, document.contents.len() as u32);
    Ok(())
}

/// A position as a JSON path, and as line and column.
fn place(position: &JsonReaderPosition) -> (String, String) {
    let mut path = "$".to_owned();
    for piece in position.path.iter().flatten() {
        match piece {
            JsonPathPiece::ArrayItem(index) => path.push_str(&format!("[{index}]")),
            JsonPathPiece::ObjectMember(name) => path.push_str(&format!(".{name}")),
        }
    }
    let line = position.line_pos.map(|at| format!(" (line {}, column {})", at.line + 1, at.column + 1));
    (path, line.unwrap_or_default())
}

/// A path without its middle, if it is very long.
pub(crate) fn shortened(path: &str) -> String {
    let count = path.chars().count();
    if count <= 240 {
        return path.to_owned();
    }
    let head: String = path.chars().take(120).collect();
    let tail: String = path.chars().skip(count - 100).collect();
    format!("{head} … {tail}")
}

/// The value of the member whose name was read last.
fn value<R: Read, T: for<'a> Deserialize<'a>>(
    reader: &mut JsonStreamReader<R>,
    member: &str,
) -> Result<T, DocumentError> {
    match reader.deserialize_next() {
        Ok(value) => Ok(value),
        Err(DeserializerError::ReaderError(error)) => Err(error.into()),
        Err(error) => Err(member_fault(reader, member, error)),
    }
}

fn fault<R: Read>(reader: &JsonStreamReader<R>, text: impl Display) -> DocumentError {
    let (path, line) = place(&reader.current_position(true));
    DocumentError { place: format!("{}{line}", shortened(&path)), fault: text.to_string() }
}

/// A fault in the tile's member that was read last.
fn member_fault<R: Read>(reader: &JsonStreamReader<R>, member: &str, text: impl Display) -> DocumentError {
    let (path, line) = place(&reader.current_position(true));
    let end = path.rfind(&format!(".{member}")).unwrap_or(path.len());
    DocumentError { place: format!("{}.{member}{line}", shortened(&path[..end])), fault: text.to_string() }
}

/// A fault in the tile whose last member was read.
fn tile_fault<R: Read>(reader: &JsonStreamReader<R>, text: &str) -> DocumentError {
    let (path, line) = place(&reader.current_position(true));
    let parent = path.rsplit_once('.').map_or(path.as_str(), |(parent, _)| parent);
    DocumentError { place: format!("{}{line}", shortened(parent)), fault: text.to_owned() }
}

impl From<ReaderError> for DocumentError {
    fn from(error: ReaderError) -> DocumentError {
        let (found, location) = match &error {
            ReaderError::SyntaxError(error) => (format!("{}", error.kind), &error.location),
            ReaderError::UnexpectedValueType { expected, actual, location } => {
                (format!("{actual} where there must be {expected}"), location)
            }
            ReaderError::UnexpectedStructure { kind, location } => (kind.to_string(), location),
            ReaderError::MaxNestingDepthExceeded { location, .. } => ("nested too deeply".to_owned(), location),
            ReaderError::UnsupportedNumberValue { number, location } => (format!("the number {number}"), location),
            ReaderError::IoError { error, location } => (error.to_string(), location),
            other => return DocumentError { place: "$".to_owned(), fault: shortened(&other.to_string()) },
        };
        let (path, line) = place(location);
        let fault = format!("{}; expected JSON of a 3D Tiles tileset", shortened(&found));
        DocumentError { place: format!("{}{line}", shortened(&path)), fault }
    }
}
