//! The kill switch.

use super::host::Host;
use crate::http::problem::Problem;
use axum::Json;
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Where the switch is to be.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Driving {
    /// Whether clients are told what to do; if not, they fetch by their own rules.
    driving: bool,
    /// For the clients of this world only; for all if absent.
    world: Option<String>,
}

/// How the switch stands.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SwitchState {
    /// Whether clients are told what to do.
    driving: bool,
    /// Worlds whose clients are not, whatever `driving` says.
    not_driven: Vec<String>,
}

fn state(host: &Host) -> Json<SwitchState> {
    let switch = host.switch_state();
    Json(SwitchState { driving: switch.driving, not_driven: switch.not_driven.into_iter().collect() })
}

/// How the kill switch stands
#[utoipa::path(
    get, path = "/admin/driving", tag = "admin",
    responses(
        (status = 200, description = "How it stands", body = SwitchState),
        (status = 401, description = "Without the token", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "From a page of another origin", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn driving(State(host): State<Arc<Host>>) -> Json<SwitchState> {
    state(&host)
}

/// Moves the kill switch: all sessions are told
#[utoipa::path(
    post, path = "/admin/driving", tag = "admin", request_body = Driving,
    responses(
        (status = 200, description = "How it stands now", body = SwitchState),
        (status = 400, description = "No JSON", body = Problem, content_type = "application/problem+json"),
        (status = 401, description = "Without the token", body = Problem, content_type = "application/problem+json"),
        (status = 403, description = "From a page of another origin", body = Problem, content_type = "application/problem+json"),
        (status = 404, description = "No such world", body = Problem, content_type = "application/problem+json"),
        (status = 413, description = "Too large", body = Problem, content_type = "application/problem+json"),
        (status = 415, description = "Not application/json", body = Problem, content_type = "application/problem+json"),
        (status = 422, description = "Not what was expected", body = Problem, content_type = "application/problem+json"),
    )
)]
pub(super) async fn set_driving(
    State(host): State<Arc<Host>>,
    asked: Result<Json<Driving>, JsonRejection>,
) -> Result<Json<SwitchState>, Problem> {
    let Json(asked) = asked.map_err(|rejection| Problem::new(rejection.status(), rejection.body_text()))?;
    if host.set_driving(asked.driving, asked.world.as_deref()) {
        Ok(state(&host))
    } else {
        Err(Problem::not_found("no world of this name; GET /worlds lists those that there are"))
    }
}
