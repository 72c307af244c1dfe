//! `world.toml`: what is in a stored world, what was left out, and which version of its files counts.

use super::page::Hash;
use crate::octree::Octree;
use crate::world::Georeference;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// What [`Document::format`] says.
pub const FORMAT: &str = "foresight-world";

/// Version of the schema that is read and written.
pub const SCHEMA_VERSION: u32 = 1;

/// Most bytes of a document that is read.
pub const BYTES_MAX: usize = 1 << 20;

/// The document.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Document {
    /// [`FORMAT`].
    pub format: String,
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// What to call the world.
    pub name: String,
    /// Hash of the content in canonical order, 64 hexadecimal digits: equal for equal content, whoever built it and however
    /// often that was interrupted.
    pub identity: String,
    /// Program and version that built it.
    pub built_by: String,
    /// Page of the root.
    pub root: String,
    /// SQLite file of the catalogue; empty if that is elsewhere.
    pub catalogue: String,
    /// Away from the ground, unit length.
    pub up: [f64; 3],
    /// Code of the coordinate system, 4978 for Earth-centred; absent if the world lies nowhere on the Earth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epsg: Option<u32>,
    /// The octree.
    pub octree: OctreeParts,
    /// How orthoviews were made.
    pub orthoviews: Orthoviews,
    /// How well the directions see the world.
    pub directions: Directions,
    /// What is in it.
    pub content: Content,
    /// What it was built from.
    pub inputs: Vec<Input>,
    /// What a world like this could have and this one does not need.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// What was repaired, looks wrong, or is missing, in words.
    #[serde(default)]
    pub notes: Vec<String>,
    /// The version before, whose files are still there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub previous: Option<Previous>,
}

/// The octree's parts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OctreeParts {
    /// Least corner of the first leaf, metres.
    pub origin: [f64; 3],
    /// Side of a leaf, metres.
    pub leaf_side: f64,
    /// Doublings along each axis.
    pub splits: [u32; 3],
}

/// How orthoviews were made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Orthoviews {
    /// Side of a leaf's pixel, metres.
    pub pixel: f64,
    /// Directions by name.
    pub directions: Vec<String>,
    /// Codec of the colours.
    pub colour: String,
    /// Whether there are normals.
    pub normals: bool,
}

/// How well the directions see the surface, occlusion left aside.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Directions {
    /// N, degrees.
    pub within_degrees: f64,
    /// Share of the surface that no direction sees within N degrees of straight on.
    pub share_not_within: f64,
    /// Share of the surface that no direction faces at all.
    pub share_unseen: f64,
    /// Largest angle between a surface that is faced and its best direction, degrees.
    pub largest_degrees: f64,
}

/// What is in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Content {
    /// Cells that show something.
    pub cells: u64,
    /// Leaves among them.
    pub leaves: u64,
    /// Leaves that the octree has room for.
    pub leaves_possible: f64,
    /// Orthoviews.
    pub orthoviews: u64,
    /// Their bytes.
    pub orthoview_bytes: u64,
    /// Geometries, each level of detail counted.
    pub geometries: u64,
    /// Their bytes.
    pub geometry_bytes: u64,
    /// Bytes of all in a client's memory.
    pub decoded_bytes: u64,
    /// Triangles of the inputs.
    pub triangles: u64,
}

/// What a world was built from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Input {
    /// As it was named.
    pub name: String,
    /// Hash of its bytes, or of its parameters.
    pub identity: String,
}

/// Something that is not there, because the world does not need it or because it was so wished.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// What.
    pub what: String,
    /// Why.
    pub because: String,
    /// The figure that says so.
    pub figure: f64,
    /// What the figure is.
    pub unit: String,
}

/// A version that was published before.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Previous {
    /// Its identity.
    pub identity: String,
    /// Page of its root.
    pub root: String,
    /// SQLite file of its catalogue.
    pub catalogue: String,
    /// Its octree.
    pub octree: OctreeParts,
}

/// A fault in a document.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DocumentError {
    /// It is not TOML, or a key has another type or is missing.
    #[error("{0}")]
    Toml(String),
    /// A key has a value that means nothing.
    #[error("{key} is {found}; expected {expected}")]
    Value {
        /// The key.
        key: &'static str,
        /// Its value.
        found: String,
        /// What ought to be.
        expected: String,
    },
}

#[derive(Deserialize)]
struct Head {
    format: String,
    schema_version: u32,
}

/// Reads a document.
///
/// # Errors
/// What is none, is of another version, or contradicts itself.
pub fn parse(bytes: &[u8]) -> Result<Document, DocumentError> {
    let value = |key, found: String, expected: &str| DocumentError::Value { key, found, expected: expected.to_owned() };
    if bytes.len() > BYTES_MAX {
        return Err(value("the document", format!("{} bytes", bytes.len()), "at most 1 MiB"));
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|error| value("the document", format!("not UTF-8 from byte {} on", error.valid_up_to()), "UTF-8"))?;
    let toml = |error: toml::de::Error| DocumentError::Toml(error.to_string().trim_end().to_owned());
    // The version first: another one may have other keys.
    let head: Head = toml::from_str(text).map_err(toml)?;
    if head.format != FORMAT {
        return Err(value("format", format!("{:?}", head.format), &format!("{FORMAT:?}")));
    }
    if head.schema_version != SCHEMA_VERSION {
        let age = if head.schema_version > SCHEMA_VERSION { "a newer" } else { "an older" };
        let expected = format!("{SCHEMA_VERSION}: the world was built by a program of {age} schema; build it again");
        return Err(value("schema_version", head.schema_version.to_string(), &expected));
    }
    let document: Document = toml::from_str(text).map_err(toml)?;
    let is_digits = |text: &str| text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    if !is_digits(&document.identity) {
        return Err(value("identity", format!("{:?}", document.identity), "64 hexadecimal digits"));
    }
    let up = DVec3::from_array(document.up);
    if !(up.is_finite() && (up.length() - 1.0).abs() < 1e-6) {
        return Err(value("up", format!("{up}"), "a vector of length 1"));
    }
    let previous = document.previous.as_ref();
    for (key, octree) in [("octree", Some(&document.octree)), ("previous.octree", previous.map(|p| &p.octree))] {
        if octree.is_some_and(|octree| octree.octree().is_none()) {
            let expected = "a finite origin, a positive leaf_side, at most 40 splits along an axis";
            return Err(value(key, format!("{octree:?}"), expected));
        }
    }
    let files = [
        ("root", document.root.as_str()),
        ("catalogue", document.catalogue.as_str()),
        ("previous.root", previous.map_or("", |p| p.root.as_str())),
        ("previous.catalogue", previous.map_or("", |p| p.catalogue.as_str())),
    ];
    for (key, file) in files {
        let may_be_empty = key != "root";
        if !(is_inside(file) || may_be_empty && file.is_empty()) {
            return Err(value(key, format!("{file:?}"), "a file inside the world's folder"));
        }
    }
    if !(document.orthoviews.pixel.is_finite() && document.orthoviews.pixel > 0.0) {
        return Err(value("orthoviews.pixel", document.orthoviews.pixel.to_string(), "metres, more than 0"));
    }
    Ok(document)
}

/// True for a relative path that never leaves its folder.
fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && !path.contains(['\\', ':', '\0'])
        && path.split('/').all(|part| !matches!(part, "" | "." | ".."))
}

impl Document {
    /// As a file, with a line that says what it is.
    ///
    /// # Errors
    /// What TOML cannot say: no value of a document that was read or built.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        let text = toml::to_string(self)?;
        Ok(format!(
            "# A stored world: the only file of this folder that changes. It names the version that counts.\n{text}"
        ))
    }

    /// The identity of what is named here, everything that a client draws and where it is: `root` is the hash of the root's
    /// page.
    pub fn identity_of(&self, root: &Hash) -> String {
        let mut hasher = blake3::Hasher::new();
        let mut put = |bytes: &[u8]| {
            hasher.update(&(bytes.len() as u64).to_le_bytes());
            hasher.update(bytes);
        };
        put(b"foresight-stored-world-1");
        // The root's page holds the hashes of everything beneath it.
        put(root);
        for value in self.octree.origin.iter().chain([&self.octree.leaf_side, &self.orthoviews.pixel]).chain(&self.up) {
            put(&value.to_bits().to_le_bytes());
        }
        self.octree.splits.iter().for_each(|splits| put(&splits.to_le_bytes()));
        put(&self.epsg.unwrap_or(0).to_le_bytes());
        self.orthoviews.directions.iter().for_each(|name| put(name.as_bytes()));
        hasher.finalize().to_hex().to_string()
    }

    /// How world space lies on the Earth.
    pub fn georeference(&self) -> Option<Georeference> {
        self.epsg.map(|code| if code == 4978 { Georeference::Ecef } else { Georeference::Epsg(code) })
    }
}

/// The code that [`Document::epsg`] has.
pub fn epsg(georeference: Option<Georeference>) -> Option<u32> {
    georeference.map(|georeference| match georeference {
        Georeference::Ecef => 4978,
        Georeference::Epsg(code) => code,
    })
}

impl OctreeParts {
    /// Of an octree.
    pub fn new(octree: &Octree) -> OctreeParts {
        OctreeParts { origin: octree.origin().to_array(), leaf_side: octree.leaf_side(), splits: octree.splits() }
    }

    /// The octree; `None` if these are no parts of one.
    pub fn octree(&self) -> Option<Octree> {
        Octree::of(DVec3::from_array(self.origin), self.leaf_side, self.splits)
    }
}
