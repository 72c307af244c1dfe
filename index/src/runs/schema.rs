//! The schema and its version.

use crate::database::{Connection, Kind, Migrations, Value};

/// Version of the schema that this program reads and writes: that of the last migration.
pub const SCHEMA_VERSION: i64 = 1;

/// All migrations.
pub(super) const MIGRATIONS: Migrations =
    Migrations { table: "run_store_migrations", steps: &[("runs", include_str!("migrations/0001_runs.sql"))] };

/// What defines the tables and indices in a SQLite file, as hexadecimal: its text may be anything in a damaged file, and
/// the library panics over a declared type that is not UTF-8.
pub(super) async fn definitions(connection: &mut Connection) -> Result<Vec<Vec<Value>>, sqlx::Error> {
    let sql = "SELECT hex(name), hex(sql) FROM sqlite_master WHERE tbl_name IN ('runs', 'results') AND sql IS NOT NULL ORDER BY name";
    connection.rows(sql, &[], &[Kind::Text, Kind::Text]).await
}
