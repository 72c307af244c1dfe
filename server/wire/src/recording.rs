//! Recordings of sessions: JSON lines, a header and then an input a line with what was answered.
//!
//! ```text
//! {"format":"foresight-session","schema_version":1,"session":"1f","world":"city","identity":"9a0c…","limits":{…},"hello":{…}}
//! {"received_ns":0,"in":{"kind":"open"},"out":[{"type":"welcome",…}]}
//! {"received_ns":16683011,"in":{"kind":"frame","messages":[{"type":"view",…}]},"out":[{"type":"fetch",…}]}
//! {"received_ns":116683011,"in":{"kind":"tick"},"out":[]}
//! ```
//!
//! `received_ns` is the server's clock since the `hello`. `in` is what the session was given: `open`, a `frame` with its
//! `messages`, a `tick`, a `resume` with its `hello`, or a `switch` with whether the server is `driving` from then on. `out`
//! is what the session answered, and `unsent` what it decided and did not say (shadow mode). A session follows from its
//! inputs, so the same inputs give the same answers: [`open`] and [`feed`] replay them. A line is written at once: a
//! recording that was cut off lacks the end of its last line at most.

use crate::message::{ClientMessage, Error, Hello, ServerMessage};
use crate::session::{Session, SessionLimits, SessionWorld};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::io::{BufRead, Read, Write};

/// What the header's `format` says.
pub const FORMAT: &str = "foresight-session";

/// Version that is written. Raised when a field changes its meaning or goes away; others are refused.
pub const SCHEMA_VERSION: u32 = 1;

/// Longest line that is read, bytes: a frame of [`crate::encoding::FRAME_BYTES_MAX`] of MessagePack as JSON, and its answers.
pub const LINE_BYTES_MAX: usize = 16 << 20;

/// The first line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// [`FORMAT`].
    pub format: String,
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// The session's id.
    pub session: String,
    /// Name of the world.
    pub world: String,
    /// Hash of its content: on another world no session replays.
    pub identity: String,
    /// As the session was opened.
    pub limits: SessionLimits,
    /// What opened it.
    pub hello: Hello,
}

impl Header {
    /// Of a session as it is opened.
    pub fn new(session: &str, world: &SessionWorld, limits: &SessionLimits, hello: &Hello) -> Header {
        Header {
            format: FORMAT.to_owned(),
            schema_version: SCHEMA_VERSION,
            session: session.to_owned(),
            world: world.name.to_owned(),
            identity: world.identity.to_owned(),
            limits: limits.clone(),
            hello: hello.clone(),
        }
    }
}

/// What a session was given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Input<'a> {
    /// The header's `hello`: [`Session::open`].
    Open,
    /// [`Session::frame`].
    Frame {
        /// In order.
        messages: Cow<'a, [ClientMessage]>,
    },
    /// [`Session::tick`].
    Tick,
    /// [`Session::resume`].
    Resume {
        /// Of the new connection.
        hello: Cow<'a, Hello>,
    },
    /// [`Session::set_driving`].
    Switch {
        /// From now on.
        driving: bool,
    },
}

/// A line: an input and what came of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry<'a> {
    /// On the server's clock, ns since the `hello`.
    pub received_ns: u64,
    /// What the session was given.
    #[serde(rename = "in")]
    pub input: Input<'a>,
    /// What it answered.
    pub out: Cow<'a, [ServerMessage]>,
    /// What it decided and did not say.
    #[serde(default, skip_serializing_if = "<[ServerMessage]>::is_empty")]
    pub unsent: Cow<'a, [ServerMessage]>,
}

impl<'a> Entry<'a> {
    /// What `session` has just made of an input: its answers and what it did not say.
    pub fn new(received_ns: u64, input: Input<'a>, out: &'a [ServerMessage], session: &'a Session) -> Entry<'a> {
        let unsent = match input {
            Input::Frame { .. } | Input::Tick => session.unsent(),
            Input::Open | Input::Resume { .. } | Input::Switch { .. } => &[],
        };
        Entry { received_ns, input, out: Cow::Borrowed(out), unsent: Cow::Borrowed(unsent) }
    }

    /// The line, its end included.
    ///
    /// # Errors
    /// A number that is not finite: no session acts on one, and JSON has none.
    pub fn line(&self) -> Result<Vec<u8>, serde_json::Error> {
        line(self)
    }
}

fn line(content: &impl Serialize) -> Result<Vec<u8>, serde_json::Error> {
    let mut line = serde_json::to_vec(content)?;
    line.push(b'\n');
    Ok(line)
}

/// Writes a recording as the session goes on.
#[derive(Debug)]
pub struct Writer<W> {
    out: W,
}

impl<W: Write> Writer<W> {
    /// Writes the header.
    ///
    /// # Errors
    /// What the output says.
    pub fn new(mut out: W, header: &Header) -> std::io::Result<Writer<W>> {
        out.write_all(&line(header)?)?;
        Ok(Writer { out })
    }

    /// Goes on with a recording that has its header.
    pub fn append(out: W) -> Writer<W> {
        Writer { out }
    }

    /// Writes a line, at once.
    ///
    /// # Errors
    /// What the output says.
    pub fn push(&mut self, entry: &Entry) -> std::io::Result<()> {
        self.out.write_all(&entry.line()?)
    }

    /// The output.
    pub fn into_inner(self) -> W {
        self.out
    }
}

/// Why a recording cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// What the input says.
    #[error("{name}: {source}")]
    Io {
        /// Of the recording.
        name: String,
        /// What it says.
        source: std::io::Error,
    },
    /// A line that is none of a recording.
    #[error("{name}, line {line}: {message}")]
    Line {
        /// Of the recording.
        name: String,
        /// From 1.
        line: usize,
        /// What was found and what was expected.
        message: String,
    },
}

/// Reads a recording line by line.
#[derive(Debug)]
pub struct Reader<R> {
    name: String,
    input: R,
    header: Header,
    /// Lines read.
    lines: usize,
    cut_off: bool,
    ended: bool,
}

/// What every version's header states.
#[derive(Deserialize)]
struct Version {
    format: String,
    schema_version: u64,
}

impl<R: BufRead> Reader<R> {
    /// Reads the header. `name` is for messages.
    ///
    /// # Errors
    /// What the input says; no header; one of another version.
    pub fn new(name: &str, mut input: R) -> Result<Reader<R>, RecordingError> {
        let wrong = |message: String| RecordingError::Line { name: name.to_owned(), line: 1, message };
        let first = next_line(name, 1, &mut input)?;
        let Some(first) = first else {
            return Err(wrong(format!("is missing; expected the header of a {FORMAT}")));
        };
        let header_error = |error: serde_json::Error| wrong(format!("{error}; expected a {FORMAT} header"));
        let version: Version = serde_json::from_slice(&first).map_err(header_error)?;
        if version.format != FORMAT {
            return Err(wrong(format!("a format of `{:.40}`; expected {FORMAT}", version.format)));
        }
        if version.schema_version != u64::from(SCHEMA_VERSION) {
            let found = version.schema_version;
            return Err(wrong(format!("schema version {found}; this program reads {SCHEMA_VERSION}")));
        }
        let header = serde_json::from_slice(&first).map_err(header_error)?;
        Ok(Reader { name: name.to_owned(), input, header, lines: 1, cut_off: false, ended: false })
    }

    /// The first line.
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Whether the last line was incomplete, and left out.
    pub fn cut_off(&self) -> bool {
        self.cut_off
    }

    fn read(&mut self) -> Result<Option<Entry<'static>>, RecordingError> {
        let Some(bytes) = next_line(&self.name, self.lines + 1, &mut self.input)? else { return Ok(None) };
        self.lines += 1;
        match serde_json::from_slice(&bytes) {
            Ok(entry) => Ok(Some(entry)),
            Err(_) if !bytes.ends_with(b"\n") => {
                self.cut_off = true;
                Ok(None)
            }
            Err(error) => {
                let message = format!("{error}; expected received_ns, in and out");
                Err(RecordingError::Line { name: self.name.clone(), line: self.lines, message })
            }
        }
    }
}

impl<R: BufRead> Iterator for Reader<R> {
    type Item = Result<Entry<'static>, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let next = self.read().transpose();
        self.ended = !matches!(next, Some(Ok(_)));
        next
    }
}

/// The next line with its end; `None` after the last.
fn next_line(name: &str, number: usize, input: &mut impl BufRead) -> Result<Option<Vec<u8>>, RecordingError> {
    let mut line = Vec::new();
    let most = LINE_BYTES_MAX as u64 + 1;
    input
        .take(most)
        .read_until(b'\n', &mut line)
        .map_err(|source| RecordingError::Io { name: name.to_owned(), source })?;
    if line.len() as u64 == most {
        let message = format!("is longer than {LINE_BYTES_MAX} bytes; expected an input a line");
        return Err(RecordingError::Line { name: name.to_owned(), line: number, message });
    }
    Ok((!line.is_empty()).then_some(line))
}

/// Opens the session of a recording anew.
///
/// # Errors
/// As [`Session::open`].
pub fn open<'a>(header: &Header, world: SessionWorld<'a>) -> Result<(Session<'a>, Vec<ServerMessage>), Error> {
    Session::open(header.session.clone(), world, &header.limits, &header.hello)
}

/// Gives a session a recorded input, other than the first; its answers.
pub fn feed(session: &mut Session, received_ns: u64, input: &Input) -> Vec<ServerMessage> {
    match input {
        Input::Open => Vec::new(),
        Input::Frame { messages } => session.frame(received_ns, messages),
        Input::Tick => session.tick(received_ns),
        Input::Resume { hello } => session.resume(received_ns, hello),
        Input::Switch { driving } => session.set_driving(*driving),
    }
}
