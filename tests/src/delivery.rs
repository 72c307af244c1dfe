//! Static delivery beside nginx: the same folder, one after the other in turn, driven by wrk.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde::Serialize;

use crate::input;

/// How often a server that starts is tried, every 20 ms.
const TRIES: u32 = 500;

/// Why there is nothing to compare.
#[derive(Debug, thiserror::Error)]
pub enum DeliveryError {
    /// A program is missing.
    #[error("{0} is missing and apt-get cannot install it; nothing is compared")]
    Missing(&'static str),
    /// A program does not start or answer.
    #[error("{0}")]
    Program(String),
    /// Files cannot be written or read.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// A measurement: one server, one file, one concurrency; medians over the rounds.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// `foresight-server` or `nginx`.
    pub server: &'static str,
    /// Bytes of the file.
    pub bytes: usize,
    /// Connections that are kept busy.
    pub connections: u32,
    /// Requests per second.
    pub requests_per_second: f64,
    /// 99th percentile of the time from a request to its last byte, milliseconds.
    pub p99_ms: f64,
    /// Answers other than 200, and breaks, in all rounds.
    pub errors: u64,
}

/// What is compared.
#[derive(Clone, Debug)]
pub struct Plan {
    /// `foresight-server`.
    pub program: PathBuf,
    /// Seconds of each round.
    pub seconds: u32,
    /// Rounds of each server, in turn.
    pub rounds: usize,
    /// Sizes of the files, bytes.
    pub bytes: Vec<usize>,
    /// Connections.
    pub connections: Vec<u32>,
}

/// A server as a child process, ended when dropped.
struct Running {
    child: Child,
    port: u16,
}

impl Drop for Running {
    fn drop(&mut self) {
        // nginx ends its workers if it is told to end; killed, it leaves them behind.
        let told = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status();
        if !told.is_ok_and(|status| status.success()) {
            let _ = self.child.kill();
        }
        let _ = self.child.wait();
    }
}

/// Installs what is missing, and measures.
///
/// # Errors
/// A program that is not there and cannot be installed, or does not do what it should.
pub fn compare(plan: &Plan, mut progress: impl FnMut(&str)) -> Result<Vec<Measured>, DeliveryError> {
    let nginx = program("nginx", "nginx-light")?;
    let wrk = program("wrk", "wrk")?;
    let folder = tempfile::tempdir()?;
    let world = folder.path().join("world");
    std::fs::create_dir(&world)?;
    input::write_world(&world);
    for &bytes in &plan.bytes {
        let content: Vec<u8> = (0..bytes).map(|i| (i * 31 + (i >> 8)) as u8).collect();
        std::fs::write(world.join(format!("{bytes}.bin")), content)?;
    }
    // nginx begun by root reads as another user.
    #[cfg(unix)]
    for place in [folder.path(), &world] {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(place, std::fs::Permissions::from_mode(0o755))?;
    }
    let ours = ours(&plan.program, &world)?;
    let theirs = theirs(&nginx, folder.path(), &world)?;
    let base = base(ours.port)?;
    let mut all = Vec::new();
    for &bytes in &plan.bytes {
        for &connections in &plan.connections {
            progress(&format!("{bytes} bytes, {connections} connections"));
            let targets = [
                ("foresight-server", format!("http://127.0.0.1:{}{base}{bytes}.bin", ours.port)),
                ("nginx", format!("http://127.0.0.1:{}/{bytes}.bin", theirs.port)),
            ];
            let mut rounds: [Vec<Round>; 2] = Default::default();
            for round in 0..plan.rounds {
                // Who goes first changes from round to round.
                for place in [round % 2, (round + 1) % 2] {
                    rounds[place].push(drive(&wrk, &targets[place].1, connections, plan.seconds)?);
                }
            }
            for ((server, _), rounds) in targets.into_iter().zip(rounds) {
                all.push(Measured {
                    server,
                    bytes,
                    connections,
                    requests_per_second: median(rounds.iter().map(|round| round.rate)),
                    p99_ms: median(rounds.iter().map(|round| round.p99_ms)),
                    errors: rounds.iter().map(|round| round.errors).sum(),
                });
            }
        }
    }
    Ok(all)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// The program, installed from Debian's packages if it is not there.
fn program(name: &'static str, package: &str) -> Result<PathBuf, DeliveryError> {
    let found = || {
        ["/usr/sbin", "/usr/bin", "/usr/local/bin"]
            .map(|folder| Path::new(folder).join(name))
            .into_iter()
            .find(|path| path.is_file())
    };
    if let Some(path) = found() {
        return Ok(path);
    }
    let mut install = Command::new("apt-get");
    install.args(["install", "-y", "--no-install-recommends", package]).stdin(Stdio::null());
    // What it says is not of interest; whether the program is there afterwards is.
    let _ = install.output();
    found().ok_or(DeliveryError::Missing(name))
}

fn ours(program: &Path, world: &Path) -> Result<Running, DeliveryError> {
    let mut child = Command::new(program)
        .args(["serve", "--listen", "127.0.0.1:0", "--world"])
        .arg(world)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut line = String::new();
    if let Some(stdout) = child.stdout.take() {
        BufReader::new(stdout).read_line(&mut line)?;
    }
    let port = line.trim().rsplit_once(':').and_then(|(_, port)| port.parse().ok());
    let running = Running { child, port: port.unwrap_or_default() };
    port.map(|_| running).ok_or_else(|| DeliveryError::Program(format!("foresight-server does not listen: {line:?}")))
}

/// nginx as it comes, with as many workers as there are cores and without a log of requests.
fn theirs(program: &Path, folder: &Path, world: &Path) -> Result<Running, DeliveryError> {
    let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?.port();
    let state = folder.join("nginx");
    std::fs::create_dir(&state)?;
    let (state, world) = (state.display(), world.display());
    let config = format!(
        "worker_processes auto;\npid {state}/pid;\nerror_log {state}/error.log;\nevents {{ worker_connections 1024; }}\n\
         http {{\n  access_log off;\n  sendfile on;\n  tcp_nopush on;\n  etag on;\n  default_type application/octet-stream;\n  \
         keepalive_requests 1000000000;\n  client_body_temp_path {state}/a;\n  proxy_temp_path {state}/b;\n  \
         fastcgi_temp_path {state}/c;\n  uwsgi_temp_path {state}/d;\n  scgi_temp_path {state}/e;\n  \
         server {{ listen 127.0.0.1:{port}; root {world}; add_header Cache-Control \"public, max-age=31536000, immutable\"; }}\n}}\n"
    );
    let file = folder.join("nginx.conf");
    std::fs::write(&file, config)?;
    let child = Command::new(program)
        .args(["-g", "daemon off;", "-e", &folder.join("start.log").display().to_string(), "-c"])
        .arg(&file)
        .stdin(Stdio::null())
        .spawn()?;
    let running = Running { child, port };
    for _ in 0..TRIES {
        if TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_ok() {
            return Ok(running);
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let said = std::fs::read_to_string(folder.join("start.log")).unwrap_or_default();
    Err(DeliveryError::Program(format!("nginx does not listen: {said}")))
}

/// Where the world's content lies, `/worlds/NAME/IDENTITY/`.
fn base(port: u16) -> Result<String, DeliveryError> {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port))?;
    stream.set_read_timeout(Some(Duration::from_secs(30)))?;
    stream.write_all(b"GET /worlds/world HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n")?;
    let mut text = String::new();
    stream.read_to_string(&mut text)?;
    let base = text.split("\"base\":\"").nth(1).and_then(|rest| rest.split('"').next());
    base.map(str::to_owned).ok_or_else(|| DeliveryError::Program(format!("no base in {text}")))
}

struct Round {
    rate: f64,
    p99_ms: f64,
    errors: u64,
}

/// What wrk's script prints last: requests, microseconds, p99 in microseconds, errors.
const SCRIPT: &str = "done = function(summary, latency, requests)\n  local e = summary.errors\n  io.write(string.format(\
\"figures %d %d %.1f %d\\n\", summary.requests, summary.duration, latency:percentile(99), \
e.connect + e.read + e.write + e.status + e.timeout))\nend\n";

fn drive(wrk: &Path, url: &str, connections: u32, seconds: u32) -> Result<Round, DeliveryError> {
    let script = tempfile::NamedTempFile::new()?;
    std::fs::write(script.path(), SCRIPT)?;
    let threads = connections.min(2).to_string();
    let output = Command::new(wrk)
        .args(["-t", &threads, "-c", &connections.to_string(), "-d", &format!("{seconds}s"), "-s"])
        .arg(script.path())
        .arg(url)
        .stdin(Stdio::null())
        .output()?;
    let text = String::from_utf8_lossy(&output.stdout);
    let figures = text.lines().find_map(|line| line.strip_prefix("figures "));
    let figures: Vec<f64> = figures.unwrap_or_default().split(' ').filter_map(|figure| figure.parse().ok()).collect();
    match figures[..] {
        [requests, micros, p99, errors] => {
            Ok(Round { rate: requests / (micros * 1e-6), p99_ms: p99 * 1e-3, errors: errors as u64 })
        }
        _ => Err(DeliveryError::Program(format!("wrk says {text}{}", String::from_utf8_lossy(&output.stderr)))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_the_rounds() {
        assert_eq!(median([3.0, 1.0, 2.0].into_iter()), 2.0);
        assert!(median(std::iter::empty()).is_nan());
    }
}
