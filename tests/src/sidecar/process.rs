//! The server and the client as processes of a test: on a free port of 127.0.0.1, gone when dropped.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crate::program::{self, Ended};

/// How long a server may take to listen.
const STARTING: Duration = Duration::from_secs(120);
/// How long a server may take to end when told to.
const ENDING: Duration = Duration::from_secs(20);
/// How long an answer may take.
const ANSWERING: Duration = Duration::from_secs(10);

/// A running `foresight-server serve`.
#[derive(Debug)]
pub struct Server {
    child: Child,
    port: u16,
    log: Arc<Mutex<String>>,
}

impl Server {
    /// Starts one with these options on a free port.
    ///
    /// # Panics
    /// If it does not listen in time.
    pub fn start(folder: &Path, options: &[&str]) -> Server {
        Server::start_on(folder, 0, None, options)
    }

    /// Starts one on this port; 0 for a free one. On these processors only, if they are given (as `taskset -c` takes them).
    ///
    /// # Panics
    /// If it does not listen in time.
    pub fn start_on(folder: &Path, port: u16, cores: Option<&str>, options: &[&str]) -> Server {
        let mut command = command("foresight-server", cores);
        let mut child = command
            .arg("serve")
            .args(["--listen", &format!("127.0.0.1:{port}")])
            .args(options)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the server starts");
        let log = Arc::new(Mutex::new(String::new()));
        let kept = log.clone();
        let stderr = BufReader::new(child.stderr.take().expect("standard error is piped"));
        std::thread::spawn(move || {
            for line in stderr.lines().map_while(Result::ok) {
                let mut log = kept.lock().unwrap_or_else(PoisonError::into_inner);
                log.push_str(&line);
                log.push('\n');
            }
        });
        let mut stdout = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let (said, heard) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            let mut line = String::new();
            let _ = stdout.read_line(&mut line);
            let _ = said.send(line);
            // What follows is of no interest, but the pipe must not fill up.
            let _ = std::io::copy(&mut stdout, &mut std::io::sink());
        });
        let line = heard.recv_timeout(STARTING).unwrap_or_default();
        let port = line.trim().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
        let server = Server { child, port: port.unwrap_or_default(), log };
        assert!(port.is_some(), "the server does not listen: {line:?}\n{}", server.log());
        server
    }

    /// Its address, as `--server` takes it.
    pub fn url(&self) -> String {
        format!("http://127.0.0.1:{}", self.port)
    }

    /// Its port.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// What it has written to standard error.
    pub fn log(&self) -> String {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Ends it at once, as a power failure would.
    ///
    /// # Panics
    /// If it cannot be killed.
    pub fn kill(mut self) {
        self.child.kill().expect("a child can be killed");
        self.child.wait().expect("a child can be waited for");
    }

    /// Tells it to end, and does not wait.
    ///
    /// # Panics
    /// If it cannot be told.
    pub fn terminate(&self) {
        let told = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status();
        assert!(told.is_ok_and(|status| status.success()), "the server can be told to end");
    }

    /// Whether it still runs.
    ///
    /// # Panics
    /// If that cannot be asked.
    pub fn runs(&mut self) -> bool {
        self.child.try_wait().expect("a child can be asked for").is_none()
    }

    /// Tells it to end and answers its exit code and log.
    ///
    /// # Panics
    /// If it does not end in time.
    pub fn stop(mut self) -> (Option<i32>, String) {
        self.terminate();
        let code = program::wait(&mut self.child, ENDING);
        (code.unwrap_or_else(|| panic!("the server did not end in time\n{}", self.log())), self.log())
    }

    /// Resident memory, bytes.
    ///
    /// # Panics
    /// Where there is no `/proc`.
    pub fn resident_bytes(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("a status in /proc");
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).expect("VmRSS in the status");
        line.trim().trim_end_matches(" kB").parse::<u64>().expect("a number of kB") * 1024
    }

    /// Seconds of processor time that it has used.
    ///
    /// # Panics
    /// Where there is no `/proc`.
    pub fn cpu_seconds(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).expect("a stat in /proc");
        let fields: Vec<&str> = stat.rsplit_once(") ").expect("the name in parentheses").1.split(' ').collect();
        // Fields 14 and 15 of the line, in ticks of 1/100 s.
        let ticks = |field: usize| fields[field - 3].parse::<f64>().expect("a number of ticks");
        (ticks(14) + ticks(15)) / 100.0
    }

    /// Status and body of the answer to a GET.
    ///
    /// # Panics
    /// If there is no answer.
    pub fn get(&self, path: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(("127.0.0.1", self.port)).expect("the server listens");
        stream.set_read_timeout(Some(ANSWERING)).expect("a timeout can be set");
        write!(stream, "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: close\r\n\r\n", self.port)
            .expect("the request is written");
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).expect("the answer is read");
        let text = String::from_utf8_lossy(&bytes);
        let (head, body) = text.split_once("\r\n\r\n").expect("a head and a body");
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status");
        (status, body.to_owned())
    }

    /// The sum of a metric's samples over its labels; `None` if there is none of this name.
    ///
    /// # Panics
    /// If there is no answer.
    pub fn metric(&self, name: &str) -> Option<f64> {
        let (_, body) = self.get("/metrics");
        let samples: Vec<f64> = body
            .lines()
            .filter_map(|line| line.strip_prefix(name))
            .filter_map(|rest| rest.strip_prefix(' ').or_else(|| Some(rest.strip_prefix('{')?.split_once("} ")?.1)))
            .filter_map(|value| value.split(' ').next()?.parse().ok())
            .collect();
        (!samples.is_empty()).then(|| samples.iter().sum())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A running `foresight-viewer`.
#[derive(Debug)]
pub struct Viewer {
    child: Child,
}

impl Viewer {
    /// Starts one without a window, with these options.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(folder: &Path, server: &str, cores: Option<&str>, options: &[&str]) -> Viewer {
        let child = command("foresight-viewer", cores)
            .args(["--no-draw", "--server", server])
            .args(options)
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the viewer starts");
        Viewer { child }
    }

    /// Ends it at once, without a word to the server.
    ///
    /// # Panics
    /// If it cannot be killed.
    pub fn kill(mut self) {
        self.child.kill().expect("a child can be killed");
        self.child.wait().expect("a child can be waited for");
    }

    /// How it ended and what it said.
    ///
    /// # Panics
    /// If it has not ended in time.
    pub fn finish(mut self, limit: Duration) -> Ended {
        let stdout = program::drain(self.child.stdout.take().expect("standard output is piped"));
        let stderr = program::drain(self.child.stderr.take().expect("standard error is piped"));
        let code = program::wait(&mut self.child, limit);
        let (stdout, stderr) = (program::text(stdout), program::text(stderr));
        match code {
            Some(code) => Ended { code, stdout, stderr },
            None => panic!("the viewer still ran after {limit:?}\n{stdout}\n{stderr}"),
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn command(name: &str, cores: Option<&str>) -> Command {
    let program = program::built(name);
    match cores {
        None => Command::new(program),
        Some(cores) => {
            let mut command = Command::new("taskset");
            command.args(["-c", cores]).arg(program);
            command
        }
    }
}
