//! What the stores share: where a database is, a connection to either kind, and what its refusals mean.

mod connection;
mod location;
mod migrations;

pub use location::{Location, LocationError};

pub(crate) use connection::{Connection, Kind, Value};
pub(crate) use migrations::Migrations;

/// What a database's refusal means.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Another connection holds it.
    Locked,
    /// Its file is not what it was.
    Damaged(String),
    /// It cannot be written.
    ReadOnly(String),
    /// There is no room.
    Full(String),
    /// Anything else.
    Other(sqlx::Error),
}

impl From<sqlx::Error> for Failure {
    fn from(source: sqlx::Error) -> Failure {
        let (code, what) = match &source {
            sqlx::Error::Database(error) => (error.code().unwrap_or_default().into_owned(), error.message().to_owned()),
            _ => return Failure::Other(source),
        };
        // SQLite's extended result codes have the primary code in the low byte; PostgreSQL's have five characters.
        let sqlite = if code.len() < 5 { code.parse::<u32>().ok().map(|c| c & 0xff) } else { None };
        match (sqlite, code.as_str()) {
            (Some(5 | 6), _) | (None, "55P03") => Failure::Locked,
            (Some(11 | 26), _) => Failure::Damaged(what),
            (Some(13), _) | (None, "53100") => Failure::Full(what),
            (Some(3 | 8 | 14 | 23), _) | (None, "25006" | "42501") => Failure::ReadOnly(what),
            _ => Failure::Other(source),
        }
    }
}
