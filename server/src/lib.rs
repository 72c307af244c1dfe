//! Builds worlds, serves them over HTTP and hosts schedulers for the clients that fly through them.

pub mod browser;
pub mod build;
pub mod clock;
pub mod config;
pub mod http;
pub mod log;
pub mod serve;
pub mod session;
