//! JSON Schema of the messages, from their types.

use crate::message::{ClientMessage, ServerMessage};
use schemars::{Schema, schema_for};

/// A frame from a client: a list of [`ClientMessage`].
pub fn client_frame() -> Schema {
    schema_for!(Vec<ClientMessage>)
}

/// A frame from the server: a list of [`ServerMessage`].
pub fn server_frame() -> Schema {
    schema_for!(Vec<ServerMessage>)
}
