//! Content of worlds: which file or filler answers for an address, and the response to a conditional or partial request.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;
use std::time::SystemTime;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::header::{self, HeaderMap, HeaderName, HeaderValue};
use axum::http::request::Parts;
use axum::http::{Method, StatusCode};
use axum::response::{IntoResponse, Response};
use foresight_scheduler::lod_tree::RepId;
use headers::{HeaderMapExt, IfModifiedSince, IfUnmodifiedSince, LastModified};
use percent_encoding::percent_decode_str;

use super::body::{Delivery, Source};
use super::connection::Activity;
use super::encoding::{self, Coding};
use super::entity_tag::{self, Comparison};
use super::media;
use super::path;
use super::priority::Priority;
use super::problem::Problem;
use super::range::{self, Asked};
use super::state::AppState;
use super::store::{Key, Stored};
use super::worlds::{Files, HostedWorld};
use crate::clock;

const SERVER_TIMING: HeaderName = HeaderName::from_static("server-timing");
const PRIORITY: HeaderName = HeaderName::from_static("priority");

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

/// Content under an address that is asked for again at each use
///
/// Conditions, a range of bytes, `Accept-Encoding` and `Priority` are honoured.
#[utoipa::path(
    get, path = "/worlds/{name}/files/{path}", tag = "content",
    params(
        ("name" = String, Path, description = "Name of the world"),
        ("path" = String, Path, description = "Address within the world; may hold slashes"),
        ("session" = Option<String>, Query, description = "Session whose link the response crosses; or the field Foresight-Session"),
    ),
    responses(
        (status = 200, description = "All of it", content_type = "application/octet-stream"),
        (status = 206, description = "A range of it", content_type = "application/octet-stream"),
        (status = 304, description = "The client has it"),
        (status = 404, body = Problem, content_type = "application/problem+json"),
        (status = 412, body = Problem, content_type = "application/problem+json"),
        (status = 416, body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn revalidated(State(state): State<Arc<AppState>>, request: Request) -> Response {
    respond(&state, &request.into_parts().0, Caching::Revalidated).await.unwrap_or_else(IntoResponse::into_response)
}

/// Content under an address that never changes
///
/// May be kept for a year. Conditions, a range of bytes, `Accept-Encoding` and `Priority` are honoured.
#[utoipa::path(
    get, path = "/worlds/{name}/{identity}/{path}", tag = "content",
    params(
        ("name" = String, Path, description = "Name of the world"),
        ("identity" = String, Path, description = "Identity of the world"),
        ("path" = String, Path, description = "Address within the world; may hold slashes"),
        ("session" = Option<String>, Query, description = "Session whose link the response crosses; or the field Foresight-Session"),
    ),
    responses(
        (status = 200, description = "All of it", content_type = "application/octet-stream"),
        (status = 206, description = "A range of it", content_type = "application/octet-stream"),
        (status = 304, description = "The client has it"),
        (status = 404, body = Problem, content_type = "application/problem+json"),
        (status = 412, body = Problem, content_type = "application/problem+json"),
        (status = 416, body = Problem, content_type = "application/problem+json"),
        (status = 503, body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn immutable(State(state): State<Arc<AppState>>, request: Request) -> Response {
    respond(&state, &request.into_parts().0, Caching::Immutable).await.unwrap_or_else(IntoResponse::into_response)
}

async fn respond(state: &AppState, request: &Parts, caching: Caching) -> Result<Response, Problem> {
    let asked_at = clock::now();
    let found = look_up(state, request, caching).await;
    let prepared = found.and_then(|found| prepare(found, request, caching));
    let (length, rep) = match &prepared {
        Ok(Prepared { body: Some(body), rep, .. }) => (body.part.end - body.part.start, *rep),
        _ => (0, None),
    };
    let crosses = length > 0 && request.method != Method::HEAD;
    let transfer = state.links.as_ref().map(|links| {
        let session = session(request);
        links.start(
            session.as_deref(),
            rep.filter(|_| crosses).map(|rep| rep.0),
            if crosses { length } else { 0 },
            asked_at,
        )
    });
    if let Some(transfer) = &transfer {
        transfer.first_byte().await;
    }
    let conditional =
        request.headers.contains_key(header::IF_NONE_MATCH) || request.headers.contains_key(header::IF_MODIFIED_SINCE);
    let Prepared { mut response, body, from, .. } = match prepared {
        Ok(prepared) => prepared,
        Err(problem) => {
            state.metrics.content(StatusCode::from_u16(problem.status).unwrap_or_default(), conditional);
            return Err(problem);
        }
    };
    let priority = Priority::of(&request.headers);
    let elapsed_ms = clock::now().saturating_duration_since(asked_at).as_secs_f64() * 1e3;
    let headers = response.headers_mut();
    headers.insert(SERVER_TIMING, ascii(format!("content;desc={from};dur={elapsed_ms:.3}")));
    if request.headers.contains_key(PRIORITY) {
        headers.insert(PRIORITY, priority.header());
    }
    if let Some(body) = body.filter(|_| crosses) {
        let at_once = matches!(body.source, Source::Memory(_)) && transfer.is_none();
        let permit = if at_once { None } else { Some(state.bodies.clone().try_acquire_owned()) };
        let Ok(permit) = permit.transpose() else {
            state.metrics.refused("bodies");
            return Err(Problem::busy("as many contents are on their way as may be", 1));
        };
        state.metrics.body_size.observe(length as f64);
        *response.body_mut() = Delivery {
            source: body.source,
            part: body.part,
            transfer,
            turns: state.turns.clone(),
            place: state.turns.place(priority),
            metrics: state.metrics.clone(),
            activity: request.extensions.get::<Arc<Activity>>().cloned(),
            asked_at,
            _permit: permit,
        }
        .into_body();
    }
    state.metrics.content(response.status(), conditional);
    Ok(response)
}

/// The session that a request belongs to: the field `Foresight-Session`, else `session=` in the query.
fn session(request: &Parts) -> Option<Cow<'_, str>> {
    if let Some(value) = request.headers.get("foresight-session") {
        return value.to_str().ok().map(Cow::Borrowed);
    }
    let mut pairs = request.uri.query()?.split('&').filter_map(|pair| pair.split_once('='));
    let (_, value) = pairs.find(|(key, _)| *key == "session")?;
    percent_decode_str(value).decode_utf8().ok()
}

/// What answers, for an address as routed: `/worlds/NAME/(files|IDENTITY)/PATH`.
async fn look_up(state: &AppState, request: &Parts, caching: Caching) -> Result<Found, Problem> {
    let mut parts = request.uri.path().splitn(5, '/').skip(2);
    let (Some(name), Some(version), Some(raw)) = (parts.next(), parts.next(), parts.next()) else {
        return Err(Problem::not_found("expected /worlds/NAME/IDENTITY/PATH"));
    };
    let world = state.world(name)?;
    if caching == Caching::Immutable && version != world.identity() {
        return Err(Problem::not_found(format!(
            "world `{}` has no content of that identity; its content lies below {}",
            world.name(),
            world.facts.base
        )));
    }
    let address = path::decode(raw).ok_or_else(|| Problem::not_found("no content has such a path"))?;
    find(state, world, &address, request, caching).await
}

/// The file, a coding of it that the client accepts, or the filler.
async fn find(
    state: &AppState,
    world: &'static HostedWorld,
    address: &str,
    request: &Parts,
    caching: Caching,
) -> Result<Found, Problem> {
    let headers = &request.headers;
    let rep = || world.representation(address);
    if let Some(files) = world.files() {
        let file = files.file(address);
        let how = (Priority::of(headers), caching == Caching::Immutable);
        let accepted = headers.get(header::ACCEPT_ENCODING).and_then(|value| value.to_str().ok());
        for coding in encoding::accepted(accepted.unwrap_or_default()) {
            if let Some(found) = file_found(state, world, files, &file, Some(coding), how).await? {
                return Ok(Found { rep: rep(), ..found });
            }
        }
        if let Some(found) = file_found(state, world, files, &file, None, how).await? {
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

/// A file of a world, from memory if it is there and unchanged; `None` if there is no such file. `fresh`: not compared with
/// the disk if that was done a moment ago.
async fn file_found(
    state: &AppState,
    world: &'static HostedWorld,
    files: &'static Files,
    file: &str,
    coding: Option<Coding>,
    (priority, fresh): (Priority, bool),
) -> Result<Option<Found>, Problem> {
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
    let key = Key { world: world.name(), name: format!("{file}{}", coding.map_or("", Coding::suffix)), coding };
    if let Some(stored) = fresh.then(|| state.store.fresh(&key, clock::now())).flatten() {
        state.metrics.store_hits.inc();
        return Ok(Some(found(&stored, "memory")));
    }
    // Asked of the system here rather than on another thread: a handful of microseconds on a local disk.
    let Ok(metadata) = files.folder.metadata(&key.name) else { return Ok(None) };
    let Ok(modified) = metadata.modified().map(cap_std::time::SystemTime::into_std) else { return Ok(None) };
    if !metadata.is_file() {
        return Ok(None);
    }
    if let Some(stored) = state.store.get(&key, modified, metadata.len()) {
        state.metrics.store_hits.inc();
        return Ok(Some(found(&stored, "memory")));
    }
    state.metrics.store_misses.inc();
    let place = state.turns.place(priority);
    match state.store.load(files, key, file, &state.turns, place).await {
        Ok(stored) => Ok(Some(found(&stored, "disk"))),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => {
            tracing::error!(world = world.name(), file, %error, "a file cannot be read");
            Err(Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "the file cannot be read"))
        }
    }
}

/// A response without its body, and what that is.
struct Prepared {
    response: Response,
    body: Option<Wanted>,
    from: &'static str,
    rep: Option<RepId>,
}

struct Wanted {
    source: Source,
    part: Range<u64>,
}

/// Applies the request's conditions and its range.
fn prepare(found: Found, request: &Parts, caching: Caching) -> Result<Prepared, Problem> {
    let asked = &request.headers;
    let mut response = Response::new(Body::empty());
    let headers = response.headers_mut();
    headers.insert(header::CACHE_CONTROL, caching.header());
    headers.insert(header::ETAG, found.etag.clone());
    if let Some(modified) = found.modified {
        headers.typed_insert(LastModified::from(modified));
    }
    if found.negotiated {
        headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    }
    match precondition(asked, &found) {
        Some(StatusCode::PRECONDITION_FAILED) => {
            let detail = "the content is not the one that the request is about";
            return Err(Problem::new(StatusCode::PRECONDITION_FAILED, detail));
        }
        Some(status) => {
            *response.status_mut() = status;
            return Ok(Prepared { response, body: None, from: found.from, rep: found.rep });
        }
        None => {}
    }
    let range = wanted_range(request, &response, found.length);
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, found.media_type);
    headers.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    // A page among the files of a world runs nothing in the name of this server.
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static("default-src 'none'; sandbox"));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    if let Some(coding) = found.coding {
        headers.insert(header::CONTENT_ENCODING, HeaderValue::from_static(coding.name()));
    }
    let part = match range {
        Asked::Whole => 0..found.length,
        Asked::Part(part) => {
            let content_range = format!("bytes {}-{}/{}", part.start, part.end - 1, found.length);
            headers.insert(header::CONTENT_RANGE, ascii(content_range));
            *response.status_mut() = StatusCode::PARTIAL_CONTENT;
            part
        }
        Asked::Unsatisfiable => {
            let detail = format!("no byte of that range; the content has {}", found.length);
            let problem = Problem::new(StatusCode::RANGE_NOT_SATISFIABLE, detail);
            return Err(problem.with(header::CONTENT_RANGE, ascii(format!("bytes */{}", found.length))));
        }
    };
    response.headers_mut().insert(header::CONTENT_LENGTH, HeaderValue::from(part.end - part.start));
    Ok(Prepared { response, body: Some(Wanted { source: found.source, part }), from: found.from, rep: found.rep })
}

/// Only digits, letters and punctuation are ever put in.
fn ascii(text: String) -> HeaderValue {
    HeaderValue::try_from(text).unwrap_or_else(|_| HeaderValue::from_static(""))
}

/// 304 or 412 as RFC 9110, section 13.2.2, orders the conditions.
fn precondition(asked: &HeaderMap, found: &Found) -> Option<StatusCode> {
    // One of the field's lines holds the tag; `None` without such a field.
    let holds = |name: HeaderName, comparison| {
        let mut lines = asked.get_all(name).iter().peekable();
        lines.peek()?;
        Some(lines.any(|line| entity_tag::holds(line.as_bytes(), found.etag.as_bytes(), comparison)))
    };
    match (holds(header::IF_MATCH, Comparison::Strong), asked.typed_get::<IfUnmodifiedSince>(), found.modified) {
        (Some(false), ..) => return Some(StatusCode::PRECONDITION_FAILED),
        (None, Some(condition), Some(modified)) if !condition.precondition_passes(modified) => {
            return Some(StatusCode::PRECONDITION_FAILED);
        }
        _ => {}
    }
    if let Some(held) = holds(header::IF_NONE_MATCH, Comparison::Weak) {
        return held.then_some(StatusCode::NOT_MODIFIED);
    }
    match (asked.typed_get::<IfModifiedSince>(), found.modified) {
        (Some(condition), Some(modified)) if !condition.is_modified(modified) => Some(StatusCode::NOT_MODIFIED),
        _ => None,
    }
}

/// `Range`, unless `If-Range` says that the client holds parts of something else. Both validators are compared byte by byte:
/// entity tags strongly, and dates exactly.
fn wanted_range(request: &Parts, response: &Response, length: u64) -> Asked {
    let asked = &request.headers;
    // HEAD has no parts.
    if request.method == Method::HEAD {
        return Asked::Whole;
    }
    let Some(range) = asked.get(header::RANGE) else { return Asked::Whole };
    if let Some(condition) = asked.get(header::IF_RANGE) {
        let held = [header::ETAG, header::LAST_MODIFIED].map(|name| response.headers().get(name));
        if !held.contains(&Some(condition)) {
            return Asked::Whole;
        }
    }
    range::parse(range.as_bytes(), length)
}
