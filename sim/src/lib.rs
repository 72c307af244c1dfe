//! Replays camera paths over worlds and links, and compares prefetch policies.

pub mod accuracy;
pub mod bound;
pub mod client;
pub mod compare;
pub mod flight;
pub mod limits;
pub mod link;
pub mod outcome;
pub mod path;
pub mod policies;
pub mod pressure;
mod random;
pub mod replay;
pub mod report;
pub mod stopwatch;
pub mod suite;
mod text_lines;
