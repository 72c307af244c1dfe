//! Sessions: connections in front, decision threads behind, and what outlives both.
//!
//! A connection (`socket`, `stream`) reads frames and puts them into its session's `mailbox`; the session's decision
//! thread (`worker`) works through them turn by turn and puts the answers into the connection's `outgoing` queue. Both
//! have bounds, and neither side waits for the other. `host` knows which sessions there are; `recorder` and
//! `estimates` each own a thread for what goes to the disk.

pub mod access;
mod admin;
mod estimates;
mod host;
mod hosted;
mod ledger;
mod mailbox;
pub mod metrics;
mod outgoing;
mod rate;
mod recorder;
mod socket;
mod stream;
mod worker;

pub use host::{Host, HostError};

use axum::extract::DefaultBodyLimit;
use axum::routing::any;
use std::sync::Arc;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The addresses of sessions and of the switch. The one of WebSockets is not in the OpenAPI document, which has no words for
/// it.
pub fn routes(host: Arc<Host>) -> OpenApiRouter {
    let most = host.config.message_bytes_max.length();
    OpenApiRouter::new()
        .routes(routes!(stream::open))
        .route("/sessions/socket", any(socket::socket))
        .routes(routes!(stream::close))
        .routes(routes!(stream::frames))
        .routes(routes!(stream::events))
        .routes(routes!(admin::driving, admin::set_driving))
        .layer(DefaultBodyLimit::max(most))
        .with_state(host)
}
