//! What the server keeps of sessions beyond their end: estimates of links by client name, in a SQLite file or (feature
//! `sessions-postgres`) a PostgreSQL database.
//!
//! The interface is synchronous; the asynchronous runtime that the database library wants lives inside
//! [`SessionStore`]. Every call ends within the patience that the store was opened with, or fails.

mod estimate;
mod store;

use std::path::PathBuf;

pub use crate::database::Location;
pub use estimate::{LinkEstimate, Observation};
pub use store::{CLIENTS_MAX, SessionStore};

/// Version of the schema that this program reads and writes.
pub const SCHEMA_VERSION: i64 = 1;

/// Why the store cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SessionStoreError {
    /// A PostgreSQL URL, and a program that knows SQLite only.
    #[error("session store {store}: this build has no PostgreSQL; expected one with the feature `postgres`")]
    WithoutPostgres {
        /// Its location.
        store: String,
    },
    /// Written by another version of the program.
    #[error("session store {store} has schema version {found}; this program knows versions up to {SCHEMA_VERSION}")]
    Newer {
        /// Its location.
        store: String,
        /// Version of its schema.
        found: i64,
    },
    /// Another connection holds it.
    #[error("session store {store} is locked for more than {waited_s} s; expected it to be free")]
    Locked {
        /// Its location.
        store: String,
        /// Seconds waited.
        waited_s: f64,
    },
    /// The file that was opened is no longer there.
    #[error("session store {}: the file was removed or replaced; expected the one that was opened", .file.display())]
    Gone {
        /// Where it was.
        file: PathBuf,
    },
    /// No room.
    #[error("session store {store} is full: {what}")]
    Full {
        /// Its location.
        store: String,
        /// What the database said.
        what: String,
    },
    /// Cannot be written, or not even opened.
    #[error("session store {store} cannot be written ({what}); expected a file and a folder that can be")]
    ReadOnly {
        /// Its location.
        store: String,
        /// What the database said.
        what: String,
    },
    /// Truncated, changed, or something else.
    #[error("session store {store} is damaged or no SQLite file: {what}; expected an intact one")]
    Damaged {
        /// Its location.
        store: String,
        /// What the database said.
        what: String,
    },
    /// The server did not answer in time.
    #[error("session store {store}: no answer for {waited_s} s")]
    NoAnswer {
        /// Its location.
        store: String,
        /// Seconds waited.
        waited_s: f64,
    },
    /// Anything else that the database says.
    #[error("session store {store}: {source}")]
    Database {
        /// Its location.
        store: String,
        /// What it said.
        #[source]
        source: sqlx::Error,
    },
    /// A migration failed; nothing was changed.
    #[error("session store {store}: bringing it to schema version {SCHEMA_VERSION}: {source}")]
    Migration {
        /// Its location.
        store: String,
        /// Why.
        #[source]
        source: sqlx::migrate::MigrateError,
    },
}
