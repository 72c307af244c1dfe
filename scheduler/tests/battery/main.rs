//! The scheduler on stiff, extreme and contradictory inputs: the right answer or a property that must hold, not only
//! the absence of panics.

mod link;
mod motion;
mod nonsense;
mod predictors;
mod session;
mod settings;
mod sums;
mod worlds;
