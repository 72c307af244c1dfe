//! The run store: what goes in comes out, from a file that was killed, cut, changed, locked or written by two at once,
//! and from a PostgreSQL server.
#![cfg(feature = "runs")]

mod any_run;
mod file;
mod killed;
#[cfg(feature = "runs-postgres")]
mod postgres;
#[cfg(feature = "runs-postgres")]
#[expect(unreachable_pub, reason = "the same file is a public module of the end-to-end tests")]
#[path = "../../../tests/src/postgres.rs"]
mod server;
