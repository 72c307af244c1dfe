//! One connection to either database, under one interface of plain values.

use sqlx::sqlite::SqliteConnection;
use sqlx::{AssertSqlSafe, Connection as _, Row as _};

#[cfg(feature = "postgres")]
use sqlx::postgres::PgConnection;

/// Type of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Integer,
    Real,
    #[cfg(any(feature = "runs", feature = "catalogue"))]
    Text,
}

/// A value of a column, or its absence.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    Integer(Option<i64>),
    Real(Option<f64>),
    Text(Option<String>),
}

/// A connection to a SQLite file or a PostgreSQL server. Statements have `$1`, `$2`, … for values, which both know.
#[derive(Debug)]
pub(crate) enum Connection {
    Sqlite(SqliteConnection),
    #[cfg(feature = "postgres")]
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
                    #[cfg(any(feature = "runs", feature = "catalogue"))]
                    Kind::Text => Value::Text(row.try_get(column)?),
                })
            })
            .collect::<Result<Vec<Value>, sqlx::Error>>()
    }};
}

impl Connection {
    /// Runs a statement.
    pub(crate) async fn execute(&mut self, sql: &str, values: &[Value]) -> Result<(), sqlx::Error> {
        match self {
            Connection::Sqlite(connection) => bound!(sql, values).execute(connection).await.map(drop),
            #[cfg(feature = "postgres")]
            Connection::Postgres(connection) => bound!(sql, values).execute(connection).await.map(drop),
        }
    }

    /// Runs a query and gives its rows, whose columns are of these kinds.
    pub(crate) async fn rows(
        &mut self,
        sql: &str,
        values: &[Value],
        kinds: &[Kind],
    ) -> Result<Vec<Vec<Value>>, sqlx::Error> {
        match self {
            Connection::Sqlite(connection) => {
                bound!(sql, values).fetch_all(connection).await?.iter().map(|row| values!(row, kinds)).collect()
            }
            #[cfg(feature = "postgres")]
            Connection::Postgres(connection) => {
                bound!(sql, values).fetch_all(connection).await?.iter().map(|row| values!(row, kinds)).collect()
            }
        }
    }

    /// Begins a transaction that no other writer can come between.
    /// On PostgreSQL others can read this table meanwhile.
    pub(crate) async fn begin_writing(&mut self, table: &'static str) -> Result<(), sqlx::Error> {
        match self {
            Connection::Sqlite(_) => {
                // A file has one writer at a time, whatever the table.
                let _ = table;
                self.execute("BEGIN IMMEDIATE", &[]).await
            }
            #[cfg(feature = "postgres")]
            Connection::Postgres(_) => {
                self.execute("BEGIN", &[]).await?;
                self.execute(&format!("LOCK TABLE {table} IN SHARE ROW EXCLUSIVE MODE"), &[]).await
            }
        }
    }

    /// Ends the connection; what was not committed is undone.
    pub(crate) async fn close(self) -> Result<(), sqlx::Error> {
        match self {
            Connection::Sqlite(connection) => connection.close().await,
            #[cfg(feature = "postgres")]
            Connection::Postgres(connection) => connection.close().await,
        }
    }
}
