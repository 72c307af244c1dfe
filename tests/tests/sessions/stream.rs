//! Sessions without a WebSocket: frames posted, answers as server-sent events.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::Duration;

use crate::WORLD;
use foresight_tests::sidecar::client::{hello, http, view};
use foresight_tests::sidecar::process::Server;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Event, ServerMessage};

const JSON: [(&str, &str); 1] = [("Content-Type", "application/json")];

fn text(messages: &[ClientMessage]) -> String {
    String::from_utf8(Encoding::Json.write(messages)).expect("JSON is UTF-8")
}

/// Somebody who reads events.
struct Reader {
    lines: std::io::Lines<BufReader<TcpStream>>,
}

impl Reader {
    fn open(port: u16, path: &str, last: Option<u64>) -> Reader {
        let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("the server listens");
        stream.set_read_timeout(Some(Duration::from_secs(20))).expect("a timeout can be set");
        let last = last.map(|last| format!("Last-Event-ID: {last}\r\n")).unwrap_or_default();
        write!(stream, "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAccept: text/event-stream\r\n{last}\r\n")
            .expect("the request is written");
        let mut lines = BufReader::new(stream).lines();
        let status = lines.next().expect("a status").expect("readable");
        assert!(status.contains("200"), "{status}");
        Reader { lines }
    }

    /// Number, name and messages of the next event.
    fn next(&mut self) -> Option<(u64, String, Vec<ServerMessage>)> {
        let (mut number, mut name, mut messages) = (0, String::new(), None);
        while let Some(Ok(line)) = self.lines.next() {
            if let Some(id) = line.strip_prefix("id: ") {
                number = id.parse().expect("a number");
            } else if let Some(event) = line.strip_prefix("event: ") {
                name = event.to_owned();
            } else if let Some(data) = line.strip_prefix("data: ") {
                messages = Some(Encoding::Json.read(data.as_bytes()).expect("messages of the server"));
            } else if let (true, Some(messages)) = (line.is_empty(), messages.take()) {
                return Some((number, name, messages));
            }
        }
        None
    }
}

#[test]
fn a_session_without_a_socket() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &WORLD);
    let port = server.port();
    let (status, head, body) =
        http(port, "POST", "/sessions", &JSON, &text(&[ClientMessage::Hello(Box::new(hello("w")))]));
    assert_eq!(status, 201, "{body}");
    let opened: serde_json::Value = serde_json::from_str(&body).expect("JSON");
    assert_eq!(opened["messages"][0]["type"], "welcome", "{body}");
    let session = opened["session"].as_str().expect("an id");
    assert!(head.contains(&format!("location: /sessions/{session}")), "{head}");
    let events = opened["events"].as_str().expect("a path");
    let frames = opened["frames"].as_str().expect("a path");
    let mut reader = Reader::open(port, events, None);
    assert_eq!(http(port, "POST", frames, &JSON, &text(&[view(0, 0)])).0, 202);
    let (first, name, messages) = reader.next().expect("an event");
    assert_eq!((first, name.as_str()), (1, ""));
    assert!(messages.iter().any(|message| matches!(message, ServerMessage::Fetch(_))), "{messages:?}");
    // Read on elsewhere: the same event again, and what came meanwhile: an objection.
    drop(reader);
    let wrong = ClientMessage::Completed(Event { t_ns: 33_000_000, rep: u32::MAX });
    assert_eq!(http(port, "POST", frames, &JSON, &text(&[wrong])).0, 202);
    let mut reader = Reader::open(port, events, Some(0));
    assert_eq!(reader.next().map(|(number, _, messages)| (number, messages)), Some((1, messages)));
    assert_eq!(reader.next().map(|(number, ..)| number), Some(2));
    // What is not to be had is refused with its reason.
    let other = [("Content-Type", "text/plain")];
    for (method, path, fields, body, expected) in [
        ("POST", frames, &JSON, "[{\"type\":", 400),
        ("POST", frames, &other, "[]", 415),
        ("POST", "/sessions", &JSON, "[]", 400),
        ("POST", "/sessions/00/frames", &JSON, "[]", 404),
        ("GET", "/sessions/00/events", &JSON, "", 404),
        ("DELETE", "/sessions/00", &JSON, "", 404),
        ("GET", "/sessions/socket", &JSON, "", 400),
    ] {
        let (status, head, answer) = http(port, method, path, fields, body);
        assert_eq!(status, expected, "{method} {path}: {answer}");
        assert!(head.contains("application/problem+json"), "{head}");
    }
    let long_ago = http(port, "GET", events, &[("Last-Event-ID", "99")], "");
    assert_eq!(long_ago.0, 410);
    assert_eq!(http(port, "DELETE", &format!("/sessions/{session}"), &[], "").0, 204);
    let mut last = String::new();
    while let Some((_, name, _)) = reader.next() {
        last = name;
    }
    assert_eq!(last, "end");
    assert_eq!(http(port, "POST", frames, &JSON, "[]").0, 404);
}

#[test]
fn too_much_is_told_when_to_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &[&WORLD[..], &["--frames-per-second-max", "5"]].concat());
    let port = server.port();
    let (_, _, body) = http(port, "POST", "/sessions", &JSON, &text(&[ClientMessage::Hello(Box::new(hello("w")))]));
    let opened: serde_json::Value = serde_json::from_str(&body).expect("JSON");
    let frames = opened["frames"].as_str().expect("a path");
    let answers: Vec<_> = (0..20).map(|_| http(port, "POST", frames, &JSON, "[]")).collect();
    assert!(answers.iter().take(5).all(|(status, ..)| *status == 202));
    let refused = answers.iter().find(|(status, ..)| *status == 429).expect("some are refused");
    assert!(refused.1.contains("retry-after:"), "{}", refused.1);
}
