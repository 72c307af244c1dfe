//! The catalogue: what is in a stored world, by box, in a SQLite file or (feature `catalogue-postgres`) a PostgreSQL
//! database. It says nothing that the pages do not say; it answers faster, and to others than clients.
//!
//! The interface is synchronous; the asynchronous runtime that the database library wants lives inside [`Catalogue`].

mod store;
mod write;

pub use crate::database::Location;
pub use store::{Catalogue, CellRow, RepresentationRow};

/// Version of the schema that this program reads and writes.
pub const SCHEMA_VERSION: i64 = 1;

/// Why a catalogue cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CatalogueError {
    /// A PostgreSQL URL, and a program that knows SQLite only.
    #[error("catalogue {catalogue}: this build has no PostgreSQL; expected one with the feature `postgres`")]
    WithoutPostgres {
        /// Its location.
        catalogue: String,
    },
    /// Written by another version of the program.
    #[error(
        "catalogue {catalogue} has schema version {found}; expected {SCHEMA_VERSION}: a newer program wrote it, use that or build again"
    )]
    Newer {
        /// Its location.
        catalogue: String,
        /// Version of its schema.
        found: i64,
    },
    /// There is no catalogue.
    #[error("catalogue {catalogue} holds no tables of a catalogue; expected one that a build wrote")]
    None {
        /// Its location.
        catalogue: String,
    },
    /// It holds no such world.
    #[error("catalogue {catalogue} holds no published world of the identity {identity}")]
    Absent {
        /// Its location.
        catalogue: String,
        /// What was asked for.
        identity: String,
    },
    /// The world's own files are at fault.
    #[error(transparent)]
    Stored(#[from] crate::stored::StoredError),
    /// Another connection holds it.
    #[error("catalogue {catalogue} is locked; expected it to be free")]
    Locked {
        /// Its location.
        catalogue: String,
    },
    /// No room.
    #[error("catalogue {catalogue} is full: {what}")]
    Full {
        /// Its location.
        catalogue: String,
        /// What the database said.
        what: String,
    },
    /// Cannot be written, or not even opened.
    #[error("catalogue {catalogue} cannot be opened or written ({what})")]
    ReadOnly {
        /// Its location.
        catalogue: String,
        /// What the database said.
        what: String,
    },
    /// Truncated, changed, or something else.
    #[error("catalogue {catalogue} is damaged or no SQLite file: {what}; expected an intact one")]
    Damaged {
        /// Its location.
        catalogue: String,
        /// What the database said.
        what: String,
    },
    /// The server did not answer in time.
    #[error("catalogue {catalogue}: no answer for {waited_s} s")]
    NoAnswer {
        /// Its location.
        catalogue: String,
        /// Seconds waited.
        waited_s: f64,
    },
    /// Anything else that the database says.
    #[error("catalogue {catalogue}: {source}")]
    Database {
        /// Its location.
        catalogue: String,
        /// What it said.
        #[source]
        source: sqlx::Error,
    },
    /// A migration failed; nothing was changed.
    #[error("catalogue {catalogue}: bringing it to schema version {SCHEMA_VERSION}: {source}")]
    Migration {
        /// Its location.
        catalogue: String,
        /// Why.
        #[source]
        source: sqlx::migrate::MigrateError,
    },
}
