//! The index of a spool: magic, what it holds, the BLAKE3 hash of all before. Numbers are little-endian.

use std::fs;
use std::io;
use std::path::Path;

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use super::looks::Stored;
use super::{Block, IMAGES, Repairs, SpoolError, Statistics, TRIANGLES};
use crate::orthoview::texture::Material;

/// File of the index.
const INDEX: &str = "index";
/// Its name while it is written.
const UNFINISHED: &str = "index.unfinished";
/// What it begins with; another version has other digits.
const MAGIC: &[u8; 8] = b"FSSPOOL1";
/// No texture.
const NONE: u64 = u64::MAX;

/// Everything but triangles and images.
#[derive(Debug, PartialEq)]
pub(super) struct Index {
    pub(super) identity: [u8; 32],
    pub(super) leaf_side: f64,
    pub(super) keep_strays: bool,
    pub(super) statistics: Statistics,
    pub(super) materials: Vec<Material>,
    pub(super) images: Vec<Stored>,
    /// In order of leaf, then of offset.
    pub(super) blocks: Vec<Block>,
}

struct Writer(Vec<u8>);

impl Writer {
    fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    fn vector(&mut self, value: DVec3) {
        value.to_array().into_iter().for_each(|value| self.f64(value));
    }
}

/// Reads numbers; beyond the end there are none.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn u64(&mut self) -> Option<u64> {
        let (first, rest) = self.0.split_first_chunk::<8>()?;
        self.0 = rest;
        Some(u64::from_le_bytes(*first))
    }

    fn f64(&mut self) -> Option<f64> {
        self.u64().map(f64::from_bits)
    }

    fn vector(&mut self) -> Option<DVec3> {
        Some(DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    /// A number of things that take `bytes` each at least.
    fn count(&mut self, bytes: usize) -> Option<usize> {
        let count = usize::try_from(self.u64()?).ok()?;
        (count <= self.0.len() / bytes).then_some(count)
    }
}

impl Index {
    fn encode(&self) -> Vec<u8> {
        let mut out = Writer(MAGIC.to_vec());
        out.0.extend_from_slice(&self.identity);
        out.f64(self.leaf_side);
        out.u64(u64::from(self.keep_strays));
        let of = &self.statistics;
        [of.triangles, of.placed, of.image_bytes, of.triangle_bytes].into_iter().for_each(|value| out.u64(value));
        let Repairs { not_finite, degenerate, strays, non_manifold_edges } = of.repairs;
        [not_finite, degenerate, strays, non_manifold_edges].into_iter().for_each(|value| out.u64(value));
        out.vector(of.bounds.min);
        out.vector(of.bounds.max);
        out.f64(of.area);
        out.u64(of.orientations.len() as u64);
        for &(normal, area) in &of.orientations {
            out.vector(normal);
            out.f64(area);
        }
        out.u64(of.left_out.len() as u64);
        for text in &of.left_out {
            out.u64(text.len() as u64);
            out.0.extend_from_slice(text.as_bytes());
        }
        out.u64(self.materials.len() as u64);
        for material in &self.materials {
            let [r, g, b] = material.base;
            [r, g, b, material.cutoff].into_iter().for_each(|value| out.f64(f64::from(value)));
            out.u64(material.texture.map_or(NONE, |texture| texture as u64));
        }
        out.u64(self.images.len() as u64);
        for image in &self.images {
            out.u64(image.offset);
            out.u64(image.length);
        }
        out.u64(self.blocks.len() as u64);
        for block in &self.blocks {
            out.0.extend_from_slice(&block.leaf.to_le_bytes());
            out.u64(block.offset);
            out.u64(u64::from(block.count) | u64::from(block.flags) << 32);
        }
        let hash = blake3::hash(&out.0);
        out.0.extend_from_slice(hash.as_bytes());
        out.0
    }

    /// What was encoded; `None` for anything else.
    #[expect(clippy::cast_possible_truncation, reason = "32-bit floats, and parts of a word")]
    pub(super) fn decode(bytes: &[u8]) -> Option<Index> {
        let (body, hash) = bytes.split_last_chunk::<32>()?;
        if blake3::hash(body).as_bytes() != hash {
            return None;
        }
        let (identity, body) = body.strip_prefix(MAGIC)?.split_first_chunk::<32>()?;
        let mut read = Reader(body);
        let leaf_side = read.f64()?;
        let keep_strays = read.u64()? != 0;
        let [triangles, placed, image_bytes, triangle_bytes] = [read.u64()?, read.u64()?, read.u64()?, read.u64()?];
        let repairs = Repairs {
            not_finite: read.u64()?,
            degenerate: read.u64()?,
            strays: read.u64()?,
            non_manifold_edges: read.u64()?,
        };
        let bounds = Aabb { min: read.vector()?, max: read.vector()? };
        let area = read.f64()?;
        let mut orientations = Vec::new();
        for _ in 0..read.count(32)? {
            orientations.push((read.vector()?, read.f64()?));
        }
        let mut left_out = Vec::new();
        for _ in 0..read.count(8)? {
            let (text, rest) = {
                let length = read.count(1)?;
                read.0.split_at(length)
            };
            left_out.push(String::from_utf8(text.to_vec()).ok()?);
            read.0 = rest;
        }
        let mut materials = Vec::new();
        for _ in 0..read.count(40)? {
            let mut number = || read.f64().map(|value| value as f32);
            let (base, cutoff) = ([number()?, number()?, number()?], number()?);
            let texture = read.u64()?;
            let texture = if texture == NONE { None } else { Some(usize::try_from(texture).ok()?) };
            materials.push(Material { base, texture, cutoff });
        }
        let mut images = Vec::new();
        for _ in 0..read.count(16)? {
            images.push(Stored { offset: read.u64()?, length: read.u64()? });
        }
        let mut blocks = Vec::new();
        for _ in 0..read.count(32)? {
            let (low, high, offset, word) = (read.u64()?, read.u64()?, read.u64()?, read.u64()?);
            let leaf = u128::from(low) | u128::from(high) << 64;
            blocks.push(Block { leaf, offset, count: word as u32, flags: (word >> 32) as u8 });
        }
        let statistics = Statistics {
            triangles,
            placed,
            bounds,
            area,
            orientations,
            repairs,
            left_out,
            image_bytes,
            triangle_bytes,
        };
        let whole = Index { identity: *identity, leaf_side, keep_strays, statistics, materials, images, blocks };
        read.0.is_empty().then_some(whole)
    }

    /// Writes it beside, then gives it its name.
    pub(super) fn write(&self, folder: &Path) -> Result<(), SpoolError> {
        let (beside, file) = (folder.join(UNFINISHED), folder.join(INDEX));
        let written = fs::File::create(&beside).and_then(|mut out| {
            io::Write::write_all(&mut out, &self.encode())?;
            out.sync_all()
        });
        written.map_err(|source| SpoolError::io(&beside, source))?;
        fs::rename(&beside, &file).map_err(|source| SpoolError::io(&file, source))
    }

    /// Reads it; `None` if it is not there, or the spool is not whole.
    pub(super) fn read(folder: &Path) -> Result<Option<Index>, SpoolError> {
        let file = folder.join(INDEX);
        let bytes = match fs::read(&file) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(SpoolError::io(&file, source)),
        };
        let Some(index) = Index::decode(&bytes) else { return Ok(None) };
        let length = |name: &str| fs::metadata(folder.join(name)).map_or(0, |found| found.len());
        let of = &index.statistics;
        let is_whole = length(TRIANGLES) == of.triangle_bytes && length(IMAGES) == of.image_bytes;
        Ok(is_whole.then_some(index))
    }

    /// Removes it: what is left is unfinished.
    pub(super) fn remove(folder: &Path) -> Result<(), SpoolError> {
        let file = folder.join(INDEX);
        match fs::remove_file(&file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(SpoolError::io(&file, error)),
            _ => Ok(()),
        }
    }
}
