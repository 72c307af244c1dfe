//! Files of worlds: small ones in memory, as long as they are unchanged on the disk.

use std::hash::{Hash, Hasher};
use std::io::Read;
use std::sync::Arc;
use std::time::SystemTime;

use axum::http::HeaderValue;
use bytes::Bytes;
use quick_cache::{Weighter, sync::Cache};

use super::body::Source;
use super::encoding::Coding;
use super::media;
use super::priority::{Place, Turns};
use super::worlds::Files;

/// Largest file that is kept in memory, bytes.
pub const KEPT_BYTES_MAX: u64 = 2 << 20;
/// What an entry takes besides its content, bytes, roughly.
const ENTRY_BYTES: u64 = 512;

/// A file of a world; its name with the ending of its coding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) world: &'static str,
    pub(super) name: String,
}

impl Hash for Key {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // A world's name lives at one place for as long as the process.
        self.world.as_ptr().hash(state);
        self.name.hash(state);
    }
}

/// A file as it is served.
#[derive(Debug)]
pub(super) struct Stored {
    pub(super) source: Source,
    pub(super) length: u64,
    pub(super) modified: SystemTime,
    pub(super) etag: HeaderValue,
    pub(super) media_type: HeaderValue,
    /// gzip, if the file is stored so under its plain name, as tilesets often are.
    pub(super) inner_coding: Option<Coding>,
}

#[derive(Clone, Debug)]
struct ByBytes;

impl Weighter<Key, Arc<Stored>> for ByBytes {
    fn weight(&self, key: &Key, stored: &Arc<Stored>) -> u64 {
        ENTRY_BYTES + key.name.len() as u64 + stored.length
    }
}

/// Files in memory, at most so many bytes; those used least go first.
pub struct Store {
    kept: Cache<Key, Arc<Stored>, ByBytes>,
}

impl Store {
    /// With room for `bytes`.
    pub fn new(bytes: u64) -> Store {
        Store { kept: Cache::with_weighter(usize::try_from(bytes >> 14).unwrap_or(0).max(16), bytes, ByBytes) }
    }

    /// The file if it is in memory and has still this date and length.
    pub(super) fn get(&self, key: &Key, modified: SystemTime, length: u64) -> Option<Arc<Stored>> {
        self.kept.get(key).filter(|stored| stored.modified == modified && stored.length == length)
    }

    /// Opens the file, and keeps it if it is small. `plain` is its name without the ending of its coding.
    pub(super) async fn load(
        &self,
        files: &'static Files,
        key: Key,
        plain: &str,
        coding: Option<Coding>,
        turns: &Arc<Turns>,
        place: Place,
    ) -> std::io::Result<Arc<Stored>> {
        let media_type = media::of(plain);
        let name = key.name.clone();
        let turn = turns.turn(place).await;
        let read = tokio::task::spawn_blocking(move || read(files, &name, media_type, coding));
        let stored = Arc::new(read.await.map_err(std::io::Error::other)??);
        drop(turn);
        if matches!(stored.source, Source::Memory(_)) {
            self.kept.insert(key, stored.clone());
        }
        Ok(stored)
    }
}

fn read(files: &Files, name: &str, media_type: HeaderValue, coding: Option<Coding>) -> std::io::Result<Stored> {
    let mut file = files.folder.open(name)?.into_std();
    let metadata = file.metadata()?;
    let (length, modified) = (metadata.len(), metadata.modified()?);
    let (source, inner_coding);
    if length <= KEPT_BYTES_MAX {
        let mut content = Vec::with_capacity(length as usize);
        (&mut file).take(length).read_to_end(&mut content)?;
        if content.len() as u64 != length {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        inner_coding = inner(name, &content, coding);
        source = Source::Memory(Bytes::from(content));
    } else {
        let mut head = [0; 2];
        file.read_exact(&mut head)?;
        inner_coding = inner(name, &head, coding);
        source = Source::File(Arc::new(file));
    }
    let etag = etag(modified, length, coding);
    Ok(Stored { source, length, modified, etag, media_type, inner_coding })
}

/// gzip, if that is what the content begins with and its name does not say.
fn inner(name: &str, head: &[u8], coding: Option<Coding>) -> Option<Coding> {
    (coding.is_none() && head.starts_with(b"\x1F\x8B") && !name.ends_with(".gz")).then_some(Coding::Gzip)
}

/// A strong entity tag: nanoseconds of the last change and length, hexadecimal, and the coding. Two changes within one tick of
/// the system's clock (some milliseconds) that leave the length share a tag.
fn etag(modified: SystemTime, length: u64, coding: Option<Coding>) -> HeaderValue {
    let since = modified.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_nanos();
    let suffix = coding.map_or("", Coding::suffix).replace('.', "-");
    HeaderValue::try_from(format!("\"{since:x}-{length:x}{suffix}\""))
        .unwrap_or_else(|_| HeaderValue::from_static("\"\""))
}
