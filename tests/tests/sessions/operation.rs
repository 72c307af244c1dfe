//! Configuration, access, recordings, the database and shutdown, as an operator meets them.

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

use crate::WORLD;
use foresight_tests::program;
use foresight_tests::sidecar::client::{Client, hello, http};
use foresight_tests::sidecar::process::Server;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Hello};

const LIMIT: Duration = Duration::from_secs(60);
const TOKEN: &str = "0123456789-abcdef";

#[test]
fn the_configuration_is_checked_and_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |arguments: &[&str]| program::run("foresight-server", folder.path(), arguments, &[], LIMIT);
    let file = folder.path().join("foresight.toml");
    std::fs::write(&file, "sessions_max = 12\nkeep_session = \"2m\"\n").expect("written");
    let shown = run(&["serve", "--config", "foresight.toml", "--sessions-max", "13", "--print-config"]);
    assert_eq!(shown.code, Some(0), "{}", shown.stderr);
    assert!(shown.stdout.contains("sessions_max = 13\n") && shown.stdout.contains("keep_session = \"2m\"\n"));
    // What is shown is a file that gives the same.
    std::fs::write(&file, &shown.stdout).expect("written");
    assert_eq!(run(&["serve", "--config", "foresight.toml", "--print-config"]).stdout, shown.stdout);
    for (text, expected) in [
        ("sessions_max = \"many\"", "foresight.toml: sessions_max = \"many\"; expected a whole number from 1 to"),
        ("sesions_max = 1", "sesions_max: no such setting"),
        ("listen = \"0.0.0.0:0\"", "expected a loopback address, FORESIGHT_TOKEN or token_file"),
        ("token_file = \"absent\"", "absent"),
    ] {
        std::fs::write(&file, text).expect("written");
        let refused = run(&["serve", "--config", "foresight.toml", "--world", "city:blocks=1"]);
        assert_eq!(refused.code, Some(2), "{text}");
        assert!(refused.stderr.contains(expected), "{}", refused.stderr);
    }
}

#[test]
fn without_the_token_or_from_a_strange_page_nothing_is_to_be_had() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("token"), format!("{TOKEN}\n")).expect("written");
    let server = Server::start(folder.path(), &[&WORLD[..], &["--token-file", "token"]].concat());
    let port = server.port();
    let bearer = format!("Bearer {TOKEN}");
    let connect = |fields: &[(&str, &str)]| Client::try_connect(port, Encoding::Json, fields).map(drop);
    assert_eq!(connect(&[]), Err(401));
    assert_eq!(connect(&[("Authorization", "Bearer 0123456789-abcdeg")]), Err(401));
    assert_eq!(connect(&[("Authorization", &bearer)]), Ok(()));
    assert_eq!(connect(&[("Authorization", &bearer), ("Origin", "https://evil.example")]), Err(403));
    let own = format!("http://127.0.0.1:{port}");
    assert_eq!(connect(&[("Authorization", &bearer), ("Origin", &own)]), Ok(()));
    for (method, path, open) in [
        ("POST", "/sessions", false),
        ("GET", "/metrics", false),
        ("GET", "/admin/driving", false),
        ("POST", "/admin/driving", false),
        ("DELETE", "/sessions/00", false),
        ("GET", "/worlds", true),
        ("GET", "/health/ready", true),
    ] {
        let status = http(port, method, path, &[], "").0;
        assert_eq!(status != 401, open, "{method} {path}: {status}");
    }
    assert_eq!(http(port, "GET", &format!("/admin/driving?token={TOKEN}"), &[], "").0, 200);
    let (_, log) = server.stop();
    assert!(!log.contains(TOKEN), "{log}");
}

#[test]
fn limits_on_sessions_hold_and_are_given_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = ["--sessions-max", "5", "--sessions-per-address-max", "3"];
    let server = Server::start(folder.path(), &[&WORLD[..], &options].concat());
    let open = || Client::connect(server.port(), Encoding::Json);
    let mut held: Vec<(Client, String)> = Vec::new();
    for _ in 0..3 {
        let mut client = open();
        let session = client.greet(hello("w")).session;
        held.push((client, session));
    }
    let mut fourth = open();
    assert!(fourth.send(&[ClientMessage::Hello(Box::new(hello("w")))]));
    let (errors, code, _) = fourth.closed();
    assert!(code == 1008 && errors[0].contains("3 sessions of this address"), "{errors:?} {code}");
    // Who comes back to a session needs no further one.
    let (broken, session) = held.remove(0);
    drop(broken);
    let mut back = open();
    assert!(back.greet(Hello { resume: Some(session), ..hello("w") }).resumed);
    assert!(back.send(&[ClientMessage::Bye]));
    assert_eq!(back.closed().1, 1000);
    open().greet(hello("w"));
    assert_eq!(server.metric("foresight_sessions_refused_total"), Some(1.0));
}

#[test]
fn a_recording_replays_to_the_same_decisions() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &[&WORLD[..], &["--record", "recordings"]].concat());
    let mut client = Client::connect(server.port(), Encoding::Json);
    let session = client.greet(hello("w")).session;
    for _ in 0..5 {
        let rep = client.fetch();
        assert!(client.complete(rep));
    }
    drop(client);
    let mut client = Client::connect(server.port(), Encoding::MessagePack);
    assert!(client.greet(Hello { resume: Some(session), ..hello("w") }).resumed);
    client.fetch();
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    let recordings = std::fs::read_dir(folder.path().join("recordings")).expect("the folder");
    let files: Vec<_> = recordings.map(|entry| entry.expect("an entry").path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    let file = files[0].display().to_string();
    assert!(file.ends_with(".jsonl"), "{file}");
    let arguments = ["replay", "--session", &file, "--world", "city:blocks=4"];
    let replayed = program::sim(folder.path(), &arguments, Duration::from_secs(300));
    assert_eq!(replayed.code, Some(0), "{}\n{}", replayed.stdout, replayed.stderr);
    let equal = replayed.stdout.lines().find(|line| line.contains("decisions equal")).unwrap_or_default();
    let counts: Vec<&str> = equal.split_whitespace().filter(|word| word.parse::<u64>().is_ok()).collect();
    assert!(counts.len() == 4 && counts[0] == counts[1] && counts[2] == counts[3], "{}", replayed.stdout);
}

#[test]
fn a_full_disk_for_recordings_harms_no_session() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = ["--record", "recordings", "--record-bytes-max", "2KiB"];
    let server = Server::start(folder.path(), &[&WORLD[..], &options].concat());
    let mut client = Client::connect(server.port(), Encoding::Json);
    client.greet(hello("w"));
    for _ in 0..10 {
        let rep = client.fetch();
        assert!(client.complete(rep));
    }
    // Recordings are written beside the session.
    let cut_short = || server.metric("foresight_recordings_cut_short_total");
    for _ in 0..200 {
        if cut_short() == Some(1.0) {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(cut_short(), Some(1.0));
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    let recordings = std::fs::read_dir(folder.path().join("recordings")).expect("the folder");
    let files: Vec<_> = recordings.map(|entry| entry.expect("an entry").path()).collect();
    assert!(files.len() == 1 && files[0].to_string_lossy().ends_with(".partial"), "{files:?}");
    assert!(std::fs::metadata(&files[0]).expect("its facts").len() <= 2048);
}

fn fly(server: &Server, name: &str) {
    let mut client = Client::connect(server.port(), Encoding::Json);
    client.greet(Hello { client: Some(name.to_owned()), ..hello("w") });
    for _ in 0..3 {
        let rep = client.fetch();
        assert!(client.complete(rep));
    }
    assert!(client.send(&[ClientMessage::Bye]));
    client.closed();
}

/// Waits until the server is, or is no longer, degraded.
fn becomes(server: &Server, degraded: bool) {
    for _ in 0..200 {
        let (status, body) = server.get("/health/ready");
        assert_eq!(status, 200, "{body}");
        if body.contains("degraded") == degraded {
            return;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    panic!("expected degraded: {degraded}; {}", server.log());
}

#[test]
fn link_estimates_survive_and_the_database_may_come_and_go() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sessions.sqlite");
    let options = [&WORLD[..], &["--database", "sqlite:sessions.sqlite"]].concat();
    let server = Server::start(folder.path(), &options);
    fly(&server, "tablet\u{1b}[31m\nforged line");
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(!log.contains('\u{1b}') && !log.contains("\nforged"), "{log:?}");
    let written = std::fs::read(&file).expect("the database");
    assert!(written.windows(6).any(|bytes| bytes == b"tablet"), "the estimate is in the file");

    let server = Server::start(folder.path(), &options);
    becomes(&server, false);
    // Gone: noticed at the next write, made anew, and what waited is written.
    std::fs::remove_file(&file).expect("removed");
    fly(&server, "desk");
    let written = || std::fs::read(&file).is_ok_and(|file| file.windows(4).any(|bytes| bytes == b"desk"));
    for _ in 0..400 {
        if written() {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(written(), "it is not made anew: {}", server.log());
    becomes(&server, false);
    // Nothing to be had at all: the server goes on without.
    std::fs::remove_file(&file).expect("removed");
    std::fs::create_dir(&file).expect("a folder in its place");
    fly(&server, "desk");
    becomes(&server, true);
    fly(&server, "phone");
    std::fs::remove_dir(&file).expect("removed");
    becomes(&server, false);
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(file.is_file());
}

#[test]
fn a_signal_ends_sessions_with_a_word() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &[&WORLD[..], &["--log", "json"]].concat());
    let mut client = Client::connect(server.port(), Encoding::Json);
    client.greet(Hello { client: Some("\"\u{7}".to_owned()), ..hello("w") });
    client.fetch();
    let reading = std::thread::spawn(move || client.closed());
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    let (errors, code, _) = reading.join().expect("the reader ends");
    assert!(code == 1001 && errors.iter().any(|error| error.contains("shutting down")), "{errors:?} {code}");
    let lines: Vec<serde_json::Value> =
        log.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|_| panic!("no JSON: {line:?}"))).collect();
    let end = lines.iter().find(|line| line["message"] == "session ends").expect("its line");
    assert!(end["reason"] == "shutdown" && end["frames"].as_u64() >= Some(1), "{end}");
}

#[test]
fn a_second_signal_ends_what_the_first_waits_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let options = ["--link", "constant:8kbit,40ms", "--shutdown-within", "5m"];
    let mut server = Server::start(folder.path(), &[&WORLD[..], &options].concat());
    let mut client = Client::connect(server.port(), Encoding::Json);
    client.greet(hello("w"));
    assert!(client.send(&[foresight_tests::sidecar::client::view(0, 1)]));
    let uri = client.until(|message| match message {
        foresight_wire::message::ServerMessage::Fetch(fetch) => Some(fetch.uri.clone()),
        _ => None,
    });
    // A transfer of many seconds, which the first signal lets come to its end.
    let mut transfer = TcpStream::connect(("127.0.0.1", server.port())).expect("the server listens");
    write!(transfer, "GET {uri} HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("written");
    transfer.read_exact(&mut [0; 16]).expect("the answer begins");
    server.terminate();
    std::thread::sleep(Duration::from_millis(500));
    assert!(server.runs(), "{}", server.log());
    let (code, log) = server.stop();
    assert_eq!(code, Some(130), "{log}");
}
