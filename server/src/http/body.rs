//! Bodies of responses: from memory at once, from the disk in blocks.

use std::fs::File;
use std::ops::Range;
use std::sync::Arc;

use axum::body::Body;
use bytes::Bytes;
use foresight_scheduler::lod_tree::RepId;
use futures_util::stream;

use super::filler;

/// What is read from a file at a time, bytes.
const BLOCK_BYTES: u64 = 512 << 10;

/// Where content comes from.
#[derive(Clone, Debug)]
pub(super) enum Source {
    /// All of it is in memory.
    Memory(Bytes),
    /// An open file.
    File(Arc<File>),
    /// Pseudo-random bytes.
    Filler(RepId),
}

impl Source {
    /// Bytes of the content, at most a block of them, at least one if the range is not empty.
    pub(super) async fn read(&self, part: Range<u64>) -> std::io::Result<Bytes> {
        let end = part.end.min(part.start.saturating_add(BLOCK_BYTES));
        match self {
            Source::Memory(content) => Ok(content.slice(part.start as usize..part.end as usize)),
            Source::Filler(rep) => Ok(filler::bytes(*rep, part.start, end)),
            Source::File(file) => {
                let file = file.clone();
                let read = tokio::task::spawn_blocking(move || read_at(&file, part.start, end));
                read.await.map_err(std::io::Error::other)?
            }
        }
    }
}

#[cfg(unix)]
fn read_at(file: &File, from: u64, to: u64) -> std::io::Result<Bytes> {
    use std::os::unix::fs::FileExt;
    let mut block = vec![0; (to - from) as usize];
    file.read_exact_at(&mut block, from)?;
    Ok(block.into())
}

#[cfg(windows)]
fn read_at(file: &File, from: u64, to: u64) -> std::io::Result<Bytes> {
    use std::os::windows::fs::FileExt;
    let mut block = vec![0; (to - from) as usize];
    let read = file.seek_read(&mut block, from)?;
    if read == 0 {
        return Err(std::io::ErrorKind::UnexpectedEof.into());
    }
    block.truncate(read);
    Ok(block.into())
}

/// A part of the content. A file that shrank breaks the response off.
pub(super) fn new(source: Source, part: Range<u64>) -> Body {
    if let Source::Memory(content) = &source {
        return Body::from(content.slice(part.start as usize..part.end as usize));
    }
    Body::from_stream(stream::unfold((source, part), |(source, part)| async move {
        if part.is_empty() {
            return None;
        }
        match source.read(part.clone()).await {
            Ok(block) => {
                let next = part.start + block.len() as u64..part.end;
                Some((Ok(block), (source, next)))
            }
            Err(error) => Some((Err(error), (source, part.end..part.end))),
        }
    }))
}
