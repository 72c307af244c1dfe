//! The byte-level parsers under one signature, for the corpora and for the fuzz targets.

use std::fmt::Display;
use std::path::Path;

use foresight_index::format::orthoview;
use foresight_index::generate::asteroids::AsteroidParams;
use foresight_index::generate::city::CityParams;
use foresight_index::generate::document;
use foresight_index::generate::terrain::TerrainParams;
use foresight_index::import::{cityjson, elevation, tiles3d};
use foresight_index::manifest;
use foresight_index::octree::Octree;
use foresight_index::stored::{document as document_of_a_world, page};
use foresight_index::surface::{GltfFile, ObjFile, PlyFile, SurfaceError, SurfaceSource, Up};
use foresight_server::http::{self, entity_tag::Comparison};
use foresight_traces::path::parse::{Format, Options};
use foresight_traces::{link, path};
use foresight_wire::encoding::Encoding;
use foresight_wire::message::ClientMessage;

use crate::session;

/// A parser: accepted, or refused with its message.
pub type Parser = fn(&[u8]) -> Result<(), String>;

/// Every parser by the name of its corpus and fuzz target.
pub const TARGETS: &[(&str, Parser)] = &[
    ("adsb", |bytes| path_as(Format::AdsB, bytes)),
    ("asteroids", |bytes| outcome(document::parse::<AsteroidParams>(bytes))),
    ("city", |bytes| outcome(document::parse::<CityParams>(bytes))),
    ("cityjson", |bytes| outcome(cityjson::parse(bytes, "model"))),
    ("client-messages", |bytes| outcome(Encoding::Json.read::<ClientMessage>(bytes))),
    ("client-messages-msgpack", |bytes| outcome(Encoding::MessagePack.read::<ClientMessage>(bytes))),
    ("comma2k19", comma2k19),
    ("content", |bytes| outcome(tiles3d::content_summary(bytes))),
    ("delay", |bytes| outcome(link::delay::parse("delay", bytes))),
    ("drawn-content", |bytes| outcome(tiles3d::content_surface(bytes))),
    ("geotiff", |bytes| outcome(elevation::parse_geotiff(bytes))),
    ("gltf", |bytes| surfaces(bytes, |file| Ok(Box::new(GltfFile::open(file)?)))),
    ("gpx", |bytes| path_as(Format::Gpx, bytes)),
    ("http-request", http_request),
    ("igc", |bytes| path_as(Format::Igc, bytes)),
    ("irish5g", |bytes| path_as(Format::Irish5g, bytes)),
    ("irish5g-link", irish5g_link),
    ("kml", |bytes| path_as(Format::Kml, bytes)),
    ("link", |bytes| outcome(link::parse::from_bytes("link", bytes))),
    ("manifest", |bytes| outcome(manifest::parse(bytes))),
    ("npz", |bytes| outcome(elevation::parse_npz(bytes))),
    ("obj", |bytes| surfaces(bytes, |file| Ok(Box::new(ObjFile::open(file, Up::Z)?)))),
    ("orthoview", |bytes| outcome(orthoview::decode_planes(bytes))),
    ("page", page),
    ("path", |bytes| outcome(path::parse::from_bytes("path", bytes, &path::parse::Options::default()))),
    ("ply", |bytes| surfaces(bytes, |file| Ok(Box::new(PlyFile::open(file, Up::Y)?)))),
    ("recording", recording),
    ("sabre", |bytes| outcome(link::sabre::parse("sabre", bytes))),
    ("session", session::lines),
    ("session-recording", session::recording),
    ("subtree", subtree),
    ("terrain", |bytes| outcome(document::parse::<TerrainParams>(bytes))),
    ("tileset", |bytes| outcome(tiles3d::parse_tileset(bytes))),
    ("world-toml", |bytes| outcome(document_of_a_world::parse(bytes))),
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

/// A page of an octree of 32 × 32 × 4 leaves of 64 m.
fn page(bytes: &[u8]) -> Result<(), String> {
    let octree = Octree::of(glam::DVec3::ZERO, 64.0, [5, 5, 2]).expect("parts of an octree");
    outcome(page::parse(bytes, &octree))
}

/// A subtree of two levels of a quadtree, buffers in other files absent; of three levels of an octree for its own sake.
fn subtree(bytes: &[u8]) -> Result<(), String> {
    drop(tiles3d::parse_subtree(bytes, 8, 3, &|_| None));
    outcome(tiles3d::parse_subtree(bytes, 4, 2, &|_| None))
}

/// What the server reads of a request: the first line is a path below a world, the second a `Range` of 1000 bytes, the third an
/// `Accept-Encoding`, the fourth a `Priority`, the fifth a list of entity tags. Refused is a path that leaves the world, or a range that is none or not there.
fn http_request(bytes: &[u8]) -> Result<(), String> {
    let mut lines = bytes.split(|&byte| byte == b'\n');
    let mut line = || lines.next().unwrap_or_default();
    let path = String::from_utf8_lossy(line());
    let path = http::path::decode(&path).ok_or_else(|| format!("path {path:?}"));
    let range = http::range::parse(line(), 1000);
    let accepted = http::encoding::accepted(&String::from_utf8_lossy(line()));
    let priority = http::priority::Priority::parse(line());
    assert!(accepted.len() <= 3 && priority.urgency <= 7, "{accepted:?}, {priority:?}");
    let tags = line();
    let [weakly, strongly] =
        [Comparison::Weak, Comparison::Strong].map(|how| http::entity_tag::holds(tags, b"\"a\"", how));
    assert!(weakly || !strongly);
    let path = path?;
    assert_eq!(http::path::decode(&http::path::encode(&path)).as_ref(), Some(&path));
    match range {
        http::range::Asked::Part(part) if part.start < part.end && part.end <= 1000 => Ok(()),
        http::range::Asked::Part(part) => panic!("{part:?} of 1000"),
        other => Err(format!("{other:?}")),
    }
}

/// A G-NetTrack log as a link: what does not begin with its header is some other link.
fn irish5g_link(bytes: &[u8]) -> Result<(), String> {
    outcome(link::parse::from_bytes("irish5g", bytes))
}

/// A mesh in a file of its own: every piece of it. Files that it names are not there, which is no fault.
fn surfaces(bytes: &[u8], open: fn(&Path) -> Result<Box<dyn SurfaceSource>, SurfaceError>) -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let file = folder.path().join("mesh");
    std::fs::write(&file, bytes).map_err(|error| error.to_string())?;
    let source = open(&file).map_err(|error| error.to_string())?;
    for piece in 0..source.pieces() {
        source.load(piece).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// As it was recorded, and as a path.
fn recording(bytes: &[u8]) -> Result<(), String> {
    drop(path::recording::from_bytes("recording", bytes));
    outcome(path::recording::path_from_bytes("recording", bytes, &Options::default()))
}

/// A path in a format of its own.
fn path_as(format: Format, bytes: &[u8]) -> Result<(), String> {
    outcome(path::parse::from_bytes_as(format, "path", bytes, &Options::default()))
}

/// Three arrays one after the other, each behind its length in 4 bytes.
fn comma2k19(bytes: &[u8]) -> Result<(), String> {
    let mut rest = bytes;
    let arrays = [(); 3].map(|()| {
        let (length, after) = rest.split_first_chunk::<4>().unwrap_or((&[0; 4], &[]));
        let (array, after) = after.split_at((u32::from_le_bytes(*length) as usize).min(after.len()));
        rest = after;
        array
    });
    outcome(path::parse::from_arrays("path", arrays, &Options::default()))
}

fn outcome<T, E: Display>(result: Result<T, E>) -> Result<(), String> {
    result.map(drop).map_err(|error| error.to_string())
}
