//! Contents of a tileset by representation: their bytes, and what they show in the world.

use std::io;
use std::path::Path;

use foresight_scheduler::lod_tree::RepId;
use glam::{DMat3, DMat4, DVec3};

use super::content::{self, ContentError, ContentKind};
use super::instances;
use super::resolve::{Folder, folder_of};
use super::walk::Variant;
use super::{GltfUp, Loaded, MAX_TILES, Places, Tiles3dError};
use crate::surface::{Piece, gltf};
use crate::world::World;

/// Most triangles of a content that is drawn: 400 MB while it is read.
pub const DRAWN_TRIANGLES_MAX: usize = 1 << 21;

/// Most composites inside each other.
const MAX_COMPOSITES: usize = 8;

/// The contents of a tileset.
#[derive(Debug)]
pub struct TileContents {
    folder: Folder,
    places: Places,
}

impl TileContents {
    /// Opens the tileset `file` with its contents.
    ///
    /// # Errors
    /// As [`super::open`].
    pub fn open(file: &Path) -> Result<(World, TileContents), Tiles3dError> {
        Ok(TileContents::of(super::load(file, MAX_TILES, true)?))
    }

    pub(crate) fn of(loaded: Loaded) -> (World, TileContents) {
        let Loaded { world, places, folder, .. } = loaded;
        (world, TileContents { folder, places: places.unwrap_or_default() })
    }

    /// Whose the whole is, as the tileset says.
    pub fn credit(&self) -> Option<&str> {
        self.places.credit.as_deref()
    }

    fn variant(&self, rep: RepId) -> Option<(Variant, DVec3)> {
        let &(variant, translation) = self.places.representations.get(rep.index())?;
        Some((*self.places.variants.get(variant as usize)?, translation))
    }

    /// The file of a representation, relative to the tileset's folder; empty for one that there is not.
    pub fn file(&self, rep: RepId) -> &str {
        let file = self.variant(rep).and_then(|(variant, _)| self.places.files.get(variant.file as usize));
        file.map_or("", String::as_str)
    }

    /// The bytes of a representation's file as they are stored.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn bytes(&self, rep: RepId) -> io::Result<Vec<u8>> {
        self.folder.source.read(self.file(rep))
    }

    /// What the bytes of a representation show in the world, with normals. Files that it names are read from the tileset's folder.
    ///
    /// # Errors
    /// Bytes that are none of the formats of contents, are cut off, hold a cloud of points, or only stand in for another place.
    pub fn read(&self, rep: RepId, bytes: &[u8]) -> Result<Piece, ContentError> {
        let file = self.file(rep);
        let Some((variant, translation)) = self.variant(rep) else {
            return Err(ContentError::new(format!("representation {}", rep.0), "not there; expected one of the world"));
        };
        if variant.stand_in {
            let fault = "stands in for a place that was never made; expected a content: only its size is meant";
            return Err(ContentError::new(file, fault));
        }
        let linear = self.places.linears.get(variant.linear as usize).copied().unwrap_or(DMat3::IDENTITY);
        let tile = DMat4::from_translation(translation) * DMat4::from_mat3(linear);
        let reader = Reader {
            folder: Some(&self.folder),
            tile,
            up: variant.up.rotation(),
            with_normals: true,
            triangles_max: DRAWN_TRIANGLES_MAX,
        };
        reader.read(file, bytes)
    }
}

/// What a content shows by itself, z up, files beside it left out.
///
/// # Errors
/// As [`TileContents::read`].
pub fn content_surface(bytes: &[u8]) -> Result<Piece, ContentError> {
    let (tile, up) = (DMat4::IDENTITY, GltfUp::Y.rotation());
    Reader { folder: None, tile, up, with_normals: true, triangles_max: DRAWN_TRIANGLES_MAX }.read("", bytes)
}

/// Reads contents of one tile.
pub(super) struct Reader<'a> {
    /// Where files beside a content are; without it none are.
    pub(super) folder: Option<&'a Folder>,
    /// From the tile's axes to the world.
    pub(super) tile: DMat4,
    /// From glTF axes to the tile's.
    pub(super) up: DMat3,
    pub(super) with_normals: bool,
    pub(super) triangles_max: usize,
}

impl Reader<'_> {
    /// What the bytes of `file` show.
    pub(super) fn read(&self, file: &str, bytes: &[u8]) -> Result<Piece, ContentError> {
        let mut out = Piece::default();
        let base = folder_of(file);
        self.content(base, bytes, 0, &mut out).map_err(|error| ContentError::new(file, error.to_string()))?;
        Ok(out)
    }

    /// At most [`MAX_COMPOSITES`] calls deep.
    fn content(&self, base: &str, bytes: &[u8], depth: usize, out: &mut Piece) -> Result<(), ContentError> {
        match content::kind(bytes) {
            Some(ContentKind::Cmpt) if depth < MAX_COMPOSITES => {
                for (number, part) in content::composite(bytes)?.into_iter().enumerate() {
                    let within = |error: ContentError| ContentError {
                        place: format!("tile {number} of the composite: {}", error.place),
                        ..error
                    };
                    self.content(base, part, depth + 1, out).map_err(within)?;
                }
                Ok(())
            }
            Some(ContentKind::Cmpt) => {
                let fault = format!("more than {MAX_COMPOSITES} composites inside each other; expected at most that");
                Err(ContentError::new("byte 0", fault))
            }
            Some(ContentKind::I3dm) => self.instances(base, bytes, out),
            Some(ContentKind::Pnts) => Err(ContentError::new("byte 0", "a cloud of points; expected triangles")),
            Some(ContentKind::Glb | ContentKind::Gltf | ContentKind::B3dm) => {
                self.model(base, bytes, &[DMat4::IDENTITY], out)
            }
            None => {
                let start = String::from_utf8_lossy(&bytes[..bytes.len().min(8)]);
                let fault = format!("{start:?}; expected \"b3dm\", \"glTF\" or another tile format");
                Err(ContentError::new("byte 0", fault))
            }
        }
    }

    fn instances(&self, base: &str, bytes: &[u8], out: &mut Piece) -> Result<(), ContentError> {
        let instances::Instances { places, model } = instances::parse(bytes)?;
        match model {
            instances::Model::Inside(bytes) => self.model(base, bytes, &places, out),
            instances::Model::At(uri) => {
                let bytes = self.beside(base, &uri).ok_or_else(|| {
                    ContentError::new("byte 32", format!("the model {uri:?}, which is not there; expected a file"))
                })?;
                let base = folder_of(&format!("{base}{uri}")).to_owned();
                self.model(&base, &bytes, &places, out)
            }
        }
    }

    fn beside(&self, base: &str, uri: &str) -> Option<Vec<u8>> {
        Some(self.folder?.fetch(base, uri)?.1)
    }

    /// A model at some places in the tile.
    fn model(&self, base: &str, bytes: &[u8], places: &[DMat4], out: &mut Piece) -> Result<(), ContentError> {
        let Some((json, binary, centre)) = content::gltf(bytes)? else {
            return Err(ContentError::new("byte 0", "no glTF; expected a model of one"));
        };
        let own = DMat4::from_translation(centre) * DMat4::from_mat3(self.up);
        let worlds: Vec<DMat4> = places.iter().map(|place| self.tile * *place * own).collect();
        if worlds.iter().any(|world| !world.is_finite()) {
            return Err(ContentError::new("its places", "not all finite; expected numbers"));
        }
        let fetch = |uri: &str| self.beside(base, uri);
        let reading = gltf::Reading {
            places: &worlds,
            with_normals: self.with_normals,
            triangles_max: self.triangles_max.saturating_sub(out.triangles.len()),
        };
        out.append(gltf::read(json, binary, &fetch, reading)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{Scratch, rectangle, tile};
    use super::*;
    use serde_json::json;

    /// A header, tables and the rest of a tile format.
    fn framed(magic: &[u8; 4], table: &serde_json::Value, binary: &[u8], more: &[u8], rest: &[u8]) -> Vec<u8> {
        let table = serde_json::to_vec(table).expect("JSON");
        let lengths = [table.len(), binary.len(), 0, 0].map(|length| (length as u32).to_le_bytes());
        let whole = 12 + 16 + more.len() + table.len() + binary.len() + rest.len();
        let head = [&magic[..], &1_u32.to_le_bytes(), &(whole as u32).to_le_bytes()].concat();
        [&head, lengths.as_flattened(), more, &table, binary, rest].concat()
    }

    fn read(bytes: &[u8], transform: serde_json::Value) -> Result<Piece, String> {
        let scratch = Scratch::new();
        let mut root = tile(1.0, "a.bin", &[]);
        root["transform"] = transform;
        scratch.put("a.bin", bytes);
        scratch.put("model.glb", rectangle(None));
        let file = scratch.tileset("tileset.json", &root);
        let (_, contents) = TileContents::open(&file).map_err(|error| error.to_string())?;
        let rep = RepId(0);
        assert_eq!(contents.bytes(rep).expect("a file"), bytes);
        contents.read(rep, bytes).map_err(|error| error.to_string())
    }

    fn corners(piece: &Piece) -> Vec<DVec3> {
        piece.triangles.iter().flat_map(|t| t.corners).collect()
    }

    /// Moved by (1000, 0, 0), turned by 90° about z.
    fn moved() -> serde_json::Value {
        json!([0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 1000, 0, 0, 1])
    }

    #[test]
    fn a_batched_model_stands_where_transform_and_centre_put_it() {
        let bytes =
            framed(b"b3dm", &json!({ "BATCH_LENGTH": 0, "RTC_CENTER": [10, 0, 0] }), &[], &[], &rectangle(None));
        let piece = read(&bytes, moved()).expect("a content");
        // (0, 0, ½) of the tile, at (10, 0, 0), turned: (0, 10, ½), moved.
        assert_eq!(corners(&piece)[0], DVec3::new(1000.0, 10.0, 0.5));
        assert_eq!(corners(&piece)[1], DVec3::new(1000.0, 11.0, 0.5));
        assert_eq!(piece.normals.len(), 2);
    }

    #[test]
    fn instances_stand_where_they_are_put() {
        let positions: Vec<u8> =
            [[0f32, 0.0, 0.0], [5.0, 0.0, 2.0]].iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let scales: Vec<u8> = [1f32, 2.0].iter().flat_map(|v| v.to_le_bytes()).collect();
        let binary = [positions, scales].concat();
        let table = json!({
            "INSTANCES_LENGTH": 2, "POSITION": { "byteOffset": 0 }, "SCALE": { "byteOffset": 24 }, "RTC_CENTER": [0, 7, 0],
        });
        let inside = framed(b"i3dm", &table, &binary, &1_u32.to_le_bytes(), &rectangle(None));
        let beside = framed(b"i3dm", &table, &binary, &0_u32.to_le_bytes(), b"model.glb ");
        for bytes in [&inside, &beside] {
            let piece = read(bytes, json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])).expect("a content");
            let corners = corners(&piece);
            assert_eq!(corners.len(), 12);
            assert_eq!((corners[0], corners[1]), (DVec3::new(0.0, 7.0, 0.5), DVec3::new(1.0, 7.0, 0.5)));
            assert_eq!((corners[6], corners[7]), (DVec3::new(5.0, 7.0, 3.0), DVec3::new(7.0, 7.0, 3.0)));
        }
        let composite = {
            let whole = (16 + 2 * inside.len()) as u32;
            let head = [&b"cmpt"[..], &1_u32.to_le_bytes(), &whole.to_le_bytes(), &2_u32.to_le_bytes()].concat();
            [head, inside.clone(), inside.clone()].concat()
        };
        let piece = read(&composite, moved()).expect("a content");
        assert_eq!((piece.triangles.len(), piece.normals.len()), (8, 8));
        assert_eq!(piece.triangles[4].corners[0], DVec3::new(993.0, 0.0, 0.5));
        for (whole, name) in [(&inside, "i3dm"), (&composite, "cmpt")] {
            assert!(content_surface(whole).is_ok());
            for length in 0..whole.len() {
                assert!(content_surface(&whole[..length]).is_err(), "{name} cut to {length} bytes");
            }
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_refused_with_a_word() {
        let points = framed(b"pnts", &json!({ "POINTS_LENGTH": 0 }), &[], &[], &[]);
        let error = read(&points, moved()).expect_err("points");
        assert!(error.contains("a.bin: byte 0: a cloud of points; expected triangles"), "{error}");
        let many = json!({ "INSTANCES_LENGTH": 4_000_000_000_u32, "POSITION": { "byteOffset": 0 } });
        let error = read(&framed(b"i3dm", &many, &[0; 12], &1_u32.to_le_bytes(), &rectangle(None)), moved());
        let error = error.expect_err("too few positions");
        assert!(error.contains("$.INSTANCES_LENGTH"), "{error}");
    }
}
