//! Choosing: what a representation would add to the objective, and what a discard would take away.

pub mod discard;
pub mod horizon;
