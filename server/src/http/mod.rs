//! Worlds over HTTP.

mod api;
mod body;
mod connection;
mod content;
pub mod encoding;
pub mod entity_tag;
mod filler;
pub mod limits;
pub mod listener;
mod media;
pub mod metrics;
mod page;
pub mod path;
pub mod priority;
pub mod problem;
pub mod range;
pub mod shaping;
pub mod state;
pub mod store;
pub mod worlds;

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderName, Method, StatusCode};
use axum::routing::get;
use tower_http::cors::{Any, CorsLayer};
use tower_http::timeout::RequestBodyTimeoutLayer;
use utoipa_axum::router::OpenApiRouter;
use utoipa_swagger_ui::{Config, SwaggerUi};

use problem::Problem;
use state::AppState;

/// Fields of responses that pages of other origins may read.
const EXPOSED: [&str; 9] = [
    "accept-ranges",
    "content-encoding",
    "content-length",
    "content-range",
    "date",
    "etag",
    "priority",
    "retry-after",
    "server-timing",
];

/// Fields of requests that pages of other origins may send, beside those that need no leave.
const ALLOWED: [&str; 14] = [
    "authorization",
    "cache-control",
    "content-encoding",
    "content-type",
    "foresight-session",
    "if-match",
    "if-modified-since",
    "if-none-match",
    "if-range",
    "if-unmodified-since",
    "last-event-id",
    "pragma",
    "priority",
    "range",
];

/// All addresses of the server: worlds, health, metrics and documentation, and `others` with theirs.
pub fn router(state: Arc<AppState>, others: OpenApiRouter) -> Router {
    let (addresses, document) = api::addresses(state.clone()).merge(others).split_for_parts();
    let documentation =
        SwaggerUi::new("/docs").config(Config::default().validator_url("none")).url("/openapi.json", document);
    let cors = CorsLayer::new()
        .allow_origin(Any)
        .allow_methods([Method::GET, Method::HEAD, Method::POST, Method::DELETE])
        .allow_headers(ALLOWED.map(HeaderName::from_static))
        .expose_headers(EXPOSED.map(HeaderName::from_static))
        .max_age(Duration::from_secs(86_400));
    let pages = Router::new().route("/", get(page::page)).with_state(state.clone());
    Router::new()
        .merge(addresses)
        .merge(pages)
        .merge(crate::browser::routes())
        .layer(RequestBodyTimeoutLayer::new(state.limits.body_within))
        .layer(DefaultBodyLimit::max(state.limits.body_bytes))
        .merge(documentation)
        .fallback(|| async { Problem::not_found("there is nothing at this address") })
        .method_not_allowed_fallback(|| async {
            Problem::new(StatusCode::METHOD_NOT_ALLOWED, "this address takes other methods; see Allow")
        })
        .layer(cors)
}
