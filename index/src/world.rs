//! A world that can be replayed or served: its LOD tree, where each representation is fetched, and what was found
//! about it on the way in.

use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use foresight_scheduler::lod_tree::{Aabb, LodTree, NodeId, RepId};
use glam::DVec3;

use crate::ground::Ground;
use crate::uris::UriTable;

/// A world.
#[derive(Clone, Debug)]
pub struct World {
    /// What to call it: the name of its folder, of its file, or of the generator.
    pub name: String,
    /// What it was made from.
    pub kind: WorldKind,
    /// Nodes and representations.
    pub tree: LodTree,
    /// Where each representation is fetched, relative to the world's folder.
    pub uris: UriTable,
    /// Away from the ground, unit length, world space. On a planet: the vertical at the world's middle.
    pub up: DVec3,
    /// The height of the ground.
    pub ground: Ground,
    /// How world space lies on the Earth, if it does.
    pub georeference: Option<Georeference>,
    /// Side of a pixel of the root's orthoviews, metres; a level further down it is half of that. `None` where the world has
    /// no octree of orthoviews: their errors then are all that is known of them.
    pub root_sample: Option<f64>,
    /// What was repaired, looks wrong, or was left out.
    pub notes: Vec<Note>,
}

/// What a world was made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WorldKind {
    /// A 3D Tiles tileset.
    Tiles3d,
    /// A 3D Tiles tileset instanced on a grid.
    Mosaic,
    /// A generated city.
    City,
    /// A city model in CityJSON or CityJSONSeq.
    CityJson,
    /// Terrain from a grid of heights.
    Terrain,
    /// Generated terrain.
    GeneratedTerrain,
    /// Generated models in space.
    Asteroids,
    /// A stored world: orthoviews and geometry.
    Built,
}

impl fmt::Display for WorldKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            WorldKind::Tiles3d => "3D Tiles",
            WorldKind::Mosaic => "mosaic of 3D Tiles",
            WorldKind::City => "generated city",
            WorldKind::CityJson => "CityJSON",
            WorldKind::Terrain => "elevation grid",
            WorldKind::GeneratedTerrain => "generated terrain",
            WorldKind::Asteroids => "generated asteroids",
            WorldKind::Built => "stored world",
        })
    }
}

/// How world space lies on the Earth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Georeference {
    /// Earth-centred, Earth-fixed WGS 84 coordinates (EPSG:4978), metres.
    Ecef,
    /// A projected system by its EPSG code: x east, y north, z height, metres.
    Epsg(u32),
}

/// What a note means for those who use the world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Something was wrong and was put right.
    Repair,
    /// Something is not what it says, or is easily misread.
    Trap,
    /// Something was left out.
    Missing,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Severity::Repair => "repaired",
            Severity::Trap => "mind",
            Severity::Missing => "missing",
        })
    }
}

/// Something that was repaired, looks wrong, or was left out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// What it means.
    pub severity: Severity,
    /// The file it is about, relative to the world's folder.
    pub file: String,
    /// The place in the file: a JSON path or a byte offset; empty for the whole file.
    pub place: String,
    /// What was found, and what was done about it.
    pub text: String,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.severity, self.file)?;
        if !self.place.is_empty() {
            write!(f, " at {}", self.place)?;
        }
        write!(f, ": {}", self.text)
    }
}

/// A world in figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Nodes of the tree.
    pub nodes: u64,
    /// Nodes without children.
    pub leaves: u64,
    /// Representations.
    pub representations: u64,
    /// Nodes from the root to the deepest leaf, both counted.
    pub depth: u32,
    /// Sum of the bytes on the wire.
    pub wire_bytes: u64,
    /// Sum of the bytes in memory.
    pub decoded_bytes: u64,
    /// The root's bounds, metres.
    pub bounds: Aabb,
}

/// Why there is no world to be had from a path.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// It cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// What was to be read.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// It is none of the kinds known.
    #[error("{}: {found}; expected {EXPECTED}", file.display())]
    Unrecognised {
        /// What was looked at.
        file: PathBuf,
        /// What it looks like.
        found: String,
    },
    /// It is of a kind that this build was made without.
    #[error("{}: this build reads no {kind}", file.display())]
    NotBuilt {
        /// What was looked at.
        file: PathBuf,
        /// Its kind.
        kind: &'static str,
    },
    /// It is a tileset with a fault.
    #[cfg(feature = "tiles3d")]
    #[error(transparent)]
    Tiles3d(#[from] crate::import::tiles3d::Tiles3dError),
    /// It is a generated world with a fault.
    #[cfg(feature = "generated")]
    #[error(transparent)]
    Generated(#[from] crate::generate::document::GenerateError),
    /// It is a mosaic that cannot be made.
    #[cfg(feature = "tiles3d")]
    #[error(transparent)]
    Mosaic(Box<crate::generate::mosaic::MosaicError>),
    /// What names it is at fault.
    #[error(transparent)]
    Specification(#[from] crate::specification::SpecificationError),
    /// It is an elevation grid with a fault.
    #[cfg(feature = "elevation")]
    #[error(transparent)]
    Elevation(#[from] crate::import::elevation::ElevationError),
    /// It is a stored world with a fault.
    #[cfg(feature = "stored")]
    #[error(transparent)]
    Stored(#[from] crate::stored::StoredError),
    /// It is a city model with a fault.
    #[cfg(feature = "cityjson")]
    #[error(transparent)]
    CityJson(#[from] crate::import::cityjson::CityJsonError),
}

const EXPECTED: &str = "a 3D Tiles tileset.json, a generated world (city.json, terrain.json, asteroids.json), a stored world (world.toml), \
    a folder with one of them, \
    an elevation grid (.npz, GeoTIFF), or a CityJSON or CityJSONSeq file";

/// What makes a folder a world.
const INSIDE: [&str; 5] = ["world.toml", "tileset.json", "city.json", "terrain.json", "asteroids.json"];

/// Opens a world, recognised by content: a stored world, a tileset, a generated world's document, a folder with one of them, an
/// elevation grid, or a city model in CityJSON or CityJSONSeq.
pub fn open(path: &Path) -> Result<World, WorldError> {
    let metadata = std::fs::metadata(path).map_err(|source| WorldError::Io { file: path.to_owned(), source })?;
    let file = if metadata.is_dir() {
        let found = INSIDE.into_iter().map(|name| path.join(name)).find(|file| file.is_file());
        found.ok_or_else(|| WorldError::Unrecognised {
            file: path.to_owned(),
            found: format!("a folder with none of {}", INSIDE.join(", ")),
        })?
    } else {
        path.to_owned()
    };
    let io = |source| WorldError::Io { file: file.clone(), source };
    let mut head = Vec::new();
    File::open(&file).map_err(io)?.take(HEAD_BYTES).read_to_end(&mut head).map_err(io)?;
    #[cfg(feature = "elevation")]
    if let Some(format) = crate::import::elevation::format(&head) {
        return Ok(crate::import::elevation::open(&file, format)?);
    }
    if file.file_name().is_some_and(|name| name == "world.toml") {
        return open_stored(&file);
    }
    match recognise(&head) {
        Content::Generated(format) => open_generated(&file, format),
        Content::CityJson => open_city_model(&file),
        Content::Json => open_tileset(&file),
        Content::Other(found) => Err(WorldError::Unrecognised { file, found }),
    }
}

/// The world that there is without any file: a city of about 2 km × 2 km, z up, its ground at 0.
#[cfg(feature = "city")]
pub fn built_in_city() -> World {
    let params = crate::generate::city::CityParams::default();
    crate::generate::city::city(&params).expect("the built-in parameters are in range")
}

#[cfg(feature = "tiles3d")]
fn open_tileset(file: &Path) -> Result<World, WorldError> {
    Ok(crate::import::tiles3d::open(file)?)
}

#[cfg(not(feature = "tiles3d"))]
fn open_tileset(file: &Path) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: file.to_owned(), kind: "3D Tiles" })
}

#[cfg(feature = "stored")]
fn open_stored(file: &Path) -> Result<World, WorldError> {
    Ok(crate::stored::open(file.parent().unwrap_or(Path::new("")))?)
}

#[cfg(not(feature = "stored"))]
fn open_stored(file: &Path) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: file.to_owned(), kind: "stored worlds" })
}

/// Opens a generated world by what its document says it is.
#[cfg(feature = "generated")]
fn open_generated(file: &Path, format: &'static str) -> Result<World, WorldError> {
    match format {
        #[cfg(feature = "city")]
        "foresight-city" => Ok(crate::generate::document::open::<crate::generate::city::CityParams>(file)?),
        #[cfg(feature = "terrain")]
        "foresight-terrain" => Ok(crate::generate::document::open::<crate::generate::terrain::TerrainParams>(file)?),
        #[cfg(feature = "asteroids")]
        "foresight-asteroids" => {
            Ok(crate::generate::document::open::<crate::generate::asteroids::AsteroidParams>(file)?)
        }
        _ => Err(WorldError::NotBuilt { file: file.to_owned(), kind: format }),
    }
}

#[cfg(not(feature = "generated"))]
fn open_generated(file: &Path, format: &'static str) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: file.to_owned(), kind: format })
}

#[cfg(feature = "cityjson")]
fn open_city_model(file: &Path) -> Result<World, WorldError> {
    Ok(crate::import::cityjson::open(file)?)
}

#[cfg(not(feature = "cityjson"))]
fn open_city_model(file: &Path) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: file.to_owned(), kind: "CityJSON" })
}

/// How much of a file is looked at to recognise it.
const HEAD_BYTES: u64 = 1 << 16;

/// What the documents of generated worlds say they are.
const GENERATED: [&str; 3] = ["foresight-city", "foresight-terrain", "foresight-asteroids"];

enum Content {
    Generated(&'static str),
    CityJson,
    Json,
    Other(String),
}

fn recognise(head: &[u8]) -> Content {
    let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head).trim_ascii_start();
    if head.starts_with(b"\x1F\x8B") {
        // gzip, as tilesets are often stored.
        Content::Json
    } else if head.is_empty() {
        Content::Other("nothing in it".to_owned())
    } else if head[0] != b'{' {
        let start = String::from_utf8_lossy(&head[..head.len().min(24)]);
        Content::Other(format!("it begins with {:?}", start.trim_end_matches(char::REPLACEMENT_CHARACTER)))
    } else if let Some(format) = GENERATED.into_iter().find(|format| contains(head, format.as_bytes())) {
        Content::Generated(format)
    } else if ["\"CityJSON", "\"CityObjects\""].iter().any(|name| contains(head, name.as_bytes())) {
        Content::CityJson
    } else {
        Content::Json
    }
}

fn contains(text: &[u8], part: &[u8]) -> bool {
    text.windows(part.len()).any(|window| window == part)
}

impl World {
    /// Where a representation is fetched, relative to the world's folder.
    pub fn uri(&self, rep: RepId) -> Cow<'_, str> {
        self.uris.get(rep)
    }

    /// The height of the ground under a position, as a coordinate along [`World::up`], metres. `None` where the
    /// position is not finite.
    pub fn ground_height(&self, at: DVec3) -> Option<f64> {
        self.ground.height(&self.tree, self.up, at)
    }

    /// The world in figures, from one pass over its arrays.
    pub fn summary(&self) -> Summary {
        let tree = &self.tree;
        let mut depths: Vec<u32> = Vec::with_capacity(tree.nodes());
        let (mut leaves, mut depth) = (0, 0);
        for node in (0..tree.nodes() as u32).map(NodeId) {
            let own = 1 + tree.parent(node).map_or(0, |parent| depths[parent.index()]);
            depths.push(own);
            depth = depth.max(own);
            leaves += u64::from(tree.is_leaf(node));
        }
        let reps = || (0..tree.representations() as u32).map(RepId);
        Summary {
            nodes: tree.nodes() as u64,
            leaves,
            representations: tree.representations() as u64,
            depth,
            wire_bytes: reps().map(|rep| tree.wire_bytes(rep)).sum(),
            decoded_bytes: reps().map(|rep| tree.decoded_bytes(rep)).sum(),
            bounds: tree.bounds(tree.root()),
        }
    }

    /// What the world is, as 32 bytes: the BLAKE3 hash over up, then every node and every representation in order of id, with
    /// its address, then the surfaces of a world with directions. The name, the notes and the machine do not enter.
    pub fn hash(&self) -> blake3::Hash {
        let tree = &self.tree;
        let mut hasher = blake3::Hasher::new();
        let mut buffer = Vec::with_capacity(1 << 16);
        let mut flush = |buffer: &mut Vec<u8>, least: usize| {
            if buffer.len() >= least {
                hasher.update(buffer);
                buffer.clear();
            }
        };
        buffer.extend_from_slice(b"foresight-world-1");
        put_vec3(&mut buffer, self.up);
        buffer.extend_from_slice(&(tree.nodes() as u64).to_le_bytes());
        buffer.extend_from_slice(&(tree.representations() as u64).to_le_bytes());
        for node in (0..tree.nodes() as u32).map(NodeId) {
            buffer.extend_from_slice(&tree.subtree_end(node).0.to_le_bytes());
            put_vec3(&mut buffer, tree.centre(node));
            put_vec3(&mut buffer, tree.half(node));
            buffer.extend_from_slice(&tree.importance(node).to_bits().to_le_bytes());
            flush(&mut buffer, 1 << 15);
        }
        for (rep, (prefix, tail)) in (0..tree.representations() as u32).map(RepId).zip(self.uris.parts()) {
            buffer.extend_from_slice(&tree.node_of(rep).0.to_le_bytes());
            buffer.extend_from_slice(&tree.wire_bytes(rep).to_le_bytes());
            buffer.extend_from_slice(&tree.decoded_bytes(rep).to_le_bytes());
            buffer.extend_from_slice(&tree.error(rep).to_bits().to_le_bytes());
            buffer.extend_from_slice(&tree.prerequisite(rep).map_or(u32::MAX, |r| r.0).to_le_bytes());
            buffer.push(tree.direction(rep).unwrap_or(u8::MAX));
            buffer.extend_from_slice(tree.shown(rep).map_or(&[][..], |shown| shown));
            buffer.extend_from_slice(&((prefix.len() + tail.len()) as u64).to_le_bytes());
            buffer.extend_from_slice(prefix.as_bytes());
            buffer.extend_from_slice(tail.as_bytes());
            flush(&mut buffer, 1 << 15);
        }
        for node in (0..tree.nodes() as u32).map(NodeId).filter(|_| tree.has_directions()) {
            for area in tree.surface(node) {
                buffer.extend_from_slice(&area.to_bits().to_le_bytes());
            }
            flush(&mut buffer, 1 << 15);
        }
        flush(&mut buffer, 0);
        hasher.finalize()
    }
}

fn put_vec3(buffer: &mut Vec<u8>, vector: DVec3) {
    for value in vector.to_array() {
        buffer.extend_from_slice(&value.to_bits().to_le_bytes());
    }
}

#[cfg(all(test, feature = "city"))]
mod tests {
    use super::*;

    #[test]
    fn the_hash_tells_worlds_apart() {
        let world = built_in_city();
        let mut other = world.clone();
        other.name = "other".to_owned();
        assert_eq!(world.hash(), other.hash());
        other.up = -other.up;
        assert_ne!(world.hash(), other.hash());
    }

    #[test]
    fn a_folder_with_nothing_known() {
        let folder = tempfile::tempdir().unwrap();
        let message = open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("tileset.json, city.json"), "{message}");
        std::fs::write(folder.path().join("city.json"), "").unwrap();
        let message = open(folder.path()).unwrap_err().to_string();
        assert!(message.contains("city.json: nothing in it; expected"), "{message}");
    }

    #[test]
    fn figures_agree_with_the_tree() {
        let world = built_in_city();
        let summary = world.summary();
        // Root, four halvings of 20 blocks to 1, block and building.
        assert_eq!(summary.depth, 7);
        assert_eq!(summary.representations, world.uris.len() as u64);
        assert!(summary.leaves < summary.nodes && summary.wire_bytes < summary.decoded_bytes);
    }
}
