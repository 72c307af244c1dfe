//! The α sweep for the terminal.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table};

use super::number::{NEVER, fixed, optional, trimmed};
use crate::suite::alpha::{AIM, AlphaRow, AlphaSweep, Contender, SPREAD};

/// The sweep as plain text: replays down, α across, then the best one and what the others make of it.
pub fn alpha_sweep_text(sweep: &AlphaSweep) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING.header_separator(LineStyle::none().fill('─')));
    table.set_content_arrangement(ContentArrangement::Disabled);
    let alphas = sweep.alphas.iter().map(|a| trimmed(*a, 2));
    let rest = ["spread", "of it", "best", "adapted", "α", "regret", "solved", "α", "W ≥", "W", "regret", "is"];
    table.set_header(["case".to_owned()].into_iter().chain(alphas).chain(rest.map(str::to_owned)));
    for row in &sweep.rows {
        table.add_row(cells(row));
    }
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        column.set_cell_alignment(if index == 0 { CellAlignment::Left } else { CellAlignment::Right });
    }
    let mut text: String = table.lines().map(|line| format!("{}\n", line.trim_end())).collect();
    text.push_str(
        "\nMean deficits; spread: largest − smallest over the fixed α, and that ÷ the smallest; regret: that against the smallest \
         ÷ spread.\nsolved: W/Σw at least what the best fixed α reached.\n",
    );
    for (name, of) in [("adapted", adapted as fn(&AlphaRow) -> &Contender), ("solved", solved)] {
        text.push_str(&verdict(sweep, name, of));
    }
    if let Some(means) = sweep.mean_deficits() {
        let (fixed_ones, both) = means.split_at(sweep.alphas.len());
        let listed: Vec<String> =
            sweep.alphas.iter().zip(fixed_ones).map(|(a, d)| format!("{} {}", trimmed(*a, 2), fixed(*d, 4))).collect();
        let both: Vec<String> = both.iter().map(|d| fixed(*d, 4)).collect();
        text.push_str(&format!(
            "mean deficit over all replays: {}; adapted {}, solved {}\n",
            listed.join(", "),
            both[0],
            both[1]
        ));
    }
    text
}

fn adapted(row: &AlphaRow) -> &Contender {
    &row.adapted
}

fn solved(row: &AlphaRow) -> &Contender {
    &row.solved
}

fn cells(row: &AlphaRow) -> Vec<String> {
    let mut cells = vec![row.case.clone()];
    cells.extend(row.deficits.iter().map(|d| fixed(*d, 4)));
    cells.extend([fixed(row.spread, 4), format!("{} %", fixed(100.0 * row.relative_spread, 0))]);
    cells.push(trimmed(row.best_alpha, 2));
    let share = |c: &Contender| if row.counts() { optional(c.share, 2) } else { NEVER.to_owned() };
    let (a, s) = (&row.adapted, &row.solved);
    cells.extend([fixed(a.deficit, 4), fixed(a.mean_alpha, 2), share(a)]);
    cells.extend([fixed(s.deficit, 4), fixed(s.mean_alpha, 2), fixed(row.at_least, 2)]);
    let mut stands = s.constraint.clone();
    stands.dedup();
    cells.extend([optional(s.worst_quality, 3), share(s), stands.join("/")]);
    cells
}

/// In how many of the replays that count the aim is reached, and which ones miss it.
fn verdict(sweep: &AlphaSweep, name: &str, of: fn(&AlphaRow) -> &Contender) -> String {
    let counted: Vec<&AlphaRow> = sweep.rows.iter().filter(|r| r.counts()).collect();
    let misses: Vec<String> = counted
        .iter()
        .filter(|r| of(r).share.is_none_or(|s| s > AIM))
        .map(|r| format!("{} {}", r.case, optional(of(r).share, 2)))
        .collect();
    let missed = if misses.is_empty() { String::new() } else { format!("; above: {}", misses.join(", ")) };
    format!(
        "{name}: regret ÷ spread ≤ {} in {} of {} replays whose spread is at least {}{missed}\n",
        trimmed(AIM, 2),
        counted.len() - misses.len(),
        counted.len(),
        trimmed(SPREAD, 3),
    )
}
