//! A stored world into a catalogue, in one transaction.

use super::store::Catalogue;
use super::{CatalogueError, Location};
use crate::database::{Connection, Kind, Value};
use crate::octree::Cell;
use crate::stored::document::Document;
use crate::stored::page::{self, Node};
use crate::stored::{Pages, StoredError, address};
use std::time::Duration;

/// Rows of a statement: many columns at a time cost less than many statements.
const ROWS: usize = 200;

/// Versions of a world that stay: the newest and the one before.
const KEPT: i64 = 2;

/// Rows on their way.
struct Rows {
    table: &'static str,
    columns: &'static str,
    width: usize,
    values: Vec<Value>,
}

impl Rows {
    async fn push(
        &mut self,
        connection: &mut Connection,
        row: impl IntoIterator<Item = Value>,
    ) -> Result<(), sqlx::Error> {
        self.values.extend(row);
        if self.values.len() >= ROWS * self.width { self.flush(connection).await } else { Ok(()) }
    }

    async fn flush(&mut self, connection: &mut Connection) -> Result<(), sqlx::Error> {
        if self.values.is_empty() {
            return Ok(());
        }
        let count = self.values.len() / self.width;
        let row = |r: usize| {
            let columns: Vec<String> = (1..=self.width).map(|c| format!("${}", r * self.width + c)).collect();
            format!("({})", columns.join(", "))
        };
        let rows: Vec<String> = (0..count).map(row).collect();
        let sql = format!("INSERT INTO {} ({}) VALUES {}", self.table, self.columns, rows.join(", "));
        connection.execute(&sql, &self.values).await?;
        self.values.clear();
        Ok(())
    }
}

fn integer(value: impl TryInto<i64>) -> Value {
    Value::Integer(value.try_into().ok())
}

fn text(value: &str) -> Value {
    Value::Text(Some(value.to_owned()))
}

/// A row of what the catalogue holds, in the order of the tree.
enum Row {
    Cell([Value; 14]),
    Representation([Value; 9]),
}

impl Catalogue {
    /// Puts a world into the catalogue at `location`, which is made if it is not there: all of it or nothing. The newest
    /// version of the same name before it stays, older ones go.
    ///
    /// # Errors
    /// A world that cannot be read; what the database refuses.
    pub fn publish(
        location: &Location,
        document: &Document,
        pages: &Pages,
        patience: Duration,
    ) -> Result<(), CatalogueError> {
        let mut catalogue = Catalogue::create(location, patience)?;
        let mut fault = None;
        let written = catalogue.within(async |connection| {
            let written = write(connection, document, pages, &mut fault).await;
            if written.is_err() || fault.is_some() {
                // What made it fail is told; that a broken connection cannot be rolled back is no news.
                let _ = connection.execute("ROLLBACK", &[]).await;
            }
            written
        });
        match fault {
            Some(fault) => Err(fault.into()),
            None => written,
        }
    }
}

/// Writes a world; where its own files are at fault, says so in `fault` and leaves the transaction open.
async fn write(
    connection: &mut Connection,
    document: &Document,
    pages: &Pages,
    fault: &mut Option<StoredError>,
) -> Result<(), sqlx::Error> {
    connection.begin_writing("catalogue_versions").await?;
    let next = "SELECT COALESCE(MAX(id), 0) + 1 FROM catalogue_versions";
    let rows = connection.rows(next, &[], &[Kind::Integer]).await?;
    let Some([Value::Integer(Some(version))]) = rows.first().map(Vec::as_slice) else {
        return Err(sqlx::Error::RowNotFound);
    };
    let version = *version;
    let same = [text(&document.name), text(&document.identity)];
    remove(connection, "name = $1 AND identity = $2", &same).await?;
    let octree = pages.octree();
    let mut values = vec![integer(version), text(&document.identity), text(&document.name)];
    values.extend(octree.origin().to_array().into_iter().chain([octree.leaf_side()]).map(|v| Value::Real(Some(v))));
    values.extend(octree.splits().map(integer));
    let sql = "INSERT INTO catalogue_versions (id, identity, name, origin_x, origin_y, origin_z, leaf_side, splits_x, \
               splits_y, splits_z, is_published) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, 0)";
    connection.execute(sql, &values).await?;
    let mut objects =
        Rows { table: "catalogue_objects", columns: "version, id, name, identity", width: 4, values: Vec::new() };
    for (id, input) in document.inputs.iter().enumerate() {
        objects.push(connection, [integer(version), integer(id), text(&input.name), text(&input.identity)]).await?;
    }
    objects.flush(connection).await?;
    if let Err(error) = write_tree(connection, version, document, pages).await {
        match error {
            TreeError::Stored(error) => *fault = Some(error),
            TreeError::Database(error) => return Err(error),
        }
        return Ok(());
    }
    connection.execute("UPDATE catalogue_versions SET is_published = 1 WHERE id = $1", &[integer(version)]).await?;
    let older = "name = $1 AND id NOT IN (SELECT id FROM catalogue_versions WHERE name = $1 ORDER BY id DESC LIMIT $2)";
    remove(connection, older, &[text(&document.name), Value::Integer(Some(KEPT))]).await?;
    connection.execute("COMMIT", &[]).await
}

async fn remove(connection: &mut Connection, condition: &str, values: &[Value]) -> Result<(), sqlx::Error> {
    for table in ["catalogue_representations", "catalogue_cells", "catalogue_objects"] {
        let sql = format!("DELETE FROM {table} WHERE version IN (SELECT id FROM catalogue_versions WHERE {condition})");
        connection.execute(&sql, values).await?;
    }
    connection.execute(&format!("DELETE FROM catalogue_versions WHERE {condition}"), values).await
}

enum TreeError {
    Stored(StoredError),
    Database(sqlx::Error),
}

impl From<StoredError> for TreeError {
    fn from(error: StoredError) -> TreeError {
        TreeError::Stored(error)
    }
}

impl From<sqlx::Error> for TreeError {
    fn from(error: sqlx::Error) -> TreeError {
        TreeError::Database(error)
    }
}

/// A page at a time: what is in memory is a page's rows for each level of pages.
async fn write_tree(
    connection: &mut Connection,
    version: i64,
    document: &Document,
    pages: &Pages,
) -> Result<(), TreeError> {
    let mut cells = Rows {
        table: "catalogue_cells",
        columns: "version, id, parent, level, x, y, z, min_x, min_y, min_z, max_x, max_y, max_z, page",
        width: 14,
        values: Vec::new(),
    };
    let mut representations = Rows {
        table: "catalogue_representations",
        columns: "version, cell, id, direction, detail, file, wire_bytes, decoded_bytes, error",
        width: 9,
        values: Vec::new(),
    };
    let root = pages.root(&document.root)?;
    let mut waiting = vec![(root, document.root.clone(), None)];
    let mut next = 0;
    while let Some((node, page, parent)) = waiting.pop() {
        let mut rows = Vec::new();
        let mut beneath = Vec::new();
        rows_of(version, &node, &page, parent, &mut next, &mut rows, &mut beneath);
        for row in rows {
            match row {
                Row::Cell(row) => cells.push(connection, row).await?,
                Row::Representation(row) => representations.push(connection, row).await?,
            }
        }
        for (cell, reference, parent) in beneath.into_iter().rev() {
            let name = address::page(cell, &reference.hash);
            waiting.push((pages.page(cell, &reference)?, name, Some(parent)));
        }
    }
    cells.flush(connection).await?;
    representations.flush(connection).await?;
    Ok(())
}

/// The rows of a page, and the pages that it names with the ids of their parents. At most
/// [`crate::octree::LEVELS_MAX`] calls deep.
fn rows_of(
    version: i64,
    node: &Node,
    page: &str,
    parent: Option<i64>,
    next: &mut i64,
    rows: &mut Vec<Row>,
    beneath: &mut Vec<(Cell, page::PageReference, i64)>,
) {
    let id = *next;
    *next += 1;
    let bounds = node.summary().bounds;
    let [x, y, z] = node.cell.place.map(integer);
    let corner = |v: f64| Value::Real(Some(v));
    rows.push(Row::Cell([
        integer(version),
        integer(id),
        Value::Integer(parent),
        integer(node.cell.level),
        x,
        y,
        z,
        corner(bounds.min.x),
        corner(bounds.min.y),
        corner(bounds.min.z),
        corner(bounds.max.x),
        corner(bounds.max.y),
        corner(bounds.max.z),
        text(page),
    ]));
    for (at, rep) in node.representations.iter().enumerate() {
        let (folder, name) = address::representation(node.cell, rep.kind, &rep.hash);
        let (direction, detail) = match rep.kind {
            page::Kind::Orthoview(direction) => (text(&direction.name()), Value::Integer(None)),
            page::Kind::Geometry(level) => (Value::Text(None), integer(level)),
        };
        rows.push(Row::Representation([
            integer(version),
            integer(id),
            integer(at),
            direction,
            detail,
            text(&(folder + &name)),
            integer(rep.wire_bytes),
            integer(rep.decoded_bytes),
            Value::Real(Some(f64::from(rep.error))),
        ]));
    }
    for child in &node.children {
        match child {
            page::Child::Node(node) => rows_of(version, node, page, Some(id), next, rows, beneath),
            page::Child::Page(cell, reference) => beneath.push((*cell, *reference, id)),
        }
    }
}
