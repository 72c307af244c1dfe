//! The terminal's table: policies down, figures across, the upper bound as the goal line.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table};

use super::metric::{Context, METRICS, bound_cell, pressure_word};
use super::number::{self, duration, mebibytes, printable, significant};
use crate::outcome::Comparison;

/// Longest name shown, characters.
const NAME_LIMIT: usize = 48;
/// Spaces between two columns.
const GAP: u16 = 2;

/// The comparison as plain text without colour codes. Where `width` characters do not hold all columns they go on in
/// a further table beneath; no table has less than one column.
pub fn table(comparison: &Comparison, width: usize) -> String {
    let mut text = String::new();
    let context = Context::new(comparison);
    let columns = columns(comparison, &context);
    let mut first = 0;
    while first < columns.len() {
        let mut last = first + 1;
        while last < columns.len() && line_width(&names(comparison), &columns[first..=last]) <= width {
            last += 1;
        }
        text.push_str(&render(&names(comparison), &columns[first..last]));
        text.push_str("\n\n");
        first = last;
    }
    for line in footer(comparison) {
        text.push_str(&line);
        text.push('\n');
    }
    text
}

fn names(comparison: &Comparison) -> Vec<String> {
    let mut names = vec!["policy".to_owned()];
    names.extend(comparison.policies.iter().map(|p| printable(&p.name, NAME_LIMIT)));
    names.push("upper bound".to_owned());
    names
}

/// Every column as text, heading first and the bound last.
fn columns(comparison: &Comparison, context: &Context) -> Vec<Vec<String>> {
    let figures = METRICS.iter().enumerate().map(|(index, metric)| {
        let cells = comparison.policies.iter().map(|policy| {
            let cell = metric.cell(policy, context);
            match cell.half_width {
                Some(half) => format!("{} ±{half}", cell.text),
                None => cell.text,
            }
        });
        let mut column = vec![metric.heading.to_owned()];
        column.extend(cells);
        column.push(bound_cell(index, comparison, context));
        column
    });
    figures.collect()
}

fn arranged(names: &[String], columns: &[Vec<String>]) -> Table {
    let mut table = Table::new();
    let rule = LineStyle::none().fill('─');
    table.load_style(NOTHING.header_separator(rule)).set_content_arrangement(ContentArrangement::Disabled);
    let row = |r: usize| {
        let cells = columns.iter().map(move |c| c.get(r).cloned().unwrap_or_default());
        std::iter::once(names[r].clone()).chain(cells).collect::<Vec<_>>()
    };
    table.set_header(row(0));
    for r in 1..names.len() {
        table.add_row(row(r));
    }
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, if index < columns.len() { GAP } else { 0 }));
        column.set_cell_alignment(if index == 0 { CellAlignment::Left } else { CellAlignment::Right });
    }
    table
}

fn line_width(names: &[String], columns: &[Vec<String>]) -> usize {
    arranged(names, columns).column_max_content_widths().iter().map(|w| usize::from(*w)).sum::<usize>()
        + columns.len() * usize::from(GAP)
}

/// The lines of a table, the rule beneath its heading once more above the bound; without the bound where these columns
/// say nothing of it.
fn render(names: &[String], columns: &[Vec<String>]) -> String {
    let mut lines: Vec<String> = arranged(names, columns).lines().map(|l| l.trim_end().to_owned()).collect();
    if columns.iter().all(|c| c.last().is_none_or(String::is_empty)) {
        lines.pop();
    } else if let Some(rule) = lines.get(1).cloned() {
        lines.insert(lines.len() - 1, rule);
    }
    lines.join("\n")
}

fn footer(comparison: &Comparison) -> Vec<String> {
    let (inputs, pressure) = (&comparison.inputs, &comparison.pressure);
    let mut lines = Vec::new();
    if !comparison.upper_bound.method.is_empty() {
        lines.push(format!("bound     {}", printable(&comparison.upper_bound.method, 400)));
    }
    if let Some(prices) = &comparison.shadow_prices {
        lines.push(format!("worth     {}", super::prices::sentence(prices)));
    }
    if let Some(limits) = &comparison.limits {
        lines.push(format!("limits    {}", limits.sentence()));
    }
    lines.push(format!(
        "pressure  λ {}  ρ {} ({})  μ {}  frames with something in view {} %",
        significant(pressure.lambda),
        significant(pressure.rho),
        pressure_word(pressure.rho),
        significant(pressure.mu),
        number::fixed(comparison.nonempty_share * 100.0, 1),
    ));
    for (label, name, hash) in [
        ("world", &inputs.world, &inputs.world_hash),
        ("path", &inputs.path, &inputs.path_hash),
        ("link", &inputs.link, &inputs.link_hash),
    ] {
        lines.push(format!("{label:<9} {}  {}", printable(name, 200), printable(hash, 12)));
    }
    lines.push(format!(
        "replayed  {}, memory {}, {}, placed {}, seed {}, {}",
        duration(inputs.duration_s),
        mebibytes(inputs.memory_bytes as f64),
        if inputs.warm { "warm start" } else { "cold start" },
        printable(&inputs.place, 100),
        inputs.seed,
        match inputs.starts_s.len() {
            0 | 1 => "one start".to_owned(),
            n => format!("{n} starts, ± is half a 95 % interval"),
        },
    ));
    lines.push(format!(
        "aim       α {}, {} worst case, {} refinement",
        number::trimmed(inputs.alpha, 3),
        printable(&inputs.worst_case, 40),
        printable(&inputs.refinement, 40),
    ));
    lines.extend(super::alpha::sentences(comparison).into_iter().map(|line| format!("alpha     {line}")));
    lines.extend(comparison.warnings.iter().map(|w| format!("warning: {}", printable(w, 1000))));
    lines
}
