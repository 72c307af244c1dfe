//! Clients that mean harm: each is answered or closed with a reason, others notice nothing, memory stays bounded.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use foresight_tests::sidecar::client::{Client, Received, hello, http};
use foresight_tests::sidecar::process::Server;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Event};

const WORLD: [&str; 2] = ["--world", "w=city:blocks=4"];

/// Memory that the server may take beyond what it had, bytes: the bounds of a few connections.
const GROWTH_MAX: u64 = 64 << 20;

/// Does `harm` while another client flies; that one must be answered throughout, and the server not swell.
fn beside_a_flight(options: &[&str], harm: impl FnOnce(&Server)) {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &[&WORLD[..], options].concat());
    let mut witness = Client::connect(server.port(), Encoding::Json);
    witness.greet(hello("w"));
    witness.fetch();
    let before = server.resident_bytes();
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let flying = scope.spawn(|| {
            let mut number = 200_u64;
            while !over.load(Ordering::Relaxed) || number < 210 {
                number += 1;
                assert!(witness.probe(number), "the flight goes on");
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        // The flight ends also where the harm fails.
        let done = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| harm(&server)));
        over.store(true, Ordering::Relaxed);
        flying.join().expect("the flight was not disturbed");
        done.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    });
    let after = server.resident_bytes();
    assert!(after < before + GROWTH_MAX, "from {before} to {after} bytes");
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(!log.contains("panicked"), "{log}");
}

fn greeted(server: &Server, encoding: Encoding) -> Client {
    let mut client = Client::connect(server.port(), encoding);
    client.greet(hello("w"));
    client
}

#[test]
fn floods_are_closed_with_their_reason() {
    beside_a_flight(&["--frames-per-second-max", "100"], |server| {
        let mut flood = greeted(server, Encoding::Json);
        let mut sent = 0;
        while sent < 20_000 && flood.send_text("[]") {
            sent += 1;
        }
        let (errors, code, _) = flood.closed();
        assert!(code == 1008 && errors.iter().any(|error| error.contains("frames")), "{errors:?} {code}");
        let mut pings = greeted(server, Encoding::Json);
        let ping = || tokio_tungstenite::tungstenite::Message::Ping(Vec::new().into());
        while pings.socket.send(ping()).is_ok() {}
        let mut bytes = greeted(server, Encoding::Json);
        let padded = format!("[{}]", " ".repeat(500_000));
        while bytes.send_text(&padded) {}
    });
}

#[test]
fn what_is_too_large_too_deep_or_garbage_is_closed_with_its_reason() {
    beside_a_flight(&[], |server| {
        let closed = |client: &mut Client| {
            let (errors, code, reason) = client.closed();
            assert!(!errors.is_empty() && !reason.is_empty() && code > 1000, "{errors:?} {code} {reason}");
            errors.join(" ")
        };
        let mut large = greeted(server, Encoding::Json);
        let _ = large.send_text(&format!("[{}]", " ".repeat(3 << 20)));
        // The server reads no further; how much of its answer arrives is the network's.
        assert!(!matches!(large.read(), Received::Nothing));
        for deep in ["[".repeat(200_000), "{\"a\":".repeat(100_000), "[{\"type\":".repeat(50_000)] {
            let mut client = greeted(server, Encoding::Json);
            assert!(client.send_text(&deep));
            closed(&mut client);
        }
        let mut packed = greeted(server, Encoding::MessagePack);
        let deep = vec![0x91_u8; 500_000];
        assert!(packed.socket.send(tokio_tungstenite::tungstenite::Message::binary(deep)).is_ok());
        closed(&mut packed);
        // A length that promises 4 GiB.
        let mut promise = greeted(server, Encoding::MessagePack);
        assert!(
            promise
                .socket
                .send(tokio_tungstenite::tungstenite::Message::binary(vec![0xdd, 255, 255, 255, 255]))
                .is_ok()
        );
        closed(&mut promise);
        let mut text = greeted(server, Encoding::MessagePack);
        assert!(text.send_text("[]"));
        assert!(closed(&mut text).contains("binary"));
        let mut number = greeted(server, Encoding::Json);
        assert!(number.send_text("[{\"type\":\"view\",\"t_ns\":1e400,\"cameras\":[]}]"));
        closed(&mut number);
    });
}

#[test]
fn compression_is_not_offered() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &WORLD);
    let mut stream = TcpStream::connect(("127.0.0.1", server.port())).expect("the server listens");
    write!(
        stream,
        "GET /sessions/socket HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Extensions: permessage-deflate; client_max_window_bits\r\n\r\n"
    )
    .expect("the request is written");
    let mut head = [0; 512];
    let length = stream.read(&mut head).expect("an answer");
    let head = String::from_utf8_lossy(&head[..length]).to_ascii_lowercase();
    assert!(head.starts_with("http/1.1 101") && !head.contains("extensions"), "{head}");
    // A frame that says it is compressed (RSV1), masked with zeros.
    stream.write_all(&[0b1100_0001, 0x80 | 2, 0, 0, 0, 0, b'[', b']']).expect("the frame is written");
    let mut answer = Vec::new();
    stream.set_read_timeout(Some(Duration::from_secs(10))).expect("a timeout can be set");
    let _ = stream.read_to_end(&mut answer);
    let answer = String::from_utf8_lossy(&answer);
    assert!(answer.contains("malformed") || answer.contains("\u{3}"), "closed with a reason: {answer:?}");
    let body = [("Content-Type", "application/json"), ("Content-Encoding", "gzip")];
    assert!(matches!(http(server.port(), "POST", "/sessions", &body, "\u{1f}").0, 400 | 415));
}

#[test]
fn a_slow_consumer_is_let_go() {
    let options = [
        "--answers-max",
        "64",
        "--frames-per-second-max",
        "100000",
        "--bytes-per-second-max",
        "1GiB",
        "--idle-after",
        "20s",
    ];
    beside_a_flight(&options, |server| {
        let mut slow = greeted(server, Encoding::Json);
        // Is answered with errors and reads none: they gather in its socket, then in its queue.
        let unknown = ClientMessage::Completed(Event { t_ns: 0, rep: u32::MAX });
        let frame = vec![unknown; 16];
        let closed = || server.get("/metrics").1.contains("foresight_connections_closed_total{reason=\"slow\"} 1");
        let mut sent = 0;
        while slow.send(&frame) && (sent % 500 != 0 || !closed()) {
            sent += 1;
            assert!(sent < 400_000, "it is still taken for a reader");
        }
        for _ in 0..100 {
            if closed() {
                return;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("{}", server.get("/metrics").1);
    });
}

#[test]
fn a_head_that_trickles_and_a_frame_that_never_ends_are_cut_off() {
    beside_a_flight(&["--head-within", "1s", "--idle-after", "1s", "--ping-every", "300ms"], |server| {
        let mut trickle = TcpStream::connect(("127.0.0.1", server.port())).expect("the server listens");
        trickle.set_read_timeout(Some(Duration::from_secs(10))).expect("a timeout can be set");
        trickle.write_all(b"GET /sessions/socket HT").expect("written");
        let mut rest = Vec::new();
        let _ = trickle.read_to_end(&mut rest);
        let mut never = greeted(server, Encoding::Json);
        // A text frame of 100 bytes of which one comes.
        never.socket.get_mut().write_all(&[0x81, 0x80 | 100, 0, 0, 0, 0, b'[']).expect("written");
        std::thread::sleep(Duration::from_millis(1500));
        let (errors, ..) = never.closed();
        assert!(errors.iter().any(|error| error.contains("nothing came")), "{errors:?}");
    });
}

/// A number that follows from the one before.
fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

/// A frame that is a list of messages nearly as it should be.
fn nearly(state: &mut u64) -> String {
    let number = |state: &mut u64| match random(state) % 100 {
        0 => "-1".to_owned(),
        1 => "1e308".to_owned(),
        2 => "null".to_owned(),
        3 => "\"x\"".to_owned(),
        4..10 => u64::MAX.to_string(),
        10..20 => u32::MAX.to_string(),
        20..40 => "0".to_owned(),
        _ => (random(state) % 2000).to_string(),
    };
    let kinds = ["responded", "arrived", "completed", "dropped", "failed", "progress", "view", "settings"];
    let message = |state: &mut u64| {
        let kind = kinds[(random(state) % kinds.len() as u64) as usize];
        let (a, b, c) = (number(state), number(state), number(state));
        match kind {
            "view" => format!(
                "{{\"type\":\"view\",\"t_ns\":{a},\"cameras\":[{{\"position\":[{b},{c},0],\"orientation\":[0,0,0,1],\"fov_y\":{c},\"viewport\":[{b},9]}}]}}"
            ),
            "progress" => format!("{{\"type\":\"progress\",\"t_ns\":{a},\"total_bytes\":{b},\"in_flight_bytes\":{c}}}"),
            "settings" => format!("{{\"type\":\"settings\",\"memory_bytes\":{a}}}"),
            "failed" => format!("{{\"type\":\"failed\",\"t_ns\":{a},\"rep\":{b},\"reason\":\"\\u0000\\u001b\"}}"),
            kind => format!("{{\"type\":\"{kind}\",\"t_ns\":{a},\"rep\":{b}}}"),
        }
    };
    let messages: Vec<String> = (0..random(state) % 4).map(|_| message(state)).collect();
    let mut text = format!("[{}]", messages.join(","));
    if random(state).is_multiple_of(32) {
        let place = (random(state) % text.len() as u64) as usize;
        text.replace_range(place..place + 1, ["\u{0}", "[", "é", "\\", ""][(random(state) % 5) as usize]);
    }
    text
}

/// Sends so many frames of garbage over as many connections as it takes.
fn garbage(server: &Server, frames: u64, seed: u64) {
    let mut state = seed;
    let mut sent = 0;
    let mut connections = 0;
    while sent < frames {
        connections += 1;
        let mut client = greeted(server, Encoding::Json);
        let mut open = true;
        while open && sent < frames {
            // In small groups, each answered before the next.
            for _ in 0..20 {
                sent += 1;
                open = open && client.send_text(&nearly(&mut state));
            }
            // Where the server has closed while we still wrote, its reason may be lost on the way.
            open = open && client.probe(sent);
        }
    }
    println!("{frames} frames over {connections} connections");
}

#[test]
fn garbage_is_answered_or_closed_with_a_reason() {
    let options = ["--frames-per-second-max", "100000", "--bytes-per-second-max", "1GiB", "--keep-session", "0s"];
    let frames = if foresight_tests::full().is_ok() { 100_000 } else { 10_000 };
    beside_a_flight(&options, |server| {
        std::thread::scope(|scope| {
            for part in 0..4 {
                scope.spawn(move || garbage(server, frames / 4, 0x9e37_79b9 + part));
            }
        });
        assert_eq!(server.metric("foresight_session_panics_total"), Some(0.0));
    });
}

#[test]
fn many_worlds_and_many_clients_that_only_connect() {
    let folder = tempfile::tempdir().expect("a folder");
    let worlds: Vec<String> = (0..24).map(|n| format!("w{n}=city:blocks=2")).collect();
    let mut options = vec!["--world"];
    options.extend(worlds.iter().map(String::as_str));
    options.extend(["--sessions-per-address-max", "60", "--hello-within", "2s"]);
    let server = Server::start(folder.path(), &options);
    let silent: Vec<TcpStream> =
        (0..200).map(|_| TcpStream::connect(("127.0.0.1", server.port())).expect("the server listens")).collect();
    let waiting: Vec<Client> = (0..30).map(|_| Client::connect(server.port(), Encoding::Json)).collect();
    for number in 0..24 {
        let mut client = Client::connect(server.port(), Encoding::MessagePack);
        let welcome = client.greet(hello(&format!("w{number}")));
        assert_eq!(welcome.world, format!("w{number}"));
        client.fetch();
        assert!(client.send(&[ClientMessage::Bye]));
        client.closed();
    }
    for mut client in waiting {
        assert!(client.closed().0[0].contains("no hello"));
    }
    drop(silent);
}

#[test]
fn schemathesis_finds_nothing() {
    if let Err(skipped) = foresight_tests::full() {
        println!("{skipped}");
        return;
    }
    let Some(program) = schemathesis() else {
        println!("skipped: schemathesis cannot be installed here");
        return;
    };
    let options = ["--sessions-max", "100000", "--sessions-per-address-max", "100000", "--keep-session", "0s"];
    beside_a_flight(&options, |server| {
        let schema = format!("http://127.0.0.1:{}/openapi.json", server.port());
        let checks = "not_a_server_error,response_schema_conformance,content_type_conformance";
        let examples = "500";
        // It keeps a cache where it runs.
        let folder = tempfile::tempdir().expect("a folder");
        let ended = std::process::Command::new(&program)
            .current_dir(folder.path())
            .args([
                "run",
                &schema,
                "--checks",
                checks,
                "--max-examples",
                examples,
                "--workers",
                "2",
                "--request-timeout",
                "20",
            ])
            .args(["--exclude-path", "/sessions/{id}/events", "--generation-deterministic", "--no-color"])
            .output()
            .expect("schemathesis runs");
        let said = String::from_utf8_lossy(&ended.stdout);
        assert!(ended.status.success(), "{said}");
        println!(
            "{}",
            said.lines().rev().take(20).collect::<Vec<_>>().into_iter().rev().collect::<Vec<_>>().join("\n")
        );
    });
}

/// The program, installed beside the build where it is missing.
fn schemathesis() -> Option<std::path::PathBuf> {
    let test = std::env::current_exe().expect("this test knows its own path");
    let folder = test.ancestors().nth(3).unwrap_or(Path::new(".")).join("schemathesis");
    let program = folder.join("bin/schemathesis");
    if !program.is_file() {
        let ran = |program: &Path, arguments: &[&str]| {
            std::process::Command::new(program).args(arguments).status().is_ok_and(|status| status.success())
        };
        let made = ran(Path::new("python3"), &["-m", "venv", folder.to_str()?]);
        if !made || !ran(&folder.join("bin/pip"), &["install", "--quiet", "schemathesis"]) {
            return None;
        }
    }
    Some(program)
}
