//! The store of link estimates: what it keeps, and how it says what is wrong when the database is locked, full, gone,
//! unwritable or no database.
#![cfg(feature = "sessions")]

mod file;
#[cfg(feature = "sessions-postgres")]
mod postgres;
#[cfg(feature = "sessions-postgres")]
#[expect(unreachable_pub, reason = "the same file is a public module of the end-to-end tests")]
#[path = "../../../tests/src/postgres.rs"]
mod server;

use foresight_index::sessions::Observation;

fn observed(client: &str, rate: f64, at_ms: i64) -> Observation {
    Observation { client: client.to_owned(), rate, latency_s: 0.05, seconds: 30.0, at_ms }
}
