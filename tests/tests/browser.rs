//! The client for browsers in Chromium, against the real server. Takes a minute: under `tests/run --full` only.

use foresight_tests::chromium::Chromium;
use foresight_tests::program;
use serde_json::Value;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// A running `foresight-server serve`; it ends with its owner, at once.
struct Server {
    child: Child,
    port: u16,
}

impl Server {
    /// Starts one on this port of 127.0.0.1; 0 for a free one.
    fn start(folder: &Path, port: u16) -> Server {
        let mut child = Command::new(program::built("foresight-server"))
            .args(["serve", "--listen", &format!("127.0.0.1:{port}")])
            // A town that does not fit into the memory of a client, and a link.
            .args(["--world", "town=city:blocks=8", "--link", "constant:20Mbit,40ms"])
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the server starts");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("standard output is piped")).read_line(&mut line).expect("a line");
        let port = line.trim().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
        Server { child, port: port.unwrap_or_else(|| panic!("the server says {line:?}")) }
    }

    fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Whether it still runs.
    fn is_well(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|status| status.is_none())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

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
    // Each fetch says why it was chosen.
    assert_eq!(count(result, "shares"), count(result, "fetch"), "{result}");
}

#[test]
fn tiles_arrive_by_the_schedulers_orders_and_a_broken_connection_is_resumed() {
    let Some(mut chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut server = Server::start(folder.path(), 0);
    chromium.open(&format!("{}/fly/?self-test=20&break=8&memory=3", server.url()));
    let result = result(&mut chromium, 90);
    assert_ordered(&result);
    assert_eq!((count(&result, "welcome"), count(&result, "resumed")), (2, 1), "{result}");
    assert_eq!(result["problems"], serde_json::json!([]), "{result}");
    // The town is larger than the memory.
    assert!(
        count(&result, "hide") > 0 && count(&result, "received_bytes") > count(&result, "memory_bytes"),
        "{result}"
    );
    assert!(count(&result, "rows") > 0, "{result}");
    assert!(chromium.complaints().is_empty(), "{:?}", chromium.complaints());
    assert!(server.is_well());
}

#[test]
fn a_server_that_was_killed_finds_its_client_with_what_it_holds() {
    let Some(mut chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(folder.path(), 0);
    let port = server.port;
    chromium.open(&format!("{}/fly/?self-test=30&memory=8", server.url()));
    // Something is shown, then the server is gone.
    let shown = "document.querySelectorAll('#rows tr').length >= 10 ? true : null";
    chromium.wait_for(shown, Duration::from_secs(60));
    drop(server);
    chromium.wait_for(
        "document.getElementById('status').textContent.startsWith('No connection') || null",
        Duration::from_secs(20),
    );
    let mut server = Server::start(folder.path(), port);
    let result = result(&mut chromium, 90);
    assert_ordered(&result);
    // The new server knows nothing of the session: another has begun with what was held.
    assert_eq!((count(&result, "welcome"), count(&result, "resumed")), (2, 0), "{result}");
    assert!(server.is_well());
}

#[test]
fn the_page_is_flown_by_the_keyboard_and_seen_in_the_dark() {
    let Some(mut chromium) = chromium() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut server = Server::start(folder.path(), 0);
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
    assert!(server.is_well());
}
