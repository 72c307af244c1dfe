//! Sessions over real sockets, with the real server: how they begin, go on after a break, obey the switch, are recorded, and end.

#[path = "sessions/lifecycle.rs"]
mod lifecycle;
#[path = "sessions/modes.rs"]
mod modes;
#[path = "sessions/operation.rs"]
mod operation;
#[path = "sessions/stream.rs"]
mod stream;

/// A generated world, small enough to be opened at once.
const WORLD: [&str; 2] = ["--world", "w=city:blocks=4"];
