use foresight_scheduler::lod_tree::{NodeId, RepId};
use glam::DVec3;

use super::data;
use crate::geodesy::Projection;
use crate::world::{self, Georeference, Severity, Summary, World};

/// A world of the shared data, checked for what holds for all of them.
fn load(name: &str) -> Option<(World, Summary)> {
    let path = data(&format!("scenes/{name}"))?;
    let world = world::open(&path).unwrap();
    let (tree, summary) = (&world.tree, world.summary());
    println!("{name}: {summary:?}");
    world.notes.iter().for_each(|note| println!("  {note}"));
    assert!(tree.errors_fall());
    for node in (0..tree.nodes() as u32).map(NodeId) {
        let errors: Vec<f64> = tree.own(node).map(|rep| tree.error(rep)).collect();
        assert!(errors.is_sorted_by(|coarse, fine| coarse >= fine), "{errors:?}");
        for rep in tree.own(node) {
            assert!((500..64 << 10).contains(&tree.wire_bytes(rep)), "{}: {}", world.uri(rep), tree.wire_bytes(rep));
        }
        if tree.is_leaf(node) {
            // Positions narrowed to f32 about the tile's middle.
            assert!(errors.last().is_some_and(|&finest| finest < 1e-3), "{errors:?}");
        }
    }
    assert_eq!(world.hash(), world::open(&path).unwrap().hash());
    Some((world, summary))
}

fn error_at_the_root(world: &World) -> f64 {
    world.tree.own(NodeId(0)).map(|rep| world.tree.error(rep)).fold(f64::INFINITY, f64::min)
}

/// Degrees north and east of the world's middle.
fn middle(world: &World) -> [f64; 2] {
    let Some(Georeference::Epsg(code)) = world.georeference else { panic!("{:?}", world.georeference) };
    let bounds = world.tree.bounds(NodeId(0));
    let at = Projection::from_epsg(code).unwrap().inverse(bounds.centre()).unwrap();
    [at.latitude.to_degrees(), at.longitude.to_degrees()]
}

fn assert_near(found: [f64; 2], expected: [f64; 2], by: f64) {
    assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < by), "{found:?} {expected:?}");
}

#[test]
fn delft() {
    let Some((world, summary)) = load("delft_lod1.city.json") else { return };
    assert_eq!(world.georeference, Some(Georeference::Epsg(28992)));
    assert_near(middle(&world), [52.01, 4.36], 0.02);
    // As the file's geographicalExtent has it.
    assert!((summary.bounds.min - DVec3::new(84_616.468, 447_422.999, -0.452)).abs().max_element() < 1e-3);
    assert!((summary.bounds.max - DVec3::new(85_140.839, 447_750.636, 16.846)).abs().max_element() < 1e-3);
    assert!((10..60).contains(&summary.leaves), "{summary:?}");
    assert!((0.4e6..1.2e6).contains(&(summary.wire_bytes as f64)), "{summary:?}");
    let ground = world.ground_height(summary.bounds.centre()).unwrap();
    assert!((-0.5..6.0).contains(&ground), "{ground}");
    assert!(world.notes.iter().any(|note| note.text == "3 faces without area: left out"), "{:?}", world.notes);
}

#[test]
fn mamre_is_transformed_twice() {
    let Some((world, summary)) = load("mamre_osm_lod1_terrain.city.json") else { return };
    assert_eq!(world.georeference, Some(Georeference::Epsg(32734)));
    // The village north of Cape Town.
    assert_near(middle(&world), [-33.5, 18.47], 0.02);
    assert!((6_287_743.0..6_290_345.0).contains(&summary.bounds.centre().y));
    let note = |severity, text: &str| world.notes.iter().any(|n| n.severity == severity && n.text.contains(text));
    assert!(note(Severity::Trap, "the transform is applied twice"), "{:?}", world.notes);
    assert!(note(Severity::Repair, "its translation was left out"), "{:?}", world.notes);
    // The terrain rises from 145 to 240 m.
    let ground = world.ground_height(summary.bounds.centre()).unwrap();
    assert!((145.0..240.0).contains(&ground), "{ground}");
    assert!((20..80).contains(&summary.leaves) && error_at_the_root(&world) < 400.0, "{summary:?}");
}

#[test]
fn zurich() {
    let Some((world, summary)) = load("zurich_subset_lod2.city.json") else { return };
    assert_eq!(world.georeference, Some(Georeference::Epsg(2056)));
    assert_near(middle(&world), [47.38, 8.53], 0.03);
    // 49 buildings scattered over 9 km × 10 km, told apart.
    assert_eq!(summary.leaves, 49);
    let size = summary.bounds.max - summary.bounds.min;
    assert!((size - DVec3::new(9185.54, 9959.045, 225.119)).abs().max_element() < 1e-2, "{size}");
    // What the root leaves out counts by its own size: no building is larger than 80 m.
    assert!(error_at_the_root(&world) < 80.0, "{}", error_at_the_root(&world));
    assert!(world.ground_height(summary.bounds.centre()).is_some_and(|height| (395.0..620.0).contains(&height)));
}

#[test]
fn a_tile_of_3dbag() {
    let Some((world, summary)) = load("3dbag_tile5870.city.jsonl") else { return };
    assert_eq!(world.georeference, Some(Georeference::Epsg(28992)));
    assert_near(middle(&world), [52.05, 4.31], 0.03);
    assert!((summary.bounds.max - summary.bounds.min).max_element() < 640.0);
    // The file's levels 1.2, 1.3 and 2.2 in half of the tiles.
    let tree = &world.tree;
    let leaves = (0..tree.nodes() as u32).map(NodeId).filter(|&node| tree.is_leaf(node));
    let levels: Vec<usize> = leaves.map(|leaf| tree.own(leaf).len()).collect();
    assert!(levels.iter().filter(|&&levels| levels >= 3).count() * 2 >= levels.len(), "{levels:?}");
    let finest: u64 = (0..tree.representations() as u32)
        .map(RepId)
        .filter(|&r| tree.error(r) < 1e-3)
        .map(|r| tree.wire_bytes(r))
        .sum();
    assert!((60_000..160_000).contains(&finest), "{finest}");
}
