//! Content of worlds: which file or filler answers for an address, and the response to a conditional or partial request.

use std::sync::Arc;
use std::time::{Instant, SystemTime};

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{self, HeaderMap, HeaderName, HeaderValue};
use axum::http::request::Parts;
use axum::http::{Method, StatusCode};
use axum::response::{IntoResponse, Response};
use foresight_scheduler::lod_tree::RepId;
use headers::{HeaderMapExt, IfMatch, IfModifiedSince, IfNoneMatch, IfUnmodifiedSince, LastModified};

use super::body::{self, Source};
use super::encoding::{self, Coding};
use super::media;
use super::path;
use super::problem::Problem;
use super::range::{self, Asked};
use super::state::AppState;
use super::store::{Key, Stored};
use super::worlds::{Files, HostedWorld};
use crate::clock;

/// What caches may do with a response.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Caching {
    /// The address holds the world's identity.
    Immutable,
    /// Asked for again at each use.
    Revalidated,
}

impl Caching {
    fn header(self) -> HeaderValue {
        HeaderValue::from_static(match self {
            Caching::Immutable => "public, max-age=31536000, immutable",
            Caching::Revalidated => "no-cache",
        })
    }
}

/// What answers for an address.
struct Found {
    source: Source,
    length: u64,
    etag: HeaderValue,
    modified: Option<SystemTime>,
    media_type: HeaderValue,
    coding: Option<Coding>,
    /// Whether another coding could have been chosen.
    negotiated: bool,
    /// For `Server-Timing`.
    from: &'static str,
    rep: Option<RepId>,
}

/// `/worlds/{name}/files/{path}`: content under an address that is asked for again at each use.
pub(super) async fn revalidated(State(state): State<Arc<AppState>>, request: Request) -> Response {
    respond(&state, &request.into_parts().0, Caching::Revalidated).await.unwrap_or_else(IntoResponse::into_response)
}

/// `/worlds/{name}/{identity}/{path}`: content under an address that never changes.
pub(super) async fn immutable(State(state): State<Arc<AppState>>, request: Request) -> Response {
    respond(&state, &request.into_parts().0, Caching::Immutable).await.unwrap_or_else(IntoResponse::into_response)
}

async fn respond(state: &AppState, request: &Parts, caching: Caching) -> Result<Response, Problem> {
    let asked_at = clock::now();
    // As routed: /worlds/NAME/(files|IDENTITY)/PATH.
    let mut parts = request.uri.path().splitn(5, '/').skip(2);
    let (Some(name), Some(version), Some(raw)) = (parts.next(), parts.next(), parts.next()) else {
        return Err(Problem::not_found("expected /worlds/NAME/IDENTITY/PATH"));
    };
    let world = state.world(name)?;
    if caching == Caching::Immutable && version != world.identity() {
        return Err(Problem::not_found(format!(
            "world `{}` has no content of identity `{version}`; its content lies below {}",
            world.name(),
            world.facts.base
        )));
    }
    let address = path::decode(raw).ok_or_else(|| Problem::not_found("no content has such a path"))?;
    let found = find(state, world, &address, &request.headers).await?;
    respond_with(state, found, request, caching, asked_at).await
}

/// The file, a coding of it that the client accepts, or the filler.
async fn find(
    state: &AppState,
    world: &'static HostedWorld,
    address: &str,
    headers: &HeaderMap,
) -> Result<Found, Problem> {
    let rep = || world.representation(address);
    if let Some(files) = world.files() {
        let file = files.file(address);
        let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok());
        for coding in encoding::accepted(accepted.unwrap_or_default()) {
            if let Some(found) = file_found(state, world, files, &file, Some(coding)).await? {
                return Ok(Found { rep: rep(), ..found });
            }
        }
        if let Some(found) = file_found(state, world, files, &file, None).await? {
            return Ok(Found { rep: rep(), ..found });
        }
    }
    let rep = rep().filter(|_| world.facts.content != "files");
    let rep = rep.ok_or_else(|| Problem::not_found(format!("world `{}` has no `{address}`", world.name())))?;
    let etag = format!("\"{}-{}\"", &world.identity()[..16], rep.0);
    Ok(Found {
        source: Source::Filler(rep),
        length: world.world.tree.wire_bytes(rep),
        etag: HeaderValue::try_from(etag).map_err(|_| Problem::not_found("no such content"))?,
        modified: None,
        media_type: media::of(address),
        coding: None,
        negotiated: false,
        from: "filler",
        rep: Some(rep),
    })
}

/// A file of a world, from memory if it is there and unchanged; `None` if there is no such file.
async fn file_found(
    state: &AppState,
    world: &'static HostedWorld,
    files: &'static Files,
    file: &str,
    coding: Option<Coding>,
) -> Result<Option<Found>, Problem> {
    let name = format!("{file}{}", coding.map_or("", Coding::suffix));
    // Asked of the system here rather than on another thread: a handful of microseconds on a local disk.
    let Ok(metadata) = files.folder.metadata(&name) else { return Ok(None) };
    let Ok(modified) = metadata.modified().map(cap_std::time::SystemTime::into_std) else { return Ok(None) };
    if !metadata.is_file() {
        return Ok(None);
    }
    let length = metadata.len();
    let key = Key { world: world.name(), name };
    let found = |stored: &Stored, from| Found {
        source: stored.source.clone(),
        length: stored.length,
        etag: stored.etag.clone(),
        modified: Some(stored.modified),
        media_type: stored.media_type.clone(),
        coding: coding.or(stored.inner_coding),
        negotiated: true,
        from,
        rep: None,
    };
    if let Some(stored) = state.store.get(&key, modified, length) {
        state.metrics.store_hits.inc();
        return Ok(Some(found(&stored, "memory")));
    }
    state.metrics.store_misses.inc();
    match state.store.load(files, key, file, coding).await {
        Ok(stored) => Ok(Some(found(&stored, "disk"))),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => {
            tracing::error!(world = world.name(), file, %error, "a file cannot be read");
            Err(Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "the file cannot be read"))
        }
    }
}

async fn respond_with(
    state: &AppState,
    found: Found,
    request: &Parts,
    caching: Caching,
    asked_at: Instant,
) -> Result<Response, Problem> {
    let asked = &request.headers;
    let mut response = Response::new(Body::empty());
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, caching.header());
    headers.insert(header::ETAG, found.etag.clone());
    let modified = found.modified.map(LastModified::from);
    if let Some(modified) = modified {
        headers.typed_insert(modified);
    }
    if found.negotiated {
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    }
    let status = match precondition(asked, &found) {
        Some(status) => status,
        None => {
            headers.insert(header::CONTENT_TYPE, found.media_type.clone());
            headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
            if let Some(coding) = found.coding {
                headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(coding.name()));
            }
            StatusCode::OK
        }
    };
    let mut part = 0..0;
    let mut final_status = status;
    if status == StatusCode::OK {
        part = 0..found.length;
        match wanted_range(asked, &response, found.length) {
            Asked::Whole => {}
            Asked::Part(range) => {
                let content_range = format!("bytes {}-{}/{}", range.start, range.end - 1, found.length);
                response.headers_mut().insert(header::CONTENT_RANGE, ascii(content_range));
                final_status = StatusCode::PARTIAL_CONTENT;
                part = range;
            }
            Asked::Unsatisfiable => {
                let problem = Problem::new(
                    StatusCode::RANGE_NOT_SATISFIABLE,
                    format!("no byte of that range; the content has {}", found.length),
                );
                return Err(problem.with(header::CONTENT_RANGE, ascii(format!("bytes */{}", found.length))));
            }
        }
        response.headers_mut().insert(header::CONTENT_LENGTH, HeaderValue::from(part.end - part.start));
    }
    *response.status_mut() = final_status;
    if status == StatusCode::PRECONDITION_FAILED {
        return Err(Problem::new(status, "the content is not the one that the request is about"));
    }
    let has_body = status == StatusCode::OK && request.method != Method::HEAD;
    state.metrics.content(final_status);
    let elapsed = clock::now().saturating_duration_since(asked_at).as_secs_f64() * 1e3;
    let timing = format!("content;desc={};dur={elapsed:.3}", found.from);
    response.headers_mut().insert(HeaderName::from_static("server-timing"), ascii(timing));
    if has_body {
        *response.body_mut() = body::new(found.source, part);
    }
    let _ = found.rep;
    Ok(response)
}

/// Only digits, letters and punctuation are ever put in.
fn ascii(text: String) -> HeaderValue {
    HeaderValue::try_from(text).unwrap_or_else(|_| HeaderValue::from_static(""))
}

/// 304 or 412 as RFC 9110, section 13.2.2, orders the conditions.
fn precondition(asked: &HeaderMap, found: &Found) -> Option<StatusCode> {
    let etag = || found.etag.to_str().ok().and_then(|text| text.parse::<headers::ETag>().ok());
    if let Some(condition) = asked.typed_get::<IfMatch>() {
        if !etag().is_some_and(|etag| condition.precondition_passes(&etag)) {
            return Some(StatusCode::PRECONDITION_FAILED);
        }
    } else if let (Some(condition), Some(modified)) = (asked.typed_get::<IfUnmodifiedSince>(), found.modified)
        && !condition.precondition_passes(modified)
    {
        return Some(StatusCode::PRECONDITION_FAILED);
    }
    if let Some(condition) = asked.typed_get::<IfNoneMatch>() {
        let passes = etag().is_none_or(|etag| condition.precondition_passes(&etag));
        return (!passes).then_some(StatusCode::NOT_MODIFIED);
    }
    match (asked.typed_get::<IfModifiedSince>(), found.modified) {
        (Some(condition), Some(modified)) if !condition.is_modified(modified) => Some(StatusCode::NOT_MODIFIED),
        _ => None,
    }
}

/// `Range`, unless `If-Range` says that the client holds parts of something else. Both validators are compared byte by byte:
/// entity tags strongly, and dates exactly.
fn wanted_range(asked: &HeaderMap, response: &Response, length: u64) -> Asked {
    let Some(range) = asked.get(header::RANGE) else { return Asked::Whole };
    if let Some(condition) = asked.get(header::IF_RANGE) {
        let held = [header::ETAG, header::LAST_MODIFIED].map(|name| response.headers().get(name));
        if !held.contains(&Some(condition)) {
            return Asked::Whole;
        }
    }
    range::parse(range.as_bytes(), length)
}
