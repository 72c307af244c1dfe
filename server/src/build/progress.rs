//! How far a build is, on standard error.

use crate::clock;
use std::io::{IsTerminal as _, Write as _};
use std::time::{Duration, Instant};

/// Tells how far it is: on a terminal a line that changes, elsewhere a line every now and then.
#[derive(Debug)]
pub(super) struct Progress {
    begun: Instant,
    /// When the part at work began.
    part: Instant,
    told: Option<Instant>,
    to_terminal: bool,
    is_quiet: bool,
}

impl Progress {
    /// Begins now. A quiet one says nothing.
    pub(super) fn begin(is_quiet: bool) -> Progress {
        let now = clock::now();
        Progress { begun: now, part: now, told: None, to_terminal: std::io::stderr().is_terminal(), is_quiet }
    }

    /// Seconds since the beginning.
    pub(super) fn seconds(&self) -> f64 {
        clock::now().saturating_duration_since(self.begun).as_secs_f64()
    }

    /// Another part begins, with a pace of its own.
    pub(super) fn begin_part(&mut self) {
        self.part = clock::now();
    }

    /// Says a line.
    pub(super) fn say(&mut self, text: &str) {
        if !self.is_quiet {
            let clear = if self.to_terminal { "\r\x1b[K" } else { "" };
            // Nobody to tell is no reason to stop.
            let _ = writeln!(std::io::stderr(), "{clear}{text}");
        }
    }

    /// `done` of `all` are done, `more` says what else there is. `made_now` of them since the beginning tell how long the
    /// rest takes.
    pub(super) fn at(&mut self, what: &str, done: u64, all: u64, made_now: u64, more: &str) {
        let now = clock::now();
        let every = if self.to_terminal { Duration::from_millis(200) } else { Duration::from_secs(5) };
        let is_due = self.told.is_none_or(|told| now.saturating_duration_since(told) >= every);
        if self.is_quiet || !is_due {
            return;
        }
        self.told = Some(now);
        let passed = now.saturating_duration_since(self.begun).as_secs_f64();
        let left = if made_now == 0 {
            String::new()
        } else {
            let in_part = now.saturating_duration_since(self.part).as_secs_f64();
            let left = in_part / made_now as f64 * all.saturating_sub(done) as f64;
            format!(", {} left", span(left))
        };
        let text = format!("{done} of {all} {what}{more}, {} passed{left}", span(passed));
        let _ = if self.to_terminal {
            write!(std::io::stderr(), "\r\x1b[K{text}")
        } else {
            writeln!(std::io::stderr(), "{text}")
        };
    }
}

/// A time for people.
pub(super) fn span(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 6000.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
