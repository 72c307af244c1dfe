//! Binary glTF 2.0 of one triangle mesh: positions and normals as 32-bit floats, indices, one material.

use glam::DVec3;
use serde_json::json;

/// Up to this many vertices, indices are of 16 bits; 65535 restarts a primitive and names no vertex.
const SHORT: usize = u16::MAX as usize;

/// Bytes of the vertex and index buffers as they are uploaded.
pub fn decoded_bytes(vertices: usize, triangles: usize) -> u64 {
    let index = if vertices <= SHORT { 2 } else { 4 };
    vertices as u64 * 12 + triangles as u64 * 3 * index
}

/// A mesh to encode, z up.
#[derive(Clone, Copy, Debug)]
pub struct Mesh<'a> {
    /// Where the positions' origin is, metres: the node's translation; none for the world's own.
    pub origin: Option<DVec3>,
    /// Metres relative to the origin.
    pub positions: &'a [[f32; 3]],
    /// A unit vector a position, or none at all: then surfaces are seen from both sides.
    pub normals: &'a [[f32; 3]],
    /// Each index is less than the number of positions.
    pub triangles: &'a [[u32; 3]],
}

/// Positions or normals as a file holds them: 8 mm at 100 km.
#[expect(clippy::cast_possible_truncation, reason = "the format's own numbers")]
pub fn narrowed(vectors: &[DVec3]) -> Vec<[f32; 3]> {
    vectors.iter().map(|at| [at.x as f32, at.y as f32, at.z as f32]).collect()
}

/// A mesh as GLB. The file is y up, as glTF wants it: (x, y, z) becomes (x, z, −y).
pub fn encode(mesh: &Mesh<'_>) -> Vec<u8> {
    let Mesh { origin, positions, normals, triangles } = *mesh;
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let mut binary = Vec::with_capacity(decoded_bytes(positions.len() + normals.len(), triangles.len()) as usize + 4);
    for &[x, y, z] in positions {
        for (axis, value) in [x, z, -y].into_iter().enumerate() {
            min[axis] = min[axis].min(value);
            max[axis] = max[axis].max(value);
            binary.extend_from_slice(&value.to_le_bytes());
        }
    }
    for &[x, y, z] in normals {
        [x, z, -y].iter().for_each(|value| binary.extend_from_slice(&value.to_le_bytes()));
    }
    let is_short = positions.len() <= SHORT;
    let vertex_bytes = binary.len();
    for &index in triangles.iter().flatten() {
        let bytes = index.to_le_bytes();
        binary.extend_from_slice(if is_short { &bytes[..2] } else { &bytes });
    }
    let index_bytes = binary.len() - vertex_bytes;
    binary.resize(binary.len().next_multiple_of(4), 0);

    let mut node = json!({ "mesh": 0 });
    if let Some(origin) = origin {
        node["translation"] = json!([origin.x, origin.z, -origin.y]);
    }
    let mut attributes = json!({ "POSITION": 0 });
    let mut material = json!({ "pbrMetallicRoughness": { "metallicFactor": 0 } });
    let mut views = vec![json!({ "buffer": 0, "byteLength": 12 * positions.len(), "target": 34962 })];
    let mut accessors = vec![
        json!({ "bufferView": 0, "componentType": 5126, "count": positions.len(), "type": "VEC3", "min": min, "max": max }),
    ];
    if normals.is_empty() {
        material["doubleSided"] = json!(true);
    } else {
        material["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.6, 0.58, 0.52, 1.0]);
        attributes["NORMAL"] = json!(1);
        let (offset, length) = (12 * positions.len(), 12 * normals.len());
        views.push(json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": 34962 }));
        accessors.push(json!({ "bufferView": 1, "componentType": 5126, "count": normals.len(), "type": "VEC3" }));
    }
    let (indices, count) = (views.len(), 3 * triangles.len());
    views.push(json!({ "buffer": 0, "byteOffset": vertex_bytes, "byteLength": index_bytes, "target": 34963 }));
    let component = if is_short { 5123 } else { 5125 };
    accessors.push(json!({ "bufferView": indices, "componentType": component, "count": count, "type": "SCALAR" }));
    let json = json!({
        "asset": { "version": "2.0", "generator": "foresight" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [node],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
        "materials": [material],
        "accessors": accessors,
        "bufferViews": views,
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
        let (normals, triangles) = (&[][..], &[[0, 1, 2], [0, 2, 3]][..]);
        let bytes = encode(&Mesh { origin: Some(origin), positions: &positions, normals, triangles });
        let summary = content_summary(&bytes).unwrap();
        assert_eq!(summary.decoded_bytes, decoded_bytes(4, 2));
        let bounds = summary.bounds.unwrap();
        assert_eq!(bounds.min, DVec3::new(2_684_000.5, 451.0, -1_246_020.0));
        assert_eq!(bounds.max, DVec3::new(2_684_010.0, 481.0, -1_246_000.25));
        assert_eq!(decoded_bytes(SHORT + 1, 1), 12 * 65536 + 12);
    }
}
