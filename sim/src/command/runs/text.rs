//! Tables and numbers for the terminal.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table};

/// Longest text in a cell, characters.
const CELL: usize = 40;

/// Plain text without colour codes: a heading, and rows beneath it. The first `left` columns are texts, the others
/// numbers.
pub(super) fn table(heading: &[&str], rows: &[Vec<String>], left: usize) -> String {
    let mut table = Table::new();
    let rule = LineStyle::none().fill('─');
    table.load_style(NOTHING.header_separator(rule)).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(heading.to_vec());
    for row in rows {
        table.add_row(row.iter().map(|cell| printable(cell, CELL)));
    }
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, if index + 1 < heading.len() { 2 } else { 0 }));
        column.set_cell_alignment(if index < left { CellAlignment::Left } else { CellAlignment::Right });
    }
    table.lines().map(|line| line.trim_end().to_owned()).collect::<Vec<_>>().join("\n")
}

/// At most so many characters, and none that would steer a terminal.
pub(super) fn printable(text: &str, limit: usize) -> String {
    let shown = |c: char| if c.is_control() { '\u{fffd}' } else { c };
    let long = text.chars().nth(limit).is_some();
    let kept = text.chars().take(if long { limit.saturating_sub(1) } else { limit }).map(shown);
    kept.chain(long.then_some('…')).collect()
}

/// Four significant digits or so of a figure between 0 and 1, or –.
pub(super) fn share(value: Option<f64>) -> String {
    value.map_or_else(|| "–".to_owned(), |v| format!("{v:.4}"))
}

/// A mean with half its interval.
pub(super) fn spread(figure: &foresight_index::runs::Figure) -> String {
    match (figure.lower, figure.upper) {
        (Some(lower), Some(upper)) => format!("{} ±{:.4}", share(figure.value), (upper - lower) / 2.0),
        _ => share(figure.value),
    }
}
