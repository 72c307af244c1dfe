//! Draws on whatever adapter there is, and compares the pictures with what they must be.

mod scene;
mod splats;
