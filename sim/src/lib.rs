//! Replays camera paths over worlds and links, and compares prefetch policies.

pub use foresight_replay::future;

pub mod accuracy;
pub mod bound;
pub mod compare;
pub mod limits;
pub mod outcome;
pub mod pressure;
pub mod replay;
pub mod report;
pub mod session_replay;
pub mod stopwatch;
pub mod suite;
