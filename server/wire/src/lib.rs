//! What a client and the sidecar say to each other. No socket and no clock: times are arguments, bytes are slices.

pub mod encoding;
pub mod message;
