//! Slow clients, too many of them, and the end of the server.

use std::io::{Read, Write};
use std::process::Command;
use std::time::Duration;

use crate::client::{Answer, BIG, Server, write_world};

/// Until the other side closes; what it has said.
fn rest(stream: &mut std::net::TcpStream) -> Vec<u8> {
    let mut bytes = Vec::new();
    let _ = stream.read_to_end(&mut bytes);
    bytes
}

#[test]
fn slow_clients_are_dropped_and_harm_nobody() {
    let folder = tempfile::tempdir().unwrap();
    write_world(folder.path());
    let server =
        Server::start(folder.path().to_str().unwrap(), &["--head-within", "1s", "--connection-idle-after", "2s"]);
    // One says nothing, one begins HTTP/2 and stops, one sends its head a byte at a time, one reads no answer.
    let mut silent = server.connect();
    let mut half = server.connect();
    half.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").unwrap();
    let mut slow = server.connect();
    let writer = {
        let mut slow = slow.try_clone().unwrap();
        std::thread::spawn(move || {
            for byte in
                b"GET /worlds HTTP/1.1\r\nhost: localhost\r\nx-slow: ".iter().chain(std::iter::repeat_n(&b'a', 1000))
            {
                if slow.write_all(&[*byte]).is_err() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        })
    };
    let mut deaf: Vec<_> = (0..4).map(|_| server.connect()).collect();
    for stream in &mut deaf {
        for _ in 0..10 {
            stream.write_all(b"GET /worlds/w/files/big.glb HTTP/1.1\r\nhost: a\r\n\r\n").unwrap();
        }
    }
    assert_eq!(server.get("/worlds/w/files/a.glb", &[]).body.len(), 5000);
    // The timeout of the socket would end these reads with an error only after 30 s.
    assert!(rest(&mut silent).is_empty());
    rest(&mut half);
    rest(&mut slow);
    writer.join().unwrap();
    std::thread::sleep(Duration::from_secs(4));
    for mut stream in deaf {
        // Whatever the system's buffers held; far less than was asked for.
        assert!(rest(&mut stream).len() < 10 * BIG);
    }
    assert!(server.metric("foresight_http_connections_closed_total{reason=\"idle\"}") >= 2.0);
    assert_eq!(server.get("/health/ready", &[]).status, 200);
}

#[test]
fn too_many_are_told_to_come_back() {
    let folder = tempfile::tempdir().unwrap();
    write_world(folder.path());
    let options = ["--connections-max", "4", "--requests-max", "2", "--link", "constant:1Mbit,200ms"];
    let server = Server::start(folder.path().to_str().unwrap(), &options);
    let held: Vec<_> = (0..4).map(|_| server.connect()).collect();
    std::thread::sleep(Duration::from_millis(200));
    let refused = Answer::parse(&rest(&mut server.connect()));
    assert_eq!((refused.status, refused.field("retry-after")), (503, "1"));
    drop(held);
    std::thread::sleep(Duration::from_millis(200));
    // Each takes a round trip to be answered, and its body 40 ms more.
    let mut streams: Vec<_> = (0..4).map(|_| server.connect()).collect();
    for stream in &mut streams {
        stream.write_all(b"GET /worlds/w/files/a.glb HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n").unwrap();
    }
    let answers: Vec<_> = streams.iter_mut().map(|stream| Answer::parse(&rest(stream))).collect();
    let statuses: Vec<u16> = answers.iter().map(|answer| answer.status).collect();
    assert_eq!(statuses.iter().filter(|&&status| status == 200).count(), 2, "{statuses:?}");
    for answer in answers.iter().filter(|answer| answer.status != 200) {
        assert_eq!((answer.status, answer.field("retry-after")), (503, "1"));
        assert_eq!(answer.field("content-type"), "application/problem+json");
    }
}

#[cfg(unix)]
#[test]
fn responses_under_way_are_finished_at_the_end() {
    let folder = tempfile::tempdir().unwrap();
    write_world(folder.path());
    let mut server = Server::start(folder.path().to_str().unwrap(), &["--link", "constant:16Mbit,0ms"]);
    let mut stream = server.connect();
    stream.write_all(b"GET /worlds/w/files/big.glb HTTP/1.1\r\nhost: a\r\n\r\n").unwrap();
    let mut first = [0; 1];
    stream.read_exact(&mut first).unwrap();
    assert!(Command::new("kill").args(["-TERM", &server.child.id().to_string()]).status().unwrap().success());
    let answer = Answer::parse(&[&first[..], &rest(&mut stream)].concat());
    assert_eq!((answer.status, answer.body.len()), (200, BIG));
    assert_eq!(server.child.wait().unwrap().code(), Some(0));
}

#[test]
fn only_loopback_without_a_token() {
    let binary = env!("CARGO_BIN_EXE_foresight-server");
    let ended =
        Command::new(binary).args(["serve", "--world", "city:blocks=1", "--listen", "0.0.0.0:0"]).output().unwrap();
    assert_eq!(ended.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&ended.stderr).contains("loopback"), "{ended:?}");
}
