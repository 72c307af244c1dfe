//! A client with its scheduler in-process, on a modelled link: [`simulation::Simulation`] is told one view at a time,
//! [`replay::replay`] flies a whole flight and keeps what came of it. The simulator and the viewer drive the same code.
//! It reads no clock and does no I/O.

pub mod future;
pub mod replay;
pub mod simulation;
