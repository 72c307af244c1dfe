//! What should a 3D client download next, and what should it throw away?
//!
//! The crate knows no clock, no socket and no file: time, views and transfers come in as arguments.

pub mod benefit;
pub mod lod_tree;
pub mod policy;
pub mod predict;
pub mod scheduler;
pub mod select;
pub mod state;
pub mod transfer;
pub mod units;
pub mod view;
pub mod worst_case;
