#![doc = include_str!("../README.md")]

pub mod benefit;
pub mod estimate;
mod excess;
pub mod integral;
pub mod lod_tree;
pub mod policy;
pub mod predict;
pub mod scheduler;
pub mod select;
pub mod setting;
mod sparse;
pub mod state;
pub mod transfer;
pub mod units;
pub mod view;
pub mod worst_case;
