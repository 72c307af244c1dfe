//! Opening a store, adding runs and reading them.

use super::row::{self, RUN_COLUMNS};
use super::run::{Run, StoredRun};
use super::{Location, RunStoreError, SCHEMA_VERSION, schema};
use crate::database::{Connection, Failure, Kind, Value};
use sqlx::ConnectOptions as _;
use sqlx::sqlite::{SqliteConnectOptions, SqliteSynchronous};
use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::Path;
use std::time::Duration;
use tokio::runtime::Runtime;

/// How long another process's lock is waited for, unless said otherwise.
const PATIENCE: Duration = Duration::from_secs(10);

/// What every SQLite file begins with.
const SQLITE_MAGIC: &[u8; 16] = b"SQLite format 3\0";

/// What a store is opened for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// It must exist; nothing in it is changed.
    Read,
    /// It is made if it is not there, and brought to the present schema.
    Write,
}

/// Which runs to list; all that meet every condition given.
#[derive(Clone, Debug, Default)]
pub struct Filter {
    /// Of this case of a suite.
    pub suite_case: Option<String>,
    /// Begun at this time or later, milliseconds since 1970-01-01 UTC.
    pub since_ms: Option<i64>,
    /// By this version of the program.
    pub program_version: Option<String>,
    /// The run of this number.
    pub id: Option<i64>,
}

/// An open store.
#[derive(Debug)]
pub struct RunStore {
    runtime: Runtime,
    // `None` only once dropped.
    connection: Option<Connection>,
    name: String,
    patience: Duration,
}

impl RunStore {
    /// Opens a store, waiting for at most 10 s where another process has it locked.
    ///
    /// A file is checked as a whole before anything is read from it or written to it.
    pub fn open(location: &Location, access: Access) -> Result<RunStore, RunStoreError> {
        RunStore::open_within(location, access, PATIENCE)
    }

    /// [`RunStore::open`] with another patience.
    pub fn open_within(location: &Location, access: Access, patience: Duration) -> Result<RunStore, RunStoreError> {
        let name = location.to_string();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|source| RunStoreError::Database { store: name.clone(), source: source.into() })?;
        let mut store = RunStore { runtime, connection: None, name, patience };
        store.connection = Some(match location {
            Location::File(file) => store.open_file(file, access)?,
            #[cfg(feature = "postgres")]
            Location::Postgres(url) => store.open_postgres(url, access)?,
            #[cfg(not(feature = "postgres"))]
            Location::Postgres(_) => return Err(RunStoreError::WithoutPostgres { store: store.name.clone() }),
        });
        Ok(store)
    }

    fn open_file(&self, file: &Path, access: Access) -> Result<Connection, RunStoreError> {
        let io = |source| RunStoreError::Io { file: file.to_owned(), source };
        if !file.try_exists().map_err(io)? {
            if access == Access::Read {
                return Err(RunStoreError::Absent { store: self.name.clone() });
            }
            self.create_file(file)?;
        }
        must_be_sqlite(file)?;
        // A journal is that of a writer at work, or of one that was killed: then its half of a transaction is undone
        // first, which a connection for reading only cannot do.
        let journal = file.with_file_name(with_suffix(file, "-journal"));
        let read_only = access == Access::Read && !journal.exists();
        let options = self.file_options(file).read_only(read_only);
        let mut connection = self.connect_file(&options)?;
        let answer = self.block(connection.rows("PRAGMA integrity_check(1)", &[], &[Kind::Text]))?;
        if answer != [[Value::Text(Some("ok".to_owned()))]] {
            let first = answer.into_iter().flatten().next();
            let what = if let Some(Value::Text(Some(what))) = first { what } else { "its check fails".to_owned() };
            return Err(self.damaged(what.replace('\n', " ")));
        }
        self.check_version(&mut connection, access)?;
        let mut intact = self.connect_file(&self.file_options(Path::new(":memory:")))?;
        self.runtime.block_on(schema::MIGRATIONS.apply(&mut intact)).map_err(|source| self.migration(source))?;
        if self.block(schema::definitions(&mut connection))? != self.block(schema::definitions(&mut intact))? {
            return Err(self.damaged(format!("its tables are not those of schema version {SCHEMA_VERSION}")));
        }
        Ok(connection)
    }

    fn file_options(&self, file: &Path) -> SqliteConnectOptions {
        // EXTRA: once a run is acknowledged, a loss of power does not bring its journal back.
        let options = SqliteConnectOptions::new().filename(file).busy_timeout(self.patience);
        options.synchronous(SqliteSynchronous::Extra).disable_statement_logging()
    }

    fn connect_file(&self, options: &SqliteConnectOptions) -> Result<Connection, RunStoreError> {
        self.block(options.connect()).map(Connection::Sqlite)
    }

    /// Makes an empty store beside its place and moves it there, so that nobody ever sees half of one. If another
    /// process was faster, its store stays.
    fn create_file(&self, file: &Path) -> Result<(), RunStoreError> {
        let folder = file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(RunStoreError::Folder { file: file.to_owned(), folder: folder.to_owned() });
        }
        let io = |source: std::io::Error| match source.kind() {
            std::io::ErrorKind::PermissionDenied | std::io::ErrorKind::ReadOnlyFilesystem => {
                RunStoreError::ReadOnly { store: self.name.clone(), what: source.to_string() }
            }
            _ => RunStoreError::Io { file: file.to_owned(), source },
        };
        let mut builder = tempfile::Builder::new();
        // As other files are made, not for the owner alone: the process's mask takes its bits away.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        let beside = builder.prefix(".runs-").suffix(".partial").tempfile_in(folder).map_err(io)?;
        let mut connection = self.connect_file(&self.file_options(beside.path()))?;
        let migrated = self.runtime.block_on(schema::MIGRATIONS.apply(&mut connection));
        self.block(connection.close())?;
        migrated.map_err(|source| self.migration(source))?;
        match beside.persist_noclobber(file) {
            Err(error) if error.error.kind() != std::io::ErrorKind::AlreadyExists => Err(io(error.error)),
            _ => Ok(()),
        }
    }

    #[cfg(feature = "postgres")]
    fn open_postgres(&self, url: &str, access: Access) -> Result<Connection, RunStoreError> {
        let options: sqlx::postgres::PgConnectOptions = url.parse().map_err(|source| self.failure(source))?;
        let millis = self.patience.as_millis().to_string();
        let options = options.options([("lock_timeout", millis.as_str())]).disable_statement_logging();
        let connecting = async { tokio::time::timeout(self.patience, options.connect()).await };
        let answer = self.runtime.block_on(connecting);
        let waited_s = self.patience.as_secs_f64();
        let connected = answer.map_err(|_| RunStoreError::NoAnswer { store: self.name.clone(), waited_s })?;
        let mut connection = Connection::Postgres(connected.map_err(|source| self.failure(source))?);
        if self.block(schema::MIGRATIONS.version(&mut connection))?.is_none() {
            if access == Access::Read {
                return Err(RunStoreError::Absent { store: self.name.clone() });
            }
            self.runtime
                .block_on(schema::MIGRATIONS.apply(&mut connection))
                .map_err(|source| self.migration(source))?;
        }
        self.check_version(&mut connection, access)?;
        Ok(connection)
    }

    /// Refuses a schema that is not ours; brings an older one to the present for writing.
    fn check_version(&self, connection: &mut Connection, access: Access) -> Result<(), RunStoreError> {
        let store = || self.name.clone();
        match self.block(schema::MIGRATIONS.version(connection))? {
            None => Err(RunStoreError::NotARunStore { store: store() }),
            Some(found) if found > SCHEMA_VERSION => {
                Err(RunStoreError::Newer { store: store(), found, known: SCHEMA_VERSION })
            }
            Some(found) if found < SCHEMA_VERSION && access == Access::Read => {
                Err(RunStoreError::Older { store: store(), found, known: SCHEMA_VERSION })
            }
            Some(found) if found < SCHEMA_VERSION => {
                self.runtime.block_on(schema::MIGRATIONS.apply(connection)).map_err(|source| self.migration(source))
            }
            Some(_) => Ok(()),
        }
    }

    /// Where the store is, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Adds a run with its document, and gives its number. It is there with all of its results, or not at all.
    pub fn add(&mut self, run: &Run, document: &str) -> Result<i64, RunStoreError> {
        let mut values = row::run_values(run, document)?;
        let results = run.results.iter().map(row::result_values).collect::<Result<Vec<_>, _>>()?;
        let checksum = row::checksum(&values, &results);
        values.extend([Value::Text(Some(checksum)), Value::Text(Some(document.to_owned()))]);
        let mut connection = self.connection.take().ok_or_else(|| self.closed())?;
        let added = self.runtime.block_on(insert(&mut connection, values, results));
        if added.is_err() {
            // What made the statement fail is told; that a broken connection cannot be rolled back is no news.
            let _ = self.runtime.block_on(connection.execute("ROLLBACK", &[]));
        }
        self.connection = Some(connection);
        added.map_err(|source| self.failure(source))
    }

    /// Runs in the order of their numbers, each checked against its checksum.
    pub fn list(&mut self, filter: &Filter) -> Result<Vec<StoredRun>, RunStoreError> {
        let conditions = "($1 IS NULL OR suite_case = $1) AND ($2 IS NULL OR started_at_ms >= $2) \
                          AND ($3 IS NULL OR program_version = $3) AND ($4 IS NULL OR id = $4)";
        let bound = [
            Value::Text(filter.suite_case.clone()),
            Value::Integer(filter.since_ms),
            Value::Text(filter.program_version.clone()),
            Value::Integer(filter.id),
        ];
        let (names, mut kinds): (Vec<_>, Vec<_>) = RUN_COLUMNS.into_iter().unzip();
        kinds.extend([Kind::Text, Kind::Integer]);
        let runs = format!("SELECT {}, checksum, id FROM runs WHERE {conditions} ORDER BY id", names.join(", "));
        let (names, mut result_kinds): (Vec<_>, Vec<_>) = row::result_columns().into_iter().unzip();
        result_kinds.push(Kind::Integer);
        // Runs are only added: whatever is added after the first query is not asked for.
        let results = format!(
            "SELECT {}, run_id FROM results WHERE run_id IN (SELECT id FROM runs WHERE {conditions}) ORDER BY run_id, place",
            names.join(", ")
        );
        let rows = self.query(&runs, &bound, &kinds)?;
        let result_rows = self.query(&results, &bound, &result_kinds)?;
        let mut of_run: BTreeMap<i64, Vec<Vec<Value>>> = BTreeMap::new();
        for mut row in result_rows {
            if let Some(Value::Integer(Some(id))) = row.pop() {
                of_run.entry(id).or_default().push(row);
            }
        }
        rows.into_iter().map(|row| self.checked(row, &mut of_run)).collect()
    }

    /// The run of a row of [`RunStore::list`], with its results.
    fn checked(
        &self,
        mut row: Vec<Value>,
        results: &mut BTreeMap<i64, Vec<Vec<Value>>>,
    ) -> Result<StoredRun, RunStoreError> {
        let (Some(Value::Integer(Some(id))), Some(Value::Text(Some(checksum)))) = (row.pop(), row.pop()) else {
            return Err(self.damaged("a run without a number or checksum".to_owned()));
        };
        let results = results.remove(&id).unwrap_or_default();
        let changed = || self.damaged(format!("run {id} is not what was recorded"));
        if row::checksum(&row, &results) != checksum {
            return Err(changed());
        }
        let (mut run, _) = row::run_from(row).ok_or_else(changed)?;
        run.results = results.into_iter().map(row::result_from).collect::<Option<_>>().ok_or_else(changed)?;
        Ok(StoredRun { id, run })
    }

    /// The run of a number.
    pub fn run(&mut self, id: i64) -> Result<StoredRun, RunStoreError> {
        let found = self.list(&Filter { id: Some(id), ..Filter::default() })?;
        found.into_iter().next().ok_or_else(|| RunStoreError::NoSuchRun { store: self.name.clone(), id })
    }

    /// The document of a run: the bytes that were recorded.
    pub fn document(&mut self, id: i64) -> Result<String, RunStoreError> {
        let sql = "SELECT document, document_hash FROM runs WHERE id = $1";
        let rows = self.query(sql, &[Value::Integer(Some(id))], &[Kind::Text, Kind::Text])?;
        match rows.into_iter().next().map(<[Value; 2]>::try_from) {
            None => Err(RunStoreError::NoSuchRun { store: self.name.clone(), id }),
            Some(Ok([Value::Text(Some(document)), Value::Text(Some(hash))]))
                if row::document_hash(&document) == hash =>
            {
                Ok(document)
            }
            Some(_) => Err(self.damaged(format!("the document of run {id} is not what was recorded"))),
        }
    }

    fn query(&mut self, sql: &str, values: &[Value], kinds: &[Kind]) -> Result<Vec<Vec<Value>>, RunStoreError> {
        let mut connection = self.connection.take().ok_or_else(|| self.closed())?;
        let rows = self.runtime.block_on(connection.rows(sql, values, kinds));
        self.connection = Some(connection);
        rows.map_err(|source| self.failure(source))
    }

    fn block<T>(&self, work: impl Future<Output = Result<T, sqlx::Error>>) -> Result<T, RunStoreError> {
        self.runtime.block_on(work).map_err(|source| self.failure(source))
    }

    fn closed(&self) -> RunStoreError {
        RunStoreError::Database { store: self.name.clone(), source: sqlx::Error::WorkerCrashed }
    }

    fn damaged(&self, what: String) -> RunStoreError {
        RunStoreError::Damaged { store: self.name.clone(), what }
    }

    fn migration(&self, source: sqlx::migrate::MigrateError) -> RunStoreError {
        match source {
            sqlx::migrate::MigrateError::Execute(source) => self.failure(source),
            source => RunStoreError::Migration { store: self.name.clone(), source },
        }
    }

    /// What the database says, in our words where we know them.
    fn failure(&self, source: sqlx::Error) -> RunStoreError {
        let store = self.name.clone();
        match Failure::from(source) {
            Failure::Locked => RunStoreError::Locked { store, waited_s: self.patience.as_secs_f64() },
            Failure::Damaged(what) => RunStoreError::Damaged { store, what },
            Failure::ReadOnly(what) | Failure::Full(what) => RunStoreError::ReadOnly { store, what },
            Failure::Other(source) => RunStoreError::Database { store, source },
        }
    }
}

impl Drop for RunStore {
    fn drop(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Everything acknowledged was committed before.
            let _ = self.runtime.block_on(connection.close());
        }
    }
}

/// Writes a run and its results in one transaction. Numbers count from 1.
async fn insert(
    connection: &mut Connection,
    mut run: Vec<Value>,
    results: Vec<Vec<Value>>,
) -> Result<i64, sqlx::Error> {
    connection.begin_writing("runs").await?;
    let newest = connection.rows("SELECT coalesce(max(id), 0) FROM runs", &[], &[Kind::Integer]).await?;
    let id = match newest.first().map(Vec::as_slice) {
        Some([Value::Integer(Some(newest))]) => newest + 1,
        _ => return Err(sqlx::Error::RowNotFound),
    };
    run.push(Value::Integer(Some(id)));
    let columns = RUN_COLUMNS.iter().map(|(name, _)| *name).chain(["checksum", "document", "id"]);
    connection.execute(&insertion("runs", columns), &run).await?;
    let columns = row::result_columns();
    let columns = columns.iter().map(|(name, _)| name.as_str()).chain(["run_id", "place"]);
    let insertion = insertion("results", columns);
    for (place, mut result) in (0..).zip(results) {
        result.extend([Value::Integer(Some(id)), Value::Integer(Some(place))]);
        connection.execute(&insertion, &result).await?;
    }
    connection.execute("COMMIT", &[]).await?;
    Ok(id)
}

fn insertion<'a>(table: &str, columns: impl Iterator<Item = &'a str>) -> String {
    let columns: Vec<&str> = columns.collect();
    let values: Vec<String> = (1..=columns.len()).map(|i| format!("${i}")).collect();
    format!("INSERT INTO {table} ({}) VALUES ({})", columns.join(", "), values.join(", "))
}

fn with_suffix(file: &Path, suffix: &str) -> std::ffi::OsString {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(suffix);
    name
}

/// Looks at the first bytes before the database library does, which takes an empty file for an empty database.
fn must_be_sqlite(file: &Path) -> Result<(), RunStoreError> {
    let refuse = |found: &str| Err(RunStoreError::NotSqlite { file: file.to_owned(), found: found.to_owned() });
    if file.is_dir() {
        return refuse("a folder");
    }
    let mut start = Vec::new();
    let read = std::fs::File::open(file).and_then(|f| f.take(SQLITE_MAGIC.len() as u64).read_to_end(&mut start));
    read.map_err(|source| RunStoreError::Io { file: file.to_owned(), source })?;
    match start.as_slice() {
        [] => refuse("empty"),
        start if start == SQLITE_MAGIC => Ok(()),
        _ => refuse("not a SQLite database"),
    }
}
