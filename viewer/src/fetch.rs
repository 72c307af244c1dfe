//! Requests over HTTP: bodies are counted byte by byte as they come. They are kept where they are to be shown, else dropped.

use crate::clock::Clock;
use bytes::Bytes;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::AbortHandle;

/// Header that names the session for which a content is requested.
const SESSION_HEADER: &str = "Foresight-Session";
/// Bytes of a body's beginning that are looked at.
const HEAD_BYTES: usize = 12;
/// How long the list of worlds may take, and how large it may be.
const LISTING: Duration = Duration::from_secs(10);
const LIST_BYTES_MAX: usize = 16 << 20;

/// Why a request failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FetchError {
    /// Another status than 200.
    #[error("status {0}; expected 200")]
    Status(u16),
    /// A body of another length.
    #[error("{got} bytes; expected {expected}")]
    Length {
        /// As the server had said.
        expected: u64,
        /// What came, or was announced.
        got: u64,
    },
    /// A body that is not what its name says.
    #[error("the content begins with {found:?}; expected {expected}")]
    Content {
        /// Its first bytes.
        found: [u8; 4],
        /// What it should have been.
        expected: &'static str,
    },
    /// No connection, no HTTP, or the connection broke.
    #[error("{0}")]
    Transport(String),
    /// What should be the list of worlds is none.
    #[error("the list of worlds: {0}; expected a JSON list of objects with a name")]
    List(String),
    /// Nothing came for so long.
    #[error("nothing came for {0} s")]
    Stalled(u64),
}

/// What happened to a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// The response's head came.
    Responded,
    /// It has ended, with its body if bodies are kept.
    Ended(Result<Bytes, FetchError>),
}

/// What happened to which, and when by the program's clock.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TransferEvent {
    /// When, ns.
    pub at_ns: u64,
    /// To what.
    pub rep: u32,
    /// What.
    pub step: Step,
}

/// How to reach the server.
#[derive(Clone, Debug)]
pub struct HttpSettings {
    /// Speak HTTP/2 from the first byte.
    pub http2: bool,
    /// A request fails when nothing comes for so long.
    pub stall: Duration,
    /// Sent as `Authorization: Bearer …`.
    pub token: Option<String>,
}

/// A client with its connections; copies share them.
#[derive(Clone, Debug)]
pub struct Http {
    client: reqwest::Client,
    settings: HttpSettings,
}

impl Http {
    /// Without a connection yet.
    ///
    /// # Errors
    /// What `reqwest` says of its settings.
    pub fn new(settings: HttpSettings) -> Result<Http, reqwest::Error> {
        let builder = reqwest::Client::builder().no_proxy().redirect(reqwest::redirect::Policy::none());
        let builder = if settings.http2 { builder.http2_prior_knowledge() } else { builder.http1_only() };
        Ok(Http { client: builder.build()?, settings })
    }

    /// The worlds that the server at `origin` lists.
    ///
    /// # Errors
    /// No answer within ten seconds, or one that is no list of worlds.
    pub async fn worlds(&self, origin: &str) -> Result<Vec<Listed>, FetchError> {
        let mut request = self.client.get(format!("{origin}/worlds")).timeout(LISTING);
        if let Some(token) = &self.settings.token {
            request = request.bearer_auth(token);
        }
        let mut response = request.send().await.map_err(|e| transport(&e))?;
        if response.status() != reqwest::StatusCode::OK {
            return Err(FetchError::Status(response.status().as_u16()));
        }
        let mut bytes = Vec::new();
        while let Some(chunk) = response.chunk().await.map_err(|e| transport(&e))? {
            bytes.extend_from_slice(&chunk);
            if bytes.len() > LIST_BYTES_MAX {
                return Err(FetchError::Length { expected: LIST_BYTES_MAX as u64, got: bytes.len() as u64 });
            }
        }
        serde_json::from_slice(&bytes).map_err(|e| FetchError::List(e.to_string()))
    }
}

/// A world as the server lists it.
#[derive(Clone, Debug, PartialEq, Eq, serde::Deserialize)]
pub struct Listed {
    /// Its name.
    pub name: String,
    /// `files`, or another word where its contents are made up.
    #[serde(default)]
    pub content: String,
}

#[derive(Debug)]
struct Request {
    id: u64,
    received: Arc<AtomicU64>,
    task: AbortHandle,
}

impl Drop for Request {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// The requests of one session. Each sends two events at most, and the session bounds their number.
#[derive(Debug)]
pub struct Requests {
    http: Http,
    clock: Clock,
    requests: BTreeMap<u32, Request>,
    next_id: u64,
    total: Arc<AtomicU64>,
    /// Whether contents are what their names say.
    has_files: bool,
    /// Whether bodies are kept.
    keeps: bool,
    sender: mpsc::UnboundedSender<(u64, TransferEvent)>,
    events: mpsc::UnboundedReceiver<(u64, TransferEvent)>,
}

impl Requests {
    /// None yet. `has_files` if contents are to begin as the ends of their names say, `keeps` if bodies are kept.
    pub fn new(http: Http, has_files: bool, keeps: bool, clock: Clock) -> Requests {
        let (sender, events) = mpsc::unbounded_channel();
        Requests {
            http,
            clock,
            requests: BTreeMap::new(),
            next_id: 0,
            total: Arc::new(AtomicU64::new(0)),
            has_files,
            keeps,
            sender,
            events,
        }
    }

    /// Requests `url` for `session`; `urgency` as in RFC 9218. A request for the same that is under way is dropped.
    pub fn start(&mut self, rep: u32, url: &str, session: &str, urgency: u8, wire_bytes: u64) {
        let id = self.next_id;
        self.next_id += 1;
        let received = Arc::new(AtomicU64::new(0));
        let mut request = self
            .http
            .client
            .get(url)
            .header(SESSION_HEADER, session)
            .header("Priority", format!("u={}", urgency.min(7)));
        if let Some(token) = &self.http.settings.token {
            request = request.bearer_auth(token);
        }
        let body = Body {
            stall: self.http.settings.stall,
            expected: wire_bytes,
            content: content(url).filter(|_| self.has_files),
            received: received.clone(),
            total: self.total.clone(),
            keeps: self.keeps,
        };
        let (clock, sender) = (self.clock, self.sender.clone());
        // The session may have ended: then nobody hears.
        let task = tokio::spawn(async move {
            let say = |step| {
                let _ = sender.send((id, TransferEvent { at_ns: clock.now_ns(), rep, step }));
            };
            let result = body.receive(request, || say(Step::Responded)).await;
            say(Step::Ended(result));
        });
        self.requests.insert(rep, Request { id, received, task: task.abort_handle() });
    }

    /// Aborts a request; what has come of it stays counted.
    pub fn abort(&mut self, rep: u32) {
        self.requests.remove(&rep);
    }

    /// The next event of a request that was not aborted.
    pub fn poll(&mut self) -> Option<TransferEvent> {
        loop {
            let (id, event) = self.events.try_recv().ok()?;
            if self.requests.get(&event.rep).is_none_or(|request| request.id != id) {
                continue;
            }
            if matches!(event.step, Step::Ended(_)) {
                self.requests.remove(&event.rep);
            }
            return Some(event);
        }
    }

    /// Bytes of a request under way that have come.
    pub fn received(&self, rep: u32) -> u64 {
        self.requests.get(&rep).map_or(0, |request| request.received.load(Ordering::Acquire))
    }

    /// Bytes received since the start, and of these those of requests under way.
    pub fn bytes(&self) -> (u64, u64) {
        // In this order no byte in flight can be missing from the total.
        let in_flight = self.requests.values().map(|request| request.received.load(Ordering::Acquire)).sum();
        (self.total.load(Ordering::Acquire), in_flight)
    }
}

/// What a content's first bytes must be, by the end of its name; `None` where any will do.
fn content(url: &str) -> Option<&'static str> {
    let path = url.split(['?', '#']).next().unwrap_or_default();
    match path.rsplit_once('.')?.1 {
        "glb" => Some("glTF"),
        "b3dm" => Some("b3dm"),
        "i3dm" => Some("i3dm"),
        "pnts" => Some("pnts"),
        "cmpt" => Some("cmpt"),
        _ => None,
    }
}

struct Body {
    stall: Duration,
    expected: u64,
    content: Option<&'static str>,
    received: Arc<AtomicU64>,
    total: Arc<AtomicU64>,
    keeps: bool,
}

impl Body {
    async fn receive(self, request: reqwest::RequestBuilder, responded: impl FnOnce()) -> Result<Bytes, FetchError> {
        let stalled = |_| FetchError::Stalled(self.stall.as_secs());
        let mut response =
            tokio::time::timeout(self.stall, request.send()).await.map_err(stalled)?.map_err(|e| transport(&e))?;
        responded();
        if response.status() != reqwest::StatusCode::OK {
            return Err(FetchError::Status(response.status().as_u16()));
        }
        if let Some(got) = response.content_length().filter(|&length| length != self.expected) {
            return Err(FetchError::Length { expected: self.expected, got });
        }
        let (mut got, mut head) = (0u64, Vec::with_capacity(HEAD_BYTES));
        // The client has made room for what the server has announced.
        let mut kept = Vec::with_capacity(if self.keeps { usize::try_from(self.expected).unwrap_or(0) } else { 0 });
        loop {
            let chunk = tokio::time::timeout(self.stall, response.chunk()).await.map_err(stalled)?;
            let Some(chunk) = chunk.map_err(|e| transport(&e))? else { break };
            head.extend(chunk.iter().take(HEAD_BYTES - head.len()));
            got += chunk.len() as u64;
            self.total.fetch_add(chunk.len() as u64, Ordering::AcqRel);
            self.received.fetch_add(chunk.len() as u64, Ordering::AcqRel);
            if got > self.expected {
                break;
            }
            if self.keeps {
                kept.extend_from_slice(&chunk);
            }
        }
        if got != self.expected {
            return Err(FetchError::Length { expected: self.expected, got });
        }
        match self.content {
            Some(expected) if !head.starts_with(expected.as_bytes()) => {
                let mut found = [0; 4];
                found.iter_mut().zip(&head).for_each(|(to, from)| *to = *from);
                Err(FetchError::Content { found, expected })
            }
            _ => Ok(Bytes::from(kept)),
        }
    }
}

/// The innermost cause says what happened; what wraps it only repeats the URL.
fn transport(error: &reqwest::Error) -> FetchError {
    let mut cause: &dyn std::error::Error = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    FetchError::Transport(cause.to_string())
}
