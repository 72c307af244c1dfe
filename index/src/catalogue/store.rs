//! Opening a catalogue and asking it.

use super::{CatalogueError, SCHEMA_VERSION};
use crate::database::{Connection, Failure, Kind, Location, Migrations, Value};
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use sqlx::ConnectOptions as _;
use sqlx::sqlite::SqliteConnectOptions;
use std::time::Duration;
use tokio::runtime::Runtime;

const MIGRATIONS: Migrations = Migrations {
    table: "catalogue_migrations",
    steps: &[("cells and representations", include_str!("migrations/0001_catalogue.sql"))],
};

/// Most rows of an answer.
pub(super) const ROWS_MAX: u32 = 100_000;

/// An open catalogue.
#[derive(Debug)]
pub struct Catalogue {
    runtime: Runtime,
    /// `None` only once dropped.
    connection: Option<Connection>,
    name: String,
    patience: Duration,
}

/// A cell as the catalogue has it.
#[derive(Clone, Debug, PartialEq)]
pub struct CellRow {
    /// In its version, preorder.
    pub id: i64,
    /// The cell above; `None` for the root.
    pub parent: Option<i64>,
    /// Level above the leaves.
    pub level: i64,
    /// Place along x, y and z.
    pub place: [i64; 3],
    /// Around what is in it, metres.
    pub bounds: Aabb,
    /// The page of the tree that holds its node.
    pub page: String,
}

/// A representation as the catalogue has it.
#[derive(Clone, Debug, PartialEq)]
pub struct RepresentationRow {
    /// The cell that it shows.
    pub cell: i64,
    /// Direction of an orthoview.
    pub direction: Option<String>,
    /// Level of detail of a geometry; 0 is the finest.
    pub detail: Option<i64>,
    /// Its file, relative to the world's folder.
    pub file: String,
    /// Bytes on the wire.
    pub wire_bytes: i64,
    /// Bytes in a client's memory.
    pub decoded_bytes: i64,
    /// Metres.
    pub error: f64,
}

impl Catalogue {
    /// Opens a catalogue that is there, and brings an older schema to the present one.
    ///
    /// # Errors
    /// One that is not there, cannot be read, or has a newer schema.
    pub fn open(location: &Location, patience: Duration) -> Result<Catalogue, CatalogueError> {
        Catalogue::connect(location, patience, false)
    }

    /// Opens a catalogue, which is made if it is not there.
    ///
    /// # Errors
    /// As [`Catalogue::open`], and one that cannot be written.
    pub fn create(location: &Location, patience: Duration) -> Result<Catalogue, CatalogueError> {
        Catalogue::connect(location, patience, true)
    }

    fn connect(location: &Location, patience: Duration, create: bool) -> Result<Catalogue, CatalogueError> {
        let name = location.to_string();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|source| CatalogueError::Database { catalogue: name.clone(), source: source.into() })?;
        let connecting = connection(location, patience, create);
        let answer = runtime.block_on(async { tokio::time::timeout(patience, connecting).await });
        let connection = match answer {
            Err(_) => return Err(CatalogueError::NoAnswer { catalogue: name, waited_s: patience.as_secs_f64() }),
            Ok(None) => return Err(CatalogueError::WithoutPostgres { catalogue: name }),
            Ok(Some(connected)) => connected.map_err(|source| failure(&name, source))?,
        };
        let mut catalogue = Catalogue { runtime, connection: Some(connection), name, patience };
        match catalogue.within(async |connection| MIGRATIONS.version(connection).await)? {
            Some(SCHEMA_VERSION) => {}
            Some(found) if found > SCHEMA_VERSION => {
                return Err(CatalogueError::Newer { catalogue: catalogue.name.clone(), found });
            }
            None if !create => return Err(CatalogueError::None { catalogue: catalogue.name.clone() }),
            _ => catalogue.migrate()?,
        }
        Ok(catalogue)
    }

    fn migrate(&mut self) -> Result<(), CatalogueError> {
        let Some(connection) = &mut self.connection else { return Err(self.no_answer()) };
        let answer = self.runtime.block_on(MIGRATIONS.apply(connection));
        answer.map_err(|source| match source {
            sqlx::migrate::MigrateError::Execute(source) => failure(&self.name, source),
            source => CatalogueError::Migration { catalogue: self.name.clone(), source },
        })
    }

    /// Where it is, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Identities and names of the worlds that are published in it, the oldest first.
    ///
    /// # Errors
    /// What the database refuses.
    pub fn worlds(&mut self) -> Result<Vec<(String, String)>, CatalogueError> {
        let sql = "SELECT identity, name FROM catalogue_versions WHERE is_published = 1 ORDER BY id";
        let rows = self.rows(sql, &[], &[Kind::Text, Kind::Text])?;
        Ok(rows.into_iter().map(|row| (text(&row[0]), text(&row[1]))).collect())
    }

    /// The cells of a world of this identity whose content meets a box, of the levels given, the largest first; at most
    /// 100,000.
    ///
    /// # Errors
    /// An identity that is not there; what the database refuses.
    pub fn cells(
        &mut self,
        identity: &str,
        bounds: &Aabb,
        levels: std::ops::RangeInclusive<u32>,
    ) -> Result<Vec<CellRow>, CatalogueError> {
        let mut values = vec![Value::Integer(Some(self.version(identity)?))];
        values.extend([levels.start(), levels.end()].map(|&level| Value::Integer(Some(i64::from(level)))));
        values.extend(bounds.max.to_array().into_iter().chain(bounds.min.to_array()).map(|v| Value::Real(Some(v))));
        let sql = format!(
            "SELECT id, parent, level, x, y, z, min_x, min_y, min_z, max_x, max_y, max_z, page FROM catalogue_cells \
             WHERE version = $1 AND level BETWEEN $2 AND $3 AND min_x <= $4 AND min_y <= $5 AND min_z <= $6 \
             AND max_x >= $7 AND max_y >= $8 AND max_z >= $9 ORDER BY level DESC, id LIMIT {ROWS_MAX}"
        );
        let kinds = [[Kind::Integer; 6], [Kind::Real; 6]].concat();
        let rows = self.rows(&sql, &values, &[&kinds[..], &[Kind::Text]].concat())?;
        Ok(rows.iter().map(|row| cell(row)).collect())
    }

    /// The representations of cells of a world, in order of the cells given; at most 100,000.
    ///
    /// # Errors
    /// An identity that is not there; what the database refuses.
    pub fn representations(&mut self, identity: &str, cells: &[i64]) -> Result<Vec<RepresentationRow>, CatalogueError> {
        let version = self.version(identity)?;
        let sql = "SELECT cell, direction, detail, file, wire_bytes, decoded_bytes, error FROM catalogue_representations \
                   WHERE version = $1 AND cell = $2 ORDER BY id";
        let kinds = [Kind::Integer, Kind::Text, Kind::Integer, Kind::Text, Kind::Integer, Kind::Integer, Kind::Real];
        let mut found = Vec::new();
        for &cell in cells {
            let values = [Value::Integer(Some(version)), Value::Integer(Some(cell))];
            found.extend(self.rows(sql, &values, &kinds)?.iter().map(|row| representation(row)));
            if found.len() >= ROWS_MAX as usize {
                found.truncate(ROWS_MAX as usize);
                break;
            }
        }
        Ok(found)
    }

    fn version(&mut self, identity: &str) -> Result<i64, CatalogueError> {
        let sql = "SELECT id FROM catalogue_versions WHERE identity = $1 AND is_published = 1 ORDER BY id DESC";
        let rows = self.rows(sql, &[Value::Text(Some(identity.to_owned()))], &[Kind::Integer])?;
        match rows.first().map(Vec::as_slice) {
            Some([Value::Integer(Some(id))]) => Ok(*id),
            _ => Err(CatalogueError::Absent { catalogue: self.name.clone(), identity: identity.to_owned() }),
        }
    }

    fn rows(&mut self, sql: &str, values: &[Value], kinds: &[Kind]) -> Result<Vec<Vec<Value>>, CatalogueError> {
        self.within(async |connection| connection.rows(sql, values, kinds).await)
    }

    pub(super) fn within<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut Connection) -> Result<T, sqlx::Error>,
    ) -> Result<T, CatalogueError> {
        let Some(connection) = &mut self.connection else { return Err(self.no_answer()) };
        self.runtime.block_on(work(connection)).map_err(|source| failure(&self.name, source))
    }

    fn no_answer(&self) -> CatalogueError {
        CatalogueError::NoAnswer { catalogue: self.name.clone(), waited_s: self.patience.as_secs_f64() }
    }
}

impl Drop for Catalogue {
    fn drop(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Everything acknowledged was committed before; a server that does not answer is not waited for.
            let closing = async { tokio::time::timeout(self.patience, connection.close()).await };
            let _ = self.runtime.block_on(closing);
        }
    }
}

/// `None` is a PostgreSQL URL in a build without it.
async fn connection(location: &Location, patience: Duration, create: bool) -> Option<Result<Connection, sqlx::Error>> {
    match location {
        Location::File(file) => {
            let options = SqliteConnectOptions::new().filename(file).create_if_missing(create).busy_timeout(patience);
            // One writer, and nothing is lost that could not be written again: the file counts once it is renamed.
            let options = if create { options } else { options.read_only(true) };
            Some(options.disable_statement_logging().connect().await.map(Connection::Sqlite))
        }
        #[cfg(feature = "postgres")]
        Location::Postgres(url) => {
            let connecting = async {
                let options: sqlx::postgres::PgConnectOptions = url.parse()?;
                options.disable_statement_logging().connect().await.map(Connection::Postgres)
            };
            Some(connecting.await)
        }
        #[cfg(not(feature = "postgres"))]
        Location::Postgres(_) => None,
    }
}

fn failure(catalogue: &str, source: sqlx::Error) -> CatalogueError {
    let catalogue = catalogue.to_owned();
    match Failure::from(source) {
        Failure::Locked => CatalogueError::Locked { catalogue },
        Failure::Damaged(what) => CatalogueError::Damaged { catalogue, what },
        Failure::ReadOnly(what) => CatalogueError::ReadOnly { catalogue, what },
        Failure::Full(what) => CatalogueError::Full { catalogue, what },
        Failure::Other(source) => CatalogueError::Database { catalogue, source },
    }
}

fn text(value: &Value) -> String {
    if let Value::Text(Some(text)) = value { text.clone() } else { String::new() }
}

fn integer(value: &Value) -> i64 {
    if let Value::Integer(Some(integer)) = value { *integer } else { 0 }
}

fn real(value: &Value) -> f64 {
    if let Value::Real(Some(real)) = value { *real } else { 0.0 }
}

fn cell(row: &[Value]) -> CellRow {
    let corner = |at: usize| DVec3::new(real(&row[at]), real(&row[at + 1]), real(&row[at + 2]));
    CellRow {
        id: integer(&row[0]),
        parent: if let Value::Integer(parent) = row[1] { parent } else { None },
        level: integer(&row[2]),
        place: [3, 4, 5].map(|at| integer(&row[at])),
        bounds: Aabb { min: corner(6), max: corner(9) },
        page: text(&row[12]),
    }
}

fn representation(row: &[Value]) -> RepresentationRow {
    RepresentationRow {
        cell: integer(&row[0]),
        direction: if let Value::Text(direction) = &row[1] { direction.clone() } else { None },
        detail: if let Value::Integer(detail) = row[2] { detail } else { None },
        file: text(&row[3]),
        wire_bytes: integer(&row[4]),
        decoded_bytes: integer(&row[5]),
        error: real(&row[6]),
    }
}
