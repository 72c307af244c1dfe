use proptest::prelude::*;
use serde_json::{Value, json};

use super::{Scratch, anywhere, b3dm, empty_tile, glb, rectangle, subtree, tile};
use crate::import::tiles3d::{Tiles3dError, content_summary, load, parse_subtree, parse_tileset};

/// The message of the error that opening a tileset with this root gives; `a.glb` and `b.json` are there.
fn refused(root: &Value) -> String {
    let scratch = Scratch::new();
    scratch.put("a.glb", rectangle(None));
    scratch.tileset("b.json", &tile(1.0, "b.json", &[]));
    scratch.tileset("tileset.json", root);
    scratch.open().expect_err("must be refused").to_string()
}

fn with(member: &str, value: Value) -> Value {
    let mut child = tile(1.0, "a.glb", &[]);
    child[member] = value;
    empty_tile(&[tile(1.0, "a.glb", &[]), child])
}

#[test]
fn faults_are_named_with_their_json_path() {
    let infinite: Value = serde_json::from_str(r#"["x"]"#).unwrap();
    for (member, value, place, expected) in [
        ("geometricError", json!(-1.0), "$.root.children[1].geometricError", "not negative"),
        ("geometricError", json!("1"), "$.root.children[1].geometricError", ""),
        ("geometricError", Value::Null, "$.root.children[1].geometricError", ""),
        ("transform", json!([1, 2, 3]), "$.root.children[1].transform", "expected 16"),
        ("transform", infinite, "$.root.children[1].transform", ""),
        (
            "transform",
            json!([1, 0, 0, 9, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]),
            "$.root.children[1].transform",
            "affine",
        ),
        ("boundingVolume", json!({}), "$.root.children[1].boundingVolume", "expected one of them"),
        ("boundingVolume", json!({ "box": [1, 2] }), "$.root.children[1].boundingVolume", "expected 12"),
        ("boundingVolume", json!({ "sphere": [0, 0, 0, -1] }), "$.root.children[1].boundingVolume", "radius"),
        ("boundingVolume", json!({ "region": [0, 1, 0, -1, 0, 0] }), "$.root.children[1].boundingVolume", "south"),
        ("refine", json!("MAYBE"), "$.root.children[1].refine", "REPLACE"),
        ("content", json!({}), "$.root.children[1].content", "address"),
        ("implicitTiling", json!({ "subdivisionScheme": "KD" }), "$.root.children[1].implicitTiling", ""),
    ] {
        let message = refused(&with(member, value.clone()));
        assert!(message.contains(place) && message.contains(expected), "{member} {value}: {message}");
        assert!(message.contains("tileset.json"), "{message}");
    }
    for member in ["geometricError", "boundingVolume"] {
        let mut child = tile(1.0, "a.glb", &[]);
        child.as_object_mut().unwrap().remove(member);
        let message = refused(&empty_tile(&[child]));
        assert!(message.contains("$.root.children[0]") && message.contains(member), "{message}");
    }
}

#[test]
fn numbers_beyond_every_number() {
    let text = |member: &str| {
        format!(
            r#"{{"asset":{{"version":"1.0"}},"root":{{"boundingVolume":{{"sphere":[0,0,0,1]}},"geometricError":1,{member}}}}}"#
        )
    };
    for member in
        [r#""transform":[1e999,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]"#, r#""geometricError":1e999"#, r#""geometricError":NaN"#]
    {
        assert!(parse_tileset(text(member).as_bytes()).is_err(), "{member}");
    }
    // Each finite, their product not.
    let huge = json!([1e200, 0, 0, 0, 0, 1e200, 0, 0, 0, 0, 1e200, 0, 0, 0, 0, 1]);
    let mut inner = tile(1.0, "a.glb", &[]);
    inner["transform"] = huge.clone();
    let mut root = empty_tile(&[inner]);
    root["transform"] = huge;
    let message = refused(&root);
    assert!(message.contains("$.root.children[0]") && message.contains("finite"), "{message}");
}

#[test]
fn circles_and_ways_out() {
    let message = refused(&tile(1.0, "b.json", &[]));
    assert!(message.contains("tileset.json → b.json → b.json"), "{message}");
    let message = refused(&tile(1.0, "../secret.glb", &[]));
    assert!(message.contains("../secret.glb") && message.contains("leaves"), "{message}");
    let message = refused(&tile(1.0, "tileset.json", &[]));
    assert!(message.contains("circle"), "{message}");
}

#[test]
fn a_chain_of_external_tilesets_is_bounded() {
    let scratch = Scratch::new();
    for i in 0..100 {
        scratch.tileset(&format!("{i}.json"), &tile(1.0, &format!("{}.json", i + 1), &[]));
    }
    scratch.tileset("tileset.json", &tile(1.0, "0.json", &[]));
    let message = scratch.open().unwrap_err().to_string();
    assert!(message.contains("inside each other"), "{message}");
}

#[test]
fn tilesets_that_double_at_every_level_are_stopped() {
    let scratch = Scratch::new();
    for i in 0..60 {
        let next = format!("{}.json", i + 1);
        scratch.tileset(&format!("{i}.json"), &empty_tile(&[tile(1.0, &next, &[]), tile(1.0, &next, &[])]));
    }
    scratch.tileset("60.json", &tile(1.0, "a.glb", &[]));
    scratch.tileset("tileset.json", &tile(1.0, "0.json", &[]));
    let error = load(&scratch.path().join("tileset.json"), 10_000, false).err().expect("must be refused");
    assert!(matches!(error, Tiles3dError::TooMany { limit: 10_000 }), "{error}");
}

#[test]
fn a_hundred_thousand_levels() {
    let depth = 100_000;
    let mut text = r#"{"asset":{"version":"1.1"},"geometricError":9,"root":"#.to_owned();
    let open = r#"{"boundingVolume":{"sphere":[0,0,0,9]},"geometricError":1,"refine":"REPLACE","content":{"uri":"a.glb"},"children":["#;
    text.push_str(&open.repeat(depth));
    text.push_str(&"]}".repeat(depth));
    text.push('}');
    let scratch = Scratch::new();
    scratch.put("a.glb", rectangle(None));
    scratch.put("tileset.json", &text);
    // It is read whole, and refused for what decisions would cost.
    assert_eq!(parse_tileset(text.as_bytes()).unwrap().tiles.len(), depth);
    let error = scratch.open().unwrap_err().to_string();
    assert!(error.contains("tileset.json") && error.contains("levels deep; expected at most"), "{error}");
    // A fault at the bottom is still named, in a message of bounded length.
    let broken = text.replacen("]}", "]", 1);
    let error = parse_tileset(broken.as_bytes()).unwrap_err().to_string();
    assert!(error.len() < 1000, "{} characters", error.len());
    // Extras as deep are skipped.
    let extras = format!("{{\"extras\":{}{},{}", "[".repeat(depth), "]".repeat(depth), &text[1..]);
    assert_eq!(parse_tileset(extras.as_bytes()).unwrap().tiles.len(), depth);
}

#[test]
fn files_that_are_something_else() {
    let scratch = Scratch::new();
    for (content, found) in [
        (b"# timestamp tx ty tz qx qy qz qw\n0 0 0 0 0 0 0 1\n".as_slice(), "# timestamp"),
        (b"", "nothing in it"),
        (b"\x89PNG\r\n", "PNG"),
        (b"{\"type\": \"Topology\"}", "no member \"asset\""),
        (b"{\"asset\": {\"version\": \"1.0\"}}", "no member \"root\""),
        (b"{\"asset\": {\"version\": \"7.0\"}}", "7.0"),
        (b"{\"asset\"", "expected JSON"),
    ] {
        let path = scratch.put("tileset.json", content);
        let message = crate::world::open(&path).unwrap_err().to_string();
        assert!(message.contains(found) && message.contains("tileset.json"), "{message}");
    }
    let message = crate::world::open(&scratch.path().join("absent")).unwrap_err().to_string();
    assert!(message.contains("absent"), "{message}");
    let message = refused(&tile(1.0, "absent.glb", &[]));
    assert!(message.contains("no content") && message.contains("absent.glb"), "{message}");
}

#[test]
fn broken_contents_are_named_by_their_byte() {
    let good = b3dm("{}", &rectangle(None));
    for length in 0..good.len() {
        let error = content_summary(&good[..length]).expect_err("truncated").to_string();
        assert!(error.contains("byte"), "{length}: {error}");
    }
    assert_eq!(content_summary(&good).unwrap().decoded_bytes, 60);
    let mut version = rectangle(None);
    version[4] = 1;
    assert!(content_summary(&version).unwrap_err().to_string().contains("byte 4: glTF version 1"));
    let cyclic = json!({
        "asset": { "version": "2.0" }, "scenes": [{ "nodes": [0] }],
        "nodes": [{ "children": [1] }, { "children": [0] }],
    });
    assert!(content_summary(&glb(&cyclic, &[])).unwrap_err().place.contains("nodes[0]"));
    let far = json!({
        "asset": { "version": "2.0" }, "scenes": [{ "nodes": [7] }],
    });
    assert!(content_summary(&glb(&far, &[])).unwrap_err().place.contains("nodes[7]"));
    // A count that no buffer holds: nothing is read, and the bytes in memory are what it says.
    let claims = json!({
        "asset": { "version": "2.0" }, "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "accessors": [{ "componentType": 5126, "count": 18_000_000_000_000_000_000_u64, "type": "VEC3" }],
    });
    let summary = content_summary(&glb(&claims, &[])).unwrap();
    assert_eq!((summary.decoded_bytes, summary.bounds), (u64::MAX, None));
    let scratch = Scratch::new();
    scratch.put("a.glb", glb(&claims, &[]));
    scratch.tileset("tileset.json", &tile(1.0, "a.glb", &[]));
    assert!(scratch.open().unwrap_err().to_string().contains("4 GiB"));
}

#[test]
fn broken_subtrees() {
    let json = json!({
        "buffers": [{ "byteLength": 8 }],
        "bufferViews": [{ "buffer": 0, "byteOffset": 0, "byteLength": 3 }, { "buffer": 0, "byteOffset": 0, "byteLength": 8 }],
        "tileAvailability": { "bitstream": 0 }, "childSubtreeAvailability": { "bitstream": 1 },
    });
    let good = subtree(&json, &[255; 8]);
    let parse = |bytes: &[u8]| parse_subtree(bytes, 4, 3, &|_| None);
    assert!(parse(&good).unwrap().tiles.get(20));
    for length in 0..good.len() {
        assert!(parse(&good[..length]).is_err(), "{length}");
    }
    assert!(parse_subtree(&good, 4, 2, &|_| None).unwrap_err().fault.contains("expected 1 for 5 bits"));
    assert!(parse_subtree(&good, 8, 3, &|_| None).unwrap_err().fault.contains("expected 10 for 73 bits"));
    let edit = |change: &dyn Fn(&mut Value)| {
        let mut edited = json.clone();
        change(&mut edited);
        parse(&subtree(&edited, &[255; 8])).unwrap_err()
    };
    assert!(edit(&|json| json["bufferViews"][0]["byteOffset"] = json!(7)).place.contains("bufferViews[0]"));
    assert!(edit(&|json| json["bufferViews"][0]["byteOffset"] = json!(u64::MAX)).place.contains("bufferViews[0]"));
    assert!(edit(&|json| json["bufferViews"][0]["buffer"] = json!(3)).fault.contains("expected one of 1"));
    assert!(edit(&|json| json["tileAvailability"] = json!({ "constant": 2 })).fault.contains("0 or 1"));
    assert!(edit(&|json| json["tileAvailability"] = json!({})).fault.contains("exactly one"));
    assert!(edit(&|json| json["buffers"][0]["uri"] = json!("x.bin")).fault.contains("x.bin"));
    let mut version = good.clone();
    version[4] = 9;
    assert!(parse(&version).unwrap_err().to_string().contains("byte 4: version 9"));
    let mut length = good;
    length[8] ^= 1;
    assert!(parse(&length).unwrap_err().place.contains("byte 8"));
}

#[test]
fn an_implicit_tiling_without_its_subtrees() {
    let mut root =
        json!({ "boundingVolume": anywhere(), "geometricError": 1.0, "refine": "ADD", "content": { "uri": "a.glb" } });
    root["implicitTiling"] = json!({
        "subdivisionScheme": "QUADTREE", "subtreeLevels": 2, "availableLevels": 4, "subtrees": { "uri": "s/{level}_{x}_{y}" },
    });
    let message = refused(&root);
    assert!(message.contains("s/0_0_0") && message.contains("not there"), "{message}");
    root["children"] = json!([tile(1.0, "a.glb", &[])]);
    assert!(refused(&root).contains("expected one of them"));
}

fn sample(kind: u8) -> Vec<u8> {
    match kind {
        0 => b3dm(r#"{"RTC_CENTER":[1,2,3]}"#, &rectangle(Some(&super::png(4, 4)))),
        1 => rectangle(None),
        2 => {
            let json = json!({
                "buffers": [{ "byteLength": 3 }], "bufferViews": [{ "buffer": 0, "byteOffset": 0, "byteLength": 3 }],
                "tileAvailability": { "bitstream": 0 }, "childSubtreeAvailability": { "constant": 0 },
            });
            subtree(&json, &[255; 3])
        }
        _ => serde_json::to_vec(
            &json!({ "asset": { "version": "1.0" }, "root": tile(1.0, "a", &[tile(0.5, "b", &[])]) }),
        )
        .unwrap(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]
    #[test]
    fn no_bytes_make_a_reader_panic(kind in 0_u8..4, edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6), cut in any::<prop::sample::Index>(), whole: bool) {
        let mut bytes = sample(kind);
        for (at, value) in edits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if !whole {
            bytes.truncate(cut.index(bytes.len()));
        }
        if let Ok(summary) = content_summary(&bytes) {
            prop_assert!(summary.bounds.is_none_or(|bounds| !bounds.is_empty()));
        }
        if let Ok(document) = parse_tileset(&bytes) {
            prop_assert!(document.tiles.iter().all(|tile| tile.geometric_error >= 0.0));
        }
        if let Ok(subtree) = parse_subtree(&bytes, 4, 3, &|_| None) {
            prop_assert!(!subtree.child_subtrees.get(64) || subtree.child_subtrees == crate::import::tiles3d::Bits::Constant(true));
        }
        crate::manifest::parse(&bytes).unwrap_err();
    }
}
