//! The schema, its version, and how a database is brought to it.

use super::connection::Connection;
use super::row::{Kind, Value};
use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{Connection as _, SqlSafeStr};

/// Version of the schema that this program reads and writes: that of the last migration.
pub const SCHEMA_VERSION: i64 = 1;

/// Which migrations a database has had; a name of its own, so that a store can share a PostgreSQL database.
const MIGRATIONS_TABLE: &str = "run_store_migrations";

/// All migrations, by version.
fn migrator() -> Migrator {
    let migration = |version, description: &'static str, sql: &'static str| {
        Migration::new(version, description.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    let mut migrator = Migrator::with_migrations(vec![migration(1, "runs", include_str!("migrations/0001_runs.sql"))]);
    // Nothing was ever recorded under another name.
    migrator.dangerous_set_table_name(MIGRATIONS_TABLE);
    migrator
}

/// The version of the schema; `None` if the database holds no run store.
pub(super) async fn version(connection: &mut Connection) -> Result<Option<i64>, sqlx::Error> {
    let tables = match connection {
        Connection::Sqlite(_) => "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = $1",
        #[cfg(feature = "runs-postgres")]
        Connection::Postgres(_) => {
            "SELECT count(*) FROM pg_tables WHERE schemaname = current_schema() AND tablename = $1"
        }
    };
    let named = [Value::Text(Some(MIGRATIONS_TABLE.to_owned()))];
    if connection.rows(tables, &named, &[Kind::Integer]).await? != [[Value::Integer(Some(1))]] {
        return Ok(None);
    }
    let newest = format!("SELECT max(version) FROM {MIGRATIONS_TABLE}");
    match connection.rows(&newest, &[], &[Kind::Integer]).await?.first().map(Vec::as_slice) {
        Some([Value::Integer(version)]) => Ok(*version),
        _ => Ok(None),
    }
}

/// Applies the migrations that the database has not had: all of them, or none if one fails.
pub(super) async fn migrate(connection: &mut Connection) -> Result<(), MigrateError> {
    match connection {
        // The library takes no lock on SQLite: the outer transaction does.
        Connection::Sqlite(connection) => {
            let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
            migrator().run(&mut *transaction).await?;
            Ok(transaction.commit().await?)
        }
        // A transaction a migration, under a lock that other programs' migrations respect.
        #[cfg(feature = "runs-postgres")]
        Connection::Postgres(connection) => migrator().run(&mut *connection).await,
    }
}

/// What defines the tables and indices in a SQLite file, as hexadecimal: its text may be anything in a damaged file, and
/// the library panics over a declared type that is not UTF-8.
pub(super) async fn definitions(connection: &mut Connection) -> Result<Vec<Vec<Value>>, sqlx::Error> {
    let sql = "SELECT hex(name), hex(sql) FROM sqlite_master WHERE tbl_name IN ('runs', 'results') AND sql IS NOT NULL ORDER BY name";
    connection.rows(sql, &[], &[Kind::Text, Kind::Text]).await
}
