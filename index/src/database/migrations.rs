//! The versions of a store's schema, and how a database is brought to the newest.

use super::{Connection, Kind, Value};
use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{Connection as _, SqlSafeStr};

/// The migrations of a store, by version from 1 on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Migrations {
    /// Which migrations a database has had: a table of the store's own, so that stores can share a database.
    pub(crate) table: &'static str,
    /// Name and statements of each.
    pub(crate) steps: &'static [(&'static str, &'static str)],
}

impl Migrations {
    fn migrator(self) -> Migrator {
        let migrations = (1..).zip(self.steps).map(|(version, (description, sql))| {
            Migration::new(version, (*description).into(), MigrationType::Simple, sql.into_sql_str(), false)
        });
        let mut migrator = Migrator::with_migrations(migrations.collect());
        // Nothing was ever recorded under another name.
        migrator.dangerous_set_table_name(self.table);
        migrator
    }

    /// The version of the schema; `None` if the database holds no such store.
    pub(crate) async fn version(self, connection: &mut Connection) -> Result<Option<i64>, sqlx::Error> {
        let tables = match connection {
            Connection::Sqlite(_) => "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = $1",
            #[cfg(feature = "postgres")]
            Connection::Postgres(_) => {
                "SELECT count(*) FROM pg_tables WHERE schemaname = current_schema() AND tablename = $1"
            }
        };
        let named = [Value::Text(Some(self.table.to_owned()))];
        if connection.rows(tables, &named, &[Kind::Integer]).await? != [[Value::Integer(Some(1))]] {
            return Ok(None);
        }
        let newest = format!("SELECT max(version) FROM {}", self.table);
        match connection.rows(&newest, &[], &[Kind::Integer]).await?.first().map(Vec::as_slice) {
            Some([Value::Integer(version)]) => Ok(*version),
            _ => Ok(None),
        }
    }

    /// Applies the migrations that the database has not had: all of them, or none if one fails.
    pub(crate) async fn apply(self, connection: &mut Connection) -> Result<(), MigrateError> {
        match connection {
            // The library takes no lock on SQLite: the outer transaction does.
            Connection::Sqlite(connection) => {
                let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
                self.migrator().run(&mut *transaction).await?;
                Ok(transaction.commit().await?)
            }
            // A transaction a migration, under a lock that other programs' migrations respect.
            #[cfg(feature = "postgres")]
            Connection::Postgres(connection) => self.migrator().run(&mut *connection).await,
        }
    }
}
