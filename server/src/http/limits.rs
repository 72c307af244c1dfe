//! What clients of the HTTP side may take.

use std::time::Duration;

/// Limits of connections and requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Connections at a time; further ones are told 503 and closed.
    pub connections: usize,
    /// Requests being answered at a time, bodies not counted; further ones are told 503.
    pub requests: usize,
    /// Bodies being read from the disk, made up or shaped at a time; further requests for such are told 503.
    pub bodies: usize,
    /// Files being read from at a time; others wait for their turn, by priority.
    pub reads: usize,
    /// Streams of an HTTP/2 connection at a time.
    pub streams: u32,
    /// Bytes of a request's target; longer ones are told 414.
    pub target_bytes: usize,
    /// Bytes of a request's head; longer ones are told 431.
    pub head_bytes: usize,
    /// Fields of a request's head; more are told 431.
    pub head_fields: usize,
    /// Bytes of a request's body; longer ones are told 413.
    pub body_bytes: usize,
    /// Time for the head of a request, and to begin the first.
    pub head_within: Duration,
    /// Time between two pieces of a request's body.
    pub body_within: Duration,
    /// A connection on which nothing moves, and on which the server owes nothing, is closed after so long.
    pub idle: Duration,
    /// Time for responses under way when the server ends.
    pub shutdown: Duration,
    /// Bytes of small files that are kept in memory.
    pub store_bytes: u64,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            connections: 4096,
            requests: 4096,
            bodies: 4096,
            reads: 32,
            streams: 128,
            target_bytes: 8192,
            head_bytes: 32 << 10,
            head_fields: 64,
            body_bytes: 1 << 20,
            head_within: Duration::from_secs(10),
            body_within: Duration::from_secs(10),
            idle: Duration::from_secs(60),
            shutdown: Duration::from_secs(10),
            store_bytes: 256 << 20,
        }
    }
}
