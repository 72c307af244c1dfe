//! Binary glTF 2.0 of a mesh on a lattice: positions, normals and texture coordinates as small integers
//! (`KHR_mesh_quantization`), vertices and indices compressed (`EXT_meshopt_compression`, vertex codec version 0 and index
//! codec version 1, as the extension has them), textures in the file. Stock viewers read it.
//!
//! Where the lattice lies is the node's translation. glTF's readers hold numbers of a node in 32 or 64 bits; it is split over
//! two nodes into numbers that 32 bits hold exactly, so that a reader that multiplies matrices in 64 bits is off by no more than
//! 2⁻⁴⁸ of the distance from the world's origin.

use glam::{DVec2, DVec3};
use meshopt::{encode_filter_oct, encode_index_buffer, encode_vertex_buffer_level};
use serde_json::{Map, Value, json};

use super::glb::framed;
use crate::orthoview::texture::linear;

/// Up to this many vertices a part, indices are of 16 bits; 65535 restarts a primitive and names no vertex.
const SHORT: usize = u16::MAX as usize;
/// Effort of the vertex codec, 0 to 3.
const EFFORT: i32 = 3;

/// How vertices and indices are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// 32-bit floats: what every reader of glTF 2.0 takes.
    Floats,
    /// 16- and 8-bit integers; readers need `KHR_mesh_quantization`.
    Quantised,
    /// The same, compressed; readers need `EXT_meshopt_compression` too.
    Compressed,
}

/// Triangles with one material.
#[derive(Clone, Debug, Default)]
pub struct Part {
    /// Steps from the model's least corner along x, y, z (z up).
    pub positions: Vec<[u16; 3]>,
    /// A unit vector a position (z up), or none.
    pub normals: Vec<[f32; 3]>,
    /// Shares of the texture, 65535 for all of it, one a position; or none.
    pub uv: Vec<[u16; 2]>,
    /// sRGB, multiplied with everything else, one a position; or none.
    pub tints: Vec<[u8; 3]>,
    /// Each index is less than the number of positions; counter-clockwise from the front.
    pub triangles: Vec<[u32; 3]>,
    /// Linear light, multiplied with the texture.
    pub base: [f32; 3],
    /// Alpha beneath this is a hole; 0 for none.
    pub cutoff: f32,
    /// Whether backs are seen.
    pub two_sided: bool,
    /// Which of the model's pictures.
    pub picture: Option<usize>,
    /// Texture coordinates are offset + scale × share, of a texture that repeats; without, shares are the coordinates and
    /// the picture is not repeated.
    pub repeat: Option<(DVec2, DVec2)>,
}

/// What is written.
#[derive(Clone, Debug)]
pub struct Model<'a> {
    /// The lattice's least corner, metres in the world, z up.
    pub origin: DVec3,
    /// Metres to a step.
    pub step: f32,
    /// Steps that no position exceeds along y.
    pub steps: u16,
    /// Without normals, materials are shown as they are, without light (`KHR_materials_unlit`).
    pub parts: &'a [Part],
    /// Files, and whether each is PNG rather than JPEG.
    pub pictures: &'a [(Vec<u8>, bool)],
    /// How vertices and indices are stored.
    pub packing: Packing,
}

impl Model<'_> {
    /// The node's translation, y up, as the sum of two vectors that 32 bits hold.
    #[expect(clippy::cast_possible_truncation, reason = "the remainder is kept")]
    fn translation(&self) -> [[f32; 3]; 2] {
        let DVec3 { x, y, z } = self.origin;
        // y is turned round, so that a whole number of steps stays one.
        let at = [x, z, -(y + f64::from(self.step) * f64::from(self.steps))];
        let near = at.map(|v| v as f32);
        [near, std::array::from_fn(|i| (at[i] - f64::from(near[i])) as f32)]
    }

    /// How far a reader that works in 64 bits places the model from where it is, metres.
    pub fn misplacement(&self) -> f64 {
        let [near, rest] = self.translation().map(|v| DVec3::from_array(v.map(f64::from)));
        let at = near + rest;
        let span = f64::from(self.step) * f64::from(self.steps);
        (DVec3::new(at.x, -at.z - span, at.y) - self.origin).length()
    }

    fn upright(&self, [x, y, z]: [u16; 3]) -> [u16; 3] {
        [x, z, self.steps.saturating_sub(y)]
    }
}

/// Bytes of the vertex and index buffers as they are uploaded, strides of four bytes included.
pub fn decoded_bytes(model: &Model<'_>) -> u64 {
    let widths = if model.packing == Packing::Floats { (12, 12, 8) } else { (8, 4, 4) };
    let index = if model.parts.iter().all(|part| part.positions.len() <= SHORT) { 2 } else { 4 };
    let part = |part: &Part| {
        let (position, normal, uv) = widths;
        (part.positions.len() * position + part.normals.len() * normal + part.uv.len() * uv + part.tints.len() * 8)
            as u64
            + 3 * index * part.triangles.len() as u64
    };
    model.parts.iter().map(part).sum()
}

/// The model as GLB; parts without triangles are left out. The file is y up, as glTF wants it: (x, y, z) becomes (x, z, −y).
///
/// # Errors
/// Those of the compressor: no more memory.
pub fn encode(model: &Model<'_>) -> Result<Vec<u8>, meshopt::Error> {
    let parts: Vec<&Part> = model.parts.iter().filter(|part| !part.triangles.is_empty()).collect();
    let mut file = File { packing: model.packing, ..File::default() };
    let count = |of: fn(&Part) -> usize| parts.iter().map(|part| of(part)).collect::<Vec<usize>>();
    let (positions, normals, uv) = (count(|p| p.positions.len()), count(|p| p.normals.len()), count(|p| p.uv.len()));
    let tints = count(|p| p.tints.len());

    let upright: Vec<[u16; 3]> = parts.iter().flat_map(|p| p.positions.iter().map(|&at| model.upright(at))).collect();
    let (mut bounds, mut first) = (Vec::new(), 0);
    for &count in &positions {
        let of = &upright[first..first + count];
        let fold = |pick: fn(u16, u16) -> u16, start: u16| {
            of.iter().fold([start; 3], |best, at| std::array::from_fn(|i| pick(best[i], at[i])))
        };
        bounds.push((fold(u16::min, u16::MAX), fold(u16::max, 0)));
        first += count;
    }
    let scaled = |at: [u16; 3]| at.map(|v| f32::from(v) * model.step);
    let at_positions = if model.packing == Packing::Floats {
        let values: Vec<[f32; 3]> = upright.iter().map(|&at| scaled(at)).collect();
        file.floats(values.as_flattened(), 3)
    } else {
        let padded: Vec<[u16; 4]> = upright.iter().map(|&[x, y, z]| [x, y, z, 0]).collect();
        file.vertices(&padded, &bytes_of(padded.as_flattened(), u16::to_le_bytes), "NONE")?
    };
    let upright: Vec<[f32; 3]> = parts.iter().flat_map(|p| p.normals.iter().map(|&[x, y, z]| [x, z, -y])).collect();
    let at_normals = match (upright.is_empty(), model.packing) {
        (true, _) => None,
        (_, Packing::Floats) => Some(file.floats(upright.as_flattened(), 3)),
        (_, Packing::Quantised) => {
            let narrowed: Vec<[i8; 4]> = upright.iter().map(|&[x, y, z]| [byte(x), byte(y), byte(z), 0]).collect();
            Some(file.vertices(&narrowed, &bytes_of(narrowed.as_flattened(), i8::to_le_bytes), "NONE")?)
        }
        (_, Packing::Compressed) => {
            let padded: Vec<[f32; 4]> = upright.iter().map(|&[x, y, z]| [x, y, z, 0.0]).collect();
            let octahedral: Vec<[i8; 4]> = encode_filter_oct(&padded, 8);
            Some(file.vertices(&octahedral, &bytes_of(octahedral.as_flattened(), i8::to_le_bytes), "OCTAHEDRAL")?)
        }
    };
    let shares: Vec<[u16; 2]> = parts.iter().flat_map(|p| p.uv.iter().copied()).collect();
    let at_uv = match (shares.is_empty(), model.packing) {
        (true, _) => None,
        (_, Packing::Floats) => {
            let values: Vec<f32> = shares.as_flattened().iter().map(|&s| f32::from(s) / 65535.0).collect();
            Some(file.floats(&values, 2))
        }
        _ => Some(file.vertices(&shares, &bytes_of(shares.as_flattened(), u16::to_le_bytes), "NONE")?),
    };
    // Linear light, in 16 bits so that the dark has steps.
    let lights: Vec<[u16; 4]> = parts.iter().flat_map(|p| p.tints.iter().map(|tint| light(*tint))).collect();
    let at_tints = match lights.is_empty() {
        true => None,
        false => Some(file.vertices(&lights, &bytes_of(lights.as_flattened(), u16::to_le_bytes), "NONE")?),
    };
    let is_short = positions.iter().all(|&count| count <= SHORT);
    let indices: Vec<u32> = parts.iter().flat_map(|p| p.triangles.as_flattened().iter().copied()).collect();
    let most = positions.iter().copied().max().unwrap_or(0);
    let at_indices = file.indices(&indices, is_short, most)?;

    let mut starts = [0; 5];
    let mut primitives = Vec::new();
    let mut materials = Vec::new();
    for (i, part) in parts.iter().enumerate() {
        let (low, high) = bounds[i];
        let is_float = model.packing == Packing::Floats;
        let mut accessor =
            file.accessor(at_positions, starts[0], if is_float { 5126 } else { 5123 }, positions[i], "VEC3");
        (accessor["min"], accessor["max"]) =
            if is_float { (json!(scaled(low)), json!(scaled(high))) } else { (json!(low), json!(high)) };
        let mut attributes = json!({ "POSITION": file.add(accessor) });
        if let Some(view) = at_normals.filter(|_| normals[i] > 0) {
            let mut accessor = file.accessor(view, starts[1], if is_float { 5126 } else { 5120 }, normals[i], "VEC3");
            if !is_float {
                accessor["normalized"] = json!(true);
            }
            attributes["NORMAL"] = file.add(accessor);
        }
        if let Some(view) = at_uv.filter(|_| uv[i] > 0) {
            let mut accessor = file.accessor(view, starts[2], if is_float { 5126 } else { 5123 }, uv[i], "VEC2");
            if !is_float {
                accessor["normalized"] = json!(true);
            }
            attributes["TEXCOORD_0"] = file.add(accessor);
        }
        if let Some(view) = at_tints.filter(|_| tints[i] > 0) {
            let mut accessor = file.accessor(view, starts[4], 5123, tints[i], "VEC4");
            accessor["normalized"] = json!(true);
            attributes["COLOR_0"] = file.add(accessor);
        }
        let kind = if is_short { 5123 } else { 5125 };
        let accessor = file.accessor(at_indices, starts[3], kind, 3 * part.triangles.len(), "SCALAR");
        let indices = file.add(accessor);
        primitives.push(json!({ "attributes": attributes, "indices": indices, "material": i }));
        materials.push(material(part));
        for (start, count) in
            starts.iter_mut().zip([positions[i], normals[i], uv[i], 3 * part.triangles.len(), tints[i]])
        {
            *start += count;
        }
    }
    let mut json = json!({
        "asset": { "version": "2.0", "generator": "foresight" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": nodes(model),
        "meshes": [{ "primitives": primitives }],
        "materials": materials,
    });
    if !model.pictures.is_empty() {
        let samplers = json!([{ "wrapS": 33071, "wrapT": 33071 }, {}]);
        let repeats = |picture: usize| parts.iter().any(|p| p.picture == Some(picture) && p.repeat.is_some());
        json["samplers"] = samplers;
        json["textures"] = (0..model.pictures.len())
            .map(|source| json!({ "source": source, "sampler": usize::from(repeats(source)) }))
            .collect();
        let images = model.pictures.iter().map(|(bytes, is_png)| {
            let view = file.image(bytes);
            json!({ "bufferView": view, "mimeType": if *is_png { "image/png" } else { "image/jpeg" } })
        });
        json["images"] = images.collect();
    }
    let is_lit = !normals.iter().all(|&count| count == 0);
    let repeats = parts.iter().any(|part| part.picture.is_some() && part.repeat.is_some());
    let mut required = Vec::new();
    if model.packing != Packing::Floats {
        required.push("KHR_mesh_quantization");
    }
    if model.packing == Packing::Compressed {
        required.push("EXT_meshopt_compression");
    }
    if repeats {
        required.push("KHR_texture_transform");
    }
    let mut used = required.clone();
    if !is_lit {
        used.push("KHR_materials_unlit");
    }
    if !used.is_empty() {
        json["extensionsUsed"] = json!(used);
    }
    if !required.is_empty() {
        json["extensionsRequired"] = json!(required);
    }
    Ok(file.finish(json))
}

fn nodes(model: &Model<'_>) -> Value {
    let [near, rest] = model.translation();
    let wide = |v: [f32; 3]| v.map(f64::from);
    let mut drawn = json!({ "mesh": 0 });
    if model.packing != Packing::Floats {
        drawn["scale"] = json!(vec![f64::from(model.step); 3]);
    }
    if rest == [0.0; 3] {
        drawn["translation"] = json!(wide(near));
        return json!([drawn]);
    }
    drawn["translation"] = json!(wide(rest));
    json!([{ "translation": wide(near), "children": [1] }, drawn])
}

fn material(part: &Part) -> Value {
    let [r, g, b] = part.base.map(f64::from);
    let mut surface = json!({ "metallicFactor": 0, "roughnessFactor": 1, "baseColorFactor": [r, g, b, 1.0] });
    if let Some(picture) = part.picture {
        let mut texture = json!({ "index": picture });
        if let Some((offset, scale)) = part.repeat {
            let transform = json!({ "offset": offset.to_array(), "scale": scale.to_array() });
            texture["extensions"] = json!({ "KHR_texture_transform": transform });
        }
        surface["baseColorTexture"] = texture;
    }
    let mut material = json!({ "pbrMetallicRoughness": surface });
    if part.two_sided {
        material["doubleSided"] = json!(true);
    }
    if part.cutoff > 0.0 {
        material["alphaMode"] = json!("MASK");
        material["alphaCutoff"] = json!(f64::from(part.cutoff));
    }
    if part.normals.is_empty() {
        material["extensions"] = json!({ "KHR_materials_unlit": {} });
    }
    material
}

/// A tint as COLOR_0 has it.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1")]
fn light(srgb: [u8; 3]) -> [u16; 4] {
    let [r, g, b] = srgb.map(|byte| (f64::from(linear(byte)) * 65535.0).round() as u16);
    [r, g, b, u16::MAX]
}

/// A component of a unit vector as a signed byte.
#[expect(clippy::cast_possible_truncation, reason = "clamped")]
fn byte(v: f32) -> i8 {
    (v * 127.0).round().clamp(-127.0, 127.0) as i8
}

fn bytes_of<T: Copy, const N: usize>(values: &[T], bytes: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&value| bytes(value)).collect()
}

/// A file as it grows.
struct File {
    packing: Packing,
    binary: Vec<u8>,
    /// Bytes of what the compressed views stand for.
    unpacked: usize,
    views: Vec<Value>,
    /// Bytes of an element of each view.
    strides: Vec<usize>,
    accessors: Vec<Value>,
}

impl Default for File {
    fn default() -> File {
        let (views, strides, accessors) = (Vec::new(), Vec::new(), Vec::new());
        File { packing: Packing::Floats, binary: Vec::new(), unpacked: 0, views, strides, accessors }
    }
}

impl File {
    /// Adds bytes at a multiple of four; returns where they are.
    fn put(&mut self, bytes: &[u8]) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.binary.extend_from_slice(bytes);
        self.binary.len() - bytes.len()
    }

    fn view(&mut self, view: Value, stride: usize) -> usize {
        self.views.push(view);
        self.strides.push(stride);
        self.views.len() - 1
    }

    fn plain(&mut self, bytes: &[u8], stride: usize, target: u32) -> usize {
        let offset = self.put(bytes);
        let mut view = json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len(), "target": target });
        if target == 34962 {
            view["byteStride"] = json!(stride);
        }
        self.view(view, stride)
    }

    /// A view of the second buffer, which is there only for readers that look at views without the extension.
    fn compressed(
        &mut self,
        packed: &[u8],
        count: usize,
        stride: usize,
        mode: &str,
        filter: &str,
        target: u32,
    ) -> usize {
        let offset = self.put(packed);
        let mut extension = Map::new();
        for (name, value) in [("buffer", 0), ("byteOffset", offset), ("byteLength", packed.len())] {
            extension.insert(name.to_owned(), json!(value));
        }
        extension.insert("byteStride".to_owned(), json!(stride));
        extension.insert("count".to_owned(), json!(count));
        extension.insert("mode".to_owned(), json!(mode));
        if filter != "NONE" {
            extension.insert("filter".to_owned(), json!(filter));
        }
        let length = count * stride;
        let mut view = json!({ "buffer": 1, "byteOffset": self.unpacked, "byteLength": length, "target": target });
        if target == 34962 {
            view["byteStride"] = json!(stride);
        }
        view["extensions"] = json!({ "EXT_meshopt_compression": extension });
        self.unpacked = (self.unpacked + length).next_multiple_of(4);
        self.view(view, stride)
    }

    fn floats(&mut self, values: &[f32], components: usize) -> usize {
        self.plain(&bytes_of(values, f32::to_le_bytes), 4 * components, 34962)
    }

    /// Vertices of integers, and the same as bytes.
    fn vertices<T>(&mut self, vertices: &[T], bytes: &[u8], filter: &str) -> Result<usize, meshopt::Error> {
        let stride = size_of::<T>();
        if self.packing != Packing::Compressed {
            return Ok(self.plain(bytes, stride, 34962));
        }
        let packed = encode_vertex_buffer_level(vertices, EFFORT, Some(0))?;
        Ok(self.compressed(&packed, vertices.len(), stride, "ATTRIBUTES", filter, 34962))
    }

    fn indices(&mut self, indices: &[u32], is_short: bool, vertices: usize) -> Result<usize, meshopt::Error> {
        let width = if is_short { 2 } else { 4 };
        if self.packing != Packing::Compressed {
            let bytes: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes().into_iter().take(width)).collect();
            return Ok(self.plain(&bytes, width, 34963));
        }
        let packed = encode_index_buffer(indices, vertices)?;
        Ok(self.compressed(&packed, indices.len(), width, "TRIANGLES", "NONE", 34963))
    }

    fn image(&mut self, bytes: &[u8]) -> usize {
        let offset = self.put(bytes);
        self.view(json!({ "buffer": 0, "byteOffset": offset, "byteLength": bytes.len() }), 1)
    }

    /// An accessor of `count` elements from the element `first` on.
    fn accessor(&self, view: usize, first: usize, kind: u32, count: usize, shape: &str) -> Value {
        let mut json = json!({ "bufferView": view, "componentType": kind, "count": count, "type": shape });
        if first > 0 {
            json["byteOffset"] = json!(first * self.strides[view]);
        }
        json
    }

    fn add(&mut self, accessor: Value) -> Value {
        self.accessors.push(accessor);
        json!(self.accessors.len() - 1)
    }

    fn finish(mut self, mut json: Value) -> Vec<u8> {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        json["accessors"] = json!(self.accessors);
        json["bufferViews"] = json!(self.views);
        let mut buffers = vec![json!({ "byteLength": self.binary.len() })];
        if self.packing == Packing::Compressed {
            let fallback = json!({ "EXT_meshopt_compression": { "fallback": true } });
            buffers.push(json!({ "byteLength": self.unpacked, "extensions": fallback }));
        }
        json["buffers"] = json!(buffers);
        framed(&json, &self.binary)
    }
}
