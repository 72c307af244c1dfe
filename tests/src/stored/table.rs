//! Tables as text and as JSON.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle};
use serde::Serialize;
use serde_json::{Map, Value};

/// A table: what it shows, its columns, its rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// One line.
    pub title: String,
    columns: Vec<&'static str>,
    rows: Vec<Vec<Value>>,
}

impl Table {
    /// Without rows. Columns carry their unit.
    pub fn new(title: impl Into<String>, columns: &[&'static str]) -> Table {
        Table { title: title.into(), columns: columns.to_vec(), rows: Vec::new() }
    }

    /// Adds a row: a value a column.
    pub fn row(&mut self, values: impl IntoIterator<Item = Value>) {
        let row: Vec<Value> = values.into_iter().collect();
        debug_assert_eq!(row.len(), self.columns.len(), "{}", self.title);
        self.rows.push(row);
    }

    /// A column's numbers; those that are none are left out.
    pub fn numbers(&self, column: &str) -> Vec<f64> {
        let at = self.columns.iter().position(|c| *c == column);
        self.rows.iter().filter_map(|row| row.get(at?)?.as_f64()).collect()
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// As text.
    pub fn text(&self) -> String {
        let mut table = comfy_table::Table::new();
        table.load_style(NOTHING.header_separator(LineStyle::none().fill('─')));
        table.set_content_arrangement(ContentArrangement::Disabled).set_header(self.columns.clone());
        for row in &self.rows {
            table.add_row(row.iter().map(shown));
        }
        for column in table.column_iter_mut().skip(1) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        format!("{}\n{table}", self.title)
    }
}

/// A number to four digits.
fn shown(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Null => "–".to_owned(),
        Value::Number(number) => match (number.as_u64(), number.as_f64()) {
            (Some(whole), _) => whole.to_string(),
            (None, Some(0.0)) => "0".to_owned(),
            (None, Some(v)) => {
                let digits = (3.0 - libm::floor(libm::log10(v.abs()))).clamp(0.0, 9.0) as usize;
                format!("{v:.digits$}")
            }
            (None, None) => number.to_string(),
        },
        other => other.to_string(),
    }
}

impl Serialize for Table {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let rows: Vec<Map<String, Value>> = self
            .rows
            .iter()
            .map(|row| self.columns.iter().map(|c| (*c).to_owned()).zip(row.iter().cloned()).collect())
            .collect();
        serde_json::json!({ "title": self.title, "rows": rows }).serialize(serializer)
    }
}
