//! What happens on a connection, so that idle and stalled ones can be told from those that wait for the server.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;

use crate::clock;

/// What happens on a connection. Progress is a request that begins, a piece of a body handed over, and bytes that the
/// client's side takes. While a request is being answered or a body waits for the link or the disk, the server owes.
#[derive(Debug)]
pub(super) struct Activity {
    origin: Instant,
    last_ns: AtomicU64,
    owed: AtomicUsize,
    requests: AtomicUsize,
}

impl Activity {
    pub(super) fn new() -> Arc<Activity> {
        Arc::new(Activity {
            origin: clock::now(),
            last_ns: AtomicU64::new(0),
            owed: AtomicUsize::new(0),
            requests: AtomicUsize::new(0),
        })
    }

    /// Something moved.
    pub(super) fn touch(&self) {
        self.last_ns.fetch_max(clock::nanos(self.origin, clock::now()), Ordering::Relaxed);
    }

    /// A request has come.
    pub(super) fn request(self: &Arc<Activity>) -> Owed {
        self.requests.fetch_add(1, Ordering::Relaxed);
        self.owe()
    }

    /// Until the answer is dropped it is the server that has to move.
    pub(super) fn owe(self: &Arc<Activity>) -> Owed {
        self.owed.fetch_add(1, Ordering::Relaxed);
        Owed(self.clone())
    }

    /// True if the client has had its time: `first` for its first request, `idle` afterwards.
    pub(super) fn is_over(&self, first: Duration, idle: Duration) -> bool {
        if self.owed.load(Ordering::Relaxed) > 0 {
            return false;
        }
        let since = clock::nanos(self.origin, clock::now()).saturating_sub(self.last_ns.load(Ordering::Relaxed));
        let limit = if self.requests.load(Ordering::Relaxed) == 0 { first } else { idle };
        u128::from(since) >= limit.as_nanos()
    }
}

/// See [`Activity::owe`].
#[derive(Debug)]
pub(super) struct Owed(Arc<Activity>);

impl Drop for Owed {
    fn drop(&mut self) {
        self.0.owed.fetch_sub(1, Ordering::Relaxed);
        self.0.touch();
    }
}

/// A connection that tells what the client takes.
#[derive(Debug)]
pub(super) struct Watched {
    stream: TcpStream,
    activity: Arc<Activity>,
}

impl Watched {
    pub(super) fn new(stream: TcpStream, activity: Arc<Activity>) -> Watched {
        Watched { stream, activity }
    }

    fn note(&self, written: &Poll<io::Result<usize>>) {
        if matches!(written, Poll::Ready(Ok(1..))) {
            self.activity.touch();
        }
    }
}

impl AsyncRead for Watched {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl AsyncWrite for Watched {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.note(&written);
        written
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, slices);
        self.note(&written);
        written
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }
}
