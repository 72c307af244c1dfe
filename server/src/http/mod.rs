//! Worlds over HTTP.

mod body;
mod content;
mod encoding;
mod filler;
pub mod listener;
mod media;
pub mod metrics;
pub mod path;
pub mod problem;
mod range;
pub mod state;
pub mod store;
pub mod worlds;

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::routing::get;
use axum::{Json, Router};
use tower_http::cors::{Any, CorsLayer};

use problem::Problem;
use state::AppState;
use worlds::WorldFacts;

/// All addresses of the server.
pub fn router(state: Arc<AppState>) -> Router {
    let exposed = [
        "accept-ranges",
        "content-encoding",
        "content-length",
        "content-range",
        "etag",
        "priority",
        "retry-after",
        "server-timing",
    ];
    let cors = CorsLayer::new()
        .allow_origin(Any)
        .allow_methods(Any)
        .allow_headers(Any)
        .expose_headers(exposed.map(axum::http::HeaderName::from_static))
        .max_age(std::time::Duration::from_secs(86_400));
    Router::new()
        .route("/worlds", get(list))
        .route("/worlds/{name}", get(facts))
        .route("/worlds/{name}/files/{*path}", get(content::revalidated))
        .route("/worlds/{name}/{identity}/{*path}", get(content::immutable))
        .route("/health/live", get(|| async { "live\n" }))
        .route("/health/ready", get(|| async { "ready\n" }))
        .route("/metrics", get(metrics_text))
        .fallback(|| async { Problem::not_found("there is nothing at this address") })
        .method_not_allowed_fallback(|| async {
            Problem::new(StatusCode::METHOD_NOT_ALLOWED, "this address takes other methods; see Allow")
        })
        .with_state(state)
        .layer(cors)
}

async fn list(State(state): State<Arc<AppState>>) -> Json<Vec<WorldFacts>> {
    Json(state.worlds.iter().map(|world| world.facts.clone()).collect())
}

async fn facts(State(state): State<Arc<AppState>>, Path(name): Path<String>) -> Result<Json<WorldFacts>, Problem> {
    Ok(Json(state.world(&name)?.facts.clone()))
}

async fn metrics_text(State(state): State<Arc<AppState>>) -> ([(axum::http::HeaderName, &'static str); 1], String) {
    let media = "application/openmetrics-text; version=1.0.0; charset=utf-8";
    ([(axum::http::header::CONTENT_TYPE, media)], state.metrics.text())
}
