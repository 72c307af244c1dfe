use std::path::PathBuf;

use crate::world;

/// The folder of shared data, or `None` (said, and not under CI) where it is absent.
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
    println!("{:#?} {:?} {:?}", world.summary(), world.up, world.notes);
    println!("{:?}", world.ground_height(world.tree.centre(world.tree.root())));
}

#[test]
fn sparse() {
    let Some(path) = data("scenes/cesium_sparse_implicit_quadtree") else { return };
    let world = world::open(&path).unwrap();
    println!("{:#?} {:?} {:?}", world.summary(), world.up, world.notes);
    let Some(path) = data("scenes/cesium_metadata_granularities") else { return };
    let world = world::open(&path).unwrap();
    println!("{:#?} {:?} {:?}", world.summary(), world.up, world.notes);
}
