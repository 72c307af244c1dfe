//! What a client and the sidecar say to each other, and the session that answers. No socket and no clock: times are
//! arguments, bytes are slices.

pub mod encoding;
mod finite;
pub mod message;
pub mod recording;
#[cfg(feature = "schema")]
pub mod schema;
pub mod session;
