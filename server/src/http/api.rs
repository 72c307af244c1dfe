//! The documented addresses.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{HeaderName, StatusCode};
use axum::routing::get;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use super::content;
use super::problem::Problem;
use super::state::AppState;
use super::worlds::WorldFacts;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Foresight",
        description = "Worlds over HTTP, and sessions that tell clients what to fetch next.",
        license(name = "MIT OR Apache-2.0")
    ),
    paths(content::immutable, content::revalidated)
)]
struct Document;

/// Worlds, content, health and metrics.
pub(super) fn addresses(state: Arc<AppState>) -> OpenApiRouter {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(list))
        .routes(routes!(facts))
        .route("/worlds/{name}/files/{*path}", get(content::revalidated))
        .route("/worlds/{name}/{identity}/{*path}", get(content::immutable))
        .routes(routes!(live))
        .routes(routes!(ready))
        .routes(routes!(metrics))
        .with_state(state)
}

/// The worlds that there are
#[utoipa::path(get, path = "/worlds", tag = "worlds", responses((status = 200, body = Vec<WorldFacts>)))]
async fn list(State(state): State<Arc<AppState>>) -> Json<Vec<WorldFacts>> {
    Json(state.worlds.iter().map(|world| world.facts.clone()).collect())
}

/// A world
#[utoipa::path(
    get, path = "/worlds/{name}", tag = "worlds",
    params(("name" = String, Path, description = "Name of the world")),
    responses(
        (status = 200, body = WorldFacts),
        (status = 400, description = "A name that is not UTF-8"),
        (status = 404, body = Problem, content_type = "application/problem+json"),
    )
)]
async fn facts(State(state): State<Arc<AppState>>, Path(name): Path<String>) -> Result<Json<WorldFacts>, Problem> {
    Ok(Json(state.world(&name)?.facts.clone()))
}

/// Whether the process works
#[utoipa::path(get, path = "/health/live", tag = "operation", responses((status = 200, body = String)))]
async fn live() -> &'static str {
    "live\n"
}

/// Whether new clients are welcome
#[utoipa::path(
    get, path = "/health/ready", tag = "operation",
    responses((status = 200, body = String), (status = 503, body = Problem, content_type = "application/problem+json"))
)]
async fn ready(State(state): State<Arc<AppState>>) -> Result<String, Problem> {
    if !state.is_ready() {
        return Err(Problem::busy("the server is ending", 5));
    }
    Ok(state.degraded().map_or_else(|| "ready\n".to_owned(), |why| format!("ready, degraded: {why}\n")))
}

/// Counters, for Prometheus
#[utoipa::path(get, path = "/metrics", tag = "operation", responses((status = 200, body = String, content_type = "application/openmetrics-text")))]
async fn metrics(State(state): State<Arc<AppState>>) -> (StatusCode, [(HeaderName, &'static str); 1], String) {
    let media = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    (StatusCode::OK, [(CONTENT_TYPE, media)], state.metrics.text())
}
