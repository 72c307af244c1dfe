//! The suite for people: a text for the terminal, one page with every case for the browser.

use comfy_table::presets::NOTHING;
use comfy_table::{CellAlignment, ContentArrangement, LineStyle, Table};
use maud::{Markup, html};

use super::downsample::{drawable, extremes};
use super::frame::{document, table};
use super::metric::{Context, METRICS};
use super::number::{NEVER, duration, fixed, mebibytes, megabytes, optional, printable, significant};
use super::plot::{Axis, BOUND_CLASS, frame, legend, lines, percent, series_class, stroke_class, swatch};
use crate::outcome::{Comparison, Limits};
use crate::suite::{CaseOutcome, Due, ReplayOutcome, Standing, SuiteOutcome, TIE, Verdict};
use foresight_scheduler::policy::specification::knows_the_future;

/// Most points of a curve over time.
const CURVE_POINTS: usize = 500;
/// Columns of [`METRICS`] that a case shows: mean Q, deficit, relative deficit, 5th percentile.
const SHOWN: usize = 4;

/// The suite as plain text: cases down, rivals across, the relative deficit of `foresight` in the cells. Where `width`
/// characters do not hold all rivals they go on in a further table beneath.
pub fn suite_text(outcome: &SuiteOutcome, width: usize) -> String {
    let mut text = String::new();
    let mut rest = &rivals(outcome)[..];
    let mut first = true;
    while first || !rest.is_empty() {
        let fits =
            |count: &usize| arranged(&rows(outcome, &rest[..*count])).lines().all(|l| l.chars().count() <= width);
        let count = (1..=rest.len()).take_while(fits).last().unwrap_or(rest.len().min(1));
        text.push_str(&arranged(&rows(outcome, &rest[..count])));
        text.push_str("\n\n");
        rest = &rest[count..];
        first = false;
    }
    text.push_str("Deficit of foresight ÷ deficit of the column: below 1 is better; = is level.\n");
    for standing in &outcome.standings {
        text.push_str(&format!("{}\n", sentence(standing)));
    }
    for case in outcome.cases.iter().filter(|c| c.due == Due::Tie) {
        text.push_str(&format!("{}\n", due(case)));
    }
    if outcome.cases.iter().any(|c| c.limits.is_some()) {
        text.push_str(&format!("\n{}\n{LIMITS_EXPLAINED}\n", arranged(&limits(outcome))));
    }
    for skipped in &outcome.skipped {
        text.push_str(&format!("skipped {}: {}\n", skipped.name, skipped.reason));
    }
    text.push_str(&cost(outcome));
    text
}

/// The rows of a table with these rivals, heading first and all cases last.
fn rows(outcome: &SuiteOutcome, rivals: &[&str]) -> Vec<Vec<String>> {
    let heading = ["case", "ρ", "deficit"].map(str::to_owned).to_vec();
    let mut rows = vec![[heading, rivals.iter().map(|r| printable(r, 40)).collect()].concat()];
    for case in &outcome.cases {
        let own: Vec<f64> = case.replays.iter().filter_map(|r| own_deficit(&r.comparison)).collect();
        let mean = (!own.is_empty()).then(|| own.iter().sum::<f64>() / own.len() as f64);
        let cells = rivals.iter().map(|r| standing_of(&case.standings, r).map_or_else(|| NEVER.to_owned(), cell));
        rows.push([vec![case.name.to_owned(), pressures(case), optional(mean, 4)], cells.collect()].concat());
    }
    let overall = rivals.iter().map(|r| optional(standing_of(&outcome.standings, r).map(|s| s.relative_deficit), 2));
    rows.push([vec!["all cases".to_owned(), String::new(), String::new()], overall.collect()].concat());
    rows
}

/// How to read the table of limits.
const LIMITS_EXPLAINED: &str = "Mean quality of foresight as a share of the proven upper bound, and where the rest is: known path \
    and link instead of predicted ones, no latency and no decoding, and last what greed loses and the bound is too high by.";

/// What keeps foresight from the bound: a heading, a row a case, their mean.
fn limits(outcome: &SuiteOutcome) -> Vec<Vec<String>> {
    let headings = ["limits", "foresight", "bound", "share %", "prediction", "client", "greed, bound"];
    let mut rows = vec![headings.iter().map(|h| (*h).to_owned()).collect::<Vec<_>>()];
    let row = |name: &str, of: Option<Limits>| {
        let cell = |value: fn(&Limits) -> f64, digits| optional(of.as_ref().map(value), digits);
        vec![
            name.to_owned(),
            cell(|l| l.foresight, 3),
            cell(|l| l.bound, 3),
            cell(|l| l.share * 100.0, 1),
            cell(|l| l.prediction, 4),
            cell(|l| l.client, 4),
            cell(|l| l.greedy_and_bound, 4),
        ]
    };
    rows.extend(outcome.cases.iter().map(|case| row(case.name, case.limits)));
    let all: Vec<Limits> = outcome.cases.iter().filter_map(|c| c.limits).collect();
    rows.push(row("all cases", Limits::mean(&all)));
    rows
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
        column.set_cell_alignment(if index == 0 { CellAlignment::Left } else { CellAlignment::Right });
    }
    let mut lines: Vec<String> = table.lines().map(|l| l.trim_end().to_owned()).collect();
    if let Some(rule) = lines.get(1).cloned() {
        lines.insert(lines.len() - 1, rule);
    }
    lines.join("\n")
}

/// The rivals in the order of the comparisons, each once.
fn rivals(outcome: &SuiteOutcome) -> Vec<&str> {
    let mut rivals: Vec<&str> = Vec::new();
    for standing in outcome.cases.iter().flat_map(|c| &c.standings) {
        if !rivals.contains(&standing.rival.as_str()) {
            rivals.push(&standing.rival);
        }
    }
    rivals
}

fn standing_of<'a>(standings: &'a [Standing], rival: &str) -> Option<&'a Standing> {
    standings.iter().find(|s| s.rival == rival)
}

fn own_deficit(comparison: &Comparison) -> Option<f64> {
    comparison.policies.iter().find(|p| p.name.starts_with("foresight"))?.mean_deficit
}

fn cell(standing: &Standing) -> String {
    let level = if standing.verdict == Verdict::Tie { " =" } else { "" };
    format!("{}{level}", fixed(standing.relative_deficit, 2))
}

/// ρ of each replay.
fn pressures(case: &CaseOutcome) -> String {
    let values: Vec<String> = case.replays.iter().map(|r| significant(r.comparison.pressure.rho)).collect();
    values.join(" ")
}

fn sentence(standing: &Standing) -> String {
    let spread = standing
        .interval
        .map_or_else(String::new, |i| format!(" (95 % interval {} to {})", fixed(i.lower, 2), fixed(i.upper, 2)));
    let future = if knows_the_future(&standing.rival) { ", which knows what no client can" } else { "" };
    format!(
        "{} × the deficit of {}{spread}{future}: ahead in {}, level in {}, behind in {} of {} cases",
        fixed(standing.relative_deficit, 2),
        printable(&standing.rival, 60),
        standing.ahead,
        standing.level,
        standing.behind,
        standing.values
    )
}

fn due(case: &CaseOutcome) -> String {
    let off: Vec<String> =
        case.not_as_due().map(|s| format!("{} ({:+.4})", printable(&s.rival, 40), s.difference)).collect();
    if off.is_empty() {
        return format!("{}: all mean deficits are within {TIE} of each other, as is due", case.name);
    }
    format!("{}: A TIE IS DUE, BUT foresight's mean deficit differs from that of {}", case.name, off.join(", "))
}

fn cost(outcome: &SuiteOutcome) -> String {
    let memory =
        outcome.peak_memory_bytes.map_or_else(String::new, |b| format!(", at most {} of memory", mebibytes(b as f64)));
    let replays: usize = outcome.cases.iter().map(|c| c.replays.len()).sum();
    format!("{} cases, {replays} comparisons, {}{memory}\n", outcome.cases.len(), duration(outcome.wall_s))
}

/// Every case on one self-contained page.
pub fn suite_page(outcome: &SuiteOutcome) -> String {
    let series = outcome.cases.iter().flat_map(|c| &c.replays).map(|r| r.comparison.policies.len()).max().unwrap_or(0);
    let header = html! {
                    h1 { "The benchmark suite: foresight against each rival" }
                    p.subject { (cost(outcome)) }
    };
    let main = html! {
                    section id="rivals" {
                        h2 { "Against each rival" }
                        p.how {
                            "A point left of 1 means that foresight leaves less undone than the rival: the geometric mean, over the cases, of \
                             its mean deficit divided by the rival's (deficits below 0.001 count as 0.001). The bar is the 95 % interval; \
                             cases in which a tie is due are left out."
                        }
                        (forest(&outcome.standings))
                    }
                    section id="cases" {
                        h2 { "Case by case" }
                        p.how {
                            "Each figure is the relative deficit of foresight against the column's policy; below 1 is better. Green is \
                             ahead, red behind, plain level: within 1 %, within 0.001 of deficit, or with an interval over the starts \
                             that holds 1."
                        }
                        (matrix(outcome))
                        @for case in outcome.cases.iter().filter(|c| c.due == Due::Tie) { p.note { (due(case)) "." } }
                        @for skipped in &outcome.skipped { p.note { "Skipped: " b { (skipped.name) } ", " (printable(&skipped.reason, 400)) } }
                    }
                    @if outcome.cases.iter().any(|c| c.limits.is_some()) {
                        section id="limits" {
                            h2 { "What limits foresight" }
                            p.how { (LIMITS_EXPLAINED) }
                            (table("What limits foresight, case by case", &limits(outcome), true))
                        }
                    }
                    @for case in &outcome.cases { (section(case)) }
    };
    document("benchmark suite", series, header, main)
}

/// Where a relative deficit lies on the axis from 1/20 to 2, logarithmic.
fn place(ratio: f64) -> f64 {
    let (low, high) = (libm::log(0.05), libm::log(2.0));
    ((libm::log(ratio) - low) / (high - low)).clamp(0.0, 1.0)
}

/// A row a rival: the mean as a point, its interval as a bar.
fn forest(standings: &[Standing]) -> Markup {
    let at = |ratio: f64| percent(place(ratio));
    html! {
        div.forest {
            @for standing in standings {
                div.row {
                    b { (printable(&standing.rival, 60)) }
                    svg height="22" role="img" aria-label=(sentence(standing)) {
                        line.one x1=(at(1.0)) x2=(at(1.0)) y1="0" y2="22" {}
                        @if let Some(interval) = standing.interval {
                            line.spread x1=(at(interval.lower)) x2=(at(interval.upper)) y1="11" y2="11" {}
                        }
                        circle.mean cx=(at(standing.relative_deficit)) cy="11" r="5" {}
                    }
                    span {
                        (fixed(standing.relative_deficit, 2)) " ×"
                        @if let Some(i) = standing.interval { span.half { " " (fixed(i.lower, 2)) "–" (fixed(i.upper, 2)) } }
                        span.note { " " (standing.ahead) " ahead, " (standing.level) " level, " (standing.behind) " behind" }
                    }
                }
            }
            div.row aria-hidden="true" {
                b {}
                div.scale {
                    @for tick in [0.05, 0.1, 0.2, 0.5, 1.0, 2.0] { span style={ "left:" (at(tick)) } { (super::number::trimmed(tick, 2)) } }
                }
                span {}
            }
        }
    }
}

fn matrix(outcome: &SuiteOutcome) -> Markup {
    let rivals = rivals(outcome);
    let class = |s: &Standing| match s.verdict {
        Verdict::Ahead => "ahead",
        Verdict::Tie => "",
        Verdict::Behind => "behind",
    };
    html! {
        div.scroll tabindex="0" role="region" aria-label="Relative deficit of foresight, case by case" {
            table {
                thead { tr {
                    th scope="col" { "case" }
                    th scope="col" { "ρ" }
                    @for rival in &rivals { th scope="col" { (printable(rival, 40)) } }
                } }
                tbody {
                    @for case in &outcome.cases {
                        tr {
                            th scope="row" { a href={ "#case-" (case.name) } { (case.name) } }
                            td { (pressures(case)) }
                            @for rival in &rivals {
                                @match standing_of(&case.standings, rival) {
                                    Some(s) => td class=(class(s)) { (fixed(s.relative_deficit, 2)) },
                                    None => td { (NEVER) },
                                }
                            }
                        }
                    }
                    tr.goal {
                        th scope="row" { "all cases" }
                        td {}
                        @for rival in &rivals {
                            td { (optional(standing_of(&outcome.standings, rival).map(|s| s.relative_deficit), 2)) }
                        }
                    }
                }
            }
        }
    }
}

/// Rows as a table, heading first and all cases last.
fn section(case: &CaseOutcome) -> Markup {
    html! {
        section id={ "case-" (case.name) } {
            h2 { (case.name) }
            p.how { (case.why) " " (case.shows) }
            @for replay in &case.replays { (replayed(replay)) }
        }
    }
}

fn replayed(replay: &ReplayOutcome) -> Markup {
    let comparison = &replay.comparison;
    let (inputs, pressure) = (&comparison.inputs, &comparison.pressure);
    let context = Context::new(comparison);
    html! {
        h3 {
            (replay.regime) ": ρ " (significant(pressure.rho)) ", λ " (significant(pressure.lambda)) ", μ " (significant(pressure.mu)) ", "
            (duration(inputs.duration_s)) ", " (mebibytes(inputs.memory_bytes as f64)) " of memory, " (inputs.representations) " representations"
        }
        pre.scroll { code { "foresight-sim " (printable(&replay.command.join(" "), 2000)) } }
        div.scroll tabindex="0" role="region" aria-label="Figures of each policy" {
            table {
                thead { tr {
                    th scope="col" { "policy" }
                    @for metric in &METRICS[..SHOWN] { th scope="col" title=(metric.explained) { (metric.heading) } }
                    th scope="col" { "fetched" }
                    th scope="col" { "wasted" }
                } }
                tbody {
                    @for (index, policy) in comparison.policies.iter().enumerate() {
                        tr {
                            th scope="row" { div.who { (swatch(&stroke_class(index))) span { (printable(&policy.name, 60)) } } }
                            @for metric in &METRICS[..SHOWN] {
                                @let cell = metric.cell(policy, &context);
                                td { (cell.text) @if let Some(half) = &cell.half_width { span.half { " ±" (half) } } }
                            }
                            td { (megabytes(policy.bytes_fetched)) }
                            td { (megabytes(policy.bytes_wasted)) }
                        }
                    }
                    tr.goal {
                        th scope="row" { div.who { (swatch("curve bound")) span { "upper bound" } } }
                        td { (optional(comparison.upper_bound.mean_quality, 3)) }
                        td { (optional(comparison.upper_bound.mean_quality.map(|q| 1.0 - q), 4)) }
                        td {} td {} td {} td {}
                    }
                }
            }
        }
        details {
            summary { "Quality over time, first start" }
            (quality(comparison))
        }
        @for warning in &comparison.warnings { p.note { (printable(warning, 400)) } }
    }
}

fn quality(comparison: &Comparison) -> Markup {
    let series = &comparison.series;
    let last = series.frame_s.iter().copied().filter(|v| drawable(*v)).fold(0.0, f64::max);
    let x = Axis::time(0.0, last, 6);
    let y = Axis::linear(0.0, 1.0, 5, "Q");
    let curve = |q: &[Option<f64>]| lines(&x, &y, &extremes(&series.frame_s, q, CURVE_POINTS));
    let drawing = html! {
        path class=(BOUND_CLASS) d=(curve(&series.bound)) { title { "upper bound" } }
        @for (index, policy) in series.policies.iter().enumerate() {
            path class=(series_class(index)) d=(curve(&policy.quality)) { title { (printable(&policy.name, 80)) } }
        }
    };
    html! {
        div.toggles {
            (legend(series.policies.iter().map(|p| p.name.as_str()), !series.bound.is_empty()))
            (frame("tall", "Quality over time, a curve a policy, and the upper bound", &x, &y, &drawing, &html! {}))
        }
    }
}
