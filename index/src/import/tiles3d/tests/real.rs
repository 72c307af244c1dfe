use std::path::PathBuf;

use foresight_scheduler::lod_tree::NodeId;
use glam::DVec3;

use crate::generate::mosaic::mosaic;
use crate::world::{self, WorldKind};

/// A part of the shared data, or `None` (said, and a failure under CI) where it is absent.
fn data(part: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let path = std::env::var_os("FORESIGHT_DATA").map_or(beside, PathBuf::from).join(part);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is absent", path.display());
    println!("skipped: {} is absent", path.display());
    None
}

#[test]
fn dingo_gap() {
    let Some(path) = data("scenes/mars_dingo_gap_3dtiles") else { return };
    let world = world::open(&path).unwrap();
    let summary = world.summary();
    assert_eq!((summary.nodes, summary.representations, summary.leaves, summary.depth), (293, 293, 220, 5));
    assert_eq!(summary.wire_bytes, 10_559_144);
    assert!((summary.decoded_bytes as f64 / 1e6 - 110.9).abs() < 0.05, "{summary:?}");
    assert_eq!(world.up, DVec3::Y);
    assert!(world.notes.iter().any(|note| note.text.contains("surfaces face +y")), "{:?}", world.notes);
    // The accessors declare y from 55.1 to 55.5 for the leaf over this corner; the declared box is 64 m high.
    let height = world.ground_height(DVec3::new(60.0, 0.0, -20.0)).unwrap();
    assert!((54.7..=55.5).contains(&height), "{height}");
    assert_eq!(world.uri(world.tree.own(NodeId(0)).next().unwrap()), "root.b3dm");
}

#[test]
fn sparse_implicit_quadtree() {
    let Some(path) = data("scenes/cesium_sparse_implicit_quadtree") else { return };
    let world = world::open(&path).unwrap();
    let summary = world.summary();
    // 9 subtrees of 7 tiles; 4 contents in each of the 8 lower ones.
    assert_eq!((summary.nodes, summary.representations, summary.depth), (63, 32, 6));
    // Each content is 4 vertices with normals, and 6 indices of 4 bytes.
    assert_eq!(summary.decoded_bytes, 32 * (4 * 24 + 6 * 4));
    assert_eq!((summary.bounds.min, summary.bounds.max), (DVec3::ZERO, DVec3::new(1.0, 1.0, 0.0)));
    for node in (0..63).map(NodeId).filter(|&node| world.tree.is_leaf(node)) {
        let rep = world.tree.own(node).next().unwrap();
        let uri = world.uri(rep).into_owned();
        let place = uri.strip_prefix("content/content_5__").and_then(|rest| rest.strip_suffix(".glb")).unwrap();
        let (x, y) = place.split_once('_').unwrap();
        let corner = DVec3::new(x.parse().unwrap(), y.parse().unwrap(), 0.0) / 32.0;
        assert!((world.tree.bounds(node).min - corner).length() < 1e-9, "{uri}");
        // ADD: the leaves' own error, 32 / 2⁵.
        assert_eq!(world.tree.error(rep), 1.0);
    }
}

#[test]
fn several_contents_to_a_tile() {
    let Some(path) = data("scenes/cesium_metadata_granularities") else { return };
    let world = world::open(&path).unwrap();
    let summary = world.summary();
    // The root, 4 districts, and a leaf for each of their 5 contents.
    assert_eq!((summary.nodes, summary.leaves, summary.representations), (25, 20, 20));
    assert_eq!(world.up, DVec3::Z);
    assert!(world.notes.is_empty(), "{:?}", world.notes);
}

#[test]
fn a_mosaic_of_dingo_gap() {
    let Some(path) = data("scenes/mars_dingo_gap_3dtiles") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("mosaic");
    let made = mosaic(&path, 16, &out, &mut |_, _| {}).unwrap();
    let world = world::open(&out).unwrap();
    let summary = world.summary();
    assert_eq!(summary.representations, made.representations);
    assert_eq!(summary.representations, 256 * 293 + 64 + 16 + 4 + 1);
    assert_eq!(world.kind, WorldKind::Mosaic);
    assert_eq!(summary.wire_bytes, 256 * 10_559_144 + 85 * 65_416);
    assert_eq!(world.up, DVec3::Y);
    // Contents are read in parallel; nothing of that shows.
    assert_eq!(world.hash(), world::open(&out).unwrap().hash());
    let first = world.ground_height(DVec3::new(60.0, 0.0, -20.0)).unwrap();
    let step = DVec3::new(5.0 * made.pitch[0], 0.0, -3.0 * made.pitch[1]);
    let shifted = world.ground_height(DVec3::new(60.0, 0.0, -20.0) + step).unwrap();
    assert!((first - shifted).abs() < 1e-4, "{first} {shifted}");
}
