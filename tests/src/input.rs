//! Small worlds, paths and links that a test writes for itself.

use std::path::Path;

/// A camera that moves 10 m in 4 s, in TUM format (`t x y z qx qy qz qw`).
pub const PATH: &str = "# t x y z qx qy qz qw\n0 0 0 0 0 0 0 1\n1 2 0 0 0 0 0 1\n2 5 0 0 0 0 0 1\n4 10 0 0 0 0 0 1\n";

/// A constant link, as written on the command line.
pub const LINK: &str = "constant:5Mbit,40ms";

/// A 3D tileset: a root of coarse content and two finer children under `REPLACE`, with these content URIs.
pub fn tileset(root: &str, children: [&str; 2]) -> String {
    format!(
        r#"{{
  "asset": {{ "version": "1.1" }},
  "geometricError": 40,
  "root": {{
    "boundingVolume": {{ "box": [0, 0, 0, 50, 0, 0, 0, 50, 0, 0, 0, 10] }},
    "geometricError": 10,
    "refine": "REPLACE",
    "content": {{ "uri": "{root}" }},
    "children": [
      {{
        "boundingVolume": {{ "box": [-25, 0, 0, 25, 0, 0, 0, 50, 0, 0, 0, 10] }},
        "geometricError": 0,
        "content": {{ "uri": "{}" }}
      }},
      {{
        "boundingVolume": {{ "box": [25, 0, 0, 25, 0, 0, 0, 50, 0, 0, 0, 10] }},
        "geometricError": 0,
        "content": {{ "uri": "{}" }}
      }}
    ]
  }}
}}
"#,
        children[0], children[1]
    )
}

/// A binary glTF of one triangle that spans the given bounds, metres.
pub fn glb(min: [f32; 3], max: [f32; 3]) -> Vec<u8> {
    let corners = [min, [max[0], min[1], max[2]], max];
    let positions: Vec<u8> = corners.iter().flatten().flat_map(|coordinate| coordinate.to_le_bytes()).collect();
    let mut json = format!(
        concat!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"#,
            r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],"#,
            r#""accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":{:?},"max":{:?}}}],"#,
            r#""bufferViews":[{{"buffer":0,"byteLength":{}}}],"buffers":[{{"byteLength":{}}}]}}"#
        ),
        min,
        max,
        positions.len(),
        positions.len()
    )
    .into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut bytes = Vec::new();
    bytes.extend_from_slice(b"glTF");
    for word in [2, 12 + 8 + json.len() + 8 + positions.len(), json.len()] {
        bytes.extend_from_slice(&u32::try_from(word).expect("a triangle is small").to_le_bytes());
    }
    bytes.extend_from_slice(b"JSON");
    bytes.extend_from_slice(&json);
    bytes.extend_from_slice(&u32::try_from(positions.len()).expect("a triangle is small").to_le_bytes());
    bytes.extend_from_slice(b"BIN\0");
    bytes.extend_from_slice(&positions);
    bytes
}

/// The binary glTF with an unknown chunk of zeros at its end, which readers skip, so that it has this many bytes; as it is
/// if that is less than a chunk's 8 bytes more. The chunk's length need not divide by 4.
pub fn padded_glb(mut glb: Vec<u8>, bytes: usize) -> Vec<u8> {
    let Some(zeros) = bytes.checked_sub(glb.len() + 8) else { return glb };
    for word in [zeros as u32, u32::from_le_bytes(*b"PADD")] {
        glb.extend_from_slice(&word.to_le_bytes());
    }
    glb.resize(bytes, 0);
    glb[8..12].copy_from_slice(&(bytes as u32).to_le_bytes());
    glb
}

/// Writes `path.txt`, and `tileset.json` with the content of its three tiles, into a folder.
pub fn write_world(folder: &Path) {
    write(folder, "path.txt", PATH);
    write(folder, "tileset.json", tileset("root.glb", ["west.glb", "east.glb"]));
    write(folder, "root.glb", glb([-50.0, -50.0, -10.0], [50.0, 50.0, 10.0]));
    write(folder, "west.glb", glb([-50.0, -50.0, -10.0], [0.0, 50.0, 10.0]));
    write(folder, "east.glb", glb([0.0, -50.0, -10.0], [50.0, 50.0, 10.0]));
}

/// Writes one file.
///
/// # Panics
/// If it cannot be written.
pub fn write(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    std::fs::write(folder.join(name), bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
}
