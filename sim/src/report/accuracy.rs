//! Error against run time for people: tables for the terminal, a page for the browser.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table};
use maud::{Markup, html};
use std::collections::BTreeMap;

use super::frame::{document, table};
use super::number::{NEVER, printable, significant};
use super::scatter::{Point, Series, Titles, scatter};
use crate::accuracy::outcome::{Accuracy, ChoiceRow, ErrorRow, GAIN_FLOOR, ProofCounts, ScaleRow, Splitting, Verdict};

/// Errors below this, zero included, are drawn on it: rounding.
const ERROR_FLOOR: f64 = 1e-17;
/// Findings printed of each verdict; the document holds all.
const FINDINGS_PRINTED: usize = 12;
/// The row over all scenes.
const ALL: &str = "all";

/// Everything as plain text: a table a part, then what must be known.
pub fn accuracy_text(outcome: &Accuracy) -> String {
    let mut text = String::new();
    for (heading, rows) in tables(outcome, true) {
        text.push_str(&format!("{heading}\n\n{}\n\n", arranged(&rows)));
    }
    if let Some(splitting) = &outcome.splitting {
        text.push_str(&format!("{}\n\n", split_sentence(splitting)));
    }
    if let Some(proof) = &outcome.proof {
        text.push_str(&format!("{}\n\n", proof_sentence(proof)));
    }
    text.push_str(&findings_text(outcome));
    text
}

/// What the rows show that their reader must know.
fn findings_text(outcome: &Accuracy) -> String {
    let mut text = String::new();
    for (verdict, heading) in VERDICTS {
        let of: Vec<&str> = outcome.findings.iter().filter(|f| f.verdict == verdict).map(|f| f.text.as_str()).collect();
        if of.is_empty() {
            text.push_str(&format!("{heading}: none.\n"));
            continue;
        }
        text.push_str(&format!("{heading}: {} rows.\n", of.len()));
        for finding in of.iter().take(FINDINGS_PRINTED) {
            text.push_str(&format!("  {}\n", printable(finding, 300)));
        }
        if of.len() > FINDINGS_PRINTED {
            text.push_str(&format!("  … and {} more; --json holds all\n", of.len() - FINDINGS_PRINTED));
        }
    }
    text
}

const VERDICTS: [(Verdict, &str); 3] = [
    (Verdict::Violated, "Proven bounds that do not hold"),
    (Verdict::Lies, "Uncertified methods that err by more than they say"),
    (Verdict::Loose, "Proven bounds that are loose"),
];

fn proof_sentence(proof: &ProofCounts) -> String {
    let ProofCounts { candidates, legs, legs_within, violated } = proof;
    format!(
        "Enclosures of {candidates} candidates, {legs} legs: {violated} candidates violated. In {legs_within} legs the reference, give or \
         take its error, lies within the bounds; in the other {} it meets or leaves them.",
        legs - legs_within
    )
}

fn split_sentence(splitting: &Splitting) -> String {
    let least = if splitting.reached { "" } else { "at least " };
    format!(
        "Splitting at events against a fixed grid at equal 99.9th percentile error ({}): {} takes {} evaluations, {} {}: {least}{} × as many; \
         at the split method's median error {} ×.",
        scientific(splitting.p999_relative_error),
        splitting.split,
        significant(splitting.split_evaluations),
        splitting.fixed,
        significant(splitting.fixed_evaluations),
        significant(splitting.ratio),
        significant(splitting.ratio_at_median)
    )
}

/// The parts that ran, each with its heading and its rows, heading row first. `short` leaves single scenes out where
/// there is a row over all.
fn tables(outcome: &Accuracy, short: bool) -> Vec<(&'static str, Vec<Vec<String>>)> {
    let mut tables = Vec::new();
    for (heading, rows) in [
        ("The added-benefit integral: relative error against the reference", &outcome.integral),
        ("The worst case: relative error, of minimum relative to Σw", &outcome.worst_case),
    ] {
        if !rows.is_empty() {
            let is_single = |r: &&ErrorRow| !short || r.case == ALL;
            let heads = "case kind method setting proven evaluations ns max p99.9 median violations gap";
            let rows = rows.iter().filter(is_single).map(error_cells);
            tables.push((heading, std::iter::once(words(heads)).chain(rows).collect()));
        }
    }
    if !outcome.choice.is_empty() {
        let heads = "case method tolerance proven wrong decisions regret fine-regret candidates ns";
        let is_single = |r: &&ChoiceRow| !short || r.case == ALL;
        let rows = outcome.choice.iter().filter(is_single).map(choice_cells);
        tables.push(("Choosing the best candidate", std::iter::once(words(heads)).chain(rows).collect()));
    }
    if !outcome.scale.is_empty() {
        let heads =
            "representations situation p50 p99 action_p50 action_p99 opened decisions actions B/representation session";
        let rows = outcome.scale.iter().map(scale_cells);
        tables.push(("Decisions as the world grows", std::iter::once(words(heads)).chain(rows).collect()));
    }
    if !outcome.upper_bound.is_empty() {
        let heads = "stratum instances least median greatest";
        let rows = bound_cells(outcome);
        let heading = "The replay's upper bound on tiny instances: exact ÷ bound";
        tables.push((heading, std::iter::once(words(heads)).chain(rows).collect()));
    }
    tables
}

fn words(heads: &str) -> Vec<String> {
    heads.split(' ').map(str::to_owned).collect()
}

fn marked(method: &str, is_default: bool) -> String {
    format!("{}{}", printable(method, 40), if is_default { " *" } else { "" })
}

fn proven(certified: bool) -> String {
    if certified { "yes" } else { "no" }.to_owned()
}

fn error_cells(row: &ErrorRow) -> Vec<String> {
    let method = row.reading.as_ref().map_or_else(|| row.method.clone(), |r| format!("{r}: {}", row.method));
    vec![
        printable(&row.case, 40),
        row.kind.name().to_owned(),
        marked(&method, row.default),
        printable(&row.setting, 40),
        proven(row.certified),
        significant(row.evaluations),
        significant(row.ns_per_candidate),
        scientific(row.max_relative_error),
        scientific(row.p999_relative_error),
        scientific(row.median_relative_error),
        row.bound_violations.to_string(),
        row.gap.map_or_else(|| NEVER.to_owned(), scientific),
    ]
}

fn choice_cells(row: &ChoiceRow) -> Vec<String> {
    vec![
        printable(&row.case, 40),
        marked(&row.method, row.default),
        scientific(row.tolerance),
        proven(row.certified),
        row.wrong_choices.to_string(),
        row.decisions.to_string(),
        scientific(row.max_regret),
        row.max_regret_reference.map_or_else(|| NEVER.to_owned(), scientific),
        significant(row.candidates_evaluated),
        significant(row.ns_per_decision),
    ]
}

fn scale_cells(row: &ScaleRow) -> Vec<String> {
    vec![
        row.representations.to_string(),
        row.situation.to_owned(),
        milliseconds(row.decision_ns.p50),
        milliseconds(row.decision_ns.p99),
        milliseconds(row.action_ns.p50),
        milliseconds(row.action_ns.p99),
        row.nodes_opened.map_or_else(|| NEVER.to_owned(), significant),
        row.decisions.to_string(),
        row.actions.to_string(),
        significant(row.bytes_per_representation),
        format!("{} kB", significant(row.session_bytes as f64 / 1e3)),
    ]
}

fn bound_cells(outcome: &Accuracy) -> Vec<Vec<String>> {
    let mut strata: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for row in &outcome.upper_bound {
        let share = if row.bound > 0.0 { row.exact / row.bound } else { 1.0 };
        strata.entry(&row.stratum).or_default().push(share);
    }
    let cells = strata.into_iter().map(|(stratum, mut shares)| {
        shares.sort_by(f64::total_cmp);
        let at = |rank: usize| shares.get(rank).copied().map_or_else(|| NEVER.to_owned(), significant);
        let count = shares.len();
        vec![stratum.to_owned(), count.to_string(), at(0), at(count / 2), at(count.saturating_sub(1))]
    });
    cells.collect()
}

fn milliseconds(nanos: u64) -> String {
    format!("{} ms", significant(nanos as f64 / 1e6))
}

/// Two digits and a power of ten.
fn scientific(value: f64) -> String {
    match value {
        0.0 => "0".to_owned(),
        v if v == f64::INFINITY => "∞".to_owned(),
        v if v.is_finite() => format!("{v:.1e}"),
        _ => NEVER.to_owned(),
    }
}

fn arranged(rows: &[Vec<String>]) -> String {
    let mut table = Table::new();
    table.load_style(NOTHING.header_separator(LineStyle::none().fill('─')));
    table.set_content_arrangement(ContentArrangement::Disabled).set_header(&rows[0]);
    for row in &rows[1..] {
        table.add_row(row);
    }
    for (index, column) in table.column_iter_mut().enumerate() {
        column.set_padding((0, 2));
        let is_text =
            rows.get(1).and_then(|r| r.get(index)).is_some_and(|c| c.starts_with(|l: char| l.is_alphabetic()));
        column.set_cell_alignment(if is_text { CellAlignment::Left } else { CellAlignment::Right });
    }
    table.lines().map(|l| l.trim_end().to_owned()).collect::<Vec<_>>().join("\n")
}

/// Error against run time on one self-contained page.
pub fn accuracy_page(outcome: &Accuracy, command: &str) -> String {
    let plots = plots(outcome);
    let most = plots.iter().map(|p| p.1).max().unwrap_or(0);
    let header = html! {
                    h1 { "Error against run time of every estimator" }
                    p.subject { (outcome.candidates) " candidates, seed " (outcome.seed) }
    };
    let main = html! {
                    section id="findings" {
                        h2 { "What to know first" }
                        @if let Some(splitting) = &outcome.splitting { p { (split_sentence(splitting)) } }
                        (findings(outcome))
                        p.how {
                            "Errors are relative to the gain, or to " (scientific(GAIN_FLOOR)) " of the best gain of its scene where the gain is less. \
                             * and a ring mark what decisions use."
                        }
                    }
                    @for (id, _, heading, how, plot) in &plots {
                        section id=(id) { h2 { (heading) } p.how { (how) } (plot) }
                    }
                    @for (heading, rows) in tables(outcome, false) {
                        section {
                            h2 { (heading) }
                            (table("Figures", &rows, false))
                        }
                    }
                    section id="command" {
                        h2 { "To repeat it" }
                        pre.scroll { code { (printable(command, 2000)) } }
                    }
    };
    document("accuracy", most, header, main)
}

fn findings(outcome: &Accuracy) -> Markup {
    html! {
        @for (verdict, heading) in VERDICTS {
            @let of = outcome.findings.iter().filter(|f| f.verdict == verdict).collect::<Vec<_>>();
            @if of.is_empty() {
                p { (heading) ": none." }
            } @else {
                details open[verdict == Verdict::Violated] {
                    summary { (heading) ": " (of.len()) " rows" }
                    ul { @for finding in of { li { (printable(&finding.text, 400)) } } }
                }
            }
        }
    }
}

type Plot = (&'static str, usize, &'static str, &'static str, Markup);

/// Those that have points: id, number of series, heading, how to read it, and the plot.
fn plots(outcome: &Accuracy) -> Vec<Plot> {
    let mut plots: Vec<Plot> = Vec::new();
    let mut add = |id, heading, how, series: Vec<Series>, titles: Titles| {
        if let Some(plot) = scatter(&series, &titles) {
            plots.push((id, series.len(), heading, how, plot));
        }
    };
    for (id, heading, kind) in [
        ("integral", "The integral on replays", "real"),
        ("integral-stiff", "The integral on stiff scenes", "stiff"),
        ("integral-extreme", "The integral on extreme scenes", "extreme"),
    ] {
        let rows = outcome.integral.iter().filter(|r| r.case == ALL && r.kind.name() == kind);
        let described = "99.9th percentile of the relative error against nanoseconds a candidate, a curve a method";
        let titles = Titles { described, x: "ns a candidate", y: "relative error, p99.9", floor: ERROR_FLOOR };
        let how = "Lower is more accurate, left is faster: a method is worth using where no other lies below and to the left of it.";
        add(id, heading, how, by_method(rows), titles);
    }
    let described = "Relative error against nanoseconds an evaluation of the worst case, a curve a method";
    let titles = Titles { described, x: "ns", y: "relative error, p99.9", floor: ERROR_FLOOR };
    let rows = outcome.worst_case.iter().filter(|r| r.case == ALL);
    add("worst-case", "The worst case", "Lower is more accurate, left is faster.", by_method(rows), titles);
    let how = "Lower is better, left is faster; what makes no wrong choice lies on the lowest line.";
    let choice = |value: fn(&ChoiceRow) -> f64| {
        let mut series: BTreeMap<&str, Vec<Point>> = BTreeMap::new();
        for row in outcome.choice.iter().filter(|r| r.case == ALL) {
            let label = format!("tolerance {}", scientific(row.tolerance));
            let point = Point { x: row.ns_per_decision, y: value(row), label, is_default: row.default };
            series.entry(&row.method).or_default().push(point);
        }
        ordered(series)
    };
    let described = "Share of wrong choices against nanoseconds a decision, a curve a method";
    let titles = Titles { described, x: "ns a decision", y: "share of wrong choices", floor: 1e-6 };
    let wrong = choice(|r| r.wrong_choices as f64 / r.decisions.max(1) as f64);
    add("wrong-choices", "Wrong choices", how, wrong, titles);
    let described = "Largest regret against nanoseconds a decision, a curve a method";
    let titles = Titles { described, x: "ns a decision", y: "largest regret", floor: 1e-6 };
    add("regret", "Regret", how, choice(|r| r.max_regret), titles);
    let mut series: BTreeMap<String, Vec<Point>> = BTreeMap::new();
    for row in &outcome.scale {
        for (name, nanos) in [("p50", row.decision_ns.p50), ("p99", row.decision_ns.p99)] {
            let label = format!("{} representations: {}", row.representations, milliseconds(nanos));
            let (x, y) = (row.representations as f64, nanos as f64 / 1e6);
            let points = series.entry(format!("{}, {name}", row.situation)).or_default();
            points.push(Point { x, y, label, is_default: false });
        }
    }
    let described = "Milliseconds a decision against the number of representations, a curve a situation and percentile";
    let titles = Titles { described, x: "representations", y: "ms a decision", floor: 1e-6 };
    let how = "A flat curve is a decision that does not care how large the world is.";
    add("scale", "Decision time against the size of the world", how, ordered(series), titles);
    plots
}

/// A series a method, by its settings in order of cost.
fn by_method<'a>(rows: impl Iterator<Item = &'a ErrorRow>) -> Vec<Series> {
    let mut series: BTreeMap<String, Vec<Point>> = BTreeMap::new();
    for row in rows {
        let name = row.reading.as_ref().map_or_else(|| row.method.clone(), |r| format!("{r}: {}", row.method));
        let label = format!("{}: {}", row.setting, scientific(row.p999_relative_error));
        let point = Point { x: row.ns_per_candidate, y: row.p999_relative_error, label, is_default: row.default };
        series.entry(name).or_default().push(point);
    }
    ordered(series)
}

fn ordered<K: ToString + Ord>(series: BTreeMap<K, Vec<Point>>) -> Vec<Series> {
    let sorted = series.into_iter().map(|(name, mut points)| {
        points.sort_by(|a, b| a.x.total_cmp(&b.x));
        Series { name: name.to_string(), points }
    });
    sorted.collect()
}
