//! Which representation to take, and which to give up.

pub mod certified;
pub mod discard;
pub mod horizon;
