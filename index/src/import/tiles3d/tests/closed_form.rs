use std::io::Write;

use foresight_scheduler::lod_tree::{Aabb, NodeId, RepId};
use glam::DVec3;
use serde_json::json;

use super::{Scratch, anywhere, b3dm, empty_tile, glb, png, rectangle, subtree, tile};
use crate::generate::mosaic::{MosaicError, in_memory, mosaic};
use crate::import::tiles3d::{ContentKind, content_summary};
use crate::world::{Georeference, Severity, World};

fn bounds(min: [f64; 3], max: [f64; 3]) -> Aabb {
    Aabb { min: DVec3::from_array(min), max: DVec3::from_array(max) }
}

fn close(a: Aabb, b: Aabb) -> bool {
    (a.min - b.min).abs().max((a.max - b.max).abs()).max_element() < 1e-9
}

fn uris(world: &World) -> Vec<String> {
    (0..world.tree.representations() as u32).map(|rep| world.uri(RepId(rep)).into_owned()).collect()
}

#[test]
fn bytes_bounds_and_error_of_one_content() {
    let scratch = Scratch::new();
    let content = b3dm(r#"{"BATCH_LENGTH":0,"RTC_CENTER":[10,20,30]}"#, &rectangle(Some(&png(64, 32))));
    scratch.put("a.b3dm", &content);
    let mut root = tile(3.0, "a.b3dm", &[]);
    // Twice the size, a quarter turn about z, then 100 m along x.
    root["transform"] = json!([0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 100, 0, 0, 1]);
    scratch.tileset("tileset.json", &root);
    let world = scratch.open().unwrap();
    let tree = &world.tree;
    assert_eq!((tree.nodes(), tree.representations()), (1, 1));
    assert_eq!(tree.wire_bytes(RepId(0)), content.len() as u64);
    assert_eq!(tree.decoded_bytes(RepId(0)), 4 * 12 + 6 * 2 + 64 * 32 * 16 / 3);
    assert_eq!(tree.error(RepId(0)), 6.0);
    // x and y of the rectangle about (10, 20): 10 to 11 and 20 to 22; z: 30.5.
    assert!(close(tree.bounds(NodeId(0)), bounds([100.0 - 44.0, 20.0, 61.0], [60.0, 22.0, 61.0])));
    assert_eq!(world.up, DVec3::Z);
    assert_eq!(world.ground_height(DVec3::new(57.0, 21.0, 0.0)), Some(61.0));
    let summary = content_summary(&content).unwrap();
    assert_eq!(summary.kind, ContentKind::B3dm);
    assert_eq!(summary.bounds, Some(bounds([10.0, 20.5, 28.0], [11.0, 20.5, 30.0])));
}

#[test]
fn contents_kept_by_add_and_several_contents_become_leaves() {
    let scratch = Scratch::new();
    for name in ["r", "a", "b", "c", "d"] {
        scratch.put(&format!("{name}.glb"), rectangle(None));
    }
    let mut several = tile(1.0, "b.glb", &[]);
    several["contents"] = json!([{ "uri": "c.glb" }]);
    let mut replaced = tile(4.0, "a.glb", &[tile(0.5, "d.glb", &[])]);
    replaced["contents"] = json!([{ "uri": "c.glb" }]);
    replaced["refine"] = json!("REPLACE");
    several["refine"] = json!("REPLACE");
    let mut root = tile(16.0, "r.glb", &[several, replaced]);
    root["refine"] = json!("ADD");
    scratch.tileset("tileset.json", &root);
    let world = scratch.open().unwrap();
    let tree = &world.tree;
    // root ⟨r⟩ ⟨ ⟨b⟩ ⟨c⟩ ⟩ a⟨ ⟨c⟩ ⟨d⟩ ⟩
    assert_eq!(uris(&world), ["r.glb", "b.glb", "c.glb", "a.glb", "c.glb", "d.glb"]);
    let errors: Vec<f64> = (0..6).map(|rep| tree.error(RepId(rep))).collect();
    assert_eq!(errors, [0.0, 1.0, 1.0, 4.0, 4.0, 0.5]);
    let parents: Vec<Option<u32>> = (0..8).map(|node| tree.parent(NodeId(node)).map(|node| node.0)).collect();
    assert_eq!(parents, [None, Some(0), Some(0), Some(2), Some(2), Some(0), Some(5), Some(5)]);
    assert_eq!(tree.own(NodeId(0)).len(), 0);
    assert_eq!(tree.own(NodeId(5)).len(), 1);
}

#[test]
fn external_tilesets_inherit_transforms_and_share_files() {
    let scratch = Scratch::new();
    scratch.put("inner/a.glb", rectangle(None));
    scratch.tileset("inner/tileset.json", &tile(1.0, "a.glb", &[]));
    let shifted = |x: f64| {
        json!({
            "boundingVolume": anywhere(), "geometricError": 5.0,
            "transform": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, 0, 0, 1], "content": { "url": "inner/tileset.json" },
        })
    };
    scratch.tileset("tileset.json", &empty_tile(&[shifted(10.0), shifted(20.0)]));
    let world = scratch.open().unwrap();
    assert_eq!(uris(&world), ["inner/a.glb", "inner/a.glb"]);
    assert_eq!((world.tree.nodes(), world.summary().leaves), (5, 2));
    assert!(close(world.tree.bounds(NodeId(4)), bounds([20.0, 0.0, 0.5], [21.0, 2.0, 0.5])));
    assert_eq!(world.ground_height(DVec3::new(10.5, 1.0, 9.0)), Some(0.5));
}

#[test]
fn a_planet_keeps_the_millimetre() {
    let scratch = Scratch::new();
    scratch.put("a.b3dm", b3dm(r#"{"RTC_CENTER":[6378137.125,0.25,0.0625]}"#, &rectangle(None)));
    let mut root = tile(1.0, "a.b3dm", &[]);
    root["boundingVolume"] = json!({ "region": [-0.001, -0.001, 0.001, 0.001, -10, 10] });
    scratch.tileset("tileset.json", &root);
    let world = scratch.open().unwrap();
    assert_eq!(world.georeference, Some(Georeference::Ecef));
    assert!((world.up - DVec3::X).length() < 1e-6, "{}", world.up);
    assert!(close(world.tree.bounds(NodeId(0)), bounds([6_378_137.125, 0.25, 0.5625], [6_378_138.125, 2.25, 0.5625])));
    let height = world.ground_height(DVec3::new(6.38e6, 1.0, 0.5)).unwrap();
    assert!((height - 6_378_137.625).abs() < 1e-3, "{height}");
}

#[test]
fn errors_are_made_monotone_and_said_once() {
    let scratch = Scratch::new();
    scratch.put("a.glb", rectangle(None));
    let children = [tile(7.0, "a.glb", &[tile(6.0, "a.glb", &[])]), tile(9.0, "a.glb", &[])];
    scratch.tileset("tileset.json", &tile(5.0, "a.glb", &children));
    let world = scratch.open().unwrap();
    assert!((0..4).all(|rep| world.tree.error(RepId(rep)) == 5.0));
    let notes: Vec<_> = world.notes.iter().filter(|note| note.severity == Severity::Repair).collect();
    assert_eq!(notes.len(), 1);
    assert!(notes[0].text.starts_with("3 tiles") && notes[0].text.contains("up to 4 m"), "{}", notes[0]);
}

#[test]
fn what_is_missing_is_pruned_and_said() {
    let scratch = Scratch::new();
    scratch.put("a.glb", rectangle(None));
    scratch.put("empty.glb", "");
    scratch.put("picture.b3dm", png(8, 8));
    let inner = tile(2.0, "gone.glb", &[tile(0.0, "a.glb", &[]), tile(0.0, "empty.glb", &[])]);
    let children = [inner, tile(0.0, "picture.b3dm", &[]), tile(0.0, "https://host/b.glb", &[]), empty_tile(&[])];
    scratch.tileset("tileset.json", &tile(5.0, "a.glb", &children));
    let world = scratch.open().unwrap();
    // The root, the inner tile without its own content, and the one leaf that is left.
    assert_eq!((world.tree.nodes(), world.tree.representations()), (3, 2));
    for (file, text) in [
        ("gone.glb", "without it"),
        ("empty.glb", "empty file"),
        ("picture.b3dm", "PNG"),
        ("tileset.json", "another host"),
    ] {
        let found =
            world.notes.iter().any(|n| n.severity == Severity::Missing && n.file == file && n.text.contains(text));
        assert!(found, "{file}: {:?}", world.notes);
    }
}

#[test]
fn an_octree_with_json_subtrees() {
    let scratch = Scratch::new();
    let mut levels = vec![(0, 0, 0, 0)];
    levels.extend((0..8).map(|child| (1, child & 1, child >> 1 & 1, child >> 2)));
    levels.push((2, 3, 1, 2));
    for (level, x, y, z) in &levels {
        scratch.put(&format!("c/{level}/{x}/{y}/{z}.glb"), rectangle(None));
    }
    let mut root = tile(8.0, "c/{level}/{x}/{y}/{z}.glb", &[]);
    root.as_object_mut().unwrap().remove("children");
    root["implicitTiling"] = json!({
        "subdivisionScheme": "OCTREE", "subtreeLevels": 2, "availableLevels": 3,
        "subtrees": { "uri": "s/{level}.{x}.{y}.{z}.json" },
    });
    scratch.tileset("tileset.json", &root);
    // Child subtree (2: 3, 1, 2): Morton index from x = 11, y = 01, z = 10, the most significant bits first:
    // z y x = 1 0 1, then 0 1 1, so 0b101_011 = 43.
    let mut bits = [0_u8; 8];
    bits[43 / 8] |= 1 << (43 % 8);
    scratch.put("s/bits.bin", bits);
    let top = json!({
        "buffers": [{ "uri": "bits.bin", "byteLength": 8 }],
        "bufferViews": [{ "buffer": 0, "byteOffset": 0, "byteLength": 8 }],
        "tileAvailability": { "constant": 1 }, "contentAvailability": [{ "constant": 1 }],
        "childSubtreeAvailability": { "bitstream": 0 },
    });
    scratch.put("s/0.0.0.0.json", serde_json::to_vec(&top).unwrap());
    let below = json!({
        "buffers": [{ "byteLength": 2 }], "bufferViews": [{ "buffer": 0, "byteOffset": 0, "byteLength": 2 }],
        "tileAvailability": { "bitstream": 0 }, "contentAvailability": [{ "bitstream": 0 }],
        "childSubtreeAvailability": { "constant": 0 },
    });
    scratch.put("s/2.3.1.2.json", subtree(&below, &[1, 0]));
    let world = scratch.open().unwrap();
    assert_eq!(world.tree.representations(), 10);
    let uris = uris(&world);
    let deepest = uris.iter().position(|uri| uri == "c/2/3/1/2.glb").unwrap();
    let node = world.tree.node_of(RepId(deepest as u32));
    assert_eq!(world.tree.error(RepId(deepest as u32)), 2.0);
    let parent = world.tree.parent(node).unwrap();
    assert_eq!(world.uri(world.tree.own(parent).next().unwrap()), "c/1/1/0/1.glb");
    assert_eq!(world.notes.len(), 1);
    assert!(world.notes[0].text.starts_with("declared boxes are "), "{}", world.notes[0]);
}

#[test]
fn a_mosaic_shares_one_copy() {
    let scratch = Scratch::new();
    scratch.put("in/sub/a.glb", rectangle(None));
    scratch.tileset("in/start.json", &tile(2.0, "sub/a.glb", &[tile(0.5, "sub/a.glb", &[])]));
    let out = scratch.path().join("out");
    let mut told = Vec::new();
    let made = mosaic(&scratch.path().join("in/start.json"), 3, &out, &mut |done, all| told.push((done, all))).unwrap();
    assert_eq!((made.instances, made.coarse_tiles, made.representations), (9, 4, 22));
    assert_eq!(made.pitch, [1.0, 2.0]);
    assert_eq!((told.first().map(|t| t.0), told.last().copied()), (Some(0), Some((made.bytes, made.bytes))));
    let world = crate::world::open(&out).unwrap();
    assert_eq!(world.tree.representations(), 22);
    let all = uris(&world);
    let distinct: std::collections::BTreeSet<&String> = all.iter().collect();
    // Each instance has its own address; in the source the file has two tiles.
    assert_eq!(distinct.len(), 9 + 4);
    assert_eq!(all[0], "coarse/2/0_0.glb");
    assert!(all.contains(&"cells/2_1/sub/a.glb".to_owned()));
    let errors: Vec<f64> = (0..3).map(|rep| world.tree.error(RepId(rep))).collect();
    assert_eq!(errors, [8.0, 4.0, 2.0]);
    assert!(close(world.tree.bounds(NodeId(0)), bounds([0.0, 0.0, 0.5], [3.0, 6.0, 0.5])));
    assert_eq!(world.ground_height(DVec3::new(2.5, 5.0, 0.0)), Some(0.5));
    assert!(world.notes.iter().any(|note| note.text.contains("synthetic")));
    // Nothing beside the one copy, and nothing left behind.
    assert_eq!(std::fs::read_dir(out.join("source/sub")).unwrap().count(), 1);
    assert_eq!(std::fs::read_dir(scratch.path()).unwrap().count(), 2);
    let again = mosaic(&scratch.path().join("in/start.json"), 3, &out, &mut |_, _| {}).unwrap_err();
    assert!(again.to_string().contains("not empty"), "{again}");
    let unwritten = in_memory(&scratch.path().join("in/start.json"), 3).unwrap();
    assert_eq!((unwritten.hash(), unwritten.kind, unwritten.notes), (world.hash(), world.kind, world.notes.clone()));
    let nested = mosaic(&out, 2, &scratch.path().join("out2"), &mut |_, _| {}).unwrap_err();
    assert!(matches!(nested, MosaicError::Kind { .. }), "{nested}");
}

#[test]
fn a_mosaic_copies_subtrees_and_external_tilesets() {
    let scratch = Scratch::new();
    scratch.put("in/deep/a.glb", rectangle(None));
    let mut inner = tile(1.0, "a.glb", &[]);
    inner.as_object_mut().unwrap().remove("children");
    inner["implicitTiling"] = json!({
        "subdivisionScheme": "QUADTREE", "subtreeLevels": 1, "availableLevels": 1, "subtrees": { "uri": "s{level}.subtree" },
    });
    scratch.tileset("in/deep/t.json", &inner);
    let one = json!({
        "tileAvailability": { "constant": 1 }, "contentAvailability": [{ "constant": 1 }],
        "childSubtreeAvailability": { "constant": 0 },
    });
    scratch.put("in/deep/s0.subtree", subtree(&one, &[]));
    scratch.tileset("in/tileset.json", &tile(2.0, "deep/t.json", &[]));
    let out = scratch.path().join("out");
    mosaic(&scratch.path().join("in"), 2, &out, &mut |_, _| {}).unwrap();
    let world = crate::world::open(&out).unwrap();
    assert_eq!(in_memory(&scratch.path().join("in"), 2).unwrap().hash(), world.hash());
    assert_eq!(uris(&world)[1..], ["0_0", "1_0", "0_1", "1_1"].map(|cell| format!("cells/{cell}/deep/a.glb")));
}

#[test]
fn projected_coordinates_are_not_taken_for_earth_centred_ones() {
    let scratch = Scratch::new();
    scratch.put("a.glb", rectangle(None));
    let mut root = tile(1.0, "a.glb", &[]);
    root["transform"] = json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 500_000, 6_290_000, 80, 1]);
    scratch.tileset("tileset.json", &root);
    let world = scratch.open().unwrap();
    assert_eq!((world.up, world.georeference), (DVec3::Z, None));
    assert!(world.notes.iter().any(|note| note.text.contains("projected")), "{:?}", world.notes);
}

#[test]
fn buffers_beside_a_gltf_are_part_of_it() {
    let scratch = Scratch::new();
    let asset = |buffer: &str| {
        json!({
            "asset": { "version": "2.0" }, "nodes": [{ "mesh": 0, "translation": [0, 0, 5] }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            // Normalised 16-bit integers, 8 bytes apart.
            "accessors": [{ "bufferView": 0, "componentType": 5122, "normalized": true, "count": 2, "type": "VEC3" }],
            "bufferViews": [{ "buffer": 0, "byteLength": 14, "byteStride": 8 }],
            "buffers": [{ "byteLength": 14, "uri": buffer }],
        })
    };
    let positions: [i16; 7] = [32767, 0, -32767, 0, 0, 32767, 0];
    let bytes: Vec<u8> = positions.iter().flat_map(|value| value.to_le_bytes()).collect();
    scratch.put("m/a b.bin", &bytes);
    let inline = "data:application/octet-stream;base64,/38AAAGAAAAAAP9/AAA=";
    let (external, inline) = (asset("a%20b.bin").to_string(), asset(inline).to_string());
    scratch.put("m/external.gltf", &external);
    scratch.put("m/inline.gltf", &inline);
    let children = [tile(0.0, "m/external.gltf?v=2", &[]), tile(0.0, "m/inline.gltf", &[])];
    scratch.tileset("tileset.json", &empty_tile(&children));
    let world = scratch.open().unwrap();
    let tree = &world.tree;
    assert_eq!(
        (tree.wire_bytes(RepId(0)), tree.wire_bytes(RepId(1))),
        (external.len() as u64 + 14, inline.len() as u64)
    );
    assert_eq!((tree.decoded_bytes(RepId(0)), tree.decoded_bytes(RepId(1))), (12, 12));
    // glTF (1, 0, −1 + 5) and (0, 1, 0 + 5): tile (1, −4, 0) and (0, −5, 1).
    for node in [NodeId(1), NodeId(2)] {
        assert!(close(tree.bounds(node), bounds([0.0, -5.0, 0.0], [1.0, -4.0, 1.0])), "{:?}", tree.bounds(node));
    }
    assert_eq!(uris(&world)[0], "m/external.gltf?v=2");
    assert_eq!(world.notes.len(), 1);
    assert!(world.notes[0].text.starts_with("declared boxes are "), "{}", world.notes[0]);
}

#[test]
fn contents_that_are_not_read_are_bounded_as_declared() {
    let scratch = Scratch::new();
    let mut cloud = b"pnts\x01\0\0\0".to_vec();
    cloud.extend(40_u32.to_le_bytes());
    cloud.resize(40, 0);
    scratch.put("a.pnts", &cloud);
    let mut root = tile(1.0, "a.pnts", &[]);
    root["content"]["boundingVolume"] = json!({ "sphere": [1, 2, 3, 1] });
    scratch.tileset("tileset.json", &root);
    let world = scratch.open().unwrap();
    assert!(close(world.tree.bounds(NodeId(0)), bounds([0.0, 1.0, 2.0], [2.0, 3.0, 4.0])));
    assert_eq!((world.tree.wire_bytes(RepId(0)), world.tree.decoded_bytes(RepId(0))), (40, 40));
    assert_eq!(world.ground_height(DVec3::ZERO), Some(2.0));
    assert!(world.notes.iter().any(|note| note.severity == Severity::Trap && note.text.contains("point cloud")));
}

#[test]
fn the_extensions_that_became_part_of_the_format() {
    let scratch = Scratch::new();
    scratch.put("a.glb", rectangle(None));
    scratch.put("b.glb", rectangle(None));
    let mut several = empty_tile(&[]);
    several["extensions"] =
        json!({ "3DTILES_multiple_contents": { "content": [{ "uri": "a.glb" }, { "uri": "b.glb" }] } });
    let mut implicit = tile(1.0, "b.glb", &[]);
    implicit.as_object_mut().unwrap().remove("children");
    implicit["extensions"] = json!({ "3DTILES_implicit_tiling": {
        "subdivisionScheme": "QUADTREE", "subtreeLevels": 1, "maximumLevel": 0, "subtrees": { "uri": "{level}.subtree" },
    } });
    let one = json!({
        "tileAvailability": { "constant": 1 }, "contentAvailability": { "constant": 1 },
        "childSubtreeAvailability": { "constant": 0 },
    });
    scratch.put("0.subtree", subtree(&one, &[]));
    let document = json!({
        "asset": { "version": "1.0" }, "root": empty_tile(&[several, implicit]),
        "extensionsRequired": ["3DTILES_implicit_tiling", "X_unheard_of"],
    });
    scratch.put("tileset.json", document.to_string());
    let world = scratch.open().unwrap();
    assert_eq!(uris(&world), ["a.glb", "b.glb", "b.glb"]);
    assert_eq!(world.notes.len(), 2);
    assert!(world.notes[0].text.contains("X_unheard_of"), "{}", world.notes[0]);
}

#[test]
fn gzip_is_inflated_and_counted_as_it_is_sent() {
    let scratch = Scratch::new();
    let packed = |bytes: &[u8]| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let content = packed(&rectangle(None));
    scratch.put("a.glb", &content);
    let plain = std::fs::read(scratch.tileset("tileset.json", &tile(1.0, "a.glb", &[]))).unwrap();
    scratch.put("tileset.json", packed(&plain));
    let world = scratch.open().unwrap();
    assert_eq!((world.tree.wire_bytes(RepId(0)), world.tree.decoded_bytes(RepId(0))), (content.len() as u64, 60));
    scratch.put("tileset.json", &packed(&plain)[..20]);
    assert!(scratch.open().unwrap_err().to_string().contains("tileset.json"));
}

#[test]
fn instances_on_the_gpu_are_bounded_as_declared() {
    let scratch = Scratch::new();
    let asset = json!({
        "asset": { "version": "2.0" },
        "nodes": [{ "mesh": 0, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": 0 } } } }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 1, "type": "VEC3" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 12 }], "buffers": [{ "byteLength": 12 }],
    });
    scratch.put("a.glb", glb(&asset, &[0; 12]));
    scratch.tileset("tileset.json", &tile(1.0, "a.glb", &[]));
    let world = scratch.open().unwrap();
    assert!(close(world.tree.bounds(NodeId(0)), bounds([-100.0; 3], [100.0; 3])));
    assert!(world.notes.iter().any(|note| note.text.contains("instanced")), "{:?}", world.notes);
}
