//! Links: recorded or made capacity over time, and how transfers share it.
//!
//! Capacity is counted in integer *nano-bits*: R bit/s deliver exactly R nano-bits in a nanosecond, and a byte is
//! [`NANO_BITS_PER_BYTE`] of them. Nothing on a link is ever rounded but the time of an event, upwards to the nanosecond.

mod built_in;
pub mod delay;
pub mod g_nettrack;
mod latency;
mod loss;
mod mahimahi;
pub mod parse;
mod rate_lines;
pub mod sabre;
pub mod shared;
mod statistics;
mod trace;

#[cfg(test)]
mod format_tests;
#[cfg(test)]
mod parse_tests;
#[cfg(test)]
mod shared_tests;

pub use built_in::built_in;
pub use latency::RttPiece;
pub use shared::SharedLink;
pub use statistics::LinkStatistics;
pub use trace::{LinkTrace, RatePiece};

/// Nano-bits in a byte.
pub const NANO_BITS_PER_BYTE: u128 = 8_000_000_000;

/// Bytes that one delivery opportunity of a Mahimahi trace carries.
pub const OPPORTUNITY_BYTES: u64 = 1500;

/// Highest rate accepted, bit/s.
pub const RATE_MAX: u64 = 1_000_000_000_000_000;

/// Longest trace, round trip or offset accepted, seconds.
pub const SECONDS_MAX: f64 = 1e9;

/// Why there is no link.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The file could not be read.
    #[error("{name}: {source}")]
    Io {
        /// The file.
        name: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// The content is of no link format that is read here.
    #[error(
        "{name}, line {line}: `{found}` is not a supported link format; expected Mahimahi lines (one non-decreasing \
         integer of milliseconds each), lines of `seconds Mbit/s`, a SABRE list (JSON), or a G-NetTrack log (CSV with \
         Timestamp and DL_bitrate)"
    )]
    Unsupported {
        /// The file.
        name: String,
        /// Line, counted from 1.
        line: usize,
        /// The beginning of the line.
        found: String,
    },
    /// A line of a recognised format is wrong.
    #[error("{name}, line {line}: {message}")]
    Line {
        /// The file.
        name: String,
        /// Line, counted from 1.
        line: usize,
        /// What was found and what was expected.
        message: String,
    },
    /// The link as a whole is wrong.
    #[error("{name}: {message}")]
    Whole {
        /// The file or specification.
        name: String,
        /// What was found and what was expected.
        message: String,
    },
    /// No capacity at all.
    #[error("{name}: the link delivers no byte in its {seconds} seconds; expected some capacity")]
    NoCapacity {
        /// The file or specification.
        name: String,
        /// Length of the trace.
        seconds: f64,
    },
    /// A link specification is wrong.
    #[error("link `{spec}`: {message}")]
    Specification {
        /// The specification as given.
        spec: String,
        /// What was found and what was expected.
        message: String,
    },
}
