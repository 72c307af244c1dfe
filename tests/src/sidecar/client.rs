//! A client of sessions that does what a test says, over a real socket; and plain HTTP requests.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use foresight_wire::encoding::Encoding;
use foresight_wire::message::{
    Camera, ClientMessage, Event, Hello, Mode, Refinement, ServerMessage, VERSION, Views, Welcome,
};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::{HeaderName, HeaderValue};
use tokio_tungstenite::tungstenite::{self, Message, WebSocket};

/// Between two views, by the client's clock; at most as long as it waits for an answer.
const VIEW_EVERY: Duration = Duration::from_millis(50);

/// Numbers of representations that no world has.
const PROBED: u32 = 4_000_000_000;

/// How long an answer is waited for.
const ANSWERING: Duration = Duration::from_secs(20);

/// A client's end of a session.
#[derive(Debug)]
pub struct Client {
    /// The socket.
    pub socket: WebSocket<TcpStream>,
    encoding: Encoding,
    /// What it was told to fetch and has not done.
    pending: VecDeque<u32>,
    /// Views sent.
    views: u64,
}

/// What came from the server.
#[derive(Debug)]
pub enum Received {
    /// A frame.
    Messages(Vec<ServerMessage>),
    /// The server has closed the connection: code and reason.
    Closed(u16, String),
    /// It broke without a word.
    Broken(String),
    /// Nothing came in time.
    Nothing,
}

/// A hello to a world with 64 MB of memory.
pub fn hello(world: &str) -> Hello {
    Hello {
        version: VERSION,
        world: world.to_owned(),
        memory_bytes: 64 << 20,
        refinement: Refinement::Partial,
        policy: None,
        mode: Mode::Drive,
        resume: None,
        resident: Vec::new(),
        client: None,
        link: None,
    }
}

/// A view from somewhere above the world's middle, a little further with each number.
pub fn view(t_ns: u64, number: u64) -> ClientMessage {
    let camera = Camera {
        position: [number as f64 % 100.0, -50.0, 30.0],
        orientation: [0.5_f64.sqrt(), 0.0, 0.0, 0.5_f64.sqrt()],
        fov_y: 1.0,
        viewport: [1280, 720],
        weight: 1.0,
    };
    ClientMessage::View(Views { t_ns, cameras: vec![camera] })
}

impl Client {
    /// Opens a socket.
    ///
    /// # Panics
    /// If the server refuses it.
    pub fn connect(port: u16, encoding: Encoding) -> Client {
        Client::try_connect(port, encoding, &[]).unwrap_or_else(|status| panic!("refused with {status}"))
    }

    /// Opens a socket with further header fields.
    ///
    /// # Errors
    /// The status of the refusal.
    ///
    /// # Panics
    /// If the server does not answer.
    pub fn try_connect(port: u16, encoding: Encoding, fields: &[(&str, &str)]) -> Result<Client, u16> {
        let stream = TcpStream::connect(("127.0.0.1", port)).expect("the server listens");
        stream.set_read_timeout(Some(ANSWERING)).expect("a timeout can be set");
        stream.set_write_timeout(Some(ANSWERING)).expect("a timeout can be set");
        let address = format!("ws://127.0.0.1:{port}/sessions/socket");
        let mut request = address.into_client_request().expect("an address");
        let protocol = match encoding {
            Encoding::Json => "foresight.json.v1",
            Encoding::MessagePack => "foresight.msgpack.v1",
        };
        let headers = request.headers_mut();
        headers.insert("Sec-WebSocket-Protocol", HeaderValue::from_static(protocol));
        for (name, value) in fields {
            let name: HeaderName = name.parse().expect("a field's name");
            headers.insert(name, value.parse().expect("a field's value"));
        }
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Client { socket, encoding, pending: VecDeque::new(), views: 0 }),
            Err(tungstenite::HandshakeError::Failure(tungstenite::Error::Http(response))) => {
                Err(response.status().as_u16())
            }
            Err(error) => panic!("no handshake: {error}"),
        }
    }

    /// Sends a frame; false if the socket does not take it.
    pub fn send(&mut self, messages: &[ClientMessage]) -> bool {
        let bytes = self.encoding.write(messages);
        match self.encoding {
            Encoding::Json => self.send_text(&String::from_utf8(bytes).expect("JSON is UTF-8")),
            Encoding::MessagePack => self.socket.send(Message::binary(bytes)).is_ok(),
        }
    }

    /// Sends a text frame as it is; false if the socket does not take it.
    pub fn send_text(&mut self, text: &str) -> bool {
        self.socket.send(Message::text(text)).is_ok()
    }

    /// What comes next, pings left out.
    ///
    /// # Panics
    /// If the server sends what is no list of its messages.
    pub fn read(&mut self) -> Received {
        loop {
            let frame = match self.socket.read() {
                Ok(Message::Text(text)) => text.as_bytes().to_vec(),
                Ok(Message::Binary(bytes)) => bytes.to_vec(),
                Ok(Message::Close(Some(close))) => {
                    return Received::Closed(close.code.into(), close.reason.to_string());
                }
                Ok(Message::Close(None)) => return Received::Closed(1005, String::new()),
                Ok(_) => continue,
                Err(tungstenite::Error::Io(error))
                    if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) =>
                {
                    return Received::Nothing;
                }
                Err(error) => return Received::Broken(error.to_string()),
            };
            return Received::Messages(self.encoding.read_at_most(&frame, 16 << 20).expect("messages of the server"));
        }
    }

    /// The first message for which `pick` has something.
    ///
    /// # Panics
    /// If the connection ends before.
    pub fn until<T>(&mut self, mut pick: impl FnMut(&ServerMessage) -> Option<T>) -> T {
        loop {
            match self.read() {
                Received::Messages(messages) => {
                    self.note(&messages);
                    if let Some(found) = messages.iter().find_map(&mut pick) {
                        return found;
                    }
                }
                other => panic!("expected a message, not {other:?}"),
            }
        }
    }

    /// Says hello and answers the welcome.
    ///
    /// # Panics
    /// If there is none.
    pub fn greet(&mut self, hello: Hello) -> Welcome {
        assert!(self.send(&[ClientMessage::Hello(Box::new(hello))]), "the hello is sent");
        self.until(|message| match message {
            ServerMessage::Welcome(welcome) => Some((**welcome).clone()),
            _ => None,
        })
    }

    /// What it is told to fetch next, views being sent until it is told something.
    ///
    /// # Panics
    /// If it is told nothing after many views.
    pub fn fetch(&mut self) -> u32 {
        self.wait(VIEW_EVERY);
        for _ in 0..400 {
            if let Some(rep) = self.pending.pop_front() {
                self.wait(ANSWERING);
                return rep;
            }
            self.views += 1;
            assert!(self.send(&[view(self.now_ns(), self.views)]), "the view is sent");
            match self.read() {
                Received::Nothing => {}
                Received::Messages(messages) => self.note(&messages),
                other => panic!("expected an answer, not {other:?}"),
            }
        }
        panic!("nothing is to be fetched");
    }

    /// Remembers what it was told to fetch.
    fn note(&mut self, messages: &[ServerMessage]) {
        self.pending.extend(messages.iter().filter_map(|message| match message {
            ServerMessage::Fetch(fetch) => Some(fetch.rep),
            _ => None,
        }));
    }

    /// Its clock: as many steps as it has sent views.
    fn now_ns(&self) -> u64 {
        self.views * VIEW_EVERY.as_nanos() as u64
    }

    /// How long to wait for a frame from now on.
    fn wait(&mut self, limit: Duration) {
        self.socket.get_ref().set_read_timeout(Some(limit)).expect("a timeout can be set");
    }

    /// Sends a view with an event that the session must object to, and waits for that: what it has been told before has been
    /// worked off then. Where objections are many some are left out, so it is tried again. `false` if the connection ends.
    ///
    /// # Panics
    /// If there is no answer for long.
    pub fn probe(&mut self, number: u64) -> bool {
        let event = Event { t_ns: number * 33_000_000, rep: PROBED + (number % 1_000_000) as u32 };
        let wanted = event.rep.to_string();
        self.wait(Duration::from_secs(2));
        for _ in 0..15 {
            if !self.send(&[view(event.t_ns, number), ClientMessage::Completed(event)]) {
                return false;
            }
            loop {
                match self.read() {
                    Received::Messages(messages) => {
                        let objects = |message: &ServerMessage| matches!(message, ServerMessage::Error(error) if error.message.contains(&wanted));
                        if messages.iter().any(objects) {
                            self.wait(ANSWERING);
                            return true;
                        }
                    }
                    Received::Nothing => break,
                    Received::Closed(_, reason) => {
                        assert!(!reason.is_empty(), "closed without a reason");
                        return false;
                    }
                    Received::Broken(_) => return false,
                }
            }
        }
        panic!("nothing was answered");
    }

    /// Says that something has come and can be shown.
    pub fn complete(&mut self, rep: u32) -> bool {
        let event = Event { t_ns: self.now_ns(), rep };
        self.send(&[ClientMessage::Responded(event), ClientMessage::Arrived(event), ClientMessage::Completed(event)])
    }

    /// Reads until the server closes the connection: the errors told before, code and reason.
    ///
    /// # Panics
    /// If it does not.
    pub fn closed(&mut self) -> (Vec<String>, u16, String) {
        let mut errors = Vec::new();
        loop {
            match self.read() {
                Received::Messages(messages) => {
                    errors.extend(messages.into_iter().filter_map(|message| match message {
                        ServerMessage::Error(error) => Some(error.message),
                        _ => None,
                    }))
                }
                Received::Closed(code, reason) => return (errors, code, reason),
                other => panic!("expected the connection to be closed with a reason, not {other:?}; {errors:?}"),
            }
        }
    }
}

/// Status, head and body of the answer to a request; the connection is closed after it.
///
/// # Panics
/// If there is no answer.
pub fn http(port: u16, method: &str, path: &str, fields: &[(&str, &str)], body: &str) -> (u16, String, String) {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the server listens");
    stream.set_read_timeout(Some(ANSWERING)).expect("a timeout can be set");
    let fields: String = fields.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let length = body.len();
    write!(
        stream,
        "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\nContent-Length: {length}\r\n{fields}\r\n{body}"
    )
    .expect("the request is written");
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).expect("the answer is read");
    let text = String::from_utf8_lossy(&bytes);
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("no head in {text:?}"));
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
    (status, head.to_ascii_lowercase(), body.to_owned())
}
