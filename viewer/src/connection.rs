//! The session's WebSocket: opened again with back-off when it breaks.

use crate::clock::Clock;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, ServerMessage};
use futures_util::{SinkExt, StreamExt};
use std::future::Future;
use std::pin::Pin;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::http::header::{AUTHORIZATION, SEC_WEBSOCKET_PROTOCOL};
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{self, Message};

/// Frames that wait to be written; a socket that is behind by more is given up.
const OUTGOING_MAX: usize = 256;
/// Frames that wait to be obeyed; beyond that the server is not read.
const INCOMING_MAX: usize = 256;
/// Largest frame from the server, bytes.
const FRAME_MAX: usize = 16 << 20;
/// How long a connection may take to open.
const OPENING: Duration = Duration::from_secs(10);
/// How long the last frames may take to leave.
const LEAVING: Duration = Duration::from_secs(2);
/// First pause before the connection is opened again; it doubles up to the last.
const BACK_OFF_NS: u64 = 200_000_000;
const BACK_OFF_MAX_NS: u64 = 5_000_000_000;

/// Why there is no connection.
#[derive(Debug, thiserror::Error)]
pub enum ConnectionError {
    /// The server's address is none.
    #[error("{0:?} is no server; expected http://HOST:PORT")]
    Address(String),
    /// It could not be opened, or broke.
    #[error("the session's socket: {0}")]
    Socket(Box<tungstenite::Error>),
    /// It took too long to open.
    #[error("the session's socket did not open within {} s", OPENING.as_secs())]
    Late,
}

/// Where and how to connect.
#[derive(Clone, Debug)]
pub struct Address {
    /// `http://HOST:PORT`, without a slash at its end.
    pub origin: String,
    /// How frames are written.
    pub encoding: Encoding,
    /// Sent as `Authorization: Bearer …`.
    pub token: Option<String>,
}

impl Address {
    /// Of a server named by its URL.
    ///
    /// # Errors
    /// What is no `http://` URL of a host.
    pub fn new(server: &str, encoding: Encoding, token: Option<String>) -> Result<Address, ConnectionError> {
        let wrong = || ConnectionError::Address(server.to_owned());
        let origin = server.trim_end_matches('/');
        let host = origin.strip_prefix("http://").filter(|host| !host.is_empty() && !host.contains('/'));
        host.ok_or_else(wrong)?;
        reqwest::Url::parse(origin).map_err(|_| wrong())?;
        Ok(Address { origin: origin.to_owned(), encoding, token })
    }

    fn request(&self) -> Result<tungstenite::handshake::client::Request, tungstenite::Error> {
        let url = format!("ws{}/sessions/socket", self.origin.strip_prefix("http").unwrap_or_default());
        let mut request = url.into_client_request()?;
        let protocol = match self.encoding {
            Encoding::Json => "foresight.json.v1",
            Encoding::MessagePack => "foresight.msgpack.v1",
        };
        request.headers_mut().insert(SEC_WEBSOCKET_PROTOCOL, HeaderValue::from_static(protocol));
        if let Some(token) = &self.token {
            let value = HeaderValue::try_from(format!("Bearer {token}")).map_err(tungstenite::http::Error::from)?;
            request.headers_mut().insert(AUTHORIZATION, value);
        }
        Ok(request)
    }
}

/// What comes from the connection.
#[derive(Debug)]
pub enum Incoming {
    /// It is open: a `hello` is due.
    Opened,
    /// A frame.
    Messages {
        /// When it was read, ns by the program's clock.
        at_ns: u64,
        /// What it says.
        messages: Vec<ServerMessage>,
    },
    /// It broke or could not be opened, and will be opened again.
    Lost(String),
}

struct Socket {
    outgoing: mpsc::Sender<Message>,
    incoming: mpsc::Receiver<(u64, Result<Vec<ServerMessage>, String>)>,
    writer: JoinHandle<()>,
    reader: JoinHandle<()>,
}

impl Drop for Socket {
    fn drop(&mut self) {
        self.writer.abort();
        self.reader.abort();
    }
}

type Opening = Pin<Box<dyn Future<Output = Result<Socket, ConnectionError>> + Send>>;

enum State {
    Closed { retry_ns: u64 },
    Opening(Opening),
    Open(Socket),
}

/// A connection that comes back.
pub struct Connection {
    address: Address,
    clock: Clock,
    state: State,
    back_off_ns: u64,
}

impl Connection {
    /// Not opened yet: [`Connection::next`] does.
    pub fn new(address: Address, clock: Clock) -> Connection {
        Connection { address, clock, state: State::Closed { retry_ns: 0 }, back_off_ns: BACK_OFF_NS }
    }

    /// Whether frames can be sent.
    pub fn is_open(&self) -> bool {
        matches!(self.state, State::Open(_))
    }

    /// The session goes on: the next pause is the first again.
    pub fn settled(&mut self) {
        self.back_off_ns = BACK_OFF_NS;
    }

    /// Closes it; [`Connection::next`] opens it again after a pause.
    pub fn lose(&mut self) {
        self.state = State::Closed { retry_ns: self.clock.now_ns() + self.back_off_ns };
        self.back_off_ns = (self.back_off_ns * 2).min(BACK_OFF_MAX_NS);
    }

    /// Sends a frame. False if there is no connection, or it is so far behind that it is given up.
    pub fn send(&mut self, messages: &[ClientMessage]) -> bool {
        let State::Open(socket) = &self.state else { return false };
        let bytes = self.address.encoding.write(messages);
        let frame = match self.address.encoding {
            // JSON is UTF-8.
            Encoding::Json => Message::text(String::from_utf8_lossy(&bytes).into_owned()),
            Encoding::MessagePack => Message::binary(bytes),
        };
        if socket.outgoing.try_send(frame).is_err() {
            self.lose();
            return false;
        }
        true
    }

    /// What comes next. Nothing is lost if it is dropped before it has answered.
    pub async fn next(&mut self) -> Incoming {
        loop {
            match &mut self.state {
                State::Closed { retry_ns } => {
                    self.clock.sleep_until(*retry_ns).await;
                    self.state = State::Opening(Box::pin(open(self.address.clone(), self.clock)));
                }
                State::Opening(opening) => match opening.await {
                    Ok(socket) => {
                        self.state = State::Open(socket);
                        return Incoming::Opened;
                    }
                    Err(error) => {
                        self.lose();
                        return Incoming::Lost(error.to_string());
                    }
                },
                State::Open(socket) => {
                    let why = match socket.incoming.recv().await {
                        Some((at_ns, Ok(messages))) => return Incoming::Messages { at_ns, messages },
                        Some((_, Err(why))) => why,
                        None => "the server closed the session's socket".to_owned(),
                    };
                    self.lose();
                    return Incoming::Lost(why);
                }
            }
        }
    }

    /// Lets the last frames leave, and closes.
    pub async fn finish(self) {
        if let State::Open(mut socket) = self.state {
            let _ = socket.outgoing.send(Message::Close(None)).await;
            // What is not out by then is not worth waiting for.
            let _ = tokio::time::timeout(LEAVING, &mut socket.writer).await;
        }
    }
}

async fn open(address: Address, clock: Clock) -> Result<Socket, ConnectionError> {
    let socket = |error| ConnectionError::Socket(Box::new(error));
    let config = WebSocketConfig::default().max_message_size(Some(FRAME_MAX)).max_frame_size(Some(FRAME_MAX));
    // Frames are small and urgent: they do not wait for others.
    let connecting =
        tokio_tungstenite::connect_async_with_config(address.request().map_err(socket)?, Some(config), true);
    let opened = tokio::time::timeout(OPENING, connecting).await;
    let (stream, _) = opened.map_err(|_| ConnectionError::Late)?.map_err(socket)?;
    let (mut to_server, mut from_server) = stream.split();
    let (outgoing, mut frames) = mpsc::channel::<Message>(OUTGOING_MAX);
    let (heard, incoming) = mpsc::channel(INCOMING_MAX);
    let writer = tokio::spawn(async move {
        while let Some(frame) = frames.recv().await {
            let last = matches!(frame, Message::Close(_));
            if to_server.send(frame).await.is_err() || last {
                break;
            }
        }
    });
    let encoding = address.encoding;
    let reader = tokio::spawn(async move {
        while let Some(frame) = from_server.next().await {
            let read = |bytes: &[u8]| encoding.read::<ServerMessage>(bytes).map_err(|e| e.to_string());
            let messages = match frame {
                Ok(Message::Text(text)) => read(text.as_bytes()),
                Ok(Message::Binary(bytes)) => read(&bytes),
                Ok(Message::Close(frame)) => Err(match frame {
                    Some(frame) if !frame.reason.is_empty() => format!("closed by the server: {}", frame.reason),
                    _ => "closed by the server".to_owned(),
                }),
                Ok(_) => continue,
                Err(error) => Err(error.to_string()),
            };
            let broken = messages.is_err();
            if heard.send((clock.now_ns(), messages)).await.is_err() || broken {
                break;
            }
        }
    });
    Ok(Socket { outgoing, incoming, writer, reader })
}
