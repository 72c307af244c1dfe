//! Sessions over a WebSocket.
//!
//! Subprotocol `foresight.json.v1` has text frames, `foresight.msgpack.v1` binary ones; without one it is JSON. The first
//! message is the hello. Frames are not compressed: permessage-deflate is not offered, so none can swell. A client that
//! sends too much, too large or what cannot be read is told why and closed; its session is kept for a while.

use super::access::Client;
use super::host::{Host, Stranger};
use super::mailbox::{Frame, Handle, Item};
use super::metrics::ReasonLabel;
use super::outgoing::Outgoing;
use super::rate::Rate;
use crate::clock;
use crate::http::problem::Problem;
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::http::header::SEC_WEBSOCKET_PROTOCOL;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse as _, Response};
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Error, ErrorCode, ServerMessage};
use futures_util::stream::{SplitSink, SplitStream};
use futures_util::{SinkExt as _, StreamExt as _};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// Subprotocols, by preference.
const PROTOCOLS: [(&str, Encoding); 2] =
    [("foresight.json.v1", Encoding::Json), ("foresight.msgpack.v1", Encoding::MessagePack)];

/// What a connection is given to send its last words and to hear the client's.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// Bytes written to a socket before it has taken the earlier ones, beyond one frame.
const WRITE_BUFFER_BYTES: usize = 16 << 10;

/// A connection ends: a word for the metrics, and what the client is told.
struct End {
    reason: &'static str,
    error: Option<Error>,
}

impl End {
    fn told(reason: &'static str, code: ErrorCode, message: impl Into<String>) -> End {
        End { reason, error: Some(Error { code, message: message.into(), fatal: true }) }
    }

    fn silent(reason: &'static str) -> End {
        End { reason, error: None }
    }
}

/// `GET /sessions/socket`.
pub(super) async fn socket(
    State(host): State<Arc<Host>>,
    Extension(client): Extension<Client>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => {
            let detail = format!("this address takes WebSockets: {}", rejection.body_text());
            return Problem::new(rejection.status(), detail).into_response();
        }
    };
    let most = host.config.message_bytes_max.length();
    let upgrade = upgrade
        .max_message_size(most)
        .max_frame_size(most)
        .write_buffer_size(WRITE_BUFFER_BYTES)
        .max_write_buffer_size(usize::MAX)
        .protocols(PROTOCOLS.map(|(name, _)| name));
    let chosen = upgrade.selected_protocol().and_then(|name| name.to_str().ok());
    let encoding = PROTOCOLS.iter().find(|(name, _)| Some(*name) == chosen).map(|(_, encoding)| *encoding);
    let encoding = match encoding {
        Some(encoding) => encoding,
        None if !offers_others(&headers) => Encoding::default(),
        None => {
            let names = PROTOCOLS.map(|(name, _)| name).join(" or ");
            return Problem::new(StatusCode::BAD_REQUEST, format!("no subprotocol that is known; expected {names}"))
                .into_response();
        }
    };
    match host.stranger(client.0) {
        Ok(stranger) => upgrade.on_upgrade(move |socket| converse(host, stranger, socket, encoding)).into_response(),
        Err(error) => Problem::busy(error.message, 5).into_response(),
    }
}

/// Whether the client offers subprotocols that are ours or strangers', the token's carrier apart.
fn offers_others(headers: &HeaderMap) -> bool {
    let offered = headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter().filter_map(|value| value.to_str().ok());
    offered.flat_map(|value| value.split(',')).any(|protocol| !protocol.trim().starts_with("foresight.token."))
}

/// A connection's limits on what it may send.
struct Limits {
    frames: Rate,
    bytes: Rate,
}

impl Limits {
    fn new(host: &Host) -> Limits {
        let now = clock::now();
        let config = &host.config;
        Limits {
            frames: Rate::new(config.frames_per_second_max.0, 1, now),
            bytes: Rate::new(config.bytes_per_second_max.0, config.message_bytes_max.0, now),
        }
    }

    fn take(&mut self, bytes: usize) -> bool {
        let now = clock::now();
        self.frames.take(1, now) && self.bytes.take(bytes as u64, now)
    }
}

async fn converse(host: Arc<Host>, stranger: Stranger, socket: WebSocket, encoding: Encoding) {
    let _counted = host.socket();
    let (mut sink, mut stream) = socket.split();
    let mut limits = Limits::new(&host);
    let outgoing = Arc::new(Outgoing::new(host.config.answers_max.count()));
    let reason = {
        let reading = async {
            let end = read(&host, stranger, &mut stream, &mut limits, encoding, &outgoing).await;
            // The writer says it, after what waits.
            outgoing.close(end.reason, end.error);
            end.reason
        };
        let writing = write(&host, &mut sink, encoding, &outgoing);
        tokio::pin!(reading, writing);
        tokio::select! {
            reason = &mut writing => reason,
            reason = &mut reading => timeout(LAST_WORDS, writing).await.unwrap_or(reason),
            // A client that does not read may not take even this.
            () = outgoing.overflow() => timeout(LAST_WORDS, writing).await.unwrap_or("slow"),
        }
    };
    host.metrics.connections_closed.get_or_create(&ReasonLabel { reason }).inc();
    // The client's own last words are read, or the system would break the connection off before ours have arrived.
    let _ = timeout(LAST_WORDS, async { while let Some(Ok(_)) = stream.next().await {} }).await;
}

/// Reads until the connection ends.
async fn read(
    host: &Arc<Host>,
    stranger: Stranger,
    stream: &mut SplitStream<WebSocket>,
    limits: &mut Limits,
    encoding: Encoding,
    outgoing: &Arc<Outgoing>,
) -> End {
    let within = host.config.hello_within.0;
    let first = timeout(within, async {
        loop {
            match next(host, stream, limits, encoding).await {
                // A pong, say.
                Ok((messages, 0)) if messages.is_empty() => {}
                first => return first,
            }
        }
    });
    let (mut messages, bytes) = match first.await {
        Err(_) => {
            host.metrics.refused("no_hello");
            let within = humantime::format_duration(within);
            return End::told("no_hello", ErrorCode::Order, format!("no hello within {within}; expected one"));
        }
        Ok(Err(end)) => return end,
        Ok(Ok(first)) => first,
    };
    if !matches!(messages.first(), Some(ClientMessage::Hello(_))) {
        return End::told("no_hello", ErrorCode::Order, "the first message is no hello; expected one");
    }
    let ClientMessage::Hello(hello) = messages.remove(0) else { return End::silent("no_hello") };
    let session = match host.enter(stranger, hello, outgoing.clone()).await {
        Ok(session) => session,
        Err(error) => return End { reason: "refused", error: Some(error) },
    };
    let gone = Gone { session: session.clone(), outgoing: outgoing.clone() };
    let end = frames(host, (&session, outgoing), (messages, bytes), stream, limits, encoding).await;
    drop(gone);
    end
}

/// Tells the session, however this ends, that its connection is gone.
struct Gone {
    session: Arc<Handle>,
    outgoing: Arc<Outgoing>,
}

impl Drop for Gone {
    fn drop(&mut self) {
        let item = Item::Absent { at: clock::now(), outgoing: self.outgoing.clone(), keeps_answers: false };
        self.session.post(item);
    }
}

/// Passes frames on to the session; `first` is what came with the hello.
async fn frames(
    host: &Host,
    (session, outgoing): (&Arc<Handle>, &Arc<Outgoing>),
    first: (Vec<ClientMessage>, usize),
    stream: &mut SplitStream<WebSocket>,
    limits: &mut Limits,
    encoding: Encoding,
) -> End {
    let (mut messages, mut bytes) = first;
    loop {
        if !messages.is_empty() {
            let at = clock::now();
            // Where there is no room, the socket is not read: the client's own system holds it back.
            let Some(room) = session.room(bytes).await else { return End::silent("session_over") };
            if !session.post(Item::Frame(Frame { at, messages, over: Some(outgoing.clone()), room: Some(room) })) {
                return End::silent("session_over");
            }
        }
        (messages, bytes) = match timeout(host.config.idle_after.0, next(host, stream, limits, encoding)).await {
            Err(_) => {
                let idle = humantime::format_duration(host.config.idle_after.0);
                return End::told("idle", ErrorCode::Limit, format!("nothing came for {idle}"));
            }
            Ok(Err(end)) => return end,
            Ok(Ok(frame)) => frame,
        };
    }
}

/// The next frame of messages; a ping or pong is an empty one.
async fn next(
    host: &Host,
    stream: &mut SplitStream<WebSocket>,
    limits: &mut Limits,
    encoding: Encoding,
) -> Result<(Vec<ClientMessage>, usize), End> {
    let message = match stream.next().await {
        None => return Err(End::silent("gone")),
        Some(Ok(message)) => message,
        Some(Err(error)) => return Err(broken(&error)),
    };
    let data = match (&message, encoding) {
        (Message::Close(_), _) => return Err(End::silent("closed_by_client")),
        (Message::Ping(data) | Message::Pong(data), _) => data.len(),
        (Message::Text(text), _) => text.len(),
        (Message::Binary(data), _) => data.len(),
    };
    host.metrics.frames.inc();
    host.metrics.frame_bytes.inc_by(data as u64);
    if !limits.take(data) {
        let (frames, bytes) = (host.config.frames_per_second_max.0, host.config.bytes_per_second_max.0);
        let message = format!("too much was sent; expected at most {frames} frames and {bytes} bytes a second");
        return Err(End::told("rate", ErrorCode::Limit, message));
    }
    let most = host.config.message_bytes_max.length();
    let read = match (&message, encoding) {
        (Message::Text(text), Encoding::Json) => encoding.read_at_most::<ClientMessage>(text.as_bytes(), most),
        (Message::Binary(data), Encoding::MessagePack) => encoding.read_at_most::<ClientMessage>(data, most),
        (Message::Text(_) | Message::Binary(_), _) => {
            host.metrics.frames_malformed.inc();
            let expected = if encoding == Encoding::Json { "text frames" } else { "binary frames" };
            return Err(End::told(
                "malformed",
                ErrorCode::Malformed,
                format!("expected {expected} in this subprotocol"),
            ));
        }
        _ => return Ok((Vec::new(), 0)),
    };
    match read {
        Ok(messages) => Ok((messages, data)),
        Err(error) => {
            host.metrics.frames_malformed.inc();
            Err(End::told("malformed", ErrorCode::Malformed, error.to_string()))
        }
    }
}

/// What the WebSocket layer could not read.
fn broken(error: &axum::Error) -> End {
    let text = error.to_string();
    if text.contains("too long") || text.contains("too big") || text.contains("Space limit exceeded") {
        return End::told("too_large", ErrorCode::Limit, text);
    }
    if text.contains("protocol") || text.contains("UTF-8") || text.contains("Utf8") {
        return End::told("protocol", ErrorCode::Malformed, text);
    }
    End::silent("broken")
}

/// Writes answers and pings until there is nothing more to say.
async fn write(
    host: &Host,
    sink: &mut SplitSink<WebSocket, Message>,
    encoding: Encoding,
    outgoing: &Outgoing,
) -> &'static str {
    let mut ping = tokio::time::interval(host.config.ping_every.0);
    ping.reset();
    loop {
        let batch = tokio::select! {
            batch = outgoing.next() => batch,
            _ = ping.tick() => {
                if !sent(host, sink, Message::Ping(Vec::new().into())).await {
                    return "stuck";
                }
                continue;
            }
        };
        if !batch.messages.is_empty() {
            if !sent(host, sink, frame(encoding, &batch.messages)).await {
                return "stuck";
            }
            let now = clock::now();
            for received in batch.answered {
                let took = now.saturating_duration_since(received);
                host.metrics.view_to_decision.observe(took.as_secs_f64());
            }
        }
        if let Some(closed) = batch.closed {
            let code = close_code_of(closed.reason, closed.error.as_ref());
            let why = closed.error.as_ref().map_or_else(|| closed.reason.to_owned(), |error| error.message.clone());
            if let Some(error) = closed.error {
                host.metrics.errors_told.inc();
                sent(host, sink, frame(encoding, &[ServerMessage::Error(error)])).await;
            }
            let close = CloseFrame { code, reason: clipped(&why).into() };
            sent(host, sink, Message::Close(Some(close))).await;
            return closed.reason;
        }
    }
}

fn frame(encoding: Encoding, messages: &[ServerMessage]) -> Message {
    let bytes = encoding.write(messages);
    match encoding {
        Encoding::Json => Message::Text(String::from_utf8(bytes).unwrap_or_default().into()),
        Encoding::MessagePack => Message::Binary(bytes.into()),
    }
}

/// Sends, if the client takes it before it counts as gone.
async fn sent(host: &Host, sink: &mut SplitSink<WebSocket, Message>, message: Message) -> bool {
    matches!(timeout(host.config.idle_after.0, sink.send(message)).await, Ok(Ok(())))
}

fn close_code_of(reason: &str, error: Option<&Error>) -> u16 {
    match error.map(|error| error.code) {
        None if reason == "bye" => close_code::NORMAL,
        None | Some(ErrorCode::Shutdown) => close_code::AWAY,
        Some(ErrorCode::Internal) => close_code::ERROR,
        Some(ErrorCode::Limit) if reason == "too_large" => close_code::SIZE,
        Some(_) => close_code::POLICY,
    }
}

/// As much as a close frame holds: 123 bytes.
fn clipped(text: &str) -> String {
    let mut end = text.len().min(123);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text[..end].to_owned()
}
