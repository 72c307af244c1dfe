//! Opening the store, reading an estimate, adding observations.

use super::estimate::{LinkEstimate, Observation};
use super::{SCHEMA_VERSION, SessionStoreError};
use crate::database::{Connection, Failure, Kind, Location, Migrations, Value};
use sqlx::ConnectOptions as _;
use sqlx::sqlite::SqliteConnectOptions;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::runtime::Runtime;

/// Clients that are remembered; beyond that the oldest are forgotten.
pub const CLIENTS_MAX: i64 = 100_000;

const MIGRATIONS: Migrations = Migrations {
    table: "session_store_migrations",
    steps: &[("link estimates", include_str!("migrations/0001_links.sql"))],
};

/// An open store.
#[derive(Debug)]
pub struct SessionStore {
    runtime: Runtime,
    /// `None` only once dropped.
    connection: Option<Connection>,
    /// The file and what it was when it was opened.
    file: Option<(PathBuf, FileId)>,
    name: String,
    patience: Duration,
}

/// Device and number of a file.
type FileId = (u64, u64);

#[cfg(not(unix))]
fn file_id(file: &Path) -> Option<FileId> {
    file.exists().then_some((0, 0))
}

#[cfg(unix)]
fn file_id(file: &Path) -> Option<FileId> {
    use std::os::unix::fs::MetadataExt as _;
    std::fs::metadata(file).ok().map(|facts| (facts.dev(), facts.ino()))
}

impl SessionStore {
    /// Opens a store, which is made if it is not there. This and every later call wait for at most `patience`.
    ///
    /// # Errors
    /// Whatever keeps it from being read and brought to the present schema. That it cannot be written shows when it is.
    pub fn open(location: &Location, patience: Duration) -> Result<SessionStore, SessionStoreError> {
        let name = location.to_string();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|source| SessionStoreError::Database { store: name.clone(), source: source.into() })?;
        let connecting = connect(location, patience);
        let answer = runtime.block_on(async { tokio::time::timeout(patience, connecting).await });
        let waited_s = patience.as_secs_f64();
        let connection = match answer {
            Err(_) => return Err(SessionStoreError::NoAnswer { store: name, waited_s }),
            Ok(None) => return Err(SessionStoreError::WithoutPostgres { store: name }),
            Ok(Some(connected)) => connected.map_err(|source| failure(&name, patience, source))?,
        };
        let file = match location {
            Location::File(file) => file_id(file).map(|id| (file.clone(), id)),
            Location::Postgres(_) => None,
        };
        let mut store = SessionStore { runtime, connection: Some(connection), file, name, patience };
        match store.within(async |connection| MIGRATIONS.version(connection).await)? {
            Some(SCHEMA_VERSION) => {}
            Some(found) if found > SCHEMA_VERSION => {
                return Err(SessionStoreError::Newer { store: store.name.clone(), found });
            }
            _ => store.migrate()?,
        }
        Ok(store)
    }

    fn migrate(&mut self) -> Result<(), SessionStoreError> {
        let Some(connection) = &mut self.connection else { return Err(self.no_answer()) };
        let applying = MIGRATIONS.apply(connection);
        let answer = self.runtime.block_on(async { tokio::time::timeout(self.patience, applying).await });
        let answer = answer.map_err(|_| self.no_answer())?;
        answer.map_err(|source| match source {
            sqlx::migrate::MigrateError::Execute(source) => failure(&self.name, self.patience, source),
            source => SessionStoreError::Migration { store: self.name.clone(), source },
        })
    }

    /// Where the store is, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What is believed of a client's link.
    ///
    /// # Errors
    /// What the database refuses, or that the file is gone.
    pub fn estimate(&mut self, client: &str) -> Result<Option<LinkEstimate>, SessionStoreError> {
        self.must_be_there()?;
        self.within(async |connection| estimate(connection, client).await)
    }

    /// Adds observations, all of them or none; those whose values mean nothing are left out.
    ///
    /// # Errors
    /// What the database refuses, or that the file is gone.
    pub fn observe(&mut self, observations: &[Observation]) -> Result<(), SessionStoreError> {
        self.must_be_there()?;
        let written = self.within(async |connection| {
            let written = observe(connection, observations).await;
            if written.is_err() {
                // What made it fail is told; that a broken connection cannot be rolled back is no news.
                let _ = connection.execute("ROLLBACK", &[]).await;
            }
            written
        });
        written.and_then(|()| self.must_be_there())
    }

    /// Lets a SQLite file grow to so many pages only: what a full disk does.
    ///
    /// # Errors
    /// What the database refuses.
    pub fn pages_max(&mut self, pages: u32) -> Result<(), SessionStoreError> {
        self.within(async |connection| connection.execute(&format!("PRAGMA max_page_count = {pages}"), &[]).await)
    }

    /// Lets this connection to a SQLite file only read.
    ///
    /// # Errors
    /// What the database refuses.
    pub fn read_only(&mut self) -> Result<(), SessionStoreError> {
        self.within(async |connection| connection.execute("PRAGMA query_only = true", &[]).await)
    }

    /// A file that was removed takes writes and forgets them.
    fn must_be_there(&self) -> Result<(), SessionStoreError> {
        match &self.file {
            Some((file, id)) if file_id(file) != Some(*id) => Err(SessionStoreError::Gone { file: file.clone() }),
            _ => Ok(()),
        }
    }

    fn no_answer(&self) -> SessionStoreError {
        SessionStoreError::NoAnswer { store: self.name.clone(), waited_s: self.patience.as_secs_f64() }
    }

    fn within<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut Connection) -> Result<T, sqlx::Error>,
    ) -> Result<T, SessionStoreError> {
        // SQLite waits for a lock by itself, for as long; what it says then is better than that it was slow.
        let limit = self.patience + self.patience / 2;
        let Some(connection) = &mut self.connection else { return Err(self.no_answer()) };
        let work = work(connection);
        let answer = self.runtime.block_on(async { tokio::time::timeout(limit, work).await });
        match answer {
            Err(_) => Err(self.no_answer()),
            Ok(answer) => answer.map_err(|source| failure(&self.name, self.patience, source)),
        }
    }
}

impl Drop for SessionStore {
    fn drop(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Everything acknowledged was committed before; a server that does not answer is not waited for.
            let closing = async { tokio::time::timeout(self.patience, connection.close()).await };
            let _ = self.runtime.block_on(closing);
        }
    }
}

/// `None` is a PostgreSQL URL in a build without it.
async fn connect(location: &Location, patience: Duration) -> Option<Result<Connection, sqlx::Error>> {
    match location {
        Location::File(file) => {
            let options = SqliteConnectOptions::new().filename(file).create_if_missing(true).busy_timeout(patience);
            Some(options.disable_statement_logging().connect().await.map(Connection::Sqlite))
        }
        #[cfg(feature = "postgres")]
        Location::Postgres(url) => {
            let connecting = async {
                let options: sqlx::postgres::PgConnectOptions = url.parse()?;
                let millis = patience.as_millis().to_string();
                let options = options.options([("lock_timeout", millis.as_str())]).disable_statement_logging();
                options.connect().await.map(Connection::Postgres)
            };
            Some(connecting.await)
        }
        #[cfg(not(feature = "postgres"))]
        Location::Postgres(_) => None,
    }
}

fn failure(store: &str, patience: Duration, source: sqlx::Error) -> SessionStoreError {
    let store = store.to_owned();
    match Failure::from(source) {
        Failure::Locked => SessionStoreError::Locked { store, waited_s: patience.as_secs_f64() },
        Failure::Damaged(what) => SessionStoreError::Damaged { store, what },
        Failure::ReadOnly(what) => SessionStoreError::ReadOnly { store, what },
        Failure::Full(what) => SessionStoreError::Full { store, what },
        Failure::Other(source) => SessionStoreError::Database { store, source },
    }
}

async fn estimate(connection: &mut Connection, client: &str) -> Result<Option<LinkEstimate>, sqlx::Error> {
    let sql = "SELECT rate, latency_s, weight_s, updated_ms FROM link_estimates WHERE client = $1";
    let kinds = [Kind::Real, Kind::Real, Kind::Real, Kind::Integer];
    let rows = connection.rows(sql, &[Value::Text(Some(client.to_owned()))], &kinds).await?;
    Ok(rows.first().and_then(|row| match row.as_slice() {
        [
            Value::Real(Some(rate)),
            Value::Real(Some(latency_s)),
            Value::Real(Some(weight_s)),
            Value::Integer(Some(updated_ms)),
        ] => Some(LinkEstimate { rate: *rate, latency_s: *latency_s, weight_s: *weight_s, updated_ms: *updated_ms }),
        _ => None,
    }))
}

async fn observe(connection: &mut Connection, observations: &[Observation]) -> Result<(), sqlx::Error> {
    connection.begin_writing("link_estimates").await?;
    // One statement a client, in the order of their names.
    let mut of_client: BTreeMap<&str, LinkEstimate> = BTreeMap::new();
    for observation in observations.iter().filter(|observation| observation.is_sound()) {
        let known = match of_client.get(observation.client.as_str()) {
            Some(known) => Some(*known),
            None => estimate(connection, &observation.client).await?,
        };
        of_client.insert(&observation.client, observation.onto(known));
    }
    let sql = "INSERT INTO link_estimates (client, rate, latency_s, weight_s, updated_ms) VALUES ($1, $2, $3, $4, $5) \
               ON CONFLICT (client) DO UPDATE SET rate = $2, latency_s = $3, weight_s = $4, updated_ms = $5";
    for (client, estimate) in of_client {
        let values = [
            Value::Text(Some(client.to_owned())),
            Value::Real(Some(estimate.rate)),
            Value::Real(Some(estimate.latency_s)),
            Value::Real(Some(estimate.weight_s)),
            Value::Integer(Some(estimate.updated_ms)),
        ];
        connection.execute(sql, &values).await?;
    }
    let forget = "DELETE FROM link_estimates WHERE client IN \
                  (SELECT client FROM link_estimates ORDER BY updated_ms DESC, client LIMIT 1000 OFFSET $1)";
    connection.execute(forget, &[Value::Integer(Some(CLIENTS_MAX))]).await?;
    connection.execute("COMMIT", &[]).await
}
