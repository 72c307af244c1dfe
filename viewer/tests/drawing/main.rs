//! Draws on whatever adapter there is, and compares the pictures with what they must be.

mod fading;
mod occlusion;
mod scene;
mod splats;
