//! Log lines on stderr, as text or as JSON objects.
//!
//! What clients say is written with its control characters escaped: as a quoted string in text, by JSON's own rules else.

use crate::config::{LogForm, LogLevels};
use std::io::{IsTerminal as _, stderr};
use tracing_subscriber::EnvFilter;

/// Begins to write log lines; a second call changes nothing.
pub fn begin(form: LogForm, levels: &LogLevels) {
    // Checked when the configuration was read.
    let levels = EnvFilter::try_new(&levels.0).unwrap_or_else(|_| EnvFilter::new("info"));
    let lines = tracing_subscriber::fmt().with_env_filter(levels).with_writer(stderr).with_ansi(stderr().is_terminal());
    let _ = match form {
        LogForm::Text => lines.try_init(),
        LogForm::Json => lines.json().flatten_event(true).try_init(),
    };
}
