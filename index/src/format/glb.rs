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
    framed(&json, &binary)
}

/// One material of a model.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// Metres relative to the model's origin, z up.
    pub positions: &'a [[f32; 3]],
    /// A unit vector a position.
    pub normals: &'a [[f32; 3]],
    /// Texture coordinates, one a position; or none.
    pub uv: &'a [[f32; 2]],
    /// Each index is less than the number of positions; counter-clockwise from the front.
    pub triangles: &'a [[u32; 3]],
    /// Linear light, multiplied with the texture.
    pub colour: [f32; 3],
    /// Which of the model's images, repeated beyond its borders.
    pub texture: Option<usize>,
}

/// A model of several materials as GLB, with the images (PNG) inside. Parts without triangles are left out.
pub fn encode_model(origin: DVec3, parts: &[Part<'_>], images: &[&[u8]]) -> Vec<u8> {
    let mut binary: Vec<u8> = Vec::new();
    let (mut views, mut accessors, mut primitives, mut materials) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut view = |bytes: &[u8], target: Option<u32>, views: &mut Vec<serde_json::Value>| {
        binary.resize(binary.len().next_multiple_of(4), 0);
        let mut json = json!({ "buffer": 0, "byteOffset": binary.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            json["target"] = json!(target);
        }
        binary.extend_from_slice(bytes);
        views.push(json);
        views.len() - 1
    };
    let upright = |vectors: &[[f32; 3]]| vectors.iter().map(|&[x, y, z]| [x, z, -y]).collect::<Vec<[f32; 3]>>();
    let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    for part in parts.iter().filter(|part| !part.triangles.is_empty()) {
        let count = part.positions.len();
        let positions = upright(part.positions);
        let bound = |start: f32, pick: fn(f32, f32) -> f32| {
            positions.iter().fold([start; 3], |best, at| std::array::from_fn(|axis| pick(best[axis], at[axis])))
        };
        let mut accessor = |view: usize, kind: u32, count: usize, shape: &str, bounds: bool| {
            let mut json = json!({ "bufferView": view, "componentType": kind, "count": count, "type": shape });
            if bounds {
                json["min"] = json!(bound(f32::INFINITY, f32::min));
                json["max"] = json!(bound(f32::NEG_INFINITY, f32::max));
            }
            accessors.push(json);
            accessors.len() - 1
        };
        let at = view(&floats(positions.as_flattened()), Some(34962), &mut views);
        let mut attributes = json!({ "POSITION": accessor(at, 5126, count, "VEC3", true) });
        if !part.normals.is_empty() {
            let at = view(&floats(upright(part.normals).as_flattened()), Some(34962), &mut views);
            attributes["NORMAL"] = json!(accessor(at, 5126, count, "VEC3", false));
        }
        if !part.uv.is_empty() {
            let at = view(&floats(part.uv.as_flattened()), Some(34962), &mut views);
            attributes["TEXCOORD_0"] = json!(accessor(at, 5126, count, "VEC2", false));
        }
        let is_short = count <= SHORT;
        let bytes: Vec<u8> = part
            .triangles
            .iter()
            .flatten()
            .flat_map(|index| index.to_le_bytes().into_iter().take(if is_short { 2 } else { 4 }))
            .collect();
        let at = view(&bytes, Some(34963), &mut views);
        let kind = if is_short { 5123 } else { 5125 };
        let indices = accessor(at, kind, 3 * part.triangles.len(), "SCALAR", false);
        let [r, g, b] = part.colour;
        let mut surface = json!({ "metallicFactor": 0, "roughnessFactor": 1, "baseColorFactor": [r, g, b, 1.0] });
        if let Some(texture) = part.texture {
            surface["baseColorTexture"] = json!({ "index": texture });
        }
        primitives.push(json!({ "attributes": attributes, "indices": indices, "material": materials.len() }));
        materials.push(json!({ "pbrMetallicRoughness": surface }));
    }
    let mut json = json!({
        "asset": { "version": "2.0", "generator": "foresight" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "translation": [origin.x, origin.z, -origin.y] }],
        "meshes": [{ "primitives": primitives }],
        "materials": materials,
    });
    if !images.is_empty() {
        let stored =
            images.iter().map(|image| json!({ "bufferView": view(image, None, &mut views), "mimeType": "image/png" }));
        json["images"] = stored.collect();
        json["textures"] = (0..images.len()).map(|source| json!({ "source": source })).collect();
    }
    binary.resize(binary.len().next_multiple_of(4), 0);
    json["accessors"] = json!(accessors);
    json["bufferViews"] = json!(views);
    json["buffers"] = json!([{ "byteLength": binary.len() }]);
    framed(&json, &binary)
}

/// The two chunks of a GLB; the binary's length is a multiple of 4.
pub(super) fn framed(json: &serde_json::Value, binary: &[u8]) -> Vec<u8> {
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
    bytes.extend_from_slice(binary);
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
