//! Draws on whatever adapter there is, and compares the pictures with what they must be.

mod environment;
mod fading;
mod frames;
mod occlusion;
mod refusals;
mod scene;
mod splats;
