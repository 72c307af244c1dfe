//! Recordings of sessions on the disk: one thread that writes, and a bounded queue before it.
//!
//! A recording is a file of lines, `NAME.jsonl.partial` while its session lasts and `NAME.jsonl` afterwards. Where a line is
//! lost (the queue or the disk is full) nothing after it would replay: the recording ends there and keeps its `.partial`,
//! which can be read as far as it goes. Sessions never wait.

use super::metrics::{ReasonLabel, SessionMetrics};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::sync::oneshot;

/// Lines before the thread.
const QUEUE_MAX: usize = 4096;
/// Bytes gathered before a file is written.
const BUFFER_BYTES: usize = 16 << 10;
/// Written to the files when nothing has come for so long.
const IDLE: Duration = Duration::from_secs(1);

/// Gives a line with its end; called on the writing thread.
type Line = Box<dyn FnOnce() -> Vec<u8> + Send>;

enum Order {
    Begin { number: u64, name: String, alive: Arc<AtomicBool>, line: Line },
    Line { number: u64, line: Line },
    End { number: u64 },
    Flush(oneshot::Sender<()>),
}

/// The way to the thread that writes recordings.
pub(super) struct Recorder {
    queue: Mutex<Option<SyncSender<Order>>>,
    metrics: SessionMetrics,
    thread: Option<JoinHandle<()>>,
}

/// A recording under way; dropped, it is at its end.
pub(super) struct Recording {
    queue: SyncSender<Order>,
    number: u64,
    /// No line is lost so far.
    alive: Arc<AtomicBool>,
    metrics: SessionMetrics,
}

impl Recorder {
    /// Starts the thread. The bytes of all recordings in the folder together stay below `bytes_max`.
    pub(super) fn start(folder: &Path, bytes_max: u64, metrics: SessionMetrics) -> std::io::Result<Recorder> {
        std::fs::create_dir_all(folder)?;
        let mut bytes = 0_u64;
        for entry in std::fs::read_dir(folder)? {
            let entry = entry?;
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.ends_with(".jsonl") || name.ends_with(".jsonl.partial") {
                bytes = bytes.saturating_add(entry.metadata()?.len());
            }
        }
        let (queue, orders) = sync_channel(QUEUE_MAX);
        let mut writer = Writer {
            folder: folder.to_owned(),
            left: bytes_max.saturating_sub(bytes),
            files: BTreeMap::new(),
            metrics: metrics.clone(),
        };
        let thread = std::thread::Builder::new().name("recordings".to_owned()).spawn(move || writer.run(&orders))?;
        Ok(Recorder { queue: Mutex::new(Some(queue)), metrics, thread: Some(thread) })
    }

    /// Begins a recording with its first line.
    pub(super) fn begin(
        &self,
        number: u64,
        name: String,
        line: impl FnOnce() -> Vec<u8> + Send + 'static,
    ) -> Option<Recording> {
        let queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        let alive = Arc::new(AtomicBool::new(true));
        let order = Order::Begin { number, name, alive: alive.clone(), line: Box::new(line) };
        let recording = Recording { queue, number, alive, metrics: self.metrics.clone() };
        recording.send(order);
        self.metrics.recordings.inc();
        Some(recording)
    }

    /// Returns when all that was recorded so far is written.
    pub(super) async fn flush(&self) {
        let queue = self.queue.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let (done, flushed) = oneshot::channel();
        let mut order = Order::Flush(done);
        while let Some(Err(std::sync::mpsc::TrySendError::Full(again))) =
            queue.as_ref().map(|queue| queue.try_send(order))
        {
            order = again;
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
        drop(queue);
        let _ = flushed.await;
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        *self.queue.lock().unwrap_or_else(PoisonError::into_inner) = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Recording {
    /// Adds a line.
    pub(super) fn line(&self, line: impl FnOnce() -> Vec<u8> + Send + 'static) {
        if self.is_alive() {
            self.send(Order::Line { number: self.number, line: Box::new(line) });
        }
    }

    /// Whether lines are still taken.
    pub(super) fn is_alive(&self) -> bool {
        self.alive.load(Ordering::Relaxed)
    }

    fn send(&self, order: Order) {
        if self.queue.try_send(order).is_err() && self.alive.swap(false, Ordering::Relaxed) {
            self.metrics.recordings_cut_short.get_or_create(&ReasonLabel { reason: "queue_full" }).inc();
            tracing::warn!(session_number = self.number, "recording cut short: its thread is too slow");
        }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        // If the queue is full now, the file keeps its name and is complete but for that.
        self.send(Order::End { number: self.number });
    }
}

struct Writer {
    folder: PathBuf,
    /// Bytes that may still be written.
    left: u64,
    files: BTreeMap<u64, Open>,
    metrics: SessionMetrics,
}

struct Open {
    file: BufWriter<File>,
    partial: PathBuf,
    done: PathBuf,
    alive: Arc<AtomicBool>,
}

impl Writer {
    fn run(&mut self, orders: &Receiver<Order>) {
        loop {
            match orders.recv_timeout(IDLE) {
                Ok(Order::Begin { number, name, alive, line }) => {
                    match self.create(&name, alive.clone()) {
                        Ok(open) => {
                            self.files.insert(number, open);
                            self.write(number, line);
                        }
                        Err(error) => self.cut_short(&alive, &error),
                    };
                }
                Ok(Order::Line { number, line }) => self.write(number, line),
                Ok(Order::End { number }) => self.finish(number),
                Ok(Order::Flush(done)) => {
                    self.flush();
                    let _ = done.send(());
                }
                Err(RecvTimeoutError::Timeout) => self.flush(),
                Err(RecvTimeoutError::Disconnected) => return self.flush(),
            }
        }
    }

    fn create(&self, name: &str, alive: Arc<AtomicBool>) -> std::io::Result<Open> {
        let partial = self.folder.join(format!("{name}.jsonl.partial"));
        let file = File::options().write(true).create_new(true).open(&partial)?;
        let done = self.folder.join(format!("{name}.jsonl"));
        Ok(Open { file: BufWriter::with_capacity(BUFFER_BYTES, file), partial, done, alive })
    }

    fn write(&mut self, number: u64, line: Line) {
        let Some(open) = self.files.get_mut(&number) else { return };
        let line = line();
        let bytes = line.len() as u64;
        let written = if bytes > self.left {
            Err(std::io::Error::new(std::io::ErrorKind::QuotaExceeded, "record_bytes_max is reached"))
        } else {
            open.file.write_all(&line)
        };
        match written {
            Ok(()) => {
                self.left -= bytes;
                self.metrics.recording_bytes.inc_by(bytes);
            }
            Err(error) => self.give_up(number, &error),
        }
    }

    /// Ends a recording whose disk does not take it.
    fn give_up(&mut self, number: u64, error: &std::io::Error) {
        if let Some(open) = self.files.remove(&number) {
            self.cut_short(&open.alive, error);
            // Writes what the buffer holds if it can; a line is cut at most at the end.
            let mut file = open.file;
            let _ = file.flush();
            let _ = file.into_parts();
        }
    }

    fn cut_short(&self, alive: &AtomicBool, error: &std::io::Error) {
        if alive.swap(false, Ordering::Relaxed) {
            let reason = if error.kind() == std::io::ErrorKind::QuotaExceeded { "limit" } else { "disk" };
            self.metrics.recordings_cut_short.get_or_create(&ReasonLabel { reason }).inc();
            tracing::warn!(reason, error = ?error.to_string(), "recording cut short");
        }
    }

    fn finish(&mut self, number: u64) {
        let Some(mut open) = self.files.remove(&number) else { return };
        let intact = open.alive.load(Ordering::Relaxed);
        let closed = open.file.flush();
        let closed = closed.and_then(|()| if intact { std::fs::rename(&open.partial, &open.done) } else { Ok(()) });
        if let Err(error) = closed {
            self.cut_short(&open.alive, &error);
        }
    }

    fn flush(&mut self) {
        let failed: Vec<(u64, std::io::Error)> = self
            .files
            .iter_mut()
            .filter_map(|(number, open)| open.file.flush().err().map(|error| (*number, error)))
            .collect();
        for (number, error) in failed {
            self.give_up(number, &error);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .expect("the folder")
            .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_recording_is_renamed_at_its_end_and_kept_within_its_limit() {
        let folder = tempfile::tempdir().expect("a folder");
        let recorder = Recorder::start(folder.path(), 20, SessionMetrics::default()).expect("starts");
        let whole = recorder.begin(1, "whole".to_owned(), || b"12345\n".to_vec()).expect("begins");
        whole.line(|| b"6789\n".to_vec());
        drop(whole);
        let cut = recorder.begin(2, "cut".to_owned(), || b"1234\n".to_vec()).expect("begins");
        cut.line(|| b"too much\n".to_vec());
        cut.line(|| b"x\n".to_vec());
        drop(cut);
        drop(recorder);
        assert_eq!(names(folder.path()), ["cut.jsonl.partial", "whole.jsonl"]);
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("readable");
        assert_eq!(read("whole.jsonl"), "12345\n6789\n");
        assert_eq!(read("cut.jsonl.partial"), "1234\n");
    }

    #[test]
    fn a_file_that_cannot_be_made_is_counted_and_harms_nobody() {
        let folder = tempfile::tempdir().expect("a folder");
        let metrics = SessionMetrics::default();
        let recorder = Recorder::start(folder.path(), 1 << 20, metrics.clone()).expect("starts");
        std::fs::create_dir(folder.path().join("taken.jsonl.partial")).expect("a folder");
        let recording = recorder.begin(1, "taken".to_owned(), || b"header\n".to_vec()).expect("begins");
        recording.line(|| b"line\n".to_vec());
        drop(recording);
        drop(recorder);
        assert_eq!(metrics.recordings_cut_short.get_or_create(&ReasonLabel { reason: "disk" }).get(), 1);
    }
}
