//! A recorded session for the terminal.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table};

use super::number::{NEVER, duration, fixed, mebibytes, megabytes, optional, printable};
use crate::outcome::PolicyOutcome;
use crate::session_replay::{Agreement, SessionOutcome, Shift, Simulated};

/// What came of a recorded session as plain text.
pub fn session_text(outcome: &SessionOutcome) -> String {
    let mut text = format!(
        "{}: world {}, {}, {}, {} views in {}\n",
        printable(&outcome.recording, 200),
        printable(&outcome.world, 80),
        printable(&outcome.policy, 80),
        mebibytes(outcome.memory_bytes as f64),
        outcome.views,
        duration(outcome.duration_s)
    );
    text.push_str(&agreement(&outcome.agreement));
    if let Some(live) = &outcome.live {
        text.push_str(&figures(live, outcome.simulated.as_ref()));
    }
    if let Some(simulated) = &outcome.simulated {
        text.push_str(&difference(outcome, simulated));
    }
    for warning in &outcome.warnings {
        text.push_str(&format!("mind: {}\n", printable(warning, 400)));
    }
    text.push('\n');
    text
}

fn agreement(agreement: &Agreement) -> String {
    let mut text = format!(
        "{} of {} decisions equal, and {} of {} other answers\n",
        agreement.decisions_equal, agreement.decisions, agreement.others_equal, agreement.others
    );
    if let Some(first) = &agreement.first_difference {
        let words = |message: &Option<_>| message.as_ref().map_or("nothing".to_owned(), |m| format!("{m:?}"));
        text.push_str(&format!(
            "first difference: line {}, received at {:.6} s\n  recorded: {}\n  again:    {}\n",
            first.line,
            first.received_s,
            printable(&words(&first.recorded), 400),
            printable(&words(&first.again), 400)
        ));
    }
    text
}

fn table(heading: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(NOTHING.header_separator(LineStyle::none().fill('─')));
    table.set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(heading.to_vec());
    table
}

fn render(mut table: Table) -> String {
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        column.set_cell_alignment(if index == 0 { CellAlignment::Left } else { CellAlignment::Right });
    }
    table.lines().map(|line| format!("{}\n", line.trim_end())).collect()
}

fn figures(live: &PolicyOutcome, simulated: Option<&Simulated>) -> String {
    type Figure = fn(&PolicyOutcome) -> String;
    let rows: [(&str, Figure); 9] = [
        ("mean deficit", |o| optional(o.mean_deficit, 4)),
        ("mean quality", |o| optional(o.mean_quality, 4)),
        ("5th percentile", |o| optional(o.p05_quality, 4)),
        ("below 0.9, s", |o| fixed(o.seconds_below_0_9, 1)),
        ("to 0.9, s", |o| optional(o.seconds_to_0_9, 2)),
        ("within 16 px", |o| optional(o.share_within_16px, 4)),
        ("fetched", |o| megabytes(o.bytes_fetched)),
        ("wasted", |o| megabytes(o.bytes_wasted)),
        ("let go", |o| fixed(o.evictions, 0)),
    ];
    let mut heading = vec!["", "live"];
    heading.extend(simulated.map(|_| "simulated"));
    let mut table = table(&heading);
    for (name, figure) in rows {
        let mut cells = vec![name.to_owned(), figure(live)];
        cells.extend(simulated.map(|simulated| figure(&simulated.outcome)));
        table.add_row(cells);
    }
    render(table)
}

fn difference(outcome: &SessionOutcome, simulated: &Simulated) -> String {
    let of = simulated.path.as_deref().map_or("the recorded views".to_owned(), |path| printable(path, 80));
    let share =
        simulated.relative_difference.map_or(NEVER.to_owned(), |share| format!("{} %", fixed(100.0 * share, 2)));
    let deficit = |outcome: Option<&PolicyOutcome>| optional(outcome.and_then(|o| o.mean_deficit), 5);
    let mut text = format!(
        "simulated: {of} over {}\nd_live {}, d_simulated {}: |d_live − d_simulated| / max(d_simulated, 0.001) = {share}\n",
        printable(&simulated.link, 80),
        deficit(outcome.live.as_ref()),
        deficit(Some(&simulated.outcome))
    );
    let differences = &simulated.differences;
    text.push_str(&format!(
        "first request {} ms after the first view live, {} ms simulated\n",
        optional(differences.first_request_live_ms, 1),
        optional(differences.first_request_simulated_ms, 1)
    ));
    let mut table =
        table(&["later live by", "in both", "live only", "simulated only", "median, ms", "|median|, ms", "|p99|, ms"]);
    let mut row = |name: &str, shift: &Shift| {
        table.add_row([
            name.to_owned(),
            shift.matched.to_string(),
            shift.live_only.to_string(),
            shift.simulated_only.to_string(),
            optional(shift.median_ms, 1),
            optional(shift.median_amount_ms, 1),
            optional(shift.p99_amount_ms, 1),
        ]);
    };
    row("requests", &differences.requests);
    row("completions", &differences.completions);
    text.push_str(&render(table));
    text
}
