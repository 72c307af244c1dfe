use std::path::Path;

use glam::DVec3;
use meshopt::{encode_index_buffer, encode_index_sequence, encode_vertex_buffer};
use serde_json::{Value, json};

use crate::orthoview::raster::Triangle;
use crate::surface::{Piece, SurfaceSource, Surfaces, open};

/// Puts an asset together: views one after the other in the binary chunk.
#[derive(Default)]
struct Builder {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Builder {
    fn view(&mut self, bytes: &[u8], more: Value) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        self.binary.extend_from_slice(bytes);
        merge(&mut view, more);
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, view: usize, kind: u32, count: usize, shape: &str, more: Value) -> usize {
        let mut accessor = json!({ "bufferView": view, "componentType": kind, "count": count, "type": shape });
        merge(&mut accessor, more);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn floats(&mut self, values: &[f32], shape: &str, components: usize) -> usize {
        let view = self.view(&bytes(values), json!({}));
        self.accessor(view, 5126, values.len() / components, shape, json!({}))
    }

    /// The asset with one mesh of these primitives.
    fn json(&self, primitives: Value, more: Value) -> Value {
        let mut json = json!({
            "asset": { "version": "2.0" },
            "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
            "meshes": [{ "primitives": primitives }],
            "buffers": [{ "byteLength": self.binary.len() }],
            "bufferViews": self.views, "accessors": self.accessors,
        });
        merge(&mut json, more);
        json
    }

    fn glb(&self, json: &Value) -> Vec<u8> {
        let mut text = serde_json::to_vec(json).expect("JSON");
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut binary = self.binary.clone();
        binary.resize(binary.len().next_multiple_of(4), 0);
        let whole = 12 + 8 + text.len() + 8 + binary.len();
        let mut out = b"glTF".to_vec();
        out.extend([2, whole as u32].into_iter().flat_map(u32::to_le_bytes));
        for (kind, chunk) in [(0x4E4F_534A_u32, &text), (0x004E_4942, &binary)] {
            out.extend((chunk.len() as u32).to_le_bytes());
            out.extend(kind.to_le_bytes());
            out.extend(chunk);
        }
        out
    }
}

fn merge(into: &mut Value, more: Value) {
    if let (Value::Object(into), Value::Object(more)) = (into, more) {
        into.extend(more);
    }
}

fn bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The quadrilateral (0, 0) to (2, 1) in the plane of the file's x and y, in the order of a strip.
const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 2.0, 1.0, 0.0];

fn in_folder(files: &[(&str, &[u8])], name: &str) -> Result<(Vec<Surfaces>, Vec<String>), String> {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in files {
        let file = folder.path().join(name);
        std::fs::create_dir_all(file.parent().expect("a folder")).expect("made");
        std::fs::write(file, bytes).expect("written");
    }
    let progress: crate::specification::Progress = std::sync::Arc::new(|_, _| {});
    let source =
        open(folder.path().join(name).to_str().expect("UTF-8"), &progress).map_err(|error| error.to_string())?;
    let identity = source.identity().expect("readable");
    assert_eq!(source.identity().expect("readable"), identity);
    let read = (0..source.pieces()).map(|piece| source.load(piece).map_err(|error| error.to_string()));
    let pieces = read.collect::<Result<Vec<_>, _>>()?;
    let left_out = pieces.iter().flat_map(|piece| piece.left_out.clone()).collect();
    Ok((pieces, left_out))
}

fn loaded(glb: &[u8]) -> (Vec<Triangle>, Vec<String>) {
    let (pieces, left_out) = in_folder(&[("a.glb", glb)], "a.glb").expect("an asset");
    (pieces.into_iter().flat_map(|piece| piece.triangles).collect(), left_out)
}

/// Area vectors, with the file's y up turned to z: the square looks along −y.
fn areas(triangles: &[Triangle]) -> Vec<DVec3> {
    let area = |t: &Triangle| 0.5 * (t.corners[1] - t.corners[0]).cross(t.corners[2] - t.corners[0]);
    triangles.iter().map(area).collect()
}

#[test]
fn strips_fans_and_lists_face_the_same_way() {
    for (mode, order, count) in [
        (4, vec![0_u16, 1, 3, 0, 3, 2], 2),
        (5, vec![0, 1, 2, 3], 2),
        (6, vec![0, 1, 3, 2], 2),
        (5, vec![0, 1, 2, 3, 1], 3),
    ] {
        let mut asset = Builder::default();
        let positions = asset.floats(&SQUARE, "VEC3", 3);
        let indices: Vec<u8> = order.iter().flat_map(|index| index.to_le_bytes()).collect();
        let view = asset.view(&indices, json!({}));
        let indices = asset.accessor(view, 5123, order.len(), "SCALAR", json!({}));
        let json = asset.json(
            json!([{ "attributes": { "POSITION": positions }, "indices": indices, "mode": mode }]),
            json!({ "materials": [{}] }),
        );
        let (triangles, left_out) = loaded(&asset.glb(&json));
        assert_eq!((triangles.len(), left_out.len()), (count, 0));
        for area in &areas(&triangles)[..2] {
            assert!((*area - DVec3::new(0.0, -1.0, 0.0)).length() < 1e-9, "mode {mode}: {area}");
        }
    }
}

#[test]
fn quantised_and_packed_vertices_are_read() {
    // Positions of 16 bits, normalised, colours of 8, coordinates of 16: interleaved in 16 bytes, packed; indices packed.
    let mut vertices: Vec<[u32; 4]> = Vec::new();
    for (x, y) in [(0_u16, 0_u16), (65535, 0), (0, 32768), (65535, 32768)] {
        let position = [u32::from(x) | u32::from(y) << 16, 0];
        vertices.push([position[0], position[1], 0x00FF_8000 | u32::from(x & 0xFF), u32::from(x) | u32::from(y) << 16]);
    }
    let packed = encode_vertex_buffer(&vertices).expect("packed");
    for as_triangles in [true, false] {
        let mut asset = Builder::default();
        let plain = json!({ "byteOffset": 0, "byteLength": 64, "byteStride": 16, "buffer": 1 });
        let extension = |length: usize, offset: usize, stride: usize, count: usize, mode: &str| {
            json!({ "EXT_meshopt_compression": {
                "buffer": 0, "byteOffset": offset, "byteLength": length, "byteStride": stride, "count": count, "mode": mode,
            } })
        };
        let view = asset.view(&packed, plain);
        asset.views[view]["extensions"] = extension(packed.len(), 0, 16, 4, "ATTRIBUTES");
        let order = [0, 1, 2, 2, 1, 3];
        let (indices, mode) = if as_triangles {
            (encode_index_buffer(&order, 4).expect("packed"), "TRIANGLES")
        } else {
            (encode_index_sequence(&order, 4).expect("packed"), "INDICES")
        };
        let offset = asset.binary.len().next_multiple_of(4);
        let second = asset.view(&indices, json!({ "buffer": 1, "byteOffset": 64, "byteLength": 12 }));
        asset.views[second]["extensions"] = extension(indices.len(), offset, 2, 6, mode);
        let positions = asset.accessor(view, 5123, 4, "VEC3", json!({ "normalized": true }));
        let colours = asset.accessor(view, 5121, 4, "VEC3", json!({ "normalized": true, "byteOffset": 8 }));
        let coordinates = asset.accessor(view, 5123, 4, "VEC2", json!({ "normalized": true, "byteOffset": 12 }));
        let indices = asset.accessor(second, 5123, 6, "SCALAR", json!({}));
        let attributes = json!({ "POSITION": positions, "COLOR_0": colours, "TEXCOORD_0": coordinates });
        let json = asset.json(
            json!([{ "attributes": attributes, "indices": indices }]),
            json!({
                "nodes": [{ "mesh": 0, "scale": [2, 2, 2] }],
                "buffers": [{ "byteLength": asset.binary.len() }, { "byteLength": 76, "extensions": { "EXT_meshopt_compression": { "fallback": true } } }],
                "extensionsUsed": ["KHR_mesh_quantization", "EXT_meshopt_compression"],
                "extensionsRequired": ["KHR_mesh_quantization", "EXT_meshopt_compression"],
            }),
        );
        let (triangles, left_out) = loaded(&asset.glb(&json));
        assert_eq!((triangles.len(), left_out), (2, Vec::new()));
        let area: DVec3 = areas(&triangles).into_iter().sum();
        assert!((area - DVec3::new(0.0, -2.0 * 65536.0 / 65535.0, 0.0)).length() < 1e-6, "{area}");
        // Colours are light: 0x80 of it is sRGB 188.
        let corner = triangles.iter().flat_map(|t| t.corners.into_iter().zip(t.tint)).find(|(at, _)| at.x > 1.9);
        assert_eq!(corner.expect("a corner").1, [255, 188, 255]);
        assert!(triangles.iter().flat_map(|t| t.uv).any(|uv| (uv.x - 1.0).abs() < 1e-9 && uv.y == 0.0));
    }
}

#[test]
fn packed_claims_beyond_their_bytes_are_refused() {
    for (count, stride, mode) in [
        (u64::MAX / 2, 16, "ATTRIBUTES"),
        (1 << 40, 4, "TRIANGLES"),
        (4, 18, "ATTRIBUTES"),
        (6, 3, "INDICES"),
        (4, 0, "ATTRIBUTES"),
    ] {
        let mut asset = Builder::default();
        let view = asset.view(&[0xA0; 64], json!({ "byteLength": 64 }));
        asset.views[view]["extensions"] = json!({ "EXT_meshopt_compression": {
            "buffer": 0, "byteLength": 64, "byteStride": stride, "count": count, "mode": mode,
        } });
        let positions = asset.accessor(view, 5126, 4, "VEC3", json!({}));
        let json = asset.json(json!([{ "attributes": { "POSITION": positions } }]), json!({}));
        let (triangles, left_out) = loaded(&asset.glb(&json));
        assert!(triangles.is_empty() && left_out.iter().any(|why| why.contains("view 0: ")), "{left_out:?}");
    }
}

#[test]
fn texture_coordinates_are_transformed() {
    let mut asset = Builder::default();
    let positions = asset.floats(&SQUARE[..9], "VEC3", 3);
    let first = asset.floats(&[9.0; 6], "VEC2", 2);
    let second = asset.floats(&[1.0, 0.0, 0.0, 1.0, 1.0, 1.0], "VEC2", 2);
    let quarter = std::f64::consts::FRAC_PI_2;
    let transform = json!({ "offset": [0.5, 0.25], "rotation": quarter, "scale": [2, 3], "texCoord": 1 });
    let texture = json!({ "index": 0, "extensions": { "KHR_texture_transform": transform } });
    let json = asset.json(
        json!([{ "attributes": { "POSITION": positions, "TEXCOORD_0": first, "TEXCOORD_1": second }, "material": 0 }]),
        json!({
            "materials": [{ "pbrMetallicRoughness": { "baseColorTexture": texture, "baseColorFactor": [0.5, 1, 1, 1] } }],
            "textures": [{ "source": 0 }],
            "images": [{ "uri": "absent.png" }],
        }),
    );
    let (pieces, left_out) = in_folder(&[("a.glb", &asset.glb(&json))], "a.glb").expect("an asset");
    // Scaled, then turned to the left of an image that runs downwards: (x, y) to (y, −x), then moved.
    for (uv, expected) in pieces[0].triangles[0].uv.iter().zip([[0.5, -1.75], [3.5, 0.25], [3.5, -1.75]]) {
        assert!((uv.x - expected[0]).abs() < 1e-9 && (uv.y - expected[1]).abs() < 1e-9, "{uv}");
    }
    assert!(left_out[0].contains("\"absent.png\", which is not there"), "{left_out:?}");
    use crate::orthoview::raster::Surface;
    let colour = pieces[0].materials.colour(pieces[0].triangles[0].material, glam::DVec2::ZERO, 0.0);
    assert_eq!(colour, Some([0.5, 1.0, 1.0]), "a missing texture leaves the base colour");
}

#[test]
fn glossy_materials_and_a_centre() {
    let mut asset = Builder::default();
    let positions = asset.floats(&SQUARE[..9], "VEC3", 3);
    let glossy = json!({ "diffuseFactor": [0.25, 0.5, 0.75, 1], "diffuseTexture": { "index": 0 } });
    let json = asset.json(
        json!([{ "attributes": { "POSITION": positions }, "material": 0 }]),
        json!({
            "materials": [{ "extensions": { "KHR_materials_pbrSpecularGlossiness": glossy } }],
            "textures": [{ "source": 0 }],
            "images": [{ "uri": "absent.png" }],
            "extensionsRequired": ["CESIUM_RTC", "KHR_materials_pbrSpecularGlossiness"],
            "extensions": { "CESIUM_RTC": { "center": [6e6, 1000.25, -3.0] } },
        }),
    );
    let (pieces, left_out) = in_folder(&[("a.glb", &asset.glb(&json))], "a.glb").expect("an asset");
    assert_eq!(pieces[0].materials.materials[0].base, [0.25, 0.5, 0.75]);
    assert_eq!(left_out.len(), 1);
    // (2, 0, 0) of the file.
    assert_eq!(pieces[0].triangles[0].corners[1], DVec3::new(6e6 + 2.0, 1000.25, -3.0));
}

#[test]
fn instances_sparse_elements_and_mirrors() {
    let mut asset = Builder::default();
    let positions = asset.floats(&SQUARE[..9], "VEC3", 3);
    let indices = asset.view(&[2, 0, 0, 0], json!({}));
    let values = asset.view(&bytes(&[0.0, 3.0, 0.0]), json!({}));
    asset.accessors[positions]["sparse"] = json!({
        "count": 1,
        "indices": { "bufferView": indices, "componentType": 5121, "byteOffset": 0 },
        "values": { "bufferView": values, "byteOffset": 0 },
    });
    let moved = asset.floats(&[0.0, 0.0, 0.0, 10.0, 0.0, 0.0], "VEC3", 3);
    let scaled = asset.floats(&[1.0, 1.0, 1.0, -1.0, 2.0, 1.0], "VEC3", 3);
    let node = json!({ "mesh": 0, "extensions": { "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": moved, "SCALE": scaled } } } });
    let json = asset.json(json!([{ "attributes": { "POSITION": positions } }]), json!({ "nodes": [node] }));
    let (triangles, left_out) = loaded(&asset.glb(&json));
    assert!(left_out.is_empty(), "{left_out:?}");
    let found = areas(&triangles);
    assert_eq!(found.len(), 2);
    // The second is mirrored and twice as high, and looks the same way.
    for (area, expected) in found.iter().zip([3.0, 6.0]) {
        assert!((*area - DVec3::new(0.0, -expected, 0.0)).length() < 1e-9, "{area}");
    }
    assert!(triangles[1].corners.iter().all(|c| (8.0..=10.0).contains(&c.x)));
}

#[test]
fn buffers_and_images_beside_the_file_and_inside_it() {
    let mut asset = Builder::default();
    let positions = asset.floats(&SQUARE[..9], "VEC3", 3);
    let mut png = std::io::Cursor::new(Vec::new());
    let pixels = image::RgbImage::from_pixel(1, 1, image::Rgb([255, 0, 0]));
    pixels.write_to(&mut png, image::ImageFormat::Png).expect("into memory");
    let png = png.into_inner();
    use base64::Engine;
    let inline = |bytes: &[u8]| {
        format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
    };
    for (buffer, image) in [("sub/a.bin".to_owned(), "sub/b.png".to_owned()), (inline(&asset.binary), inline(&png))] {
        let json = asset.json(
            json!([{ "attributes": { "POSITION": positions }, "material": 0 }]),
            json!({
                "materials": [{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }],
                "textures": [{ "source": 0 }],
                "images": [{ "uri": image }],
                "buffers": [{ "byteLength": asset.binary.len(), "uri": buffer }],
            }),
        );
        let text = serde_json::to_vec(&json).expect("JSON");
        let files: [(&str, &[u8]); 3] = [("a.gltf", &text), ("sub/a.bin", &asset.binary), ("sub/b.png", &png)];
        let (pieces, left_out) = in_folder(&files, "a.gltf").expect("an asset");
        assert!(left_out.is_empty() && pieces[0].materials.textures[0].is_some(), "{left_out:?}");
        assert_eq!(pieces[0].triangles.len(), 1);
    }
}

#[test]
fn what_cannot_be_read_is_said_with_its_place() {
    let mut asset = Builder::default();
    let positions = asset.floats(&SQUARE[..9], "VEC3", 3);
    let primitive = json!([{ "attributes": { "POSITION": positions } }]);
    let glb = asset.glb(&asset.json(primitive.clone(), json!({})));
    let fails = |bytes: &[u8], part: &str| {
        let message = in_folder(&[("a.glb", bytes)], "a.glb").err().unwrap_or_default();
        assert!(message.contains(part) && message.contains("a.glb"), "{message}; expected {part}");
    };
    fails(&glb[..glb.len() - 1], "byte 8: length");
    fails(&glb[..10], "byte 8");
    let mut long = glb.clone();
    long[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    fails(&long, "byte 12: a chunk of 4294967295 bytes");
    let mut old = glb.clone();
    old[4] = 1;
    fails(&old, "byte 4: glTF version 1");
    let required = json!({ "extensionsRequired": ["KHR_draco_mesh_compression"] });
    fails(&asset.glb(&asset.json(primitive.clone(), required)), "$.extensionsRequired: KHR_draco_mesh_compression");
    let circle = json!({ "nodes": [{ "children": [0] }] });
    fails(&asset.glb(&asset.json(primitive.clone(), circle)), "$.nodes[0]: beneath two nodes or itself");
    fails(&asset.glb(&asset.json(json!([]), json!({}))), "no triangles");
    let points = json!([{ "attributes": { "POSITION": positions }, "mode": 0 }]);
    fails(&asset.glb(&asset.json(points, json!({}))), "no triangles (left out: points, lines or nothing)");
    // Counts that the bytes do not hold.
    asset.accessors[positions]["count"] = json!(1_u64 << 50);
    fails(&asset.glb(&asset.json(primitive.clone(), json!({}))), "claims 375299968947541 triangles");
    asset.accessors[positions]["count"] = json!(300);
    let (triangles, left_out) = loaded(&asset.glb(&asset.json(primitive.clone(), json!({}))));
    assert!(triangles.is_empty() && left_out[0].contains("bytes 0 to 3600 of view 0"), "{left_out:?}");
    // An index that names no vertex.
    asset.accessors[positions]["count"] = json!(3);
    let view = asset.view(&[0, 1, 77], json!({}));
    let indices = asset.accessor(view, 5121, 3, "SCALAR", json!({}));
    let primitive = json!([{ "attributes": { "POSITION": positions }, "indices": indices }]);
    let (triangles, _) = loaded(&asset.glb(&asset.json(primitive, json!({}))));
    assert!(triangles[0].corners[2].is_nan());
    let packed =
        json!([{ "attributes": { "POSITION": positions }, "extensions": { "KHR_draco_mesh_compression": {} } }]);
    let (_, left_out) = loaded(&asset.glb(&asset.json(packed, json!({}))));
    assert!(left_out[0].contains("KHR_draco_mesh_compression, which is not read"), "{left_out:?}");
}

#[test]
fn a_large_mesh_is_cut_into_pieces_that_add_up() {
    let count = 2 * crate::surface::PIECE_TRIANGLES + 5;
    let mut asset = Builder::default();
    let positions = asset.floats(&SQUARE, "VEC3", 3);
    let order: Vec<u8> = (0..count).flat_map(|_| [0, 1, 3]).collect();
    let view = asset.view(&order, json!({}));
    let indices = asset.accessor(view, 5121, 3 * count, "SCALAR", json!({}));
    let json = asset.json(json!([{ "attributes": { "POSITION": positions }, "indices": indices }]), json!({}));
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.glb");
    std::fs::write(&file, asset.glb(&json)).expect("written");
    let source = super::GltfFile::open(&file).expect("an asset");
    assert_eq!(source.pieces(), 3);
    let read = |piece: usize| -> Piece { source.read(piece).expect("readable") };
    assert_eq!((0..3).map(|piece| read(piece).triangles.len()).sum::<usize>(), count);
    assert_eq!(source.name(2), "a.glb: $.meshes[0].primitives[0]");
    assert_ne!(super::GltfFile::open(Path::new(&file)).expect("an asset").identity().expect("readable"), [0; 32]);
}
