//! Sessions: connections in front, decision threads behind, and what outlives both.
//!
//! A connection ([`socket`], [`stream`]) reads frames and puts them into its session's [`mailbox`]; the session's decision
//! thread ([`worker`]) works through them turn by turn and puts the answers into the connection's [`outgoing`] queue. Both
//! have bounds, and neither side waits for the other. [`host`] knows which sessions there are; [`recorder`] and
//! [`estimates`] each own a thread for what goes to the disk.

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

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::routing::{any, delete, get, post};
use std::sync::Arc;

/// The addresses of sessions and of the switch.
pub fn routes(host: Arc<Host>) -> Router {
    let most = host.config.message_bytes_max.length();
    Router::new()
        .route("/sessions", post(stream::open))
        .route("/sessions/socket", any(socket::socket))
        .route("/sessions/{id}", delete(stream::close))
        .route("/sessions/{id}/frames", post(stream::frames))
        .route("/sessions/{id}/events", get(stream::events))
        .route("/admin/driving", get(admin::driving).post(admin::set_driving))
        .layer(DefaultBodyLimit::max(most))
        .with_state(host)
}
