//! How sessions begin, go on after a break, and end.

use std::path::Path;

use crate::WORLD;
use foresight_tests::sidecar::client::{Client, Received, hello, http, view};
use foresight_tests::sidecar::process::Server;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Hello, Mode, ServerMessage};

fn server(folder: &Path, options: &[&str]) -> Server {
    Server::start(folder, &[&WORLD, options].concat())
}

#[test]
fn both_encodings_are_told_what_to_fetch() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = server(folder.path(), &[]);
    for encoding in [Encoding::Json, Encoding::MessagePack] {
        let mut client = Client::connect(server.port(), encoding);
        let welcome = client.greet(hello("w"));
        assert!(!welcome.resumed && welcome.driving && welcome.representations > 0, "{welcome:?}");
        assert_eq!(welcome.session.len(), 32);
        let rep = client.fetch();
        assert!(client.complete(rep));
        assert!(client.send(&[ClientMessage::Bye]));
        let (errors, code, reason) = client.closed();
        assert_eq!((errors, code, reason.as_str()), (Vec::new(), 1000, "bye"));
    }
    assert_eq!(server.metric("foresight_sessions_opened_total"), Some(2.0));
    assert_eq!(server.metric("foresight_requests_completed_total"), Some(2.0));
    assert_eq!(server.metric("foresight_sessions_active"), Some(0.0));
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert_eq!(log.matches("session begins").count(), 2, "{log}");
    assert_eq!(log.matches("session ends").count(), 2, "{log}");
}

#[test]
fn a_session_goes_on_after_a_break_and_for_nobody_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = server(folder.path(), &["--keep-session", "2s"]);
    let mut first = Client::connect(server.port(), Encoding::Json);
    let session = first.greet(hello("w")).session;
    let rep = first.fetch();
    assert!(first.complete(rep));
    drop(first);
    let resume = |id: &str| Hello { resume: Some(id.to_owned()), resident: vec![rep], ..hello("w") };
    let mut second = Client::connect(server.port(), Encoding::Json);
    let welcome = second.greet(resume(&session));
    assert!(welcome.resumed && welcome.session == session, "{welcome:?}");
    // What is held is not fetched again.
    assert_ne!(second.fetch(), rep);
    // Another connection takes over; the one before is told.
    let mut third = Client::connect(server.port(), Encoding::MessagePack);
    assert!(third.greet(resume(&session)).resumed);
    let (errors, ..) = second.closed();
    assert!(errors.iter().any(|error| error.contains("another connection")), "{errors:?}");
    drop(third);
    // A guess begins a session of its own, with what the client holds.
    let mut stranger = Client::connect(server.port(), Encoding::Json);
    let welcome = stranger.greet(resume(&"0".repeat(32)));
    assert!(!welcome.resumed && welcome.session != session, "{welcome:?}");
    assert_ne!(stranger.fetch(), rep);
    // After a while nobody comes back.
    for _ in 0..100 {
        std::thread::sleep(std::time::Duration::from_millis(100));
        if server.metric("foresight_sessions_active") == Some(1.0) {
            break;
        }
    }
    let mut late = Client::connect(server.port(), Encoding::Json);
    assert!(!late.greet(resume(&session)).resumed);
    assert_eq!(server.metric("foresight_sessions_resumed_total"), Some(2.0));
}

#[test]
fn a_restarted_server_refetches_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = server(folder.path(), &[]);
    let mut client = Client::connect(first.port(), Encoding::Json);
    let session = client.greet(hello("w")).session;
    let rep = client.fetch();
    assert!(client.complete(rep));
    first.kill();
    let second = server(folder.path(), &[]);
    let mut client = Client::connect(second.port(), Encoding::Json);
    let welcome = client.greet(Hello { resume: Some(session), resident: vec![rep], ..hello("w") });
    assert!(!welcome.resumed);
    for _ in 0..5 {
        assert_ne!(client.fetch(), rep);
    }
}

#[test]
fn the_switch_is_obeyed_by_all_or_by_one_world() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = ["--world", "v=city:blocks=3", "--not-driven", "v"];
    let server = server(folder.path(), &options);
    let switch =
        |body: &str| http(server.port(), "POST", "/admin/driving", &[("Content-Type", "application/json")], body);
    let switched = |client: &mut Client| {
        client.until(|message| match message {
            ServerMessage::Switch { driving } => Some(*driving),
            _ => None,
        })
    };
    let mut left_alone = Client::connect(server.port(), Encoding::Json);
    left_alone.greet(hello("v"));
    let mut driven = Client::connect(server.port(), Encoding::Json);
    driven.greet(hello("w"));
    driven.fetch();
    let (status, _, body) = switch("{\"driving\": false}");
    assert_eq!((status, body.as_str()), (200, "{\"driving\":false,\"not_driven\":[\"v\"]}"));
    assert!(!switched(&mut driven));
    // A client that fetches by its own rules is not told anything.
    let event = foresight_wire::message::Event { t_ns: 9_000_000_000, rep: 0 };
    assert!(driven.send(&[ClientMessage::Completed(event), view(9_000_000_000, 3)]));
    assert_eq!(switch("{\"driving\": true}").0, 200);
    assert!(switched(&mut driven));
    assert_eq!(switch("{\"driving\": true, \"world\": \"v\"}").0, 200);
    let mut told: Vec<bool> = Vec::new();
    while told.last() != Some(&true) {
        told.push(switched(&mut left_alone));
    }
    left_alone.fetch();
    assert_eq!(switch("{\"driving\": true, \"world\": \"x\"}").0, 404);
    assert_eq!(switch("{}").0, 422);
}

#[test]
fn a_shadow_is_told_nothing_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = server(folder.path(), &["--record", "recordings"]);
    let mut client = Client::connect(server.port(), Encoding::Json);
    let welcome = client.greet(Hello { mode: Mode::Shadow, ..hello("w") });
    assert!(!welcome.driving);
    for number in 0..30 {
        assert!(client.send(&[view(number * 100_000_000, number)]));
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    assert!(client.send(&[ClientMessage::Bye]));
    let mut told = Vec::new();
    loop {
        match client.read() {
            Received::Messages(messages) => told.extend(messages),
            Received::Closed(..) => break,
            other => panic!("expected the end, not {other:?}"),
        }
    }
    let orders = |message: &ServerMessage| {
        matches!(message, ServerMessage::Fetch(_) | ServerMessage::Cancel { .. } | ServerMessage::Discard { .. })
    };
    assert!(!told.iter().any(orders), "{told:?}");
    server.stop();
    let recordings = std::fs::read_dir(folder.path().join("recordings")).expect("the folder");
    let files: Vec<_> = recordings.map(|entry| entry.expect("an entry").path()).collect();
    assert!(files.len() == 1 && files[0].extension().is_some_and(|e| e == "jsonl"), "{files:?}");
    let recording = std::fs::read_to_string(&files[0]).expect("readable");
    assert!(recording.contains("\"unsent\":[{\"type\":\"fetch\""), "decisions are recorded: {recording}");
}

#[test]
fn every_end_has_its_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = ["--hello-within", "300ms", "--idle-after", "600ms", "--ping-every", "200ms"];
    let server = server(folder.path(), &options);
    let mut silent = Client::connect(server.port(), Encoding::Json);
    let (errors, code, _) = silent.closed();
    assert!(code == 1008 && errors[0].contains("no hello within"), "{errors:?} {code}");
    // Answers no ping.
    let mut frozen = Client::connect(server.port(), Encoding::Json);
    frozen.greet(hello("w"));
    std::thread::sleep(std::time::Duration::from_millis(1500));
    let (errors, ..) = frozen.closed();
    assert!(errors.iter().any(|error| error.contains("nothing came")), "{errors:?}");
    let refused = |hello: Hello| {
        let mut client = Client::connect(server.port(), Encoding::Json);
        assert!(client.send(&[ClientMessage::Hello(Box::new(hello))]));
        client.closed().0.join(" ")
    };
    assert!(refused(hello("nowhere")).contains("expected one of w"));
    assert!(refused(Hello { version: 99, ..hello("w") }).contains("99"));
    assert!(refused(Hello { memory_bytes: 0, ..hello("w") }).contains("memory_bytes"));
    assert!(refused(Hello { policy: Some("clairvoyant".to_owned()), ..hello("w") }).contains("clairvoyant"));
    let mut late = Client::connect(server.port(), Encoding::Json);
    assert!(late.send(&[view(0, 0)]));
    assert!(late.closed().0[0].contains("no hello"));
    assert_eq!(server.metric("foresight_sessions_active"), Some(1.0), "the frozen one is kept for a while");
}
