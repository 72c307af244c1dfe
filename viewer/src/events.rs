//! What happens to representations at the client, and a log of it.

use foresight_wire::message::{ClientMessage, Event, Failure};
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// Version of the log's lines.
pub const SCHEMA_VERSION: u32 = 1;

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum What {
    /// It was requested.
    Requested,
    /// Its first byte came.
    Responded,
    /// Its last byte came.
    Arrived,
    /// It can be shown.
    Completed,
    /// It could not be fetched, or what it needs could not.
    Failed {
        /// Why.
        reason: String,
    },
    /// The server had its request aborted, or what had come of it dropped.
    Cancelled,
    /// The server had it freed.
    Discarded,
    /// The client freed it by itself: it was left over from a session that was lost.
    Dropped,
}

/// Something that happened to a representation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Happening {
    /// When, ns since the first tick.
    pub at_ns: u64,
    /// To what.
    pub rep: u32,
    /// What.
    pub what: What,
    /// Whether the server is to be told: it is not of what it does not know.
    pub told: bool,
}

impl Happening {
    /// What the server is told of it; times are those of the session, which began at `epoch_ns`.
    pub fn message(&self, epoch_ns: u64) -> Option<ClientMessage> {
        let event = Event { t_ns: self.at_ns.saturating_sub(epoch_ns), rep: self.rep };
        match &self.what {
            _ if !self.told => None,
            What::Responded => Some(ClientMessage::Responded(event)),
            What::Arrived => Some(ClientMessage::Arrived(event)),
            What::Completed => Some(ClientMessage::Completed(event)),
            What::Failed { reason } => {
                Some(ClientMessage::Failed(Failure { t_ns: event.t_ns, rep: event.rep, reason: reason.clone() }))
            }
            What::Dropped => Some(ClientMessage::Dropped(event)),
            What::Requested | What::Cancelled | What::Discarded => None,
        }
    }
}

#[derive(Serialize)]
struct Line<'a> {
    t_ns: u64,
    rep: u32,
    #[serde(flatten)]
    what: &'a What,
}

/// A file of JSON lines: a header, then one line for each happening: `t_ns` since the first tick, `rep`, `event`.
#[derive(Debug)]
pub struct Log {
    out: BufWriter<File>,
}

impl Log {
    /// Begins a file; one of that name is replaced.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(file: &Path, world: &str) -> std::io::Result<Log> {
        let mut out = BufWriter::new(File::create(file)?);
        let header =
            serde_json::json!({ "format": "foresight-client", "schema_version": SCHEMA_VERSION, "world": world });
        writeln!(out, "{header}")?;
        Ok(Log { out })
    }

    /// Appends a line.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&mut self, happening: &Happening) -> std::io::Result<()> {
        let line = Line { t_ns: happening.at_ns, rep: happening.rep, what: &happening.what };
        serde_json::to_writer(&mut self.out, &line)?;
        self.out.write_all(b"\n")
    }

    /// Writes what is buffered.
    ///
    /// # Errors
    /// What the file system says.
    pub fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}
