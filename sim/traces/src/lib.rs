//! Camera paths and links, recorded or made, and the models that they are played on: processor sharing on a link, decoding
//! and uploading at a client. The simulator, the server's `--link` and the headless client share them.

#[cfg(feature = "arguments")]
pub mod arguments;
pub mod client;
pub mod flight;
pub mod link;
pub mod path;
pub mod random;
#[cfg(test)]
mod recorded;
mod text_lines;
