//! Proven upper bounds on the mean quality of any policy, and what they say about link and memory.
//!
//! Two bounds, both by weak duality, both for one who knows path and link: [`frame`] bounds every frame by itself,
//! [`over_time`] the replay as a whole, so that bytes spent on one view are not spent on another again and what was
//! discarded has to be fetched again. The second takes the first as one more constraint, so with its best prices it is
//! never above it; [`whole`] takes the smaller of the two. A frame's own bound and the bound over time must not be mixed
//! by taking the smaller one frame by frame: the latter bounds the mean only.

pub mod ascent;
mod elements;
pub mod exact;
pub mod frame;
pub mod over_time;
pub mod prices;
mod seen;
pub mod shadow;
mod targets;
pub mod tiny;
pub mod whole;

pub use exact::exact;
pub use frame::{CheapestBeneath, FrameBound, FrameDual, Limits};
pub use tiny::{Instance, Stratum, bound, tiny, tiny_with_directions};
