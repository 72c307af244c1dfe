//! Meshes as binary glTF, y up as glTF wants it: (x, y, z) of a world with z up is written as (x, z, −y).

use glam::DVec3;
use serde_json::json;

/// One mesh as a GLB: positions and normals in f32, indices in 16 bits where they fit, else in 32.
pub(super) fn glb(positions: &[DVec3], normals: &[DVec3], triangles: &[[u32; 3]]) -> Vec<u8> {
    let mut binary = Vec::with_capacity(24 * positions.len() + 12 * triangles.len());
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for at in positions {
        let turned = y_up(*at);
        for axis in 0..3 {
            min[axis] = min[axis].min(turned[axis]);
            max[axis] = max[axis].max(turned[axis]);
        }
        turned.iter().for_each(|value| binary.extend_from_slice(&value.to_le_bytes()));
    }
    for normal in normals {
        y_up(*normal).iter().for_each(|value| binary.extend_from_slice(&value.to_le_bytes()));
    }
    let vertex_bytes = 12 * positions.len();
    let indices = triangles.iter().flatten();
    let is_short = positions.len() <= 65_535;
    for &index in indices {
        if is_short {
            binary.extend_from_slice(&(index as u16).to_le_bytes());
        } else {
            binary.extend_from_slice(&index.to_le_bytes());
        }
    }
    let index_bytes = binary.len() - 2 * vertex_bytes;
    binary.resize(binary.len().next_multiple_of(4), 0);
    let json = json!({
        "asset": { "version": "2.0", "generator": "foresight" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 2, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.6, 0.58, 0.52, 1.0], "metallicFactor": 0.0 } }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": positions.len(), "type": "VEC3", "min": min, "max": max },
            { "bufferView": 1, "componentType": 5126, "count": positions.len(), "type": "VEC3" },
            {
                "bufferView": 2, "componentType": if is_short { 5123 } else { 5125 }, "count": 3 * triangles.len(),
                "type": "SCALAR",
            },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": vertex_bytes, "target": 34962 },
            { "buffer": 0, "byteOffset": vertex_bytes, "byteLength": vertex_bytes, "target": 34962 },
            { "buffer": 0, "byteOffset": 2 * vertex_bytes, "byteLength": index_bytes, "target": 34963 },
        ],
        "buffers": [{ "byteLength": binary.len() }],
    });
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + json.len() + 8 + binary.len();
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(b"glTF");
    for word in [2, length, json.len()] {
        bytes.extend_from_slice(&(word as u32).to_le_bytes());
    }
    bytes.extend_from_slice(b"JSON");
    bytes.extend_from_slice(&json);
    bytes.extend_from_slice(&(binary.len() as u32).to_le_bytes());
    bytes.extend_from_slice(b"BIN\0");
    bytes.extend_from_slice(&binary);
    bytes
}

#[expect(clippy::cast_possible_truncation, reason = "the format's own numbers: 8 mm at 100 km")]
fn y_up(at: DVec3) -> [f32; 3] {
    [at.x as f32, at.z as f32, -at.y as f32]
}
