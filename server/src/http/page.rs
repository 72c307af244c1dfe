//! The page at `/`.

use std::sync::Arc;

use axum::extract::State;
use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use maud::{DOCTYPE, html};

use super::state::AppState;

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}\
table{border-collapse:collapse;width:100%}th,td{text-align:left;padding:.3rem .8rem .3rem 0;border-bottom:1px solid #8886}\
td.n,th.n{text-align:right}";

/// Worlds, and where to go from here.
pub(super) async fn page(State(state): State<Arc<AppState>>) -> Response {
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { "Foresight" }
                style { (STYLE) }
            }
            body {
                h1 { "Foresight" }
                table {
                    tr { th { "World" } th { "Made from" } th { "Content" } th .n { "Representations" } th .n { "MB on the wire" } th { "For stock clients" } }
                    @for world in state.worlds.iter() {
                        @let facts = &world.facts;
                        tr {
                            td { a href={ "/worlds/" (facts.name) } { (facts.name) } }
                            td { (facts.kind) }
                            td { (facts.content) }
                            td .n { (facts.representations) }
                            td .n { (format!("{:.1}", facts.wire_bytes as f64 / 1e6)) }
                            td { @if let Some(entry) = &facts.entry { a href=(entry) { "tileset" } } }
                        }
                    }
                }
                p {
                    a href="/fly/" { "Fly in the browser" } " · "
                    a href="/docs/" { "Interface" } " · "
                    a href="/metrics" { "Metrics" }
                    @if let Some(links) = &state.links { " · responses are shaped: " (links.trace().name()) }
                }
            }
        }
    };
    let policy = "default-src 'none'; style-src 'unsafe-inline'";
    ([(header::CONTENT_SECURITY_POLICY, policy)], Html(markup.into_string())).into_response()
}
