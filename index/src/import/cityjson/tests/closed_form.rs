use foresight_scheduler::lod_tree::{Aabb, NodeId, RepId};
use glam::DVec3;
use serde_json::{Value, json};

use super::{area, corners, document, faces, model, opened, walls};
use crate::world::{Georeference, Severity, World, WorldKind};

/// A box of 10 m at level 1; at level 2 its top is a pyramid of 3 m.
fn house() -> (Value, Vec<[i64; 3]>) {
    let mut vertices = corners([0, 0, 0], [10, 10, 10]);
    vertices.push([5, 5, 13]);
    let mut roofed = walls(0);
    roofed.extend([[4, 5, 8], [5, 6, 8], [6, 7, 8], [7, 4, 8]].map(|face| json!([face])));
    let geometry = json!([
        { "type": "Solid", "lod": "2", "boundaries": [roofed] },
        { "type": "Solid", "lod": "1", "boundaries": [faces(0)] },
    ]);
    (json!({ "house": { "type": "Building", "geometry": geometry } }), vertices)
}

fn errors(world: &World) -> Vec<f64> {
    (0..world.tree.representations() as u32).map(|rep| world.tree.error(RepId(rep))).collect()
}

#[test]
fn two_levels_of_a_house() {
    let (objects, vertices) = house();
    let world = opened(&document(&objects, &vertices).to_string()).unwrap();
    assert_eq!((world.kind, world.name.as_str()), (WorldKind::CityJson, "model"));
    assert_eq!((world.tree.nodes(), world.tree.representations()), (1, 2));
    // The apex is 3 m from the box; the box's top, 5 m from each eave, is 15/√34 = 2.57 m from the roof.
    let errors = errors(&world);
    assert!((3.0..=3.15).contains(&errors[0]) && errors[1] == 0.0, "{errors:?}");
    let decoded = [0, 1].map(|rep| world.tree.decoded_bytes(RepId(rep)));
    assert_eq!(decoded, [8 * 12 + 12 * 6, 9 * 12 + 14 * 6]);
    assert!(world.tree.wire_bytes(RepId(0)) > decoded[0] && world.tree.wire_bytes(RepId(1)) < 1500);
    assert_eq!([0, 1].map(|rep| world.uri(RepId(rep)).into_owned()), ["tiles/r-0.glb", "tiles/r-1.glb"]);
    let bounds = world.tree.bounds(NodeId(0));
    assert_eq!(bounds, Aabb { min: DVec3::ZERO, max: DVec3::new(10.0, 10.0, 13.0) });
    assert_eq!(world.ground_height(DVec3::new(4.0, 4.0, 90.0)), Some(0.0));
    assert_eq!(world.notes.len(), 1);
    assert!(world.notes[0].text.contains("no reference system"));
}

#[test]
fn a_hole_an_inner_shell_and_repeated_corners() {
    let square = |low: i64, high: i64| [[low, low, 0], [high, low, 0], [high, high, 0], [low, high, 0]];
    let mut vertices = [square(0, 10), square(3, 7)].concat();
    vertices.extend(corners([20, 0, 0], [30, 10, 10]));
    vertices.extend(corners([23, 3, 3], [27, 7, 7]));
    let objects = json!({
        // The hole may turn either way; a corner may stand twice, and the first again at the end.
        "a": { "type": "LandUse", "geometry": [
            { "type": "MultiSurface", "lod": 0, "boundaries": [[[0, 1, 2, 3], [4, 5, 6, 7]], [[0, 1]], [[0, 0, 0, 1]]] },
            { "type": "MultiSurface", "lod": 1, "boundaries": [[[0, 1, 1, 2, 3, 0], [7, 6, 5, 4]]] },
        ] },
        "b": { "type": "Building", "geometry": [
            { "type": "Solid", "lod": "1.2", "boundaries": [faces(8), faces(16)] },
        ] },
        "c": { "type": "Building", "geometry": [
            { "type": "MultiSolid", "lod": "1", "boundaries": [[faces(8)], [faces(16)]] },
            { "type": "MultiPoint", "lod": "0", "boundaries": [0, 1] },
            { "type": "Cloud", "lod": "0" },
        ] },
    });
    let model = model(&document(&objects, &vertices));
    for level in [0, 1000] {
        assert!((area(&model, 0, level) - 84.0).abs() < 1e-9, "{}", area(&model, 0, level));
        for triangle in &model.objects[0].levels[&level] {
            let [a, b, c] = triangle.map(|corner| model.vertices[corner as usize]);
            assert!((b - a).cross(c - a).z > 0.0);
        }
    }
    assert!((area(&model, 1, 1200) - 696.0).abs() < 1e-9);
    assert!((area(&model, 2, 1000) - 696.0).abs() < 1e-9);
    let notes: Vec<_> = model.notes.iter().map(|note| (note.severity, note.text.as_str())).collect();
    assert!(notes.contains(&(Severity::Repair, "2 faces without area: left out")), "{notes:?}");
    assert!(notes.iter().any(|(_, text)| text.starts_with("1 geometries of points or lines")), "{notes:?}");
    assert!(notes.iter().any(|(_, text)| text.starts_with("1 geometries of a type that")), "{notes:?}");
    assert_eq!(model.notes[0].place, r#"$.CityObjects["a"].geometry[0]"#);
}

#[test]
fn instances_of_a_template() {
    let instance = |point: u32, matrix: [f64; 16]| json!({ "type": "GeometryInstance", "template": 0, "boundaries": [point], "transformationMatrix": matrix });
    // Doubled and turned from the plane z = 0 into y = 0, then moved 1 up.
    let upright = [2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let plain = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let objects = json!({
        "bush": { "type": "SolitaryVegetationObject", "geometry": [instance(0, plain)] },
        "tree": { "type": "SolitaryVegetationObject", "geometry": [instance(1, upright)] },
    });
    let mut whole = document(&objects, &[[100, 200, 300], [500, 600, 700]]);
    whole["geometry-templates"] = json!({
        "templates": [{ "type": "MultiSurface", "lod": "2.1", "boundaries": [[[0, 1, 2, 3]]] }],
        "vertices-templates": [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [1.5, 1.0, 0.0], [0.0, 1.0, 0.0]],
    });
    let model = model(&whole);
    assert!((area(&model, 0, 2100) - 1.5).abs() < 1e-12);
    assert!((area(&model, 1, 2100) - 6.0).abs() < 1e-12);
    let highest = model.objects[1].levels[&2100].iter().flatten().map(|&corner| model.vertices[corner as usize]);
    let (low, high) =
        highest.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)));
    assert_eq!((low, high), (DVec3::new(500.0, 600.0, 701.0), DVec3::new(503.0, 600.0, 703.0)));
}

#[test]
fn a_sequence_is_the_file_of_the_same_objects() {
    let (objects, vertices) = house();
    let shifted: Vec<[i64; 3]> = vertices.iter().map(|[x, y, z]| [x + 40, y + 5, z + 1]).collect();
    let other = |start: u32| json!({ "type": "Building", "geometry": [{ "type": "Solid", "lod": "1", "boundaries": [faces(start)] }] });
    let together = document(
        &json!({ "house": objects["house"], "shed": other(9) }),
        &[vertices.clone(), shifted.clone()].concat(),
    );
    let header = document(&json!({}), &[]);
    let feature = |id: &str, object: &Value, vertices: &[[i64; 3]]| json!({ "type": "CityJSONFeature", "id": id, "CityObjects": { id: object }, "vertices": vertices });
    let (shed, house) = (feature("shed", &other(0), &shifted), feature("house", &objects["house"], &vertices));
    let sequence = format!("{header}\n{shed}\n\n{house}\r\n");
    let (one, two) = (opened(&together.to_string()).unwrap(), opened(&sequence).unwrap());
    assert_eq!(one.hash(), two.hash());
    let pretty = serde_json::to_string_pretty(&together).unwrap();
    assert_eq!(opened(&pretty).unwrap().hash(), one.hash());

    let bad = json!({ "type": "CityJSONFeature", "CityObjects": { "x": other(2) }, "vertices": vertices });
    let message = opened(&format!("{header}\n{shed}\n{bad}\n")).unwrap_err();
    assert!(message.ends_with(
        r#"model.city.json: line 3, $.CityObjects["x"].geometry[0].boundaries: vertex 9; expected one of the 9 there are"#
    ), "{message}");
    let message = opened(&format!("{header}\n{shed}\n{{\"type\": \n")).unwrap_err();
    assert!(message.contains(": line 3, column "), "{message}");
    let message = opened(&format!("{header}\n{shed}\n{shed}\n")).unwrap_err();
    assert!(
        message.contains(r#"line 3, $.CityObjects["shed"]: an object of this identifier a second time"#),
        "{message}"
    );
}

#[test]
fn a_part_takes_the_place_of_its_building() {
    // The building has a footprint at level 0, its part bodies of 5 and 10 m at levels 1 and 2.
    let mut vertices = corners([0, 0, 0], [10, 10, 5]);
    vertices.extend(corners([0, 0, 0], [10, 10, 10]));
    let solid = |lod: f64, start: u32| json!({ "type": "Solid", "lod": lod, "boundaries": [faces(start)] });
    let footprint = json!([{ "type": "MultiSurface", "lod": "0", "boundaries": [[[0, 1, 2, 3]]] }]);
    let objects = json!({
        "whole": { "type": "Building", "children": ["part"], "geometry": footprint },
        "part": { "type": "BuildingPart", "parents": ["whole"], "geometry": [solid(1.0, 0), solid(2.0, 8)] },
        "group": { "type": "CityObjectGroup", "children": ["whole", "part"] },
    });
    let world = opened(&document(&objects, &vertices).to_string()).unwrap();
    assert_eq!((world.tree.nodes(), world.tree.representations()), (1, 2), "{:?}", world.notes);
    // Levels 1 and 2 cost the same: the worse is of no use. The footprint is 10 m below the roof.
    let errors = errors(&world);
    assert!((10.0..=10.5).contains(&errors[0]) && errors[1] == 0.0, "{errors:?}");
    assert_eq!(world.tree.decoded_bytes(RepId(0)), 4 * 12 + 2 * 6);
    assert_eq!(world.tree.decoded_bytes(RepId(1)), 8 * 12 + 12 * 6);
}

/// A hill of n × n cells of 10 m, and its height at a corner.
fn hill(n: i64) -> (Value, Vec<[i64; 3]>) {
    let height = |x: i64, y: i64| 4 * x * (n - x) / n + 4 * y * (n - y) / n;
    let at = |x: i64, y: i64| y * (n + 1) + x;
    let corners = (0..=n).flat_map(|y| (0..=n).map(move |x| [10 * x, 10 * y, height(x, y)])).collect();
    let cells = (0..n).flat_map(|y| (0..n).map(move |x| (x, y)));
    let triangles: Vec<Value> = cells
        .flat_map(|(x, y)| {
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [json!([[a, b, c]]), json!([[a, c, d]])]
        })
        .collect();
    let geometry = json!([{ "type": "CompositeSurface", "lod": "1", "boundaries": triangles }]);
    (json!({ "hill": { "type": "TINRelief", "geometry": geometry } }), corners)
}

#[test]
fn terrain_is_split_and_simplified() {
    let (objects, vertices) = hill(64);
    let world = opened(&document(&objects, &vertices).to_string()).unwrap();
    let tree = &world.tree;
    let nodes = || (0..tree.nodes() as u32).map(NodeId);
    let leaves: Vec<NodeId> = nodes().filter(|&node| tree.is_leaf(node)).collect();
    // 8192 triangles in tiles of at most 2048.
    assert!((4..=16).contains(&leaves.len()), "{}", leaves.len());
    assert!(tree.errors_fall());
    let finest: u64 =
        leaves.iter().filter_map(|&leaf| tree.own(leaf).next_back()).map(|rep| tree.decoded_bytes(rep)).sum();
    assert!((65 * 65 * 12 + 8192 * 6..66 * 72 * 12 + 8192 * 6).contains(&finest), "{finest}");
    let root = tree.own(tree.root()).next().unwrap();
    assert!(tree.wire_bytes(root) < finest / 2 && tree.error(root) > 0.0 && tree.error(root) < 20.0);
    for node in nodes() {
        for rep in tree.own(node) {
            assert!(tree.wire_bytes(rep) <= 40_000, "{}", tree.wire_bytes(rep));
        }
    }
    // At a corner of the grid, and in the middle of an edge.
    assert_eq!(world.ground_height(DVec3::new(320.0, 160.0, 999.0)), Some(64.0 + 48.0));
    let between = world.ground_height(DVec3::new(5.0, 0.0, 0.0)).unwrap();
    assert!((between - 0.5 * f64::from(4 * 63 / 64)).abs() < 1e-9, "{between}");
    assert_eq!(world.hash(), opened(&document(&objects, &vertices).to_string()).unwrap().hash());
}

#[test]
fn scattered_objects_are_told_apart() {
    let mut vertices = Vec::new();
    let mut objects = serde_json::Map::new();
    for at in 0..20 {
        let (x, y) = (1000 * (at % 5), 1000 * (at / 5));
        vertices.extend(corners([x, y, 0], [x + 10, y + 10, 10]));
        let geometry = json!([{ "type": "Solid", "lod": "1", "boundaries": [faces(8 * at as u32)] }]);
        objects.insert(format!("{at}"), json!({ "type": "Building", "geometry": geometry }));
    }
    let world = opened(&document(&Value::Object(objects), &vertices).to_string()).unwrap();
    let summary = world.summary();
    assert_eq!(summary.leaves, 20);
    assert!(world.tree.errors_fall());
    assert_eq!(summary.bounds, Aabb { min: DVec3::ZERO, max: DVec3::new(4010.0, 3010.0, 10.0) });
}

#[test]
fn a_transform_applied_twice_is_repaired_only_if_proven() {
    let placed = |translate: [f64; 3], extent: [f64; 6], system: &str| {
        let (objects, _) = house();
        let mut vertices = corners([550_000, 6_290_000, 100], [550_010, 6_290_010, 110]);
        vertices.push([550_005, 6_290_005, 113]);
        let mut whole = document(&objects, &vertices);
        whole["transform"]["translate"] = json!(translate);
        whole["metadata"] = json!({ "referenceSystem": system, "geographicalExtent": extent });
        opened(&whole.to_string()).unwrap()
    };
    let utm = "https://www.opengis.net/def/crs/EPSG/0/32734";
    let extent = [550_000.0, 6_290_000.0, 100.0, 550_010.0, 6_290_010.0, 113.0];
    let right = placed([0.0; 3], extent, utm);
    assert_eq!(right.georeference, Some(Georeference::Epsg(32734)));
    assert!(right.notes.is_empty(), "{:?}", right.notes);

    let twice = placed([550_000.0, 6_290_000.0, 100.0], extent, utm);
    assert_eq!(twice.hash(), right.hash());
    let found: Vec<_> = twice.notes.iter().map(|note| (note.severity, note.text.as_str())).collect();
    assert!(found[0].0 == Severity::Trap && found[0].1.contains("the transform is applied twice"), "{found:?}");
    assert!(found[1].0 == Severity::Repair && found[1].1.starts_with("its translation was left out"), "{found:?}");

    // Nothing fits this extent: said, and left as it is.
    let elsewhere = placed([550_000.0, 6_290_000.0, 100.0], [0.0, 0.0, 0.0, 9.0, 9.0, 9.0], utm);
    assert_eq!(elsewhere.tree.bounds(NodeId(0)).min.y, 12_580_000.0);
    assert!(elsewhere.notes[0].text.contains("wholly outside of it"), "{:?}", elsewhere.notes);
    // The extent is so large that the repair proves nothing.
    let vast = [0.0, 0.0, 0.0, 1e6, 1e7, 1e4];
    assert!(placed([550_000.0, 6_290_000.0, 100.0], vast, utm).tree.bounds(NodeId(0)).min.y > 1.2e7);
    // Not a system that is known, none in metres, and nowhere in it.
    for (system, translate, says) in [
        ("https://www.opengis.net/def/crs/EPSG/0/99999", [0.0; 3], "EPSG:99999"),
        ("https://www.opengis.net/def/crs/EPSG/0/4326", [0.0; 3], "EPSG:4326"),
        ("https://example.org/local", [0.0; 3], "https://example.org/local"),
        (utm, [1e9, 0.0, 0.0], "not on the Earth"),
    ] {
        let extent = [-1e12, -1e12, -1e12, 1e12, 1e12, 1e12];
        let world = placed(translate, extent, system);
        assert_eq!(world.georeference, None);
        assert!(world.notes[0].text.contains(says), "{:?}", world.notes);
    }
}
