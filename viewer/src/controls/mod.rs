//! Moving the camera by hand: flying, walking and orbiting, as functions of what is pressed and of the time that has passed.
//! No window and no clock; what a key means stands in [`bindings`].

pub mod bindings;
pub mod capture;
pub mod recorder;
pub mod rig;
pub mod surroundings;
