//! Accessors of an asset whose buffers are in memory or stay in their files. Lengths and offsets are checked one by one:
//! nothing in the asset is trusted.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;
use std::sync::Arc;

use gltf::json::Root;
use gltf::json::accessor::sparse::Sparse;
use gltf::json::accessor::{Accessor, ComponentType};
use gltf::json::validation::Checked;

use super::compression;
use crate::import::tiles3d::mesh::{Elements, element_bytes};

/// A buffer's bytes.
#[derive(Debug)]
pub(super) enum Bytes<'a> {
    Memory(Cow<'a, [u8]>),
    /// A part of a file.
    File {
        file: PathBuf,
        offset: u64,
        length: u64,
    },
}

impl Bytes<'_> {
    /// A part of it; `None` if it is not there.
    fn part(&self, from: u64, length: u64) -> Option<Vec<u8>> {
        let end = from.checked_add(length)?;
        match self {
            Bytes::Memory(bytes) => Some(bytes.get(usize::try_from(from).ok()?..usize::try_from(end).ok()?)?.to_vec()),
            Bytes::File { length: whole, .. } if end > *whole => None,
            Bytes::File { file, offset, .. } => {
                let mut opened = File::open(file).ok()?;
                opened.seek(SeekFrom::Start(offset.checked_add(from)?)).ok()?;
                let mut bytes = Vec::new();
                opened.take(length).read_to_end(&mut bytes).ok()?;
                (bytes.len() as u64 == length).then_some(bytes)
            }
        }
    }
}

/// Views that were unfolded, by number.
pub(super) type Unfolded = BTreeMap<usize, Arc<Vec<u8>>>;

/// An asset with its buffers.
#[derive(Clone, Copy)]
pub(super) struct Asset<'a> {
    pub(super) root: &'a Root,
    /// Absent where a buffer is not there.
    pub(super) buffers: &'a [Option<Bytes<'a>>],
}

impl Asset<'_> {
    fn buffer(&self, index: usize) -> Result<&Bytes<'_>, String> {
        self.buffers.get(index).and_then(Option::as_ref).ok_or_else(|| format!("buffer {index}, which is not there"))
    }

    /// The bytes of a view, unfolded if it is compressed.
    pub(super) fn view(&self, index: usize) -> Result<Vec<u8>, String> {
        let length = self.root.buffer_views.get(index).map_or(0, |view| view.byte_length.0);
        self.part(index, 0, length, &mut Unfolded::new())
    }

    /// A part of a view's bytes.
    fn part(&self, index: usize, from: u64, length: u64, unfolded: &mut Unfolded) -> Result<Vec<u8>, String> {
        let absent = || format!("view {index}, which is not there");
        let outside =
            || format!("bytes {from} to {} of view {index}, which are not there", from.saturating_add(length));
        let view = self.root.buffer_views.get(index).ok_or_else(absent)?;
        let Some(packed) = compression::of(view) else {
            let end = from.checked_add(length).filter(|&end| end <= view.byte_length.0).ok_or_else(outside)?;
            let start = view.byte_offset.map_or(0, |offset| offset.0).checked_add(end - length).ok_or_else(outside)?;
            return self.buffer(view.buffer.value())?.part(start, length).ok_or_else(outside);
        };
        let bytes = match unfolded.get(&index) {
            Some(known) => known.clone(),
            None => {
                let packed = packed.map_err(|why| format!("view {index}: {why}"))?;
                let bytes = self.buffer(packed.buffer)?.part(packed.offset, packed.length).ok_or_else(outside)?;
                let plain = packed.decode(&bytes).map_err(|why| format!("view {index}: {why}"))?;
                let plain = Arc::new(plain);
                unfolded.insert(index, plain.clone());
                plain
            }
        };
        let range = usize::try_from(from).ok().zip(from.checked_add(length).and_then(|end| usize::try_from(end).ok()));
        Ok(range.and_then(|(from, end)| bytes.get(from..end)).ok_or_else(outside)?.to_vec())
    }

    /// The elements of an accessor.
    pub(super) fn elements(&self, index: usize, unfolded: &mut Unfolded) -> Result<Elements<'static>, String> {
        let missing = || format!("accessor {index}, which is not there");
        let accessor = self.root.accessors.get(index).ok_or_else(missing)?;
        let unreadable = || format!("accessor {index}, which has no known type");
        let size = element_bytes(accessor).ok_or_else(unreadable)?;
        let count = usize::try_from(accessor.count.0).map_err(|_| missing())?;
        let mut elements = match accessor.buffer_view {
            Some(view) => {
                let given = self.root.buffer_views.get(view.value()).and_then(|view| view.byte_stride);
                let stride = given.map_or(size, |stride| stride.0).max(size);
                let length = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
                let length = length.ok_or_else(missing)? as u64;
                let from = accessor.byte_offset.map_or(0, |offset| offset.0);
                let bytes = self.part(view.value(), from, length, unfolded)?;
                Elements::new(bytes.into(), stride, accessor)
            }
            // All zero, but for what is sparse: of that there must be some.
            None => {
                let sparse = accessor.sparse.as_ref().map(|sparse| self.indices(sparse, unfolded)).transpose()?;
                if count > sparse.map_or(0, |(bytes, _)| bytes.len()).saturating_mul(256) {
                    return Err(format!("accessor {index} of {count} elements without a view"));
                }
                Elements::new(vec![0; count.checked_mul(size).ok_or_else(missing)?].into(), size, accessor)
            }
        }
        .ok_or_else(unreadable)?;
        if accessor.sparse.is_some() {
            self.replace(accessor, size, &mut elements, unfolded).map_err(|why| format!("accessor {index}: {why}"))?;
        }
        Ok(elements)
    }

    /// The bytes of sparse indices, and their type.
    fn indices(&self, sparse: &Sparse, unfolded: &mut Unfolded) -> Result<(Vec<u8>, ComponentType), String> {
        let Checked::Valid(kind) = sparse.indices.component_type else {
            return Err("sparse indices of no known type".to_owned());
        };
        let length = sparse.count.0.checked_mul(kind.0.size() as u64).ok_or("sparse indices beyond every buffer")?;
        let bytes = self.part(sparse.indices.buffer_view.value(), sparse.indices.byte_offset.0, length, unfolded)?;
        Ok((bytes, kind.0))
    }

    /// Puts the sparse elements of an accessor into their places.
    fn replace(
        &self,
        accessor: &Accessor,
        size: usize,
        elements: &mut Elements<'static>,
        unfolded: &mut Unfolded,
    ) -> Result<(), String> {
        let Some(sparse) = &accessor.sparse else { return Ok(()) };
        let (indices, kind) = self.indices(sparse, unfolded)?;
        let length = sparse.count.0.checked_mul(size as u64).ok_or("sparse elements beyond every buffer")?;
        let values = self.part(sparse.values.buffer_view.value(), sparse.values.byte_offset.0, length, unfolded)?;
        for (index, value) in indices.chunks_exact(kind.size()).zip(values.chunks_exact(size)) {
            let at = match (kind, index) {
                (ComponentType::U8, &[a]) => usize::from(a),
                (ComponentType::U16, &[a, b]) => usize::from(u16::from_le_bytes([a, b])),
                (ComponentType::U32, &[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]) as usize,
                _ => return Err("sparse indices that are no whole numbers".to_owned()),
            };
            if !elements.replace(at, value) {
                return Err(format!("sparse index {at}; expected less than {}", elements.count));
            }
        }
        Ok(())
    }
}
