//! Clients, servers and sockets that are gone from one moment to the next.

use std::time::Duration;

use foresight_tests::sidecar::case::Case;
use foresight_tests::sidecar::process::Server;
use foresight_tests::sidecar::proxy::Proxy;

use crate::{is_sound, recovery};

const CASE: &str =
    "--world city:blocks=20 --path steady:speed=10,duration=14 --link constant:4Mbit,40ms --memory 32MiB";
/// Of its link, bytes/s.
const RATE: f64 = 500_000.0;

#[test]
fn a_client_that_is_killed_is_forgotten_and_harms_no_other() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let case = Case::open(CASE, None);
    let server = Server::start(folder, &["--world", case.world(), "--link", case.link(), "--keep-session", "2s"]);
    let stays = case.start(folder, &server.url(), "stays.jsonl", &[]);
    let goes = case.start(folder, &server.url(), "goes.jsonl", &[]);
    let active = || server.metric("foresight_sessions_active").unwrap_or_default();
    let both = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(100));
        active() == 2.0
    });
    assert!(both, "{} sessions", active());
    // In the middle of a transfer: the link is busy from the first view on.
    std::thread::sleep(Duration::from_secs(3));
    goes.kill();
    let one = (0..80).any(|_| {
        std::thread::sleep(Duration::from_millis(100));
        active() == 1.0
    });
    assert!(one, "{} sessions", active());
    let live = case.finish(folder, stays, "stays.jsonl");
    is_sound(&live);
    assert_eq!((live.flown.count("failed"), live.figure("reconnections")), (0, 0.0));
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(!log.contains("panic"), "{log}");
}

#[test]
fn a_server_that_is_killed_and_comes_back_is_used_again() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let case = Case::open(CASE, None);
    let options = ["--world", case.world(), "--link", case.link()];
    let server = Server::start(folder, &options);
    let port = server.port();
    let undisturbed = case.fly(folder, &server, "undisturbed.jsonl", &[]);
    let viewer = case.start(folder, &server.url(), "events.jsonl", &[]);
    let begun = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(100));
        server.metric("foresight_sessions_connected") == Some(1.0)
    });
    assert!(begun, "no session");
    std::thread::sleep(Duration::from_secs(3));
    server.kill();
    std::thread::sleep(Duration::from_secs(1));
    let server = Server::start_on(folder, port, None, &options);
    let live = case.finish(folder, viewer, "events.jsonl");
    is_sound(&live);
    assert_eq!((live.figure("reconnections"), live.figure("resumed")), (1.0, 0.0));
    let broke = live.flown.lines.iter().rfind(|line| line.event == "failed" || line.event == "dropped");
    let broke = broke.map_or(0, |line| line.t_ns);
    let shown = live.flown.lines.iter().filter(|line| line.event == "completed" && line.t_ns > broke).count();
    assert!(shown > 0, "nothing was shown after the server had come back");
    let requests = live.flown.requests();
    let pause = requests.windows(2).max_by_key(|pair| pair[1].0 - pair[0].0).expect("several requests");
    let back = pause[1].0;
    let (allowed, returned) =
        recovery("server killed for a second", &case, (&undisturbed, &live), back as f64 * 1e-9, RATE);
    if foresight_tests::full().is_ok() {
        assert!(returned.is_some_and(|returned| returned <= allowed), "{returned:?} of {allowed} s");
    }
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
}

#[test]
fn a_session_goes_on_when_its_socket_has_broken() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let case = Case::open(CASE, None);
    let server = Server::start(folder, &["--world", case.world(), "--link", case.link()]);
    let proxy = Proxy::start(server.port(), None);
    let viewer = case.start(folder, &proxy.url(), "events.jsonl", &[]);
    let mut cuts = 0;
    while cuts < 3 {
        std::thread::sleep(Duration::from_secs(2));
        cuts += proxy.cut();
    }
    let live = case.finish(folder, viewer, "events.jsonl");
    is_sound(&live);
    println!(
        "socket broken {cuts} times: {} reconnections, {} resumed, {} failed, {} dropped",
        live.figure("reconnections"),
        live.figure("resumed"),
        live.flown.count("failed"),
        live.flown.count("dropped")
    );
    assert_eq!((live.figure("reconnections"), live.figure("resumed")), (3.0, 3.0));
    assert_eq!(live.flown.count("failed"), 0, "contents do not come through the socket");
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
}
