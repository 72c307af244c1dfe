//! Bodies of responses: from memory at once; from the disk, made up, or over a link in blocks.

use std::fs::File;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use axum::body::Body;
use bytes::Bytes;
use foresight_scheduler::lod_tree::RepId;
use futures_util::stream;
use tokio::sync::OwnedSemaphorePermit;

use super::connection::Activity;
use super::filler;
use super::metrics::Metrics;
use super::priority::{Place, Turns};
use super::shaping::Transfer;

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
    /// Bytes of the content: all if they are in memory, else at most a block of them and at least one. `part` is not empty.
    async fn read(&self, part: Range<u64>, turns: &Arc<Turns>, place: Place) -> std::io::Result<Bytes> {
        let end = part.end.min(part.start.saturating_add(BLOCK_BYTES));
        match self {
            Source::Memory(content) => Ok(content.slice(part.start as usize..part.end as usize)),
            Source::Filler(rep) => Ok(filler::bytes(*rep, part.start, end)),
            Source::File(file) => {
                let _turn = turns.turn(place).await;
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

/// A body on its way.
pub(super) struct Delivery {
    pub(super) source: Source,
    /// Bytes of the content that are still to be sent.
    pub(super) part: Range<u64>,
    pub(super) transfer: Option<Transfer>,
    pub(super) turns: Arc<Turns>,
    pub(super) place: Place,
    pub(super) metrics: Arc<Metrics>,
    pub(super) activity: Option<Arc<Activity>>,
    /// When the request came.
    pub(super) asked_at: Instant,
    /// One of those that may be on their way.
    pub(super) _permit: Option<OwnedSemaphorePermit>,
}

/// Why a body breaks off.
#[derive(Debug, thiserror::Error)]
enum BodyError {
    #[error("the link lost the rest of the response")]
    Lost,
    #[error("the content cannot be read: {0}")]
    Read(#[from] std::io::Error),
}

impl Delivery {
    /// As a body. What is in memory and crosses no link is handed over at once, and counts as sent then.
    pub(super) fn into_body(self) -> Body {
        match &self.source {
            Source::Memory(content) if self.transfer.is_none() => {
                let bytes = content.slice(self.part.start as usize..self.part.end as usize);
                self.metrics.sent(bytes.len() as u64);
                self.metrics.completed(self.asked_at);
                Body::from(bytes)
            }
            _ => Body::from_stream(stream::unfold(Some(Streamed::new(self)), |streamed| async move {
                let mut streamed = streamed?;
                match streamed.next().await {
                    Ok(None) => None,
                    Ok(Some(block)) => Some((Ok(block), Some(streamed))),
                    Err(error) => Some((Err(error), None)),
                }
            })),
        }
    }
}

/// A body that is sent piece by piece; counted as cancelled if it is dropped before its end.
struct Streamed {
    delivery: Delivery,
    /// Read and not sent yet.
    block: Bytes,
    sent: u64,
    over: bool,
}

impl Streamed {
    fn new(delivery: Delivery) -> Streamed {
        delivery.metrics.bodies_active.inc();
        Streamed { delivery, block: Bytes::new(), sent: 0, over: false }
    }

    async fn next(&mut self) -> Result<Option<Bytes>, BodyError> {
        let _owed = self.delivery.activity.as_ref().map(Activity::owe);
        match self.piece().await {
            Ok(Some(piece)) => {
                self.sent += piece.len() as u64;
                self.delivery.metrics.sent(piece.len() as u64);
                Ok(Some(piece))
            }
            Ok(None) => {
                self.over = true;
                self.delivery.metrics.completed(self.delivery.asked_at);
                Ok(None)
            }
            Err(error) => {
                self.over = true;
                self.delivery.metrics.bodies_failed.inc();
                Err(error)
            }
        }
    }

    async fn piece(&mut self) -> Result<Option<Bytes>, BodyError> {
        let mut allowed = u64::MAX;
        if let Some(transfer) = &mut self.delivery.transfer {
            let released = transfer.released(self.sent).await;
            allowed = released.bytes.saturating_sub(self.sent);
            if allowed == 0 && released.breaks {
                transfer.settle().await;
                return Err(BodyError::Lost);
            }
        }
        if self.block.is_empty() {
            let part = &mut self.delivery.part;
            if part.is_empty() {
                return Ok(None);
            }
            self.block = self.delivery.source.read(part.clone(), &self.delivery.turns, self.delivery.place).await?;
            part.start += self.block.len() as u64;
        }
        let length = usize::try_from(allowed).unwrap_or(usize::MAX).min(self.block.len());
        Ok(Some(self.block.split_to(length)))
    }
}

impl Drop for Streamed {
    fn drop(&mut self) {
        let metrics = &self.delivery.metrics;
        metrics.bodies_active.dec();
        // Whoever reads to the last byte need not ask for the end.
        let complete = self.block.is_empty() && self.delivery.part.is_empty();
        if !self.over && complete {
            metrics.completed(self.delivery.asked_at);
        } else if !self.over {
            metrics.bodies_cancelled.inc();
            metrics.cancelled_bytes.inc_by(self.sent);
        }
    }
}
