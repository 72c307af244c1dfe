//! The byte-level parsers under one signature, for the corpora and for the fuzz targets.

use std::fmt::Display;

use foresight_index::generate::asteroids::AsteroidParams;
use foresight_index::generate::city::CityParams;
use foresight_index::generate::document;
use foresight_index::generate::terrain::TerrainParams;
use foresight_index::import::elevation;
use foresight_index::import::tiles3d;
use foresight_index::manifest;
use foresight_sim::{link, path};

/// A parser: accepted, or refused with its message.
pub type Parser = fn(&[u8]) -> Result<(), String>;

/// Every parser by the name of its corpus and fuzz target.
pub const TARGETS: &[(&str, Parser)] = &[
    ("asteroids", |bytes| outcome(document::parse::<AsteroidParams>(bytes))),
    ("city", |bytes| outcome(document::parse::<CityParams>(bytes))),
    ("content", |bytes| outcome(tiles3d::content_summary(bytes))),
    ("delay", |bytes| outcome(link::delay::parse("delay", bytes))),
    ("geotiff", |bytes| outcome(elevation::parse_geotiff(bytes))),
    ("irish5g-link", irish5g_link),
    ("link", |bytes| outcome(link::parse::from_bytes("link", bytes))),
    ("manifest", |bytes| outcome(manifest::parse(bytes))),
    ("npz", |bytes| outcome(elevation::parse_npz(bytes))),
    ("path", |bytes| outcome(path::parse::from_bytes("path", bytes, &path::parse::Options::default()))),
    ("recording", recording),
    ("sabre", |bytes| outcome(link::sabre::parse("sabre", bytes))),
    ("subtree", subtree),
    ("terrain", |bytes| outcome(document::parse::<TerrainParams>(bytes))),
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

/// A G-NetTrack log as a link: what does not begin with its header is some other link.
fn irish5g_link(bytes: &[u8]) -> Result<(), String> {
    outcome(link::parse::from_bytes("irish5g", bytes))
}

/// As it was recorded, and as a path.
fn recording(bytes: &[u8]) -> Result<(), String> {
    drop(path::recording::from_bytes("recording", bytes));
    outcome(path::recording::path_from_bytes("recording", bytes, &path::parse::Options::default()))
}

fn outcome<T, E: Display>(result: Result<T, E>) -> Result<(), String> {
    result.map(drop).map_err(|error| error.to_string())
}
