//! Chromium without a screen, told what to do over its debugging pipe: JSON documents that end in a zero byte.

use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use serde_json::{Value, json};
use tempfile::TempDir;

use crate::fidelity::browser::{ARGUMENTS, in_path};

/// How long an answer of the browser may take.
const ANSWERING: Duration = Duration::from_secs(60);
/// How often a page is asked whether it is done.
const POLL: Duration = Duration::from_millis(200);

/// A browser with one page; it ends with its owner.
#[derive(Debug)]
pub struct Chromium {
    child: Child,
    commands: ChildStdin,
    answers: Receiver<Value>,
    count: u64,
    session: Option<String>,
    /// What pages complained about: exceptions, and errors in the log.
    complaints: Vec<String>,
    profile: TempDir,
}

impl Chromium {
    /// Starts it; `None` where it is not installed.
    ///
    /// # Panics
    /// If it is there and does not start.
    pub fn start() -> Option<Chromium> {
        let program = in_path("chromium")?;
        let profile = tempfile::tempdir().expect("a folder for the profile");
        // The pipe is read from descriptor 3 and written to descriptor 4.
        let mut child = Command::new("sh")
            .args(["-c", "exec \"$0\" \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1"])
            .arg(program)
            .args(ARGUMENTS)
            .arg("--remote-debugging-pipe")
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("a shell starts");
        let commands = child.stdin.take().expect("standard input is piped");
        let mut output = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let (said, answers) = channel();
        std::thread::spawn(move || {
            let mut document = Vec::new();
            while output.read_until(0, &mut document).is_ok_and(|length| length > 0) {
                let value = serde_json::from_slice(document.strip_suffix(&[0]).unwrap_or(&document));
                if value.is_ok_and(|value: Value| said.send(value).is_err()) {
                    break;
                }
                document.clear();
            }
        });
        Some(Chromium { child, commands, answers, count: 0, session: None, complaints: Vec::new(), profile })
    }

    /// The browser's answer to a command; what it says in between is looked at.
    ///
    /// # Panics
    /// If it answers with an error, or not in time.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.count += 1;
        let mut command = json!({ "id": self.count, "method": method, "params": parameters });
        if let Some(session) = &self.session {
            command["sessionId"] = json!(session);
        }
        let mut bytes = command.to_string().into_bytes();
        bytes.push(0);
        self.commands.write_all(&bytes).and_then(|()| self.commands.flush()).expect("the browser listens");
        loop {
            let said = self.answers.recv_timeout(ANSWERING);
            let said = said.unwrap_or_else(|error| panic!("{method}: the browser does not answer: {error}"));
            if said["id"] == json!(self.count) {
                assert!(said.get("error").is_none(), "{method}: {said}");
                return said["result"].clone();
            }
            self.hear(&said);
        }
    }

    fn hear(&mut self, said: &Value) {
        let params = &said["params"];
        match said["method"].as_str() {
            Some("Runtime.exceptionThrown") => self.complaints.push(params["exceptionDetails"].to_string()),
            Some("Log.entryAdded") if params["entry"]["level"] == "error" => {
                self.complaints.push(params["entry"].to_string());
            }
            _ => {}
        }
    }

    /// Opens a page in the place of the one before.
    ///
    /// # Panics
    /// As [`Chromium::call`].
    pub fn open(&mut self, url: &str) {
        self.session = None;
        let target = self.call("Target.createTarget", json!({ "url": "about:blank" }))["targetId"].clone();
        let attached = self.call("Target.attachToTarget", json!({ "targetId": target, "flatten": true }));
        self.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Runtime", "Log", "Page"] {
            self.call(&format!("{domain}.enable"), json!({}));
        }
        self.call("Page.navigate", json!({ "url": url }));
    }

    /// The value of a JavaScript expression in the page.
    ///
    /// # Panics
    /// If it throws, or as [`Chromium::call`].
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.call("Runtime.evaluate", parameters);
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// The value of an expression once it is not null.
    ///
    /// # Panics
    /// If that takes longer than `limit`.
    pub fn wait_for(&mut self, expression: &str, limit: Duration) -> Value {
        for _ in 0..limit.as_millis() / POLL.as_millis() {
            let value = self.evaluate(expression);
            if !value.is_null() {
                return value;
            }
            std::thread::sleep(POLL);
        }
        let page = self.evaluate("document.body?.innerText ?? null");
        panic!("{expression} is null after {limit:?}; {:?}; the page:\n{page}", self.complaints)
    }

    /// What pages have complained about.
    pub fn complaints(&self) -> &[String] {
        &self.complaints
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let _ = self.profile.path();
    }
}
