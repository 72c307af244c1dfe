//! A session of a server.

use super::WindowError;
use crate::clock::Clock;
use crate::exchange::Exchange;
use crate::fetch::Http;
use crate::session::{Drawn, Plan, fly_drawn};

/// Does what the server says until the exchange is left.
pub(super) fn drive(
    plan: &Plan,
    http: &Http,
    runtime: &tokio::runtime::Runtime,
    exchange: &Exchange,
    clock: Clock,
) -> Result<(), WindowError> {
    let drawn = Drawn { plan, exchange, clock, http: http.clone() };
    match runtime.block_on(fly_drawn(drawn)) {
        Ok(_) => Ok(()),
        Err(error) => Err(WindowError::Session(error.to_string())),
    }
}
