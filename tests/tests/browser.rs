//! The client for browsers in Chromium, against the real server. Takes a minute: under `tests/run --full` only.

use foresight_tests::chromium::Chromium;
use foresight_tests::sidecar::process::Server;
use serde_json::Value;
use std::time::Duration;

/// A town that does not fit into the memory of the client, and a link.
const OPTIONS: [&str; 4] = ["--world", "town=city:blocks=8", "--link", "constant:20Mbit,40ms"];

/// Chromium, or that it is skipped.
fn chromium() -> Option<Chromium> {
    if let Err(skipped) = foresight_tests::full() {
        println!("{skipped}");
        return None;
    }
    let chromium = Chromium::start();
    if chromium.is_none() {
        assert!(std::env::var_os("CI").is_none(), "no chromium in PATH; tests/run --full installs it");
        println!("skipped: no chromium in PATH");
    }
    chromium
}

/// What the page writes at its end.
fn result(chromium: &mut Chromium, limit_s: u64) -> Value {
    let done = "(r => r?.dataset.state === 'done' ? r.textContent : null)(document.getElementById('result'))";
    let text = chromium.wait_for(done, Duration::from_secs(limit_s));
    serde_json::from_str(text.as_str().expect("text")).expect("JSON")
}

fn count(result: &Value, key: &str) -> u64 {
    result[key].as_u64().unwrap_or_else(|| panic!("{key} in {result}"))
}

/// Whatever happens: nothing is requested but what the scheduler has ordered, and memory stays within its budget.
fn assert_ordered(result: &Value) {
    assert!(count(result, "fetch") > 20 && count(result, "show") > 20, "{result}");
    assert_eq!((count(result, "not_ordered"), count(result, "twice")), (0, 0), "{result}");
    assert!(count(result, "requests") <= count(result, "fetch"), "{result}");
    assert!(count(result, "used_bytes_max") <= count(result, "memory_bytes"), "{result}");
    assert!(count(result, "resident_bytes") <= count(result, "used_bytes_max"), "{result}");
    assert!(count(result, "estimates") > 0 && result["quality"].as_f64().is_some_and(|q| q > 0.3), "{result}");
    assert_eq!(result["connected"], true, "{result}");
    // Each fetch says why it was chosen.
    assert_eq!(count(result, "shares"), count(result, "fetch"), "{result}");
}

#[test]
fn tiles_arrive_by_the_schedulers_orders_and_a_broken_connection_is_resumed() {
    let Some(mut chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path(), &OPTIONS);
    chromium.open(&format!("{}/fly/?self-test=20&break=8&memory=3", server.url()));
    let result = result(&mut chromium, 90);
    assert_ordered(&result);
    assert_eq!((count(&result, "welcome"), count(&result, "resumed")), (2, 1), "{result}");
    assert_eq!(result["closed"], serde_json::json!(["interrupted"]), "{result}");
    assert_eq!(count(&result, "failed"), 0, "{result}");
    // A machine with too much to do may be two seconds late; nothing else is to be said.
    let said: Vec<&str> = result["problems"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    assert!(said.iter().all(|problem| problem.contains("from the server's clock")), "{result}");
    assert!(count(&result, "hide") > 0, "{result}");
    assert!(count(&result, "rows") > 0, "{result}");
    assert!(chromium.complaints().is_empty(), "{:?}", chromium.complaints());
    assert!(!server.log().contains("panicked"), "{}", server.log());
}

#[test]
fn a_server_that_was_killed_finds_its_client_with_what_it_holds() {
    let Some(mut chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path(), &OPTIONS);
    let port = server.port();
    // After 30 s the flight is where the town ends, with nothing in view.
    chromium.open(&format!("{}/fly/?self-test=40&memory=8", server.url()));
    // Something is shown, then the server is gone.
    let shown = "document.querySelectorAll('#rows tr').length >= 10 ? true : null";
    chromium.wait_for(shown, Duration::from_secs(60));
    server.kill();
    chromium.wait_for(
        "document.getElementById('status').textContent.startsWith('No connection') || null",
        Duration::from_secs(20),
    );
    let server = Server::start_on(folder.path(), port, None, &OPTIONS);
    let result = result(&mut chromium, 90);
    assert_ordered(&result);
    // The new server knows nothing of the session: another has begun with what was held.
    assert_eq!((count(&result, "welcome"), count(&result, "resumed")), (2, 0), "{result}\n{}", server.log());
    assert!(!server.log().contains("panicked"), "{}", server.log());
}

#[test]
fn the_page_is_flown_by_the_keyboard_and_seen_in_the_dark() {
    let Some(mut chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path(), &OPTIONS);
    chromium.open(&format!("{}/fly/", server.url()));
    chromium.wait_for("document.querySelectorAll('#rows tr').length || null", Duration::from_secs(60));
    chromium.evaluate("document.getElementById('map').focus()");
    for kind in ["keyDown", "keyUp"] {
        chromium.call("Input.dispatchKeyEvent", serde_json::json!({ "type": kind, "code": "KeyW", "key": "w" }));
    }
    assert_eq!(chromium.evaluate("document.getElementById('glides').checked"), false);
    let back = "getComputedStyle(document.body).backgroundColor";
    let mut colours = Vec::new();
    for scheme in ["light", "dark"] {
        let features = serde_json::json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        chromium.call("Emulation.setEmulatedMedia", serde_json::json!({ "features": features }));
        colours.push(chromium.evaluate(back));
    }
    assert_ne!(colours[0], colours[1]);
    // Every control has a name, and so has every picture.
    let nameless = "[...document.querySelectorAll('input, select, button, canvas')]\
        .filter(e => !(e.labels?.length || e.textContent.trim() || e.ariaLabel)).length";
    assert_eq!(chromium.evaluate(nameless), 0);
    assert!(chromium.complaints().is_empty(), "{:?}", chromium.complaints());
    assert!(!server.log().contains("panicked"), "{}", server.log());
}
