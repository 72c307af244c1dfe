//! One connection to either database, under one interface of plain values.

use super::row::{Kind, Value};
use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, Connection as _, Row as _};

#[cfg(feature = "runs-postgres")]
use sqlx::postgres::PgConnection;

/// A connection to a SQLite file or a PostgreSQL server. Statements have `$1`, `$2`, … for values, which both know.
#[derive(Debug)]
pub(super) enum Connection {
    Sqlite(SqliteConnection),
    #[cfg(feature = "runs-postgres")]
    Postgres(PgConnection),
}

/// A statement with its values bound; for each database the same.
macro_rules! bound {
    ($sql:expr, $values:expr) => {{
        let mut query = sqlx::query(AssertSqlSafe($sql));
        for value in $values {
            query = match value {
                Value::Integer(value) => query.bind(*value),
                Value::Real(value) => query.bind(*value),
                Value::Text(value) => query.bind(value.as_deref()),
            };
        }
        query
    }};
}

/// A row's values by the kinds of its columns; for each database the same.
macro_rules! values {
    ($row:expr, $kinds:expr) => {{
        let row = $row;
        let kinds = $kinds.iter().enumerate();
        kinds
            .map(|(column, kind)| {
                Ok(match kind {
                    Kind::Integer => Value::Integer(row.try_get(column)?),
                    Kind::Real => Value::Real(row.try_get(column)?),
                    Kind::Text => Value::Text(row.try_get(column)?),
                })
            })
            .collect::<Result<Vec<Value>, sqlx::Error>>()
    }};
}

impl Connection {
    /// Runs a statement.
    pub(super) async fn execute(&mut self, sql: &str, values: &[Value]) -> Result<(), sqlx::Error> {
        match self {
            Connection::Sqlite(connection) => bound!(sql, values).execute(connection).await.map(drop),
            #[cfg(feature = "runs-postgres")]
            Connection::Postgres(connection) => bound!(sql, values).execute(connection).await.map(drop),
        }
    }

    /// Runs a query and gives its rows, whose columns are of these kinds.
    pub(super) async fn rows(
        &mut self,
        sql: &str,
        values: &[Value],
        kinds: &[Kind],
    ) -> Result<Vec<Vec<Value>>, sqlx::Error> {
        match self {
            Connection::Sqlite(connection) => {
                bound!(sql, values).fetch_all(connection).await?.iter().map(|row| values!(row, kinds)).collect()
            }
            #[cfg(feature = "runs-postgres")]
            Connection::Postgres(connection) => {
                bound!(sql, values).fetch_all(connection).await?.iter().map(|row| values!(row, kinds)).collect()
            }
        }
    }

    /// Begins a transaction that no other writer can come between.
    pub(super) async fn begin_writing(&mut self) -> Result<(), sqlx::Error> {
        match self {
            Connection::Sqlite(_) => self.execute("BEGIN IMMEDIATE", &[]).await,
            #[cfg(feature = "runs-postgres")]
            Connection::Postgres(_) => {
                self.execute("BEGIN", &[]).await?;
                self.execute("LOCK TABLE runs IN SHARE ROW EXCLUSIVE MODE", &[]).await
            }
        }
    }

    /// Ends the connection; what was not committed is undone.
    pub(super) async fn close(self) -> Result<(), sqlx::Error> {
        match self {
            Connection::Sqlite(connection) => connection.close().await,
            #[cfg(feature = "runs-postgres")]
            Connection::Postgres(connection) => connection.close().await,
        }
    }
}
