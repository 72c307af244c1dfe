//! `foresight-sim`: replays camera paths over worlds and links, and compares prefetch policies.

fn main() {}
