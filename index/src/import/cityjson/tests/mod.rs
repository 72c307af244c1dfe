//! City models written by hand, with areas, errors and levels known in closed form; hostile ones; and real ones.

mod closed_form;
mod hostile;
mod real;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::{Model, parse};
use crate::world::{self, World};

/// Opens a text as a world from a file of its own.
fn opened(text: &str) -> Result<World, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("model.city.json");
    std::fs::write(&file, text).unwrap();
    world::open(&file).map_err(|error| error.to_string())
}

/// A document in metres with these objects and vertices.
fn document(objects: &Value, vertices: &[[i64; 3]]) -> Value {
    json!({
        "type": "CityJSON", "version": "2.0",
        "transform": { "scale": [1.0, 1.0, 1.0], "translate": [0.0, 0.0, 0.0] },
        "CityObjects": objects, "vertices": vertices,
    })
}

fn model(document: &Value) -> Model {
    parse(document.to_string().as_bytes(), "model").unwrap()
}

/// Corners of a box: 0 to 3 its bottom, 4 to 7 its top, both turning left from above.
fn corners([x0, y0, z0]: [i64; 3], [x1, y1, z1]: [i64; 3]) -> Vec<[i64; 3]> {
    [z0, z1].into_iter().flat_map(|z| [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]).collect()
}

/// The sides and the bottom of a box whose corners begin at `start`.
fn walls(start: u32) -> Vec<Value> {
    let faces = [[0, 3, 2, 1], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
    faces.into_iter().map(|face| json!([face.map(|corner| start + corner)])).collect()
}

/// The six faces of a box.
fn faces(start: u32) -> Vec<Value> {
    let mut faces = walls(start);
    faces.push(json!([[start + 4, start + 5, start + 6, start + 7]]));
    faces
}

/// Sum of the areas of an object's triangles at a level, in thousandths.
fn area(model: &Model, object: usize, level: i32) -> f64 {
    let triangles = model.objects[object].levels[&level].iter();
    let corners = triangles.map(|triangle| triangle.map(|corner| model.vertices[corner as usize]));
    corners.map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum()
}

/// A part of the shared data, or `None` (said, and a failure under CI) where it is absent.
fn data(part: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let path = std::env::var_os("FORESIGHT_DATA").map_or(beside, PathBuf::from).join(part);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none_or(|value| value != "true"), "{} is absent", path.display());
    println!("skipped: {} is absent", path.display());
    None
}
