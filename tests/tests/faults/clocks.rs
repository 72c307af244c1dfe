//! A client whose clock jumps.

use std::net::TcpStream;
use std::time::Duration;

use foresight_tests::sidecar::process::Server;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{Camera, ClientMessage, Event, Hello, Mode, Refinement, ServerMessage, VERSION, Views};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{self, Message, WebSocket};

const MEMORY: u64 = 8 << 20;
const HOUR_NS: u64 = 3_600_000_000_000;

struct Client {
    socket: WebSocket<TcpStream>,
    held: u64,
    sizes: std::collections::BTreeMap<u32, u64>,
    errors: Vec<String>,
}

impl Client {
    fn connect(server: &Server) -> Client {
        let stream = TcpStream::connect(("127.0.0.1", server.port())).expect("the server listens");
        let mut request =
            format!("ws://127.0.0.1:{}/sessions/socket", server.port()).into_client_request().expect("an address");
        request.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("foresight.json.v1"));
        let (socket, _) = tungstenite::client(request, stream).expect("a session's socket");
        socket.get_ref().set_read_timeout(Some(Duration::from_millis(40))).expect("a timeout can be set");
        Client { socket, held: 0, sizes: std::collections::BTreeMap::new(), errors: Vec::new() }
    }

    fn send(&mut self, messages: &[ClientMessage]) {
        let text = String::from_utf8(Encoding::Json.write(messages)).expect("JSON is UTF-8");
        self.socket.send(Message::text(text)).expect("the socket is open");
    }

    /// Does at once what the server says, and answers what it is to be told: everything comes in no time.
    fn obey(&mut self, t_ns: u64) -> (Vec<ClientMessage>, usize) {
        let (mut told, mut fetched) = (Vec::new(), 0);
        loop {
            let frame = match self.socket.read() {
                Ok(Message::Text(text)) => text,
                Ok(_) => continue,
                Err(tungstenite::Error::Io(error))
                    if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) =>
                {
                    return (told, fetched);
                }
                Err(error) => panic!("the server has closed the session: {error}; {:?}", self.errors),
            };
            for message in Encoding::Json.read::<ServerMessage>(frame.as_bytes()).expect("messages of the server") {
                match message {
                    ServerMessage::Fetch(fetch) => {
                        fetched += 1;
                        for rep in &fetch.discard_on_arrival {
                            self.held -= self.sizes.remove(rep).expect("what is to be freed is held");
                        }
                        self.held += fetch.decoded_bytes;
                        assert!(self.held <= MEMORY, "{} bytes of {MEMORY}", self.held);
                        let twice = self.sizes.insert(fetch.rep, fetch.decoded_bytes);
                        assert_eq!(twice, None, "{} is held already", fetch.rep);
                        let event = Event { t_ns, rep: fetch.rep };
                        told.extend([
                            ClientMessage::Responded(event),
                            ClientMessage::Arrived(event),
                            ClientMessage::Completed(event),
                        ]);
                    }
                    ServerMessage::Discard { rep } | ServerMessage::Cancel { rep } => {
                        self.held -= self.sizes.remove(&rep).unwrap_or_default();
                    }
                    ServerMessage::Error(error) => {
                        assert!(!error.fatal, "{}", error.message);
                        self.errors.push(error.message);
                    }
                    _ => {}
                }
            }
        }
    }
}

#[test]
fn a_clock_that_jumps_an_hour_either_way_stops_no_session() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let server = Server::start(folder.path(), &["--world", "city:blocks=20"]);
    let mut client = Client::connect(&server);
    client.send(&[ClientMessage::Hello(Box::new(Hello {
        version: VERSION,
        world: "city".to_owned(),
        memory_bytes: MEMORY,
        refinement: Refinement::Partial,
        policy: None,
        mode: Mode::Drive,
        resume: None,
        resident: Vec::new(),
        client: None,
        link: None,
    }))]);
    // Steps of 50 ms; the clock is an hour ahead from the 40th to the 80th, and an hour behind from the 120th on.
    let mut fetched = [0usize; 4];
    let mut told = Vec::new();
    for step in 0..160u64 {
        let right_ns = HOUR_NS + step * 50_000_000;
        let phase = (step / 40) as usize;
        let t_ns = [right_ns, right_ns + HOUR_NS, right_ns, right_ns - HOUR_NS][phase];
        // Looks along the street and goes on, 20 m/s.
        let camera = Camera {
            position: [-900.0 + step as f64, -1000.0, 2.0],
            orientation: [0.5, -0.5, -0.5, 0.5],
            fov_y: 1.0,
            viewport: [1280, 720],
            weight: 1.0,
        };
        told.push(ClientMessage::View(Views { t_ns, cameras: vec![camera] }));
        client.send(&told);
        let (next, count) = client.obey(t_ns);
        told = next;
        fetched[phase] += count;
    }
    println!("fetched before, an hour ahead, back, an hour behind: {fetched:?}; {:?}", client.errors);
    assert!(fetched.iter().all(|&count| count > 0), "{fetched:?}");
    assert!(client.errors.iter().all(|error| error.contains("clock")), "{:?}", client.errors);
    // The first view, an hour from the server's clock, is a jump too.
    assert!((3..=4).contains(&client.errors.len()), "{:?}", client.errors);
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
}
