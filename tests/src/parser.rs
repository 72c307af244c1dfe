//! The byte-level parsers under one signature, for the corpora and for the fuzz targets.

use std::fmt::Display;

use foresight_index::generate::city;
use foresight_index::import::{cityjson, tiles3d};
use foresight_index::manifest;
use foresight_sim::{link, path};

/// A parser: accepted, or refused with its message.
pub type Parser = fn(&[u8]) -> Result<(), String>;

/// Every parser by the name of its corpus and fuzz target.
pub const TARGETS: [(&str, Parser); 8] = [
    ("city", |bytes| outcome(city::parse(bytes))),
    ("cityjson", |bytes| outcome(cityjson::parse(bytes, "model"))),
    ("content", |bytes| outcome(tiles3d::content_summary(bytes))),
    ("link", |bytes| outcome(link::parse::from_bytes("link", bytes))),
    ("manifest", |bytes| outcome(manifest::parse(bytes))),
    ("path", |bytes| outcome(path::parse::from_bytes("path", bytes, &path::parse::Options::default()))),
    ("subtree", subtree),
    ("tileset", |bytes| outcome(tiles3d::parse_tileset(bytes))),
];

/// Gives the bytes to the parser of that name.
///
/// # Errors
/// The parser's refusal.
///
/// # Panics
/// If there is no parser of that name, or if the parser panics, which is what the corpora look for.
pub fn entry(target: &str, bytes: &[u8]) -> Result<(), String> {
    let (_, parser) = TARGETS.iter().find(|(name, _)| *name == target).expect("a name of TARGETS");
    parser(bytes)
}

/// A subtree of two levels of a quadtree, buffers in other files absent; of three levels of an octree for its own sake.
fn subtree(bytes: &[u8]) -> Result<(), String> {
    drop(tiles3d::parse_subtree(bytes, 8, 3, &|_| None));
    outcome(tiles3d::parse_subtree(bytes, 4, 2, &|_| None))
}

fn outcome<T, E: Display>(result: Result<T, E>) -> Result<(), String> {
    result.map(drop).map_err(|error| error.to_string())
}
