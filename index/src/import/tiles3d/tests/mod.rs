//! Tilesets written by hand, with results known in closed form; hostile ones; and real ones with known figures.

mod closed_form;
mod hostile;
#[cfg(feature = "http")]
mod http;
mod real;

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::world::{self, World, WorldError};

/// A folder that is removed at the end of the test.
pub(super) struct Scratch(tempfile::TempDir);

impl Scratch {
    pub(super) fn new() -> Scratch {
        Scratch(tempfile::tempdir().unwrap())
    }

    pub(super) fn path(&self) -> &Path {
        self.0.path()
    }

    pub(super) fn put(&self, file: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, bytes).unwrap();
        path
    }

    pub(super) fn tileset(&self, file: &str, root: &Value) -> PathBuf {
        let document = json!({ "asset": { "version": "1.1" }, "geometricError": 100.0, "root": root });
        self.put(file, serde_json::to_vec(&document).unwrap())
    }

    fn open(&self) -> Result<World, WorldError> {
        world::open(self.path())
    }
}

/// A box around everything, 100 m each way.
fn anywhere() -> Value {
    json!({ "box": [0.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 100.0] })
}

/// A tile with one content.
pub(super) fn tile(error: f64, uri: &str, children: &[Value]) -> Value {
    json!({
        "boundingVolume": anywhere(), "geometricError": error, "refine": "REPLACE",
        "content": { "uri": uri }, "children": children,
    })
}

/// A tile without content.
fn empty_tile(children: &[Value]) -> Value {
    json!({ "boundingVolume": anywhere(), "geometricError": 10.0, "refine": "REPLACE", "children": children })
}

/// A GLB of one rectangle, 1 m along x and 2 m along −z in glTF axes: 1 m along x and 2 m along y of the tile, facing
/// up, at the height 0.5. 4 vertices of 12 bytes, 6 indices of 2 bytes, and, if given, an image.
pub(super) fn rectangle(image: Option<&[u8]>) -> Vec<u8> {
    let positions: [[f32; 3]; 4] = [[0.0, 0.5, 0.0], [1.0, 0.5, 0.0], [1.0, 0.5, -2.0], [0.0, 0.5, -2.0]];
    let mut binary: Vec<u8> = positions.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    binary.extend([0_u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    let image_at = binary.len();
    binary.extend(image.unwrap_or_default());
    let mut asset = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0.0, 0.5, -2.0], "max": [1.0, 0.5, 0.0] },
            { "bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR" },
        ],
        "buffers": [{ "byteLength": binary.len() }],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 12 },
        ],
    });
    if image.is_some() {
        let view = json!({ "buffer": 0, "byteOffset": image_at, "byteLength": binary.len() - image_at });
        asset["bufferViews"].as_array_mut().unwrap().push(view);
        asset["images"] = json!([{ "bufferView": 2, "mimeType": "image/png" }]);
        asset["textures"] = json!([{ "source": 0 }, { "source": 0 }]);
    }
    glb(&asset, &binary)
}

fn glb(asset: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = serde_json::to_vec(asset).unwrap();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = 12 + 8 + json.len() + 8 + binary.len();
    let mut bytes = b"glTF\x02\0\0\0".to_vec();
    bytes.extend((length as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json), (b"BIN\0", binary)] {
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(kind);
        bytes.extend(chunk);
    }
    bytes
}

/// A batched model around a GLB, with the feature table given.
fn b3dm(feature_table: &str, glb: &[u8]) -> Vec<u8> {
    let mut bytes = b"b3dm\x01\0\0\0".to_vec();
    for length in [28 + feature_table.len() + glb.len(), feature_table.len(), 0, 0, 0] {
        bytes.extend((length as u32).to_le_bytes());
    }
    bytes.extend(feature_table.as_bytes());
    bytes.extend(glb);
    bytes
}

/// A binary subtree.
fn subtree(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = serde_json::to_vec(json).unwrap();
    text.resize(text.len().next_multiple_of(8), b' ');
    let mut bytes = b"subt\x01\0\0\0".to_vec();
    bytes.extend((text.len() as u64).to_le_bytes());
    bytes.extend((binary.len() as u64).to_le_bytes());
    bytes.extend(text);
    bytes.extend(binary);
    bytes
}

/// The beginning of a PNG of this size, which is all that is looked at.
fn png(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0dIHDR".to_vec();
    bytes.extend(width.to_be_bytes());
    bytes.extend(height.to_be_bytes());
    bytes.extend([8, 6, 0, 0, 0, 0, 0, 0, 0]);
    bytes
}
