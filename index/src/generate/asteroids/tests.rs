use std::collections::BTreeSet;

use foresight_scheduler::lod_tree::{NodeId, RepId};

use super::*;
use crate::generate::document;
use crate::world::open;

fn few() -> AsteroidParams {
    AsteroidParams { count: 700, triangles: 1200, ..AsteroidParams::default() }
}

#[test]
fn every_model_is_there_once() {
    let world = asteroids(&few()).unwrap();
    let tree = &world.tree;
    assert_eq!(segments(1200), [6, 12]);
    assert_eq!(segments(97_000), [6, 13, 27, 55, 110]);
    let summary = world.summary();
    assert_eq!(summary.leaves, 700);
    let cells = summary.nodes - summary.leaves;
    assert_eq!(summary.representations, 2 * 700 + cells);
    let addresses: BTreeSet<String> =
        (0..tree.representations() as u32).map(|rep| world.uri(RepId(rep)).into_owned()).collect();
    assert_eq!(addresses.len() as u64, summary.representations);
    assert!(addresses.contains("models/0/699-1.glb") && addresses.contains("cells/0/0_0_0.glb"));
    let landmarks =
        (0..tree.nodes() as u32).map(NodeId).filter(|&node| tree.is_leaf(node) && tree.importance(node) == 4.0);
    assert!((15..60).contains(&landmarks.count()));
    assert_eq!(world.ground_height(DVec3::ZERO), None);
    let size = summary.bounds.max - summary.bounds.min;
    assert!((size.max_element() - 8879.0).abs() < 500.0, "{size}");
}

#[test]
fn errors_fall_on_the_way_down() {
    let world = asteroids(&few()).unwrap();
    let tree = &world.tree;
    for node in (0..tree.nodes() as u32).map(NodeId) {
        let own: Vec<f64> = tree.own(node).map(|rep| tree.error(rep)).collect();
        assert!(own.is_sorted_by(|a, b| a >= b), "{own:?}");
        if let Some(parent) = tree.parent(node) {
            let above = tree.own(parent).map(|rep| tree.error(rep)).fold(f64::INFINITY, f64::min);
            assert!(own[0] <= above, "{node:?}: {} beneath {above}", own[0]);
        }
    }
}

#[test]
fn the_same_parameters_make_the_same_world() {
    let world = asteroids(&few()).unwrap();
    assert_eq!(world.hash(), asteroids(&few()).unwrap().hash());
    assert_ne!(world.hash(), asteroids(&AsteroidParams { seed: 2, ..few() }).unwrap().hash());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a");
    document::write(&few(), &out).unwrap();
    assert_eq!(open(&out).unwrap().hash(), world.hash());
}

#[test]
fn one_model_and_models_in_one_point() {
    let one = asteroids(&AsteroidParams { count: 1, ..few() }).unwrap();
    assert_eq!((one.tree.nodes(), one.tree.representations()), (1, 2));
    let model = Model { at: DVec3::splat(0.1), radius: 1.0, id: 0, kind: 0, is_landmark: false };
    let mut models: Vec<Model> = (0..9).map(|id| Model { id, ..model }).collect();
    let halves = Cell { depth: 0, at: [0; 3], min: DVec3::splat(-1.0), side: 2.0 }.halves(&mut models);
    assert_eq!((halves.len(), halves[0].0.at, halves[0].1.len()), (1, [1; 3], 9));
    assert!(asteroids(&AsteroidParams { count: MAX_REPRESENTATIONS as u32, ..few() }).is_err());
}

#[test]
fn a_written_field_is_opened_again() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a");
    let written = write(&few(), &out, &mut |_, _| {}).unwrap();
    let catalogue = asteroids(&few()).unwrap();
    let world = open(&out).unwrap();
    assert!(world.notes.is_empty(), "{:?}", world.notes);
    // A tile a level where the catalogue has a node a model.
    assert_eq!(world.tree.representations(), catalogue.tree.representations());
    assert_eq!((written.tiles, world.summary().leaves), (world.tree.representations() as u64, 700));
    assert_eq!(written.files, 2 * 16 + catalogue.tree.nodes() as u64 - 700);
    let (bounds, model) = (world.summary().bounds, catalogue.summary().bounds);
    assert!((bounds.min - model.min).abs().max_element() < 0.01 && (bounds.max - model.max).abs().max_element() < 0.01);
    assert_eq!(world.tree.error(RepId(0)), catalogue.tree.error(RepId(0)));
}
