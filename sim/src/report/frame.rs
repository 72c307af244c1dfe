//! What every page shares: one file without script, and tables that scroll by themselves.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::plot::toggle_rules;

/// A whole page. `series` is the largest number of series that one of its plots shows or hides.
pub(super) fn document(title: &str, series: usize, header: Markup, main: Markup) -> String {
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { "Foresight: " (title) }
                style { (PreEscaped(include_str!("style.css"))) (PreEscaped(toggle_rules(series))) }
            }
            body {
                header { p.brand { "Foresight" } (header) }
                main { (main) }
            }
        }
    };
    markup.into_string()
}

/// A table of words and figures under the heads of its first row; the first of each row names it. `sums_up` sets the
/// last row apart.
pub(super) fn table(label: &str, rows: &[Vec<String>], sums_up: bool) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(label) {
            table {
                thead { tr { @for cell in &rows[0] { th scope="col" { (cell) } } } }
                tbody {
                    @for (index, row) in rows.iter().enumerate().skip(1) {
                        tr.goal[sums_up && index + 1 == rows.len()] {
                            th scope="row" { (row[0]) }
                            @for cell in &row[1..] { td { (cell) } }
                        }
                    }
                }
            }
        }
    }
}
