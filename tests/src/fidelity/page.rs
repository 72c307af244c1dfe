//! What the page is given: the case as JSON, and the tree as a 3D Tiles tileset.

use foresight_scheduler::lod_tree::{LodTree, NodeId};
use foresight_traces::flight::TICKS_PER_SECOND;
use serde_json::{Map, Value, json};

use super::case::Case;

/// Geometric error of what has no content, metres: never met.
const NO_CONTENT_ERROR: f64 = 1e6;

/// Camera, viewport and budget.
pub(super) fn setup(case: &Case) -> Value {
    let views: Vec<[f64; 7]> = case
        .flight
        .views
        .iter()
        .map(|view| {
            let (p, q) = (view.position, view.orientation);
            [p.x, p.y, p.z, q.x, q.y, q.z, q.w]
        })
        .collect();
    json!({
        "rate": TICKS_PER_SECOND,
        "views": views,
        "fov_y_deg": case.fov_y_deg(),
        "viewport": case.flight.views[0].viewport,
        "budget": case.budget,
        "streams": case.streams,
        "up": case.world.up.to_array(),
        "ground": case.ground(),
    })
}

/// A tile per representation: boxes and errors are the tree's, a node's levels of detail a chain of tiles, contents at
/// `content/REP`.
pub(super) fn tileset(tree: &LodTree) -> Value {
    // Children come after their parents: from the last to the first, every node's children are ready before it.
    let mut children: Vec<Vec<Value>> = vec![Vec::new(); tree.nodes()];
    let mut root = Value::Null;
    for node in (0..tree.nodes() as u32).rev().map(NodeId) {
        let mut beneath = core::mem::take(&mut children[node.index()]);
        beneath.reverse();
        let tile = chain(tree, node, beneath);
        match tree.parent(node) {
            Some(parent) => children[parent.index()].push(tile),
            None => root = tile,
        }
    }
    json!({ "asset": { "version": "1.0" }, "geometricError": NO_CONTENT_ERROR, "root": root })
}

/// The tiles of a node, the coarsest outside.
fn chain(tree: &LodTree, node: NodeId, children: Vec<Value>) -> Value {
    let (c, h) = (tree.centre(node), tree.half(node));
    let volume = json!({ "box": [c.x, c.y, c.z, h.x, 0.0, 0.0, 0.0, h.y, 0.0, 0.0, 0.0, h.z] });
    let tile = |error: f64, children: Vec<Value>| {
        let mut tile = Map::new();
        tile.insert("boundingVolume".to_owned(), volume.clone());
        tile.insert("geometricError".to_owned(), error.into());
        tile.insert("refine".to_owned(), "REPLACE".into());
        if !children.is_empty() {
            tile.insert("children".to_owned(), children.into());
        }
        tile
    };
    let mut levels: Vec<_> = tree.own(node).collect();
    levels.sort_by(|&a, &b| tree.error(a).total_cmp(&tree.error(b)).then(b.cmp(&a)));
    let mut beneath = children;
    if levels.is_empty() {
        return tile(NO_CONTENT_ERROR, beneath).into();
    }
    for rep in levels {
        let mut level = tile(tree.error(rep), beneath);
        level.insert("content".to_owned(), json!({ "uri": format!("content/{}", rep.0) }));
        beneath = vec![level.into()];
    }
    beneath.swap_remove(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, Representation};
    use glam::DVec3;

    #[test]
    fn levels_are_a_chain_and_children_hang_beneath_the_finest() {
        let level =
            |error| Representation { wire_bytes: 1, decoded_bytes: 1, error, prerequisite: None, direction: None };
        let unit = |x: f64| Some(Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 1.0, 1.0, 1.0) });
        let mut b = LodTreeBuilder::default();
        b.open().unwrap();
        b.add(level(4.0)).unwrap();
        b.add(level(2.0)).unwrap();
        for x in [0.0, 1.0] {
            b.open().unwrap();
            b.add(level(0.0)).unwrap();
            b.close(unit(x), 1.0).unwrap();
        }
        b.close(None, 1.0).unwrap();
        let root = &tileset(&b.finish().unwrap())["root"];
        assert_eq!(root["geometricError"], 4.0);
        assert_eq!(root["boundingVolume"]["box"], json!([1.0, 0.5, 0.5, 1.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.5]));
        let finer = &root["children"][0];
        assert_eq!((&finer["geometricError"], &finer["content"]["uri"]), (&json!(2.0), &json!("content/1")));
        let uris: Vec<_> = (0..2).map(|i| finer["children"][i]["content"]["uri"].clone()).collect();
        assert_eq!(uris, ["content/2", "content/3"]);
    }
}
