//! Tilesets on a server. Every file is fetched once and in full: bounds and bytes in memory stand in the contents
//! themselves. Only the origin of the root tileset is asked, redirects included. Queries in the addresses inside are not
//! sent.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rayon::ThreadPool;
use ureq::Agent;
use ureq::http::{StatusCode, Uri, header};

use super::{Source, Tiles3dError, load_from};
use crate::import::tiles3d::limits::MAX_TILES;
use crate::specification::Progress;
use crate::world::World;

/// Requests at once.
const PARALLEL: usize = 8;
/// Most bytes of one file, as sent.
const MAX_FILE: u64 = 1 << 29;
/// Most bytes of all files together.
const MAX_BYTES: u64 = 1 << 32;
/// Most files.
const MAX_FILES: u64 = 1 << 18;
/// Most redirects of one file.
const MAX_REDIRECTS: usize = 5;
/// Failures other than a missing file, after which no more is asked.
const MAX_FAILURES: u64 = 8;
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
const FILE_TIMEOUT: Duration = Duration::from_secs(120);

/// A folder of a server.
pub(crate) struct Http {
    agent: Agent,
    /// Scheme and host, without a slash at its end.
    origin: String,
    /// Path of the folder, with a slash at both ends.
    folder: String,
    pool: ThreadPool,
    /// Files that were fetched to see what they are.
    seen: Mutex<BTreeMap<String, Vec<u8>>>,
    files: AtomicU64,
    bytes: AtomicU64,
    failures: AtomicU64,
    progress: Progress,
}

impl std::fmt::Debug for Http {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Http").field("origin", &self.origin).field("folder", &self.folder).finish_non_exhaustive()
    }
}

/// Opens the world whose root tileset is at `url`, `http://…/tileset.json` or `https://…`; an address that ends in a slash
/// means the `tileset.json` there.
pub fn open(url: &str, progress: Progress) -> Result<World, Tiles3dError> {
    let fault = |source| Tiles3dError::Io { file: PathBuf::from(url), source };
    let (http, name) = Http::new(url, progress).map_err(fault)?;
    let mut world = load_from(Source::Http(http), None, &name, MAX_TILES, false)?.world;
    let end = url.split(['?', '#']).next().unwrap_or(url).trim_end_matches('/');
    let parts = end.rsplit('/').find(|part| !part.ends_with(".json"));
    world.name = parts.unwrap_or("tileset").to_owned();
    Ok(world)
}

fn invalid(text: String) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, text)
}

impl Http {
    fn new(url: &str, progress: Progress) -> io::Result<(Http, String)> {
        let expected = || invalid("not an address; expected http://host/path/tileset.json".to_owned());
        let uri: Uri = url.split('#').next().unwrap_or(url).parse().map_err(|_| expected())?;
        let (Some(scheme), Some(authority)) = (uri.scheme_str(), uri.authority()) else { return Err(expected()) };
        if !matches!(scheme, "http" | "https") || authority.as_str().contains('@') {
            return Err(expected());
        }
        let (folder, name) = uri.path().rsplit_once('/').ok_or_else(expected)?;
        let name = if name.is_empty() { "tileset.json" } else { name };
        let config = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .timeout_connect(Some(CONNECT_TIMEOUT))
            .timeout_global(Some(FILE_TIMEOUT))
            .max_idle_connections_per_host(PARALLEL)
            .accept_encoding("gzip")
            .user_agent(concat!("foresight/", env!("CARGO_PKG_VERSION")))
            .build();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(PARALLEL).build().map_err(io::Error::other)?;
        let http = Http {
            agent: config.new_agent(),
            origin: format!("{scheme}://{authority}"),
            folder: format!("{folder}/"),
            pool,
            seen: Mutex::new(BTreeMap::new()),
            files: AtomicU64::new(0),
            bytes: AtomicU64::new(0),
            failures: AtomicU64::new(0),
            progress,
        };
        // Names inside are plain text; what the address has encoded is decoded here once.
        let name = super::resolve::percent_decoded(name).ok_or_else(expected)?;
        Ok((http, name))
    }

    /// The address of a file of the folder.
    pub(crate) fn url(&self, file: &str) -> String {
        format!("{}{}{}", self.origin, self.folder, percent_encoded(file))
    }

    /// The bytes of a file as they were sent.
    pub(crate) fn read(&self, file: &str) -> io::Result<Vec<u8>> {
        let seen = self.seen.lock().map_err(|_| invalid("another request panicked".to_owned()))?.remove(file);
        match seen {
            Some(bytes) => Ok(bytes),
            None => self.fetch(file),
        }
    }

    /// The first byte of a file, which is kept for the next [`Http::read`].
    pub(crate) fn first_byte(&self, file: &str) -> Option<u8> {
        let bytes = self.read(file).ok()?;
        let first = bytes.first().copied();
        self.seen.lock().ok()?.insert(file.to_owned(), bytes);
        first
    }

    pub(crate) fn in_parallel<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.pool.install(work)
    }

    /// What was downloaded, in words.
    pub(crate) fn sum(&self) -> String {
        let (files, bytes) = (self.files.load(Ordering::Relaxed), self.bytes.load(Ordering::Relaxed));
        format!("{files} files of {bytes} bytes were downloaded to open this world; sizes are as they were sent")
    }

    fn fetch(&self, file: &str) -> io::Result<Vec<u8>> {
        let failures = self.failures.load(Ordering::Relaxed);
        if failures >= MAX_FAILURES {
            return Err(invalid(format!("not asked for after {failures} failures of the server")));
        }
        if self.files.fetch_add(1, Ordering::Relaxed) >= MAX_FILES {
            return Err(invalid(format!("more than {MAX_FILES} files; expected at most that")));
        }
        let fetched = self.follow(self.url(file));
        match &fetched {
            Ok(bytes) => {
                let sum = self.bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed) + bytes.len() as u64;
                (self.progress)(self.files.load(Ordering::Relaxed), sum);
            }
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(_) => drop(self.failures.fetch_add(1, Ordering::Relaxed)),
        }
        fetched
    }

    fn follow(&self, mut url: String) -> io::Result<Vec<u8>> {
        for _ in 0..=MAX_REDIRECTS {
            let room = MAX_BYTES.saturating_sub(self.bytes.load(Ordering::Relaxed)).min(MAX_FILE);
            if room == 0 {
                return Err(invalid(format!("more than {MAX_BYTES} bytes in all; expected at most that")));
            }
            let mut response = self.agent.get(&url).call().map_err(ureq::Error::into_io)?;
            let status = response.status();
            if status.is_redirection() {
                let target = response.headers().get(header::LOCATION).and_then(|value| value.to_str().ok());
                let target = target.ok_or_else(|| invalid(format!("status {status} without an address")))?;
                url = self.redirected(&url, target)?;
                continue;
            }
            if status != StatusCode::OK {
                let gone = matches!(status, StatusCode::NOT_FOUND | StatusCode::GONE);
                let kind = if gone { ErrorKind::NotFound } else { ErrorKind::InvalidData };
                return Err(io::Error::new(kind, format!("status {status}; expected 200")));
            }
            let encoding = response.headers().get(header::CONTENT_ENCODING).map(|value| value.as_bytes().to_vec());
            if encoding.as_deref().is_some_and(|encoding| !matches!(encoding, b"gzip" | b"x-gzip" | b"identity")) {
                let encoding = encoding.as_deref().map(String::from_utf8_lossy).unwrap_or_default();
                return Err(invalid(format!("encoded as {encoding:?}; expected gzip or nothing")));
            }
            let body = response.body_mut().with_config().limit(room).read_to_vec();
            return body.map_err(|error| match error {
                ureq::Error::BodyExceedsLimit(limit) => {
                    invalid(format!("more than {limit} bytes; expected at most that"))
                }
                other => other.into_io(),
            });
        }
        Err(invalid(format!("more than {MAX_REDIRECTS} redirects; expected at most that")))
    }

    /// Where a redirect leads: an address of the same origin.
    fn redirected(&self, from: &str, to: &str) -> io::Result<String> {
        let to = to.split('#').next().unwrap_or(to);
        if to.starts_with('/') && !to.starts_with("//") {
            return Ok(format!("{}{to}", self.origin));
        }
        let inside = to.strip_prefix(&self.origin).is_some_and(|rest| rest.starts_with('/'));
        if inside {
            return Ok(to.to_owned());
        }
        if to.contains("//") || to.contains(':') {
            return Err(invalid(format!("redirected to {to:?}; expected an address of {}", self.origin)));
        }
        let base = from.split('?').next().unwrap_or(from);
        let path = base.strip_prefix(&self.origin).unwrap_or("/");
        let mut parts: Vec<&str> = path.split('/').collect();
        parts.pop();
        for part in to.split('/') {
            match part {
                "." => {}
                // The root is its own parent.
                ".." if parts.len() > 1 => drop(parts.pop()),
                ".." => {}
                part => parts.push(part),
            }
        }
        Ok(format!("{}{}", self.origin, parts.join("/")))
    }
}

/// A path with everything encoded that an address may not hold.
fn percent_encoded(path: &str) -> String {
    let mut encoded = String::with_capacity(path.len());
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._~/!$&'()*+,;=:@".contains(&byte) {
            encoded.push(char::from(byte));
        } else {
            encoded.push_str(&format!("%{byte:02X}"));
        }
    }
    encoded
}
