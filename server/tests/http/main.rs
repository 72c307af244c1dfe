//! Worlds over HTTP, as clients meet them: the built program, real sockets.

mod client;
mod conditional;
mod hostile;
mod limits;
mod operation;
mod shaped;
