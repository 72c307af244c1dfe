//! A GLB or glTF file. What is larger than a piece is cut; buffers stay in their files until a piece needs them.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use foresight_scheduler::lod_tree::Aabb;
use glam::{DMat4, DVec3};
use gltf::json::Root;
use gltf::json::mesh::Primitive;

use super::accessor::{Asset, Bytes};
use super::primitive::{self, Mesh};
use super::{centre, instances, material, root};
use crate::import::tiles3d::mesh;
use crate::import::tiles3d::{ContentError, GltfUp};
use crate::orthoview::texture::Material;
use crate::surface::inputs::{beside, fault, identity, unreadable};
use crate::surface::{PIECE_TRIANGLES, Piece, SurfaceError, SurfaceSource};
use crate::world::Georeference;

/// A claim of more triangles than this for each byte of the buffers is no packing but a lie.
const TRIANGLES_PER_BYTE: u64 = 1024;

/// A GLB or glTF file, y up in the file, z up in the world.
pub struct GltfFile {
    file: PathBuf,
    root: Root,
    buffers: Vec<Option<Bytes<'static>>>,
    parts: Vec<Part>,
    /// Names of the primitives that have parts.
    names: Vec<String>,
    /// Said by the first piece.
    left_out: Vec<String>,
    /// The primitives of more than one piece that were read last, one a thread, in order of their use.
    last: Mutex<Vec<(Key, Arc<Mesh>)>>,
}

/// A primitive by its mesh and its place there.
type Key = (usize, usize);

/// Some triangles of a primitive, at some places.
struct Part {
    key: Key,
    name: usize,
    /// In the world.
    places: Arc<[DMat4]>,
    first_place: usize,
    last_place: usize,
    first: u64,
    count: u64,
    is_whole: bool,
}

/// Where JSON and binary chunk of a GLB lie in the file: offset and length.
struct Chunks {
    json: (u64, u64),
    binary: Option<(u64, u64)>,
}

fn chunks(path: &Path, file: &mut File, length: u64) -> Result<Chunks, ContentError> {
    let mut words = |at: u64| -> Result<[u32; 2], ContentError> {
        let mut bytes = [0; 8];
        let read = file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut bytes));
        read.map_err(|error| fault(path, &format!("byte {at}"), format!("{error}; expected 8 more bytes")))?;
        let [a, b, c, d, e, f, g, h] = bytes;
        Ok([u32::from_le_bytes([a, b, c, d]), u32::from_le_bytes([e, f, g, h])])
    };
    let [_, version] = words(0)?;
    if version != 2 {
        return Err(fault(path, "byte 4", format!("glTF version {version}; expected 2")));
    }
    // The last four bytes are those of the first chunk.
    let [whole, _] = words(8)?;
    let whole = u64::from(whole);
    if whole > length {
        return Err(fault(path, "byte 8", format!("length {whole}; expected at most {length}, that of the file")));
    }
    let (mut json, mut binary, mut at) = (None, None, 12);
    while at + 8 <= whole {
        let [size, kind] = words(at)?;
        let end = at + 8 + u64::from(size);
        if end > whole {
            let text = format!("a chunk of {size} bytes; expected at most {}", whole - at - 8);
            return Err(fault(path, &format!("byte {at}"), text));
        }
        let place = Some((at + 8, u64::from(size)));
        match kind {
            0x4E4F_534A => json = json.or(place),
            0x004E_4942 => binary = binary.or(place),
            _ => {}
        }
        at = end;
    }
    let json = json.ok_or_else(|| fault(path, "byte 12", "no JSON chunk; expected one"))?;
    Ok(Chunks { json, binary })
}

impl GltfFile {
    /// Opens a GLB or glTF file: reads its JSON and where its triangles are.
    ///
    /// # Errors
    /// A file that is neither, is cut off, asks for what is not read, or has no triangles.
    pub fn open(path: &Path) -> Result<GltfFile, SurfaceError> {
        let io = |error: std::io::Error| unreadable(path, &error);
        let mut file = File::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut start = Vec::new();
        (&mut file).take(4).read_to_end(&mut start).map_err(io)?;
        let chunks = if start == b"glTF" {
            chunks(path, &mut file, length)?
        } else {
            Chunks { json: (0, length), binary: None }
        };
        let (offset, size) = chunks.json;
        let mut json = Vec::new();
        file.seek(SeekFrom::Start(offset)).map_err(io)?;
        file.take(size).read_to_end(&mut json).map_err(io)?;
        let root = root(&json).map_err(|error| fault(path, &error.place, error.fault))?;
        let mut left_out = Vec::new();
        let buffers = root.buffers.iter().enumerate().map(|(index, buffer)| {
            let found = match &buffer.uri {
                None if index == 0 => {
                    chunks.binary.map(|(offset, length)| Bytes::File { file: path.to_owned(), offset, length })
                }
                None => None,
                Some(uri) if uri.starts_with("data:") => mesh::inline(uri).map(|bytes| Bytes::Memory(bytes.into())),
                Some(uri) => beside(path, uri).and_then(|file| {
                    let length = std::fs::metadata(&file).ok()?.len();
                    Some(Bytes::File { file, offset: 0, length })
                }),
            };
            if found.is_none() && buffer.extensions.is_none() {
                left_out.push(format!("buffer {index}, which is not there"));
            }
            found
        });
        let buffers: Vec<_> = buffers.collect();
        let file = path.to_owned();
        let (parts, names, last) = (Vec::new(), Vec::new(), Mutex::new(Vec::new()));
        let mut made = GltfFile { file, root, buffers, parts, names, left_out, last };
        made.cut().map_err(|error| fault(path, &error.place, error.fault))?;
        if made.parts.is_empty() {
            let why = made.left_out.first().map_or_else(String::new, |first| format!(" (left out: {first})"));
            return Err(SurfaceError::Empty { file: path.to_owned(), why });
        }
        Ok(made)
    }

    fn asset(&self) -> Asset<'_> {
        Asset { root: &self.root, buffers: &self.buffers }
    }

    /// Cuts the scene into parts.
    fn cut(&mut self) -> Result<(), ContentError> {
        let asset = Asset { root: &self.root, buffers: &self.buffers };
        let (parts, names, left_out) = (&mut self.parts, &mut self.names, &mut self.left_out);
        let bytes: u64 = self
            .buffers
            .iter()
            .flatten()
            .map(|bytes| match bytes {
                Bytes::Memory(bytes) => bytes.len() as u64,
                Bytes::File { length, .. } => *length,
            })
            .fold(0, u64::saturating_add);
        let mut room = bytes.saturating_mul(TRIANGLES_PER_BYTE);
        let world = DMat4::from_mat3(GltfUp::Y.rotation()) * centre(&self.root);
        let file = self.file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        mesh::walk(&self.root, &mut |node, transform, primitives| {
            if primitives.is_empty() {
                return;
            }
            let places: Arc<[DMat4]> = match instances(&asset, node) {
                Ok(places) => places.into_iter().map(|place| world * *transform * place).collect(),
                Err(why) => return left_out.push(why),
            };
            let mesh = node.mesh.map_or(0, |mesh| mesh.value());
            for (at, given) in primitives.iter().enumerate() {
                let count = primitive::declared(&asset, given);
                if count > room {
                    left_out.push(format!("a mesh that claims {count} triangles in {bytes} bytes"));
                    continue;
                }
                room -= count;
                if count == 0 {
                    left_out.push("points, lines or nothing".to_owned());
                    continue;
                }
                let name = names.len();
                names.push(format!("{file}: $.meshes[{mesh}].primitives[{at}]"));
                let mut part = |range: (usize, usize), first: u64, own: u64| {
                    let (first_place, last_place) = range;
                    let is_whole = own == count && range == (0, places.len());
                    let (key, places) = ((mesh, at), places.clone());
                    parts.push(Part { key, name, places, first_place, last_place, first, count: own, is_whole });
                };
                let together = (PIECE_TRIANGLES as u64 / count) as usize;
                if together > 0 {
                    for first in (0..places.len()).step_by(together) {
                        part((first, (first + together).min(places.len())), 0, count);
                    }
                    continue;
                }
                for place in 0..places.len() {
                    for first in (0..count).step_by(PIECE_TRIANGLES) {
                        part((place, place + 1), first, (count - first).min(PIECE_TRIANGLES as u64));
                    }
                }
            }
        })
    }

    fn mesh(&self, part: &Part, primitive: &Primitive) -> Result<Arc<Mesh>, String> {
        if part.is_whole {
            return Mesh::read(&self.asset(), primitive).map(Arc::new);
        }
        // Held while it is read, so that its other pieces wait instead of reading it too.
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let known = last.iter().position(|(key, _)| *key == part.key).map(|at| last.remove(at).1);
        let mesh = match known {
            Some(mesh) => mesh,
            None => Arc::new(Mesh::read(&self.asset(), primitive)?),
        };
        if last.len() >= rayon::current_num_threads() {
            last.remove(0);
        }
        last.push((part.key, mesh.clone()));
        Ok(mesh)
    }
}

impl SurfaceSource for GltfFile {
    fn pieces(&self) -> usize {
        self.parts.len()
    }

    fn declared(&self, _: usize) -> Option<Aabb> {
        None
    }

    fn name(&self, piece: usize) -> &str {
        &self.names[self.parts[piece].name]
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let part = &self.parts[piece];
        let mut out = Piece::default();
        if piece == 0 {
            out.left_out.clone_from(&self.left_out);
        }
        let Some(given) = self.root.meshes.get(part.key.0).and_then(|mesh| mesh.primitives.get(part.key.1)) else {
            return Ok(out);
        };
        let mesh = match self.mesh(part, given) {
            Ok(mesh) => mesh,
            Err(why) => {
                out.left_out.push(why);
                return Ok(out);
            }
        };
        let count = mesh.count() as u64;
        let (first, end) = (part.first.min(count) as usize, (part.first + part.count).min(count) as usize);
        for place in &part.places[part.first_place..part.last_place] {
            mesh.triangles(first..end, place, &mut out.triangles);
        }
        let number = out.triangles.first().map_or(0, |triangle| triangle.material as usize);
        let mut look = material::materials(&self.root).get(number).copied().unwrap_or_default();
        if let Some(texture) = look.texture {
            let fetch = |uri: &str| std::fs::read(beside(&self.file, uri)?).ok();
            out.images = vec![material::image_of(&self.asset(), texture, &fetch, &mut out.left_out)];
            look = Material { texture: Some(0), ..look };
        }
        out.materials = vec![look];
        out.triangles.iter_mut().for_each(|triangle| triangle.material = 0);
        Ok(out)
    }

    fn up(&self) -> DVec3 {
        DVec3::Z
    }

    fn georeference(&self) -> Option<Georeference> {
        None
    }

    fn identity(&self) -> Result<[u8; 32], ContentError> {
        let uris =
            self.root.buffers.iter().map(|b| b.uri.as_ref()).chain(self.root.images.iter().map(|i| i.uri.as_ref()));
        let named: BTreeSet<PathBuf> = uris.flatten().filter_map(|uri| beside(&self.file, uri)).collect();
        let there = named.iter().filter(|file| file.is_file()).map(PathBuf::as_path);
        identity("foresight-surfaces-gltf-1", &[], std::iter::once(self.file.as_path()).chain(there))
    }
}
