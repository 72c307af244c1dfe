//! Responses at the pace of a link.

use std::io::{Read, Write};
use std::time::{Duration, Instant};

use crate::client::{Answer, BIG, Server, write_world};

#[expect(clippy::disallowed_methods, reason = "measures what a client would")]
fn now() -> Instant {
    Instant::now()
}

fn server(folder: &std::path::Path, link: &str) -> Server {
    write_world(folder);
    Server::start(folder.to_str().unwrap(), &["--link", link])
}

/// 5000 bytes at 1 MB/s: all bytes come, in order, whatever their pace.
#[test]
fn all_bytes_come() {
    let folder = tempfile::tempdir().unwrap();
    let server = server(folder.path(), "constant:80Mbit,5ms");
    for (target, bytes) in [("a.glb", 5000), ("big.glb", BIG)] {
        let answer = server.get(&format!("/worlds/w/files/{target}?session=none"), &[("foresight-session", "none")]);
        assert!(answer.status == 200 && answer.body == crate::client::padded_glb(bytes), "{target}");
    }
    assert_eq!(server.get("/worlds/w/files/none.glb", &[]).status, 404);
}

#[test]
fn a_client_that_goes_away_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let server = server(folder.path(), "constant:8Mbit,5ms");
    let mut stream = server.connect();
    stream.write_all(b"GET /worlds/w/files/big.glb HTTP/1.1\r\nhost: a\r\n\r\n").unwrap();
    let mut head = [0; 1000];
    stream.read_exact(&mut head).unwrap();
    assert_eq!(server.metric("foresight_content_active"), 1.0);
    drop(stream);
    // 3 MB take 3 s; it is noticed with the next pieces.
    for _ in 0..100 {
        if server.metric("foresight_content_active") == 0.0 {
            break;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(server.metric("foresight_content_cancelled_total"), 1.0);
    let sent = server.metric("foresight_content_cancelled_bytes_total");
    assert!(sent > 0.0 && sent < BIG as f64, "{sent}");
}

/// Each representation breaks off where the simulator's link says.
#[test]
fn a_link_with_loss_breaks_responses_off() {
    let folder = tempfile::tempdir().unwrap();
    let spec = "constant:800Mbit,0ms,loss=1";
    let server = server(folder.path(), spec);
    let trace = foresight_traces::link::parse::from_specification(spec).unwrap();
    let world = foresight_server::http::worlds::HostedWorld::open(folder.path().to_str().unwrap()).unwrap();
    let rep = world.representation("a.glb").unwrap();
    for attempt in 1..=3 {
        let mut stream = server.connect();
        stream.write_all(b"GET /worlds/w/files/a.glb HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n").unwrap();
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let answer = Answer::parse(&bytes);
        assert_eq!(answer.field("content-length"), "5000");
        let breaks = trace.breaks_after(u64::from(rep.0), attempt, 5000).unwrap();
        assert_eq!(answer.body.len() as u64, breaks);
    }
    assert_eq!(server.metric("foresight_content_failed_total"), 3.0);
    // What is no representation arrives whole.
    assert_eq!(server.get("/worlds/w/files/sub/data.bin", &[]).body, b"data");
}

/// One transfer of 3 MiB at 8 Mbit/s and a round trip of 40 ms takes 3.186 s; two at once end together after 6.33 s.
#[test]
fn transfers_take_the_time_of_the_link() {
    if std::env::var_os("FORESIGHT_FULL").is_none_or(|value| value != "1") {
        println!("skipped: needs tests/run --full");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let server = server(folder.path(), "constant:8Mbit,40ms");
    let timed = |transfers: usize| {
        let begun = now();
        std::thread::scope(|scope| {
            for _ in 0..transfers {
                scope.spawn(|| assert_eq!(server.get("/worlds/w/files/big.glb", &[]).body.len(), BIG));
            }
        });
        begun.elapsed().as_secs_f64()
    };
    for transfers in [1, 2] {
        let expected = 0.04 + (transfers * BIG) as f64 / 1e6;
        let taken = timed(transfers);
        println!("{transfers} at once: {taken:.4} s; the link's {expected:.4} s");
        assert!(taken >= expected - 0.001 && taken < expected * 1.05 + 0.1, "{taken} s, {expected} s");
    }
}
