//! Binary glTF 2.0 of one triangle mesh: positions as 32-bit floats, indices, one material.

use glam::DVec3;
use serde_json::json;

/// Up to this many vertices, indices are of 16 bits; 65535 restarts a primitive and names no vertex.
const SHORT: usize = u16::MAX as usize;

/// Bytes of the vertex and index buffers as they are uploaded.
pub fn decoded_bytes(vertices: usize, triangles: usize) -> u64 {
    let index = if vertices <= SHORT { 2 } else { 4 };
    vertices as u64 * 12 + triangles as u64 * 3 * index
}

/// A mesh as GLB. Positions are metres relative to `origin`, z up; the file is y up, as glTF wants it: (x, y, z) becomes
/// (x, z, −y), and the origin is the node's translation. Every index must be less than the number of positions.
pub fn encode(origin: DVec3, positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<u8> {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let mut binary = Vec::with_capacity(decoded_bytes(positions.len(), triangles.len()) as usize + 4);
    for &[x, y, z] in positions {
        for (axis, value) in [x, z, -y].into_iter().enumerate() {
            min[axis] = min[axis].min(value);
            max[axis] = max[axis].max(value);
            binary.extend_from_slice(&value.to_le_bytes());
        }
    }
    let vertex_bytes = binary.len();
    let is_short = positions.len() <= SHORT;
    for &index in triangles.iter().flatten() {
        let bytes = index.to_le_bytes();
        binary.extend_from_slice(if is_short { &bytes[..2] } else { &bytes });
    }
    let index_bytes = binary.len() - vertex_bytes;
    binary.resize(binary.len().next_multiple_of(4), 0);
    let json = json!({
        "asset": { "version": "2.0", "generator": "foresight" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "translation": [origin.x, origin.z, -origin.y] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 0 }] }],
        "materials": [{ "pbrMetallicRoughness": { "metallicFactor": 0 }, "doubleSided": true }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": positions.len(), "type": "VEC3", "min": min, "max": max },
            { "bufferView": 1, "componentType": if is_short { 5123 } else { 5125 }, "count": 3 * triangles.len(), "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": vertex_bytes, "target": 34962 },
            { "buffer": 0, "byteOffset": vertex_bytes, "byteLength": index_bytes, "target": 34963 },
        ],
        "buffers": [{ "byteLength": binary.len() }],
    });
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + json.len() + 8 + binary.len();
    let mut bytes = Vec::with_capacity(length);
    bytes.extend_from_slice(b"glTF");
    for word in [2, length as u32, json.len() as u32] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    bytes.extend_from_slice(b"JSON");
    bytes.extend_from_slice(&json);
    bytes.extend_from_slice(&(binary.len() as u32).to_le_bytes());
    bytes.extend_from_slice(b"BIN\0");
    bytes.extend_from_slice(&binary);
    bytes
}

#[cfg(all(test, feature = "tiles3d"))]
mod tests {
    use super::*;
    use crate::import::tiles3d::content_summary;

    #[test]
    fn what_is_encoded_is_read_again() {
        let origin = DVec3::new(2_684_000.0, 1_246_000.0, 450.0);
        let positions = [[0.5, 0.25, 1.0], [10.0, 0.25, 1.0], [10.0, 20.0, 1.0], [0.5, 20.0, 31.0]];
        let bytes = encode(origin, &positions, &[[0, 1, 2], [0, 2, 3]]);
        let summary = content_summary(&bytes).unwrap();
        assert_eq!(summary.decoded_bytes, decoded_bytes(4, 2));
        let bounds = summary.bounds.unwrap();
        assert_eq!(bounds.min, DVec3::new(2_684_000.5, 451.0, -1_246_020.0));
        assert_eq!(bounds.max, DVec3::new(2_684_010.0, 481.0, -1_246_000.25));
        assert_eq!(decoded_bytes(SHORT + 1, 1), 12 * 65536 + 12);
    }
}
