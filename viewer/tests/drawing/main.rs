//! Draws on whatever adapter there is, and compares the pictures with what they must be.

mod frames;
mod refusals;
mod scene;
mod splats;
