//! The store of past runs, in a SQLite file or (feature `runs-postgres`) a PostgreSQL database.
//!
//! Runs are only ever added. A run and all of its results become visible in one transaction, and every reading checks
//! them against the checksum taken when they were written. The interface is synchronous; the asynchronous runtime that
//! the database library wants lives inside [`RunStore`].

mod row;
mod run;
mod schema;
mod store;

use std::path::PathBuf;

pub use crate::database::Location;
pub use run::{FIGURES, Figure, Input, PolicyResult, Pressure, Run, StoredRun};
pub use schema::SCHEMA_VERSION;
pub use store::{Access, Filter, RunStore};

/// Why a store cannot be used, or a run not be stored or read.
#[derive(Debug, thiserror::Error)]
pub enum RunStoreError {
    /// Neither a file nor a URL that is known.
    #[error("run store {0}")]
    Location(#[from] crate::database::LocationError),
    /// A PostgreSQL URL, and a program that knows SQLite only.
    #[error("run store {store}: this build has no PostgreSQL; expected one with the feature `runs-postgres`")]
    WithoutPostgres {
        /// Its location.
        store: String,
    },
    /// Nothing there.
    #[error("no run store at {store}; expected one: `foresight-sim replay --store` makes it")]
    Absent {
        /// Its location.
        store: String,
    },
    /// The folder that would hold it is not there.
    #[error("run store {}: the folder {} does not exist; expected an existing one", .file.display(), .folder.display())]
    Folder {
        /// The store's file.
        file: PathBuf,
        /// Its parent.
        folder: PathBuf,
    },
    /// Not a SQLite file.
    #[error("run store {}: {found}; expected a SQLite database", .file.display())]
    NotSqlite {
        /// The store's file.
        file: PathBuf,
        /// What it is.
        found: String,
    },
    /// A database of something else.
    #[error("{store} is a database without a run store; expected the tables of one")]
    NotARunStore {
        /// Its location.
        store: String,
    },
    /// Written by a later version of the program.
    #[error(
        "run store {store} has schema version {found}; this program knows versions up to {known}: expected a newer program"
    )]
    Newer {
        /// Its location.
        store: String,
        /// Version of its schema.
        found: i64,
        /// Newest version known.
        known: i64,
    },
    /// Written by an earlier version of the program, and opened for reading only.
    #[error("run store {store} has schema version {found}, expected {known}: recording a run brings it there")]
    Older {
        /// Its location.
        store: String,
        /// Version of its schema.
        found: i64,
        /// Version needed.
        known: i64,
    },
    /// Truncated, or bytes changed.
    #[error("run store {store} is damaged and was left as it is: {what}; expected an intact one, such as a backup")]
    Damaged {
        /// Its location.
        store: String,
        /// What is wrong.
        what: String,
    },
    /// Another process holds it.
    #[error("run store {store} is locked by another process for more than {waited_s} s; expected it to be free")]
    Locked {
        /// Its location.
        store: String,
        /// Seconds waited.
        waited_s: f64,
    },
    /// Cannot be written.
    #[error("run store {store} cannot be written ({what}); expected a file and a folder that can be")]
    ReadOnly {
        /// Its location.
        store: String,
        /// What the database said.
        what: String,
    },
    /// The server did not answer in time.
    #[error("run store {store}: no answer for {waited_s} s; expected a PostgreSQL server there")]
    NoAnswer {
        /// Its location.
        store: String,
        /// Seconds waited.
        waited_s: f64,
    },
    /// Reading or writing a file failed.
    #[error("run store {}: {source}", .file.display())]
    Io {
        /// The store's file.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// No run of that number.
    #[error("run store {store} has no run {id}; expected a number that `runs list` shows")]
    NoSuchRun {
        /// Its location.
        store: String,
        /// As asked for.
        id: i64,
    },
    /// A value that not every database can hold.
    #[error("{column} of the run cannot be stored: {what}")]
    Value {
        /// Its column.
        column: &'static str,
        /// What is wrong, and what was expected.
        what: &'static str,
    },
    /// Anything else that the database says.
    #[error("run store {store}: {source}")]
    Database {
        /// Its location.
        store: String,
        /// What it said.
        #[source]
        source: sqlx::Error,
    },
    /// A migration failed; nothing was changed.
    #[error("run store {store}: bringing it to schema version {}: {source}", SCHEMA_VERSION)]
    Migration {
        /// Its location.
        store: String,
        /// Why.
        #[source]
        source: sqlx::migrate::MigrateError,
    },
}
