//! Files of worlds: small ones in memory, as long as they are unchanged on the disk.

use std::hash::{Hash, Hasher};
use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime};

use axum::http::HeaderValue;
use bytes::Bytes;
use quick_cache::{Weighter, sync::Cache};

use super::body::Source;
use super::encoding::Coding;
use super::media;
use super::priority::{Place, Turns};
use super::worlds::Files;
use crate::clock;

/// Largest file that is kept in memory, bytes.
pub const KEPT_BYTES_MAX: u64 = 2 << 20;
/// For so long what lies under an address that never changes is not compared with the disk again.
pub const FRESH: Duration = Duration::from_secs(1);
/// What an entry takes besides its content, bytes, roughly.
const ENTRY_BYTES: u64 = 512;

/// A file of a world as it is served; its name with the ending of its coding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) world: &'static str,
    pub(super) name: String,
    /// `None` for the file under its own name, which may have such an ending too.
    pub(super) coding: Option<Coding>,
}

impl Hash for Key {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // A world's name lives at one place for as long as the process.
        self.world.as_ptr().hash(state);
        self.name.hash(state);
        self.coding.hash(state);
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
    /// When it was last compared with the disk, ns of the store's time.
    checked_ns: AtomicU64,
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
    begun: Instant,
}

impl Store {
    /// With room for `bytes`.
    pub fn new(bytes: u64) -> Store {
        let entries = usize::try_from(bytes >> 14).unwrap_or(0).max(16);
        Store { kept: Cache::with_weighter(entries, bytes, ByBytes), begun: clock::now() }
    }

    /// The file if it is in memory and was compared with the disk less than [`FRESH`] before `now`.
    pub(super) fn fresh(&self, key: &Key, now: Instant) -> Option<Arc<Stored>> {
        let now = clock::nanos(self.begun, now);
        let age = |stored: &Stored| now.saturating_sub(stored.checked_ns.load(Ordering::Relaxed));
        self.kept.get(key).filter(|stored| u128::from(age(stored)) < FRESH.as_nanos())
    }

    /// The file if it is in memory and has still this date and length.
    pub(super) fn get(&self, key: &Key, modified: SystemTime, length: u64) -> Option<Arc<Stored>> {
        let stored = self.kept.get(key).filter(|stored| stored.modified == modified && stored.length == length)?;
        stored.checked_ns.store(clock::nanos(self.begun, clock::now()), Ordering::Relaxed);
        Some(stored)
    }

    /// Opens the file, and keeps it if it is small. `plain` is its name without the ending of its coding.
    pub(super) async fn load(
        &self,
        files: &'static Files,
        key: Key,
        plain: &str,
        turns: &Arc<Turns>,
        place: Place,
    ) -> std::io::Result<Arc<Stored>> {
        let media_type = media::of(plain);
        let (name, coding) = (key.name.clone(), key.coding);
        let asked_at = clock::now();
        let turn = turns.turn(place).await;
        let read = tokio::task::spawn_blocking(move || read(files, &name, media_type, coding));
        let mut stored = read.await.map_err(std::io::Error::other)??;
        drop(turn);
        *stored.checked_ns.get_mut() = clock::nanos(self.begun, asked_at);
        let stored = Arc::new(stored);
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
    Ok(Stored { source, length, modified, etag, media_type, checked_ns: AtomicU64::new(0), inner_coding })
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
