//! Contents that fail.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use foresight_tests::sidecar::case::Case;
use foresight_tests::sidecar::process::Server;
use foresight_tests::sidecar::proxy::{Fault, Proxy, Spoiled};

use crate::{files, is_sound, recovery};

/// Of the link, bytes/s: 8 Mbit/s.
const RATE: f64 = 1_000_000.0;

/// Every third content fails once: the client says so, and gets it later.
fn spoiled(fault: Fault, reason: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let world = files(folder);
    let line = format!("--world {world} --path steady:speed=20,duration=12 --link constant:8Mbit,40ms --memory 64MiB");
    let case = Case::open(&line, None);
    let server = Server::start(folder, &["--world", case.world(), "--link", case.link()]);
    let proxy = Proxy::start(server.port(), Some(Spoiled { fault, one_in: 3, times: 1 }));
    let viewer = case.start(folder, &proxy.url(), "events.jsonl", &["--stall", "2"]);
    let live = case.finish(folder, viewer, "events.jsonl");
    is_sound(&live);

    let failed: BTreeSet<u32> =
        live.flown.lines.iter().filter(|line| line.event == "failed").map(|line| line.rep).collect();
    let completed: BTreeSet<u32> =
        live.flown.lines.iter().filter(|line| line.event == "completed").map(|line| line.rep).collect();
    let recovered = failed.intersection(&completed).count();
    println!(
        "{fault:?}: {} spoiled, {} failed, {recovered} of them shown later, {} shown in all; {}",
        proxy.spoiled(),
        failed.len(),
        completed.len(),
        live.summary["failed"]
    );
    assert!(proxy.spoiled() > 0 && !failed.is_empty(), "nothing was spoiled");
    let kinds = live.summary["failed"].as_object().expect("failures by kind");
    assert!(kinds.keys().all(|kind| kind.contains(reason)), "{kinds:?}; expected {reason}");
    assert!(recovered > 0, "nothing that had failed was shown later");
    assert!(completed.difference(&failed).next().is_some(), "nothing was shown but what had failed");
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(!log.contains("panic"), "{log}");
    if foresight_tests::full().is_ok() {
        healed(folder, &case, fault);
    }
}

/// Faults that end: how long the deficit takes to be level with an undisturbed flight's.
fn healed(folder: &Path, case: &Case, fault: Fault) {
    let fly = |name: &str, spoiled: Option<Spoiled>| {
        let server = Server::start(folder, &["--world", case.world(), "--link", case.link()]);
        let proxy = Proxy::start(server.port(), spoiled);
        let viewer = case.start(folder, &proxy.url(), name, &["--stall", "2"]);
        let begun = (0..200).any(|_| {
            std::thread::sleep(Duration::from_millis(50));
            server.metric("foresight_sessions_connected") == Some(1.0)
        });
        assert!(begun, "no session");
        std::thread::sleep(Duration::from_secs(4));
        proxy.heal();
        case.finish(folder, viewer, name)
    };
    let undisturbed = fly("undisturbed.jsonl", None);
    let disturbed = fly("healed.jsonl", Some(Spoiled { fault, one_in: 3, times: u32::MAX }));
    let failed = disturbed.flown.lines.iter().filter(|line| line.event == "failed");
    let over_s = failed.map(|line| line.t_ns).max().expect("something has failed") as f64 * 1e-9;
    let name = format!("{fault:?} until {over_s:.1} s");
    let (allowed, returned) = recovery(&name, case, (&undisturbed, &disturbed), over_s, RATE);
    assert!(returned.is_some_and(|returned| returned <= allowed), "{returned:?} of {allowed} s");
}

#[test]
fn not_found_is_asked_for_again_later() {
    spoiled(Fault::Status(404), "status #");
}

#[test]
fn server_errors_are_asked_for_again_later() {
    spoiled(Fault::Status(500), "status #");
}

#[test]
fn truncated_contents_are_not_shown() {
    spoiled(Fault::Truncated, "");
}

#[test]
fn what_is_no_http_is_not_shown() {
    spoiled(Fault::Garbage, "");
}

#[test]
fn contents_of_another_kind_are_not_shown() {
    spoiled(Fault::Swapped, "the content begins with");
}

#[test]
fn responses_that_never_come_are_given_up() {
    spoiled(Fault::Never, "nothing came for # s");
}
