use foresight_scheduler::lod_tree::{NodeId, RepId};
use glam::DVec3;

use super::data;
use crate::geodesy::Projection;
use crate::world::{self, Georeference, World};

fn load(name: &str) -> Option<World> {
    let world = world::open(&data(&format!("scenes/{name}"))?).unwrap();
    let summary = world.summary();
    println!("{name}: {summary:?}");
    world.notes.iter().for_each(|note| println!("  {note}"));
    let tree = &world.tree;
    let nodes = || (0..tree.nodes() as u32).map(NodeId);
    for node in nodes() {
        let own: Vec<String> = tree
            .own(node)
            .map(|rep| format!("{}:{}:{:.3}", world.uri(rep), tree.wire_bytes(rep), tree.error(rep)))
            .collect();
        println!("    {:?} {:?} {}", node, (2.0 * tree.half(node)).round(), own.join(" "));
    }
    assert!(tree.errors_fall());
    Some(world)
}

#[test]
fn figures() {
    for name in [
        "delft_lod1.city.json",
        "mamre_osm_lod1_terrain.city.json",
        "zurich_subset_lod2.city.json",
        "3dbag_tile5870.city.jsonl",
    ] {
        load(name);
    }
}
