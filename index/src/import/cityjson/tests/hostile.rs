use proptest::prelude::*;
use serde_json::{Value, json};

use super::super::CityJsonFault;
use super::super::limits::MAX_PARENTS;
use super::{corners, document, faces, opened, parse};

fn refusal(document: &Value) -> CityJsonFault {
    parse(document.to_string().as_bytes(), "model").unwrap_err()
}

fn with_geometry(geometry: &Value) -> Value {
    let objects = json!({ "a": { "type": "Building", "geometry": [geometry] } });
    document(&objects, &corners([0, 0, 0], [10, 10, 10]))
}

#[test]
fn geometry_that_is_refused() {
    for (geometry, place, fault) in [
        (
            json!({ "type": "MultiSurface", "lod": 1, "boundaries": [[[0, 1, 8]]] }),
            ".boundaries",
            "vertex 8; expected one of the 8",
        ),
        (
            json!({ "type": "MultiSurface", "lod": 1, "boundaries": [[0, 1, 2]] }),
            ".boundaries",
            "arrays 2 deep; expected 3",
        ),
        (json!({ "type": "Solid", "lod": 1, "boundaries": [[[0, 1, 2]]] }), ".boundaries", "arrays 3 deep; expected 4"),
        (
            json!({ "type": "MultiSurface", "lod": "fine", "boundaries": [[[0, 1, 2]]] }),
            ".lod",
            "\"fine\"; expected a number",
        ),
        (json!({ "type": "MultiSurface", "lod": -1, "boundaries": [[[0, 1, 2]]] }), ".lod", "-1; expected a number"),
        (json!({ "type": "MultiSurface", "lod": "NaN", "boundaries": [[[0, 1, 2]]] }), ".lod", "\"NaN\"; expected"),
        (
            json!({ "type": "GeometryInstance", "template": 3, "boundaries": [0] }),
            ".template",
            "3; expected one of the 0",
        ),
        (json!({ "type": "GeometryInstance", "boundaries": [0] }), ".template", "none; expected"),
    ] {
        let refused = refusal(&with_geometry(&geometry));
        assert_eq!(refused.place, format!("$.CityObjects[\"a\"].geometry[0]{place}"), "{refused}");
        assert!(refused.fault.contains(fault), "{refused}");
    }
    for boundaries in
        ["[[[0,1,-2]]]", "[[[0,1,2.5]]]", "[[[0,1,4294967296]]]", "[[[0,1,2]],[0,1,2]]", "[[\"0\"]]", "{}"]
    {
        let text = with_geometry(&json!({ "type": "MultiSurface", "lod": 1, "boundaries": "HERE" })).to_string();
        let refused = parse(text.replace("\"HERE\"", boundaries).as_bytes(), "model").unwrap_err();
        assert!(refused.place.starts_with("line 1, column "), "{boundaries}: {refused}");
    }
}

#[test]
fn documents_that_are_refused() {
    let whole = with_geometry(&json!({ "type": "Solid", "lod": "1", "boundaries": [faces(0)] }));
    let changed = |pointer: &str, value: Value| {
        let mut changed = whole.clone();
        *changed.pointer_mut(pointer).unwrap() = value;
        refusal(&changed)
    };
    assert_eq!(changed("/type", json!("FeatureCollection")).place, "$.type");
    assert_eq!(changed("/version", json!("3.0")).place, "$.version");
    assert_eq!(changed("/vertices/6", json!([1e300, 0, 0])).place, "$.vertices[6]");
    assert_eq!(changed("/transform/scale", json!([1e300, 1e300, 1e300])).place, "$.vertices[1]");
    assert!(changed("/CityObjects", json!({})).fault.contains("no face of any object has an area"));
    let flat = json!([{ "type": "MultiSurface", "lod": 0, "boundaries": [[[0, 1, 0]], [[0, 1]], [[]], []] }]);
    assert!(changed("/CityObjects/a/geometry", flat).fault.contains("no face of any object has an area"));
    let text = whole.to_string();
    for (from, to) in [("[0,0,0]", "[0,0,NaN]"), ("[0,0,0]", "[0,0,1e999]"), ("[0,0,0]", "[0,0]")] {
        let refused = parse(text.replacen(from, to, 1).as_bytes(), "model").unwrap_err();
        assert!(refused.place.starts_with("line 1, column "), "{refused}");
    }
    for cut in [0, 1, text.len() / 2, text.len() - 1] {
        assert!(parse(&text.as_bytes()[..cut], "model").is_err());
    }
    let message = opened(&text.replace("\"2.0\"", "\"9.0\"")).unwrap_err();
    assert!(
        message.ends_with("model.city.json: $.version: \"9.0\"; expected \"1.0\", \"1.1\" or \"2.0\""),
        "{message}"
    );
    // Without a transform, as 1.0 allows, vertices are metres.
    let mut plain = whole.clone();
    plain.as_object_mut().unwrap().remove("transform");
    plain["version"] = json!("1.0.3");
    assert_eq!(opened(&plain.to_string()).unwrap().hash(), opened(&text).unwrap().hash());
}

#[test]
fn parents_in_a_circle_and_too_many() {
    let vertices = corners([0, 0, 0], [10, 10, 10]);
    let solid = json!([{ "type": "Solid", "lod": "1", "boundaries": [faces(0)] }]);
    let part = |parent: &str| json!({ "type": "BuildingPart", "parents": [parent], "geometry": solid });
    for objects in [
        json!({ "a": part("a") }),
        json!({ "a": part("b"), "b": part("a") }),
        json!({ "a": part("b"), "b": part("c"), "c": part("b") }),
        json!({ "a": { "type": "Building", "children": ["b"] }, "b": { "type": "Building", "children": ["a"], "geometry": solid } }),
    ] {
        let refused = refusal(&document(&objects, &vertices));
        assert!(refused.place.ends_with(".parents") && refused.fault.contains("in no circle"), "{refused}");
    }
    let chain = |length: usize| -> Value {
        let mut objects = serde_json::Map::new();
        for at in 0..length {
            objects.insert(format!("{at:06}"), part(&format!("{:06}", at + 1)));
        }
        document(&Value::Object(objects), &vertices)
    };
    assert!(refusal(&chain(50_000)).place.contains(".parents"));
    let kept = parse(chain(MAX_PARENTS).to_string().as_bytes(), "model").unwrap();
    assert!(kept.notes.iter().any(|note| note.text.starts_with("1 objects name a parent that is not there")));
}

#[test]
fn nesting_counts_and_amplification() {
    let deep = format!("{}0{}", "[".repeat(100_000), "]".repeat(100_000));
    let text = with_geometry(&json!({ "type": "MultiSurface", "lod": 1, "boundaries": "HERE" })).to_string();
    let refused = parse(text.replace("\"HERE\"", &deep).as_bytes(), "model").unwrap_err();
    assert!(refused.fault.contains("recursion limit"), "{refused}");
    let skipped = text.replace("\"HERE\"", "[]").replacen('{', &format!("{{\"x\": {deep}, "), 1);
    assert!(parse(skipped.as_bytes(), "model").is_err());

    // A ring of more corners than one face may have.
    let ring: Vec<u32> = (0..70_000).map(|at| at % 8).collect();
    let refused = refusal(&with_geometry(&json!({ "type": "MultiSurface", "lod": 1, "boundaries": [[ring]] })));
    assert!(refused.fault.contains("a face of 70000 vertices"), "{refused}");

    // A template of 3000 triangles, instantiated 3000 times.
    let many: Vec<Value> = (0..3000).map(|_| json!([[0, 1, 2]])).collect();
    let instances: Vec<Value> =
        (0..3000).map(|_| json!({ "type": "GeometryInstance", "template": 0, "boundaries": [0] })).collect();
    let mut whole = document(&json!({ "a": { "type": "Building", "geometry": instances } }), &[[0, 0, 0]]);
    whole["geometry-templates"] = json!({
        "templates": [{ "type": "MultiSurface", "lod": "1", "boundaries": many }],
        "vertices-templates": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    });
    assert!(refusal(&whole).fault.contains("expected less"));
}

#[test]
fn extremes_that_are_worlds() {
    // A building too small for 32-bit floats beside one far away, and one as far as is allowed.
    let solid = |start: u32| json!({ "type": "Building", "geometry": [{ "type": "Solid", "lod": "1", "boundaries": [faces(start)] }] });
    for far in [1_000_000, 1_000_000_000_000 - 10] {
        let mut vertices = corners([0, 0, 0], [10, 10, 10]);
        vertices.extend(corners([far, far, 0], [far + 10, far + 10, 10]));
        let world = opened(&document(&json!({ "a": solid(0), "b": solid(8) }), &vertices).to_string()).unwrap();
        assert!(world.summary().leaves >= 1 && world.tree.errors_fall());
    }
    // Everything at one place: many identical objects still end in tiles.
    let objects: serde_json::Map<String, Value> = (0..1000).map(|at| (format!("{at}"), solid(0))).collect();
    let world = opened(&document(&Value::Object(objects), &corners([0, 0, 0], [10, 10, 10])).to_string()).unwrap();
    assert!(world.summary().leaves >= 1000 * 12 / 3072);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_faces_are_a_world_or_refused(
        vertices in prop::collection::vec(prop::array::uniform3(-50_i64..50), 3..24),
        faces in prop::collection::vec((0_usize..4, prop::collection::vec(prop::collection::vec(0_u32..24, 0..9), 1..3)), 1..40),
    ) {
        let count = vertices.len() as u32;
        let mut objects = serde_json::Map::new();
        for (at, (level, rings)) in faces.iter().enumerate() {
            let rings: Vec<Vec<u32>> = rings.iter().map(|ring| ring.iter().map(|corner| corner % count).collect()).collect();
            let kind = if at % 5 == 0 { "TINRelief" } else { "Building" };
            let geometry = json!([{ "type": "MultiSurface", "lod": level, "boundaries": [rings] }]);
            let parents: Vec<String> = if at % 3 == 1 { vec![format!("{}", at - 1)] } else { Vec::new() };
            objects.insert(format!("{at}"), json!({ "type": kind, "parents": parents, "geometry": geometry }));
        }
        match opened(&document(&Value::Object(objects), &vertices).to_string()) {
            Ok(world) => {
                prop_assert!(world.tree.errors_fall() || world.tree.nodes() == 1);
                prop_assert_eq!(world.uris.len(), world.tree.representations());
                prop_assert!(world.ground_height(world.tree.bounds(world.tree.root()).centre()).is_some());
            }
            Err(message) => prop_assert!(message.contains("expected"), "{}", message),
        }
    }
}
