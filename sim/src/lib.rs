//! Replays camera paths over worlds and links, and compares prefetch policies.

pub mod link;
pub mod outcome;
pub mod path;
mod text_lines;
