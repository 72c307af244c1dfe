//! Sessions without a WebSocket: frames are posted, answers come as server-sent events.
//!
//! `POST /sessions` takes a frame that begins with the hello and answers with the first messages; `POST
//! /sessions/{id}/frames` takes frames, in the order in which they are posted; `GET /sessions/{id}/events` gives the
//! answers, a list of messages an event. Events are numbered; a reader that comes back with `Last-Event-ID` gets what it
//! has missed, as long as that is kept. The id is all that it takes to speak for a session, so it is to be kept secret.

use super::access::Client;
use super::host::Host;
use super::mailbox::{Frame, Handle, Item};
use super::metrics::SessionMetrics;
use super::outgoing::{Closed, Outgoing};
use super::rate::Rate;
use crate::clock;
use crate::http::problem::Problem;
use axum::extract::{Path, State};
use axum::http::header::{CONTENT_TYPE, HeaderValue, LOCATION, RETRY_AFTER};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse as _, Response};
use axum::{Extension, Json};
use bytes::Bytes;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Error, ErrorCode, ServerMessage};
use futures_util::stream::{Stream, unfold};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Events that are kept for a reader that comes back.
const KEPT_MAX: usize = 64;
/// Bytes of these events together.
const KEPT_BYTES_MAX: usize = 256 << 10;
/// How long the first answer is waited for.
const OPEN_WITHIN: Duration = Duration::from_secs(10);

/// The answers of a session without a socket.
#[derive(Debug)]
pub(super) struct Events {
    outgoing: Arc<Outgoing>,
    kept: Mutex<Kept>,
    /// Counts readers; an earlier one ends when another comes.
    reader: watch::Sender<u64>,
    limits: Mutex<(Rate, Rate)>,
}

#[derive(Debug, Default)]
struct Kept {
    /// Number of the last event.
    last: u64,
    events: VecDeque<(u64, String)>,
    bytes: usize,
}

impl Kept {
    fn push(&mut self, data: String) -> u64 {
        self.last += 1;
        self.bytes += data.len();
        self.events.push_back((self.last, data));
        while self.events.len() > KEPT_MAX || self.bytes > KEPT_BYTES_MAX {
            let Some((_, gone)) = self.events.pop_front() else { break };
            self.bytes -= gone.len();
        }
        self.last
    }

    /// What came after an event; `None` if some of that is no longer kept.
    fn after(&self, number: u64) -> Option<VecDeque<(u64, String)>> {
        let first = self.events.front().map_or(self.last + 1, |(number, _)| *number);
        if number > self.last || number + 1 < first {
            return None;
        }
        Some(self.events.iter().filter(|(at, _)| *at > number).cloned().collect())
    }
}

/// A session that has begun.
#[derive(Debug, Serialize, Deserialize, utoipa::ToSchema)]
pub(super) struct Opened {
    /// Its id: the secret that it takes to go on with it.
    session: String,
    /// Where its answers come as server-sent events.
    events: String,
    /// Where frames are posted.
    frames: String,
    /// The first answers, the welcome first.
    #[schema(value_type = Vec<Object>)]
    messages: Vec<ServerMessage>,
}

fn encoding(headers: &HeaderMap) -> Result<Encoding, Problem> {
    let media = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    match media.split(';').next().unwrap_or_default().trim().to_ascii_lowercase().as_str() {
        "application/json" => Ok(Encoding::Json),
        "application/msgpack" | "application/vnd.msgpack" => Ok(Encoding::MessagePack),
        _ => Err(Problem::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "expected Content-Type: application/json or application/msgpack",
        )),
    }
}

fn read(host: &Host, headers: &HeaderMap, body: &[u8]) -> Result<Vec<ClientMessage>, Problem> {
    let encoding = encoding(headers)?;
    host.metrics.frames.inc();
    host.metrics.frame_bytes.inc_by(body.len() as u64);
    encoding.read_at_most::<ClientMessage>(body, host.config.message_bytes_max.length()).map_err(|error| {
        host.metrics.frames_malformed.inc();
        Problem::new(StatusCode::BAD_REQUEST, error.to_string())
    })
}

fn problem(error: &Error) -> Problem {
    match error.code {
        ErrorCode::World => Problem::not_found(error.message.clone()),
        ErrorCode::Limit | ErrorCode::Shutdown => Problem::busy(error.message.clone(), 5),
        ErrorCode::Internal => Problem::new(StatusCode::INTERNAL_SERVER_ERROR, error.message.clone()),
        _ => Problem::new(StatusCode::BAD_REQUEST, error.message.clone()),
    }
}

/// Begins or resumes a session
#[utoipa::path(
    post, path = "/sessions", tag = "sessions", request_body(content = Vec<Object>,
        description = "A list of messages that begins with a hello; see the schema of the messages"),
    responses(
        (status = 201, description = "It has begun", body = Opened),
        (status = 400, description = "No list of messages, or a hello that is refused", body = Problem, content_type = "application/problem+json"),
        (status = 401, description = "Without the token", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "From a page of another origin", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such world", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "Larger than a frame may be", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Neither JSON nor MessagePack", body = Problem, content_type = "application/problem+json"),
        (status = 503, description = "Too many sessions, or shutting down", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn open(
    State(host): State<Arc<Host>>,
    Extension(client): Extension<Client>,
    headers: HeaderMap,
    body: Result<Bytes, axum::extract::rejection::BytesRejection>,
) -> Result<Response, Problem> {
    let body = body.map_err(|rejection| Problem::new(rejection.status(), rejection.body_text()))?;
    let mut messages = read(&host, &headers, &body)?;
    if !matches!(messages.first(), Some(ClientMessage::Hello(_))) {
        return Err(Problem::new(StatusCode::BAD_REQUEST, "the first message is no hello; expected one"));
    }
    let ClientMessage::Hello(hello) = messages.remove(0) else {
        return Err(Problem::new(StatusCode::BAD_REQUEST, "expected a hello"));
    };
    let stranger = host.stranger(client.0).map_err(|error| problem(&error))?;
    let outgoing = Arc::new(Outgoing::new(host.config.answers_max.count()));
    let session = host.enter(stranger, hello, outgoing.clone()).await.map_err(|error| problem(&error))?;
    let first = tokio::time::timeout(OPEN_WITHIN, outgoing.next()).await;
    let Ok(first) = first else {
        session.post(Item::End("never_opened"));
        return Err(Problem::busy("the server has not come to it", 5));
    };
    if let Some(Closed { error: Some(error), .. }) = &first.closed {
        return Err(problem(error));
    }
    let now = clock::now();
    let config = &host.config;
    let frames = Rate::new(config.frames_per_second_max.0, 1, now);
    let bytes = Rate::new(config.bytes_per_second_max.0, config.message_bytes_max.0, now);
    let events = Events {
        outgoing: outgoing.clone(),
        kept: Mutex::default(),
        reader: watch::channel(0).0,
        limits: Mutex::new((frames, bytes)),
    };
    session.set_events(Arc::new(events));
    // Until somebody reads the events.
    session.post(Item::Absent { at: now, outgoing, keeps_answers: true });
    if !messages.is_empty() {
        session.post(Item::Frame(Frame { at: now, messages, over: None, room: session.room_now(body.len()) }));
    }
    let opened = Opened {
        events: format!("/sessions/{}/events", session.id),
        frames: format!("/sessions/{}/frames", session.id),
        messages: first.messages,
        session: session.id.clone(),
    };
    let location = HeaderValue::try_from(format!("/sessions/{}", session.id));
    let mut response = (StatusCode::CREATED, Json(opened)).into_response();
    if let Ok(location) = location {
        response.headers_mut().insert(LOCATION, location);
    }
    Ok(response)
}

fn session(host: &Host, id: &str) -> Result<(Arc<Handle>, Arc<Events>), Problem> {
    let session = host.find(id).ok_or_else(|| Problem::not_found("no such session; POST /sessions begins one"))?;
    let detail = "this session has a WebSocket; expected one that POST /sessions has begun";
    let events = session.events().ok_or_else(|| Problem::new(StatusCode::CONFLICT, detail))?;
    Ok((session, events))
}

/// Tells a session what happened
#[utoipa::path(
    post, path = "/sessions/{id}/frames", tag = "sessions", params(("id" = String, Path, description = "Of the session")),
    request_body(content = Vec<Object>, description = "A list of messages; see the schema of the messages"),
    responses(
        (status = 202, description = "Taken; answers come as events"),
        (status = 400, description = "No list of messages", body = Problem, content_type = "application/problem+json"),
        (status = 401, description = "Without the token", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "From a page of another origin", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The session has a WebSocket", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "Larger than a frame may be", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Neither JSON nor MessagePack", body = Problem, content_type = "application/problem+json"),
        (status = 429, description = "Too much at once; Retry-After says when", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn frames(
    State(host): State<Arc<Host>>,
    Path(id): Path<String>,
    headers: HeaderMap,
    body: Result<Bytes, axum::extract::rejection::BytesRejection>,
) -> Result<StatusCode, Problem> {
    let (session, events) = session(&host, &id)?;
    let body = body.map_err(|rejection| Problem::new(rejection.status(), rejection.body_text()))?;
    let now = clock::now();
    let allowed = {
        let mut limits = events.limits.lock().unwrap_or_else(PoisonError::into_inner);
        let allowed = limits.0.take(1, now) && limits.1.take(body.len() as u64, now);
        if allowed { Ok(()) } else { Err(limits.0.wait(1).max(limits.1.wait(body.len() as u64))) }
    };
    let too_much = |wait: Duration| {
        let (frames, bytes) = (host.config.frames_per_second_max.0, host.config.bytes_per_second_max.0);
        let detail = format!("too much at once; expected at most {frames} frames and {bytes} bytes a second");
        let problem = Problem::new(StatusCode::TOO_MANY_REQUESTS, detail);
        problem.with(RETRY_AFTER, HeaderValue::from(wait.as_secs() + 1))
    };
    allowed.map_err(too_much)?;
    let messages = read(&host, &headers, &body)?;
    let room = session.room_now(body.len()).ok_or_else(|| too_much(Duration::ZERO))?;
    if !session.post(Item::Frame(Frame { at: now, messages, over: None, room: Some(room) })) {
        return Err(Problem::not_found("the session is over"));
    }
    Ok(StatusCode::ACCEPTED)
}

/// What a session answers, as server-sent events
#[utoipa::path(
    get, path = "/sessions/{id}/events", tag = "sessions",
    params(
        ("id" = String, Path, description = "Of the session"),
        ("Last-Event-ID" = Option<String>, Header, description = "Number of the last event that was read"),
    ),
    responses(
        (status = 200, description = "A list of messages an event; the event `end` is the last, and says why",
            body = String, content_type = "text/event-stream"),
        (status = 401, description = "Without the token", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "From a page of another origin", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "The session has a WebSocket", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "What came after Last-Event-ID is no longer kept: resume by POST /sessions", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn events(
    State(host): State<Arc<Host>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (session, events) = session(&host, &id)?;
    let last = headers.get("last-event-id").map(|value| value.to_str().ok().and_then(|text| text.parse::<u64>().ok()));
    let missed = {
        let kept = events.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let last = match last {
            None => Some(kept.last),
            Some(last) => last,
        };
        last.and_then(|last| kept.after(last))
    };
    let gone = "what came after Last-Event-ID is no longer kept; expected a hello that resumes, by POST /sessions";
    let missed = missed.ok_or_else(|| Problem::new(StatusCode::GONE, gone))?;
    let mut number = 0;
    events.reader.send_modify(|readers| {
        *readers += 1;
        number = *readers;
    });
    session.post(Item::Present { outgoing: events.outgoing.clone() });
    let keep_alive = KeepAlive::new().interval(host.config.ping_every.0);
    let mut response =
        Sse::new(stream(Reader { metrics: host.metrics.clone(), session, events, number, missed, ended: false }))
            .keep_alive(keep_alive)
            .into_response();
    // Proxies are not to gather events.
    response.headers_mut().insert("x-accel-buffering", HeaderValue::from_static("no"));
    Ok(response)
}

/// Somebody who reads events.
struct Reader {
    metrics: SessionMetrics,
    session: Arc<Handle>,
    events: Arc<Events>,
    number: u64,
    missed: VecDeque<(u64, String)>,
    ended: bool,
}

impl Drop for Reader {
    fn drop(&mut self) {
        // Unless another reads by now.
        if *self.events.reader.borrow() == self.number {
            let outgoing = self.events.outgoing.clone();
            self.session.post(Item::Absent { at: clock::now(), outgoing, keeps_answers: true });
        }
    }
}

impl Reader {
    async fn next(&mut self) -> Option<Event> {
        if let Some((number, data)) = self.missed.pop_front() {
            return Some(Event::default().id(number.to_string()).data(data));
        }
        if self.ended {
            return None;
        }
        let mut readers = self.events.reader.subscribe();
        let batch = tokio::select! {
            _ = readers.wait_for(|readers| *readers != self.number) => return None,
            batch = self.events.outgoing.next() => batch,
        };
        let now = clock::now();
        for received in batch.answered {
            self.metrics.view_to_decision.observe(now.saturating_duration_since(received).as_secs_f64());
        }
        let mut messages = batch.messages;
        let Some(closed) = batch.closed else {
            return Some(self.keep(&messages));
        };
        self.ended = true;
        messages.extend(closed.error.map(ServerMessage::Error));
        Some(self.keep(&messages).event(if closed.reason == "bye" { "bye" } else { "end" }))
    }

    fn keep(&self, messages: &[ServerMessage]) -> Event {
        let data = String::from_utf8(Encoding::Json.write(messages)).unwrap_or_default();
        let number = self.events.kept.lock().unwrap_or_else(PoisonError::into_inner).push(data.clone());
        Event::default().id(number.to_string()).data(data)
    }
}

fn stream(reader: Reader) -> impl Stream<Item = Result<Event, Infallible>> {
    unfold(reader, |mut reader| async move { reader.next().await.map(|event| (Ok(event), reader)) })
}

/// Ends a session
#[utoipa::path(
    delete, path = "/sessions/{id}", tag = "sessions", params(("id" = String, Path, description = "Of the session")),
    responses(
        (status = 204, description = "It is over"),
        (status = 401, description = "Without the token", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "From a page of another origin", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such session", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn close(State(host): State<Arc<Host>>, Path(id): Path<String>) -> Result<StatusCode, Problem> {
    let session = host.find(&id).ok_or_else(|| Problem::not_found("no such session"))?;
    session.post(Item::End("deleted"));
    Ok(StatusCode::NO_CONTENT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_kept_for_a_while() {
        let mut kept = Kept::default();
        assert_eq!(kept.after(0).map(|events| events.len()), Some(0));
        assert!(kept.after(1).is_none());
        for number in 1..=100_u64 {
            assert_eq!(kept.push("[]".to_owned()), number);
        }
        assert!(kept.after(10).is_none());
        assert_eq!(kept.after(36).map(|events| events.len()), Some(KEPT_MAX));
        assert_eq!(kept.after(99).map(|events| events[0].0), Some(100));
        assert_eq!(kept.after(100).map(|events| events.len()), Some(0));
        kept.push("x".repeat(KEPT_BYTES_MAX + 1));
        assert!(kept.events.is_empty() && kept.bytes == 0);
    }
}
