//! Subtrees of implicit tiling: which tiles, contents and child subtrees there are.

use std::borrow::Cow;

use serde::Deserialize;

/// Availability in one subtree, its bits checked against their lengths.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subtree {
    /// One per tile, level by level, Morton order within a level.
    pub tiles: Bits,
    /// One set per content of a tile.
    pub contents: Vec<Bits>,
    /// One per place below the last level.
    pub child_subtrees: Bits,
}

/// A row of bits, all alike or one by one, least significant bit first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Bits {
    /// All of them are this.
    Constant(bool),
    /// One by one.
    Stream(Vec<u8>),
}

impl Bits {
    /// Bit `index`; false beyond the end.
    pub fn get(&self, index: u64) -> bool {
        match self {
            Bits::Constant(value) => *value,
            Bits::Stream(bytes) => usize::try_from(index / 8)
                .ok()
                .and_then(|at| bytes.get(at))
                .is_some_and(|byte| byte >> (index % 8) & 1 == 1),
        }
    }
}

/// A fault in a subtree.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct SubtreeError {
    /// Byte offset or JSON path.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

fn fault(place: impl Into<String>, fault: impl Into<String>) -> SubtreeError {
    SubtreeError { place: place.into(), fault: fault.into() }
}

/// Number of tiles in `levels` levels of a tree with `branching` children: (bˡ − 1)/(b − 1).
pub(crate) fn tiles_in(branching: u32, levels: u32) -> u64 {
    (0..levels).map(|level| u64::from(branching).pow(level)).sum()
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct SubtreeJson {
    #[serde(default)]
    buffers: Vec<BufferJson>,
    #[serde(default)]
    buffer_views: Vec<ViewJson>,
    tile_availability: AvailabilityJson,
    content_availability: Option<OneOrMany>,
    child_subtree_availability: AvailabilityJson,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferJson {
    uri: Option<String>,
    byte_length: u64,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ViewJson {
    buffer: usize,
    byte_offset: u64,
    byte_length: u64,
}

#[derive(Deserialize)]
struct AvailabilityJson {
    bitstream: Option<usize>,
    #[serde(rename = "bufferView")]
    buffer_view: Option<usize>,
    constant: Option<u8>,
}

/// Written as an object by early drafts, as an array by 3D Tiles 1.1.
#[derive(Deserialize)]
#[serde(untagged)]
enum OneOrMany {
    Many(Vec<AvailabilityJson>),
    One(AvailabilityJson),
}

const HEADER_BYTES: usize = 24;

/// Reads a subtree, binary or JSON, of `levels` levels with `branching` (4 or 8) children per tile. `fetch` reads a
/// buffer that lies in a file of its own.
pub fn parse_subtree(
    bytes: &[u8],
    branching: u32,
    levels: u32,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Result<Subtree, SubtreeError> {
    if !(matches!(branching, 4 | 8) && (1..=12).contains(&levels)) {
        return Err(fault("", format!("{branching} children over {levels} levels; expected 4 or 8 over 1 to 12")));
    }
    let (json_at, json, binary) = split(bytes)?;
    let given: SubtreeJson = serde_json::from_slice(json)
        .map_err(|error| fault(format!("byte {json_at}"), format!("{error}; expected JSON of a subtree")))?;
    let reader = Buffers { json: &given, binary, fetch };
    let tiles = tiles_in(branching, levels);
    let contents = match &given.content_availability {
        None => Vec::new(),
        Some(OneOrMany::One(one)) => vec![reader.bits(one, "contentAvailability", tiles)?],
        Some(OneOrMany::Many(many)) => {
            let each = many.iter().enumerate();
            each.map(|(i, one)| reader.bits(one, &format!("contentAvailability[{i}]"), tiles))
                .collect::<Result<_, _>>()?
        }
    };
    Ok(Subtree {
        tiles: reader.bits(&given.tile_availability, "tileAvailability", tiles)?,
        contents,
        child_subtrees: reader.bits(
            &given.child_subtree_availability,
            "childSubtreeAvailability",
            u64::from(branching).pow(levels),
        )?,
    })
}

/// The JSON's offset, the JSON, and the binary chunk.
fn split(bytes: &[u8]) -> Result<(usize, &[u8], &[u8]), SubtreeError> {
    if !bytes.starts_with(b"subt") {
        if bytes.trim_ascii_start().first() == Some(&b'{') {
            return Ok((0, bytes, &[]));
        }
        return Err(fault("byte 0", "neither \"subt\" nor JSON; expected a subtree"));
    }
    let Some((header, body)) = bytes.split_at_checked(HEADER_BYTES) else {
        return Err(fault("byte 4", format!("{} bytes; expected a header of {HEADER_BYTES}", bytes.len())));
    };
    let version = header[4..8].iter().rev().fold(0_u64, |sum, &byte| sum << 8 | u64::from(byte));
    if version != 1 {
        return Err(fault("byte 4", format!("version {version}; expected 1")));
    }
    let length = |at: usize| header[at..at + 8].iter().rev().fold(0_u64, |sum, &byte| sum << 8 | u64::from(byte));
    let (json, binary) = (length(8), length(16));
    if json.checked_add(binary) != Some(body.len() as u64) {
        let found = format!("chunks of {json} and {binary} bytes; expected {} together", body.len());
        return Err(fault("byte 8", found));
    }
    let (json, binary) = body.split_at(json as usize);
    Ok((HEADER_BYTES, json, binary))
}

struct Buffers<'a> {
    json: &'a SubtreeJson,
    binary: &'a [u8],
    fetch: &'a dyn Fn(&str) -> Option<Vec<u8>>,
}

impl Buffers<'_> {
    fn bits(&self, given: &AvailabilityJson, name: &str, count: u64) -> Result<Bits, SubtreeError> {
        let place = format!("$.{name}");
        let view = match (given.constant, given.bitstream.or(given.buffer_view)) {
            (Some(value @ 0..=1), None) => return Ok(Bits::Constant(value == 1)),
            (Some(value), None) => return Err(fault(place, format!("constant {value}; expected 0 or 1"))),
            (None, Some(view)) => view,
            _ => return Err(fault(place, "not one of \"constant\" and \"bitstream\"; expected exactly one")),
        };
        let views = &self.json.buffer_views;
        let Some(found) = views.get(view) else {
            return Err(fault(place, format!("bitstream {view}; expected one of {} buffer views", views.len())));
        };
        let place = format!("$.bufferViews[{view}]");
        let buffers = &self.json.buffers;
        let Some(buffer) = buffers.get(found.buffer) else {
            return Err(fault(place, format!("buffer {}; expected one of {}", found.buffer, buffers.len())));
        };
        let bytes: Cow<'_, [u8]> = match &buffer.uri {
            None => Cow::Borrowed(self.binary),
            Some(uri) => match (self.fetch)(uri) {
                Some(bytes) => Cow::Owned(bytes),
                None => return Err(fault(place, format!("buffer {uri:?} cannot be read; expected a file"))),
            },
        };
        if (bytes.len() as u64) < buffer.byte_length {
            let found = format!("{} bytes in buffer {}; expected {}", bytes.len(), found.buffer, buffer.byte_length);
            return Err(fault(format!("$.buffers[{}]", buffers.len() - 1), found));
        }
        let end = found.byte_offset.checked_add(found.byte_length).filter(|&end| end <= bytes.len() as u64);
        let Some(end) = end else {
            let text =
                format!("bytes {} and {} on; expected an end by {}", found.byte_offset, found.byte_length, bytes.len());
            return Err(fault(place, text));
        };
        if found.byte_length != count.div_ceil(8) {
            let text =
                format!("{} bytes for {name}; expected {} for {count} bits", found.byte_length, count.div_ceil(8));
            return Err(fault(place, text));
        }
        Ok(Bits::Stream(bytes[found.byte_offset as usize..end as usize].to_vec()))
    }
}
