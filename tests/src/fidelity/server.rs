//! A web server on this machine's loopback that sends contents at the pace of a simulated link.
//!
//! HTTP/1.1, a thread a connection, and one that paces: it asks [`SharedLink`] every millisecond how much of each
//! response has come through and writes that much. Everything but contents goes at once.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::Duration;

use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use foresight_sim::stopwatch::Stopwatch;
use foresight_traces::link::{LinkTrace, SharedLink};

/// How often responses proceed.
const PACE: Duration = Duration::from_millis(1);
/// Longest line of a request's head, bytes.
const LINE_MAX: u64 = 16 << 10;
/// Largest body of a request, bytes.
const BODY_MAX: u64 = 64 << 20;

/// What is served: a file by its address, and contents by their number.
pub(super) struct Pages {
    pub(super) files: BTreeMap<String, (&'static str, Vec<u8>)>,
    /// Holds `node_modules`.
    pub(super) packages: PathBuf,
    pub(super) content: Box<dyn Fn(RepId) -> Option<Vec<u8>> + Send + Sync>,
}

/// What the page said.
pub(super) enum Said {
    Result(Vec<u8>),
    Failure(String),
}

/// What crossed the link.
#[derive(Clone, Copy, Default)]
pub(super) struct Traffic {
    pub(super) bytes: u64,
    pub(super) cancelled: u64,
}

/// The server; it ends with the program or when its owner is done with it.
pub(super) struct Server {
    pub(super) port: u16,
    pub(super) said: Receiver<Said>,
    pacer: Sender<ToPacer>,
}

enum ToPacer {
    /// Time zero is now, and nothing has crossed the link.
    Start,
    Begin {
        id: u64,
        stream: TcpStream,
        body: Vec<u8>,
    },
    /// The connection of this response is closed, or has another request.
    Over {
        id: u64,
    },
    Report(Sender<Traffic>),
}

impl Server {
    /// Listens on a port that the system chooses.
    pub(super) fn start(pages: Pages, link: LinkTrace) -> std::io::Result<Server> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
        let port = listener.local_addr()?.port();
        let (say, said) = mpsc::channel();
        let (pacer, told) = mpsc::channel();
        std::thread::spawn(move || pace(&link, &told));
        let (pages, to_pacer) = (Arc::new(pages), pacer.clone());
        std::thread::spawn(move || {
            for (connection, stream) in listener.incoming().enumerate() {
                let Ok(stream) = stream else { continue };
                let (pages, say, pacer) = (Arc::clone(&pages), say.clone(), to_pacer.clone());
                std::thread::spawn(move || {
                    // A connection that breaks ends here; the page notices for itself.
                    let _ = converse(stream, connection as u64, &pages, &say, &pacer);
                });
            }
        });
        Ok(Server { port, said, pacer })
    }

    /// What has crossed the link since the page started.
    pub(super) fn traffic(&self) -> Traffic {
        let (reply, answer) = mpsc::channel();
        let sent = self.pacer.send(ToPacer::Report(reply));
        sent.ok().and_then(|()| answer.recv().ok()).unwrap_or_default()
    }
}

/// A response on its way.
struct Response {
    stream: TcpStream,
    body: Vec<u8>,
    joins: Time,
    sent: Option<usize>,
}

fn pace(trace: &LinkTrace, told: &Receiver<ToPacer>) {
    let mut clock = Stopwatch::start();
    let mut link = SharedLink::new(trace, Time::ZERO);
    let mut responses: BTreeMap<u64, Response> = BTreeMap::new();
    let mut cancelled = 0;
    let mut ended = Vec::new();
    loop {
        let wait = if responses.is_empty() { Duration::from_secs(1) } else { PACE };
        let mut message = match told.recv_timeout(wait) {
            Ok(message) => Some(message),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => return,
        };
        while let Some(next) = message {
            let now = Time(clock.nanos());
            match next {
                ToPacer::Start => {
                    clock = Stopwatch::start();
                    link = SharedLink::new(trace, Time::ZERO);
                    responses.clear();
                    cancelled = 0;
                }
                ToPacer::Begin { id, stream, body } => {
                    link.start(id, body.len() as u64, now);
                    responses.insert(id, Response { stream, body, joins: now + trace.rtt_at(now), sent: None });
                }
                ToPacer::Over { id } => {
                    if responses.remove(&id).is_some() {
                        link.cancel(id, now);
                        cancelled += 1;
                    }
                }
                // Nobody listens any more: nothing is lost.
                ToPacer::Report(reply) => drop(reply.send(Traffic { bytes: link.total_delivered(), cancelled })),
            }
            message = told.try_recv().ok();
        }
        let now = Time(clock.nanos());
        ended.clear();
        link.advance(now, &mut ended);
        responses.retain(|&id, response| match response.proceed(now, link.delivered(id)) {
            Ok(done) => !done,
            Err(_) => {
                link.cancel(id, now);
                cancelled += 1;
                false
            }
        });
    }
}

impl Response {
    /// Writes what has come through; true at its end.
    fn proceed(&mut self, now: Time, delivered: u64) -> std::io::Result<bool> {
        if now < self.joins {
            return Ok(false);
        }
        if self.sent.is_none() {
            head(&mut self.stream, "200 OK", "application/octet-stream", self.body.len())?;
        }
        let sent = self.sent.unwrap_or(0);
        let until = usize::try_from(delivered).unwrap_or(usize::MAX).min(self.body.len());
        self.stream.write_all(&self.body[sent..until])?;
        self.sent = Some(until);
        Ok(until == self.body.len())
    }
}

fn head(stream: &mut TcpStream, status: &str, kind: &str, bytes: usize) -> std::io::Result<()> {
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {bytes}\r\nCache-Control: no-store\r\n\
         Access-Control-Allow-Origin: *\r\n\r\n"
    )
}

/// Answers the requests of a connection until it is closed.
fn converse(
    mut stream: TcpStream,
    connection: u64,
    pages: &Pages,
    say: &Sender<Said>,
    pacer: &Sender<ToPacer>,
) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut paced = None;
    for number in 0_u64.. {
        let request = read_request(&mut reader);
        if let Some(id) = paced.take() {
            // A browser asks again on a connection only when it has the whole response.
            drop(pacer.send(ToPacer::Over { id }));
        }
        let Some((method, target, body)) = request? else { break };
        let path = target.split('?').next().unwrap_or_default();
        let mut answer = |status: &str, kind: &str, bytes: &[u8]| {
            head(&mut stream, status, kind, bytes.len())?;
            stream.write_all(bytes)
        };
        // A receiver that has gone has heard enough.
        match (method.as_str(), path) {
            ("POST", "/start") => drop(pacer.send(ToPacer::Start)),
            ("POST", "/result") => drop(say.send(Said::Result(body))),
            ("POST", "/failure") => drop(say.send(Said::Failure(String::from_utf8_lossy(&body).into_owned()))),
            _ => {
                let content = path.strip_prefix("/world/content/").and_then(|rep| rep.parse().ok());
                if let Some(bytes) = content.and_then(|rep| (pages.content)(RepId(rep))) {
                    let id = (connection << 32) | number;
                    drop(pacer.send(ToPacer::Begin { id, stream: stream.try_clone()?, body: bytes }));
                    paced = Some(id);
                } else if let Some((kind, bytes)) = pages.files.get(path) {
                    answer("200 OK", kind, bytes)?;
                } else if let Some(bytes) = package_file(&pages.packages, path) {
                    answer("200 OK", kind_of(path), &bytes)?;
                } else {
                    answer("404 Not Found", "text/plain", b"not found")?;
                }
                continue;
            }
        }
        answer("204 No Content", "text/plain", b"")?;
    }
    Ok(())
}

/// A file beneath `node_modules`, never above it.
fn package_file(folder: &Path, path: &str) -> Option<Vec<u8>> {
    let relative = Path::new(path.strip_prefix('/')?);
    let inside =
        relative.starts_with("node_modules") && relative.components().all(|c| matches!(c, Component::Normal(_)));
    inside.then(|| std::fs::read(folder.join(relative)).ok()).flatten()
}

fn kind_of(path: &str) -> &'static str {
    match path.rsplit('.').next() {
        Some("js" | "mjs") => "text/javascript",
        Some("json") => "application/json",
        Some("wasm") => "application/wasm",
        Some("css") => "text/css",
        _ => "application/octet-stream",
    }
}

/// Method, target and body; `None` at the end of the connection.
fn read_request(reader: &mut impl BufRead) -> std::io::Result<Option<(String, String, Vec<u8>)>> {
    let bad = |what: &str| std::io::Error::new(std::io::ErrorKind::InvalidData, what.to_owned());
    let line = |reader: &mut _| -> std::io::Result<String> {
        let mut line = String::new();
        Read::take(reader, LINE_MAX).read_line(&mut line)?;
        Ok(line)
    };
    let first = line(&mut *reader)?;
    if first.is_empty() {
        return Ok(None);
    }
    let mut words = first.split_whitespace();
    let (Some(method), Some(target)) = (words.next(), words.next()) else { return Err(bad("no request line")) };
    let mut length = 0;
    loop {
        let header = line(&mut *reader)?;
        match header.trim_end().split_once(':') {
            _ if header.is_empty() => return Err(bad("the head breaks off")),
            _ if header.trim_end().is_empty() => break,
            Some((name, value)) if name.eq_ignore_ascii_case("content-length") => {
                length = value.trim().parse().ok().filter(|&n| n <= BODY_MAX).ok_or_else(|| bad("content length"))?;
            }
            _ => {}
        }
    }
    let mut body = Vec::new();
    reader.take(length).read_to_end(&mut body)?;
    Ok(Some((method.to_owned(), target.to_owned(), body)))
}
