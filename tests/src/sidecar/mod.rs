//! The server and the headless client as processes, what comes between them, and what their flights came to.

pub mod case;
pub mod client;
pub mod flown;
pub mod process;
pub mod proxy;
pub mod slope;
