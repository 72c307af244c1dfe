//! Tile contents: what they cost, and where what they show lies.

use foresight_scheduler::lod_tree::Aabb;
use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::mesh::{self, Geometry};

/// A fault in a content.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct ContentError {
    /// Byte offset or JSON path.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

impl ContentError {
    pub(crate) fn new(place: impl Into<String>, fault: impl Into<String>) -> ContentError {
        ContentError { place: place.into(), fault: fault.into() }
    }
}

/// The kinds of content, by their first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContentKind {
    /// A GLB.
    Glb,
    /// A glTF's JSON.
    Gltf,
    /// A batched model: a GLB behind a header.
    B3dm,
    /// Instances of a model.
    I3dm,
    /// A point cloud.
    Pnts,
    /// Several contents in one file.
    Cmpt,
}

impl ContentKind {
    /// True if its vertices are read; of the other kinds only the size is known.
    pub fn has_mesh(self) -> bool {
        matches!(self, ContentKind::Glb | ContentKind::Gltf | ContentKind::B3dm)
    }
}

/// A content as far as it is needed.
#[derive(Debug)]
pub(crate) struct Content {
    pub(crate) kind: ContentKind,
    /// In glTF axes. Without points for the kinds that are not read.
    pub(crate) geometry: Geometry,
    /// Added after the rotation to the tile's axes.
    pub(crate) relative_to: DVec3,
}

/// A content in figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContentSummary {
    /// What it is.
    pub kind: ContentKind,
    /// Bytes in memory: vertex and index buffers, and each image with its mips.
    pub decoded_bytes: u64,
    /// Box around the vertices in the content's own axes, with the centre that they are relative to. `None` if
    /// they cannot be read.
    pub bounds: Option<Aabb>,
}

/// Reads a content from its bytes alone; files that it names are not looked at.
pub fn content_summary(bytes: &[u8]) -> Result<ContentSummary, ContentError> {
    let content = parse(bytes, &|_| None)?;
    let placed = place(&content, &DMat3::IDENTITY, &DMat3::IDENTITY);
    Ok(ContentSummary {
        kind: content.kind,
        decoded_bytes: content.geometry.decoded_bytes,
        bounds: placed.map(|placed| placed.bounds),
    })
}

/// Recognises a content by its first bytes.
pub(crate) fn kind(bytes: &[u8]) -> Option<ContentKind> {
    Some(match bytes.get(..4)? {
        b"glTF" => ContentKind::Glb,
        b"b3dm" => ContentKind::B3dm,
        b"i3dm" => ContentKind::I3dm,
        b"pnts" => ContentKind::Pnts,
        b"cmpt" => ContentKind::Cmpt,
        _ if bytes.trim_ascii_start().first() == Some(&b'{') => ContentKind::Gltf,
        _ => return None,
    })
}

pub(crate) fn parse(bytes: &[u8], fetch: &dyn Fn(&str) -> Option<Vec<u8>>) -> Result<Content, ContentError> {
    let Some(kind) = kind(bytes) else {
        let start = &bytes[..bytes.len().min(8)];
        let found = format!("{:?}; expected \"b3dm\", \"glTF\" or another tile format", String::from_utf8_lossy(start));
        return Err(ContentError::new("byte 0", found));
    };
    let (geometry, relative_to) = match gltf(bytes)? {
        Some((json, binary, centre)) => (mesh::read(json, binary, fetch)?, centre),
        // Counted as they are on the wire: decoding may unfold them, but never to less.
        None => {
            header(bytes)?;
            (Geometry { decoded_bytes: bytes.len() as u64, ..Geometry::default() }, DVec3::ZERO)
        }
    };
    Ok(Content { kind, geometry, relative_to })
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> Result<usize, ContentError> {
    let found = bytes.get(at..at + 4).and_then(|word| <[u8; 4]>::try_from(word).ok());
    let word = found.ok_or_else(|| ContentError::new(format!("byte {at}"), "the end; expected 4 more bytes"))?;
    Ok(u32::from_le_bytes(word) as usize)
}

/// Checks the version and the length that all tile formats begin with, and returns the length.
pub(super) fn header(bytes: &[u8]) -> Result<usize, ContentError> {
    let version = u32_at(bytes, 4)?;
    if version != 1 {
        return Err(ContentError::new("byte 4", format!("version {version}; expected 1")));
    }
    let length = u32_at(bytes, 8)?;
    if length > bytes.len() || length < 16 {
        let found = format!("length {length}; expected that of the file, {} bytes", bytes.len());
        return Err(ContentError::new("byte 8", found));
    }
    Ok(length)
}

/// The contents of a composite.
#[cfg(feature = "orthoviews")]
pub(super) fn composite(bytes: &[u8]) -> Result<Vec<&[u8]>, ContentError> {
    let length = header(bytes)?;
    let count = u32_at(bytes, 12)?;
    let (mut at, mut parts) = (16, Vec::new());
    for _ in 0..count {
        let own = bytes.get(at..length).ok_or(()).and_then(|rest| u32_at(rest, 8).map_err(|_| ()));
        let part = own.ok().filter(|own| *own >= 16).and_then(|own| bytes[..length].get(at..at.checked_add(own)?));
        let Some(part) = part else {
            let found = format!("no tile {} of {count}; expected one within {length} bytes", parts.len());
            return Err(ContentError::new(format!("byte {at}"), found));
        };
        parts.push(part);
        at += part.len();
    }
    Ok(parts)
}

#[derive(Deserialize)]
struct FeatureTable {
    #[serde(rename = "RTC_CENTER")]
    rtc_center: Option<[f64; 3]>,
}

/// Where the GLB of a batched model begins, and the centre that it is relative to.
fn b3dm(bytes: &[u8]) -> Result<(usize, DVec3), ContentError> {
    header(bytes)?;
    let mut end = 28_usize;
    for at in [12, 16, 20, 24] {
        end = end.saturating_add(u32_at(bytes, at)?);
        if end > bytes.len() {
            let found = format!("tables up to byte {end}; expected an end within the file, {} bytes", bytes.len());
            return Err(ContentError::new(format!("byte {at}"), found));
        }
    }
    let table = &bytes[28..28 + u32_at(bytes, 12)?];
    let table = table.trim_ascii();
    if table.is_empty() {
        return Ok((end, DVec3::ZERO));
    }
    let table: FeatureTable = serde_json::from_slice(table)
        .map_err(|error| ContentError::new("byte 28", format!("{error}; expected the feature table's JSON")))?;
    let centre = DVec3::from_array(table.rtc_center.unwrap_or_default());
    if !centre.is_finite() {
        return Err(ContentError::new("$.RTC_CENTER", format!("{centre}; expected finite metres")));
    }
    Ok((end, centre))
}

/// The JSON and the binary chunk of a GLB that begins at byte `offset` of its file.
fn glb_chunks(bytes: &[u8], offset: usize) -> Result<(&[u8], Option<&[u8]>), ContentError> {
    let place = |at: usize| format!("byte {}", offset + at);
    let shift = |error: ContentError| ContentError { place: place(bytes.len()), ..error };
    if !bytes.starts_with(b"glTF") {
        return Err(ContentError::new(place(0), "no \"glTF\"; expected a GLB"));
    }
    let version = u32_at(bytes, 4).map_err(shift)?;
    if version != 2 {
        return Err(ContentError::new(place(4), format!("glTF version {version}; expected 2")));
    }
    let length = u32_at(bytes, 8).map_err(shift)?;
    if length > bytes.len() {
        return Err(ContentError::new(place(8), format!("length {length}; expected at most {}", bytes.len())));
    }
    let bytes = &bytes[..length];
    let (mut json, mut binary, mut at) = (None, None, 12);
    while at < length {
        let size = u32_at(bytes, at).map_err(shift)?;
        let kind = u32_at(bytes, at + 4).map_err(shift)?;
        let Some(chunk) = at.checked_add(8 + size).and_then(|end| bytes.get(at + 8..end)) else {
            let found = format!("a chunk of {size} bytes; expected at most {}", length.saturating_sub(at + 8));
            return Err(ContentError::new(place(at), found));
        };
        match kind {
            0x4E4F_534A => json = json.or(Some(chunk)),
            0x004E_4942 => binary = binary.or(Some(chunk)),
            _ => {}
        }
        at += 8 + size;
    }
    let json = json.ok_or_else(|| ContentError::new(place(12), "no JSON chunk; expected one"))?;
    Ok((json, binary))
}

/// The glTF inside a content: its JSON, its binary chunk, and the centre that it is relative to. `None` for the kinds that
/// are not read.
#[expect(clippy::type_complexity, reason = "three parts of one file")]
pub(crate) fn gltf(bytes: &[u8]) -> Result<Option<(&[u8], Option<&[u8]>, DVec3)>, ContentError> {
    Ok(match kind(bytes) {
        Some(ContentKind::Gltf) => Some((bytes, None, DVec3::ZERO)),
        Some(ContentKind::Glb) => glb_chunks(bytes, 0).map(|(json, binary)| Some((json, binary, DVec3::ZERO)))?,
        Some(ContentKind::B3dm) => {
            let (at, centre) = b3dm(bytes)?;
            glb_chunks(&bytes[at..], at).map(|(json, binary)| Some((json, binary, centre)))?
        }
        _ => None,
    })
}

/// What a content shows under the linear part of a transform; its translation is to be added.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub(crate) bounds: Aabb,
    /// Mean of the vertices.
    pub(crate) mean: DVec3,
    /// Area vector of the surface, m².
    pub(crate) area_vector: DVec3,
    /// Area of the surface, m².
    pub(crate) area: f64,
}

/// Places a content under `rotation` (glTF axes to the tile's) and `linear`. `None` if no vertex is known.
pub(crate) fn place(content: &Content, rotation: &DMat3, linear: &DMat3) -> Option<Placed> {
    let geometry = &content.geometry;
    let matrix = *linear * *rotation;
    let centre = *linear * content.relative_to;
    let (mut bounds, mut sum, mut count) = (Aabb::EMPTY, DVec3::ZERO, 0_u32);
    for &point in &geometry.points {
        let point = matrix * point;
        bounds = bounds.union(Aabb { min: point, max: point });
        sum += point;
        count += 1;
    }
    if bounds.is_empty() || geometry.instanced {
        return None;
    }
    // Area vectors go by the cofactors, |det A| A⁻ᵀ; areas, where A is no similarity, by the mean scale.
    let determinant = matrix.determinant().abs();
    let turned =
        if determinant > 0.0 { matrix.inverse().transpose() * geometry.area_vector * determinant } else { DVec3::ZERO };
    let scale = libm::cbrt(determinant);
    Some(Placed {
        bounds: Aabb { min: bounds.min + centre, max: bounds.max + centre },
        mean: sum / f64::from(count) + centre,
        area_vector: if turned.is_finite() { turned } else { DVec3::ZERO },
        area: geometry.area * scale * scale,
    })
}
