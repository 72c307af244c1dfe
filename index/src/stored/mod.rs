//! Stored worlds: a folder of files that never change, and one document that names the version that counts.
//!
//! ```text
//! world.toml                             what is in it; the only file that changes
//! nodes/L/x_y_z.HASH.page                the tree, in pages
//! orthoviews/L/x_y_z/DIRECTION.HASH.fsov
//! geometry/x_y_z/LEVEL.HASH.glb          of leaves, 0 the finest
//! catalogue.IDENTITY.sqlite
//! building/, build.lock                  of a build in progress
//! ```
//!
//! L is a cell's level above the leaves. Publishing a version is renaming a new `world.toml` over the old one; readers see
//! the one or the other. Files of the version before stay until the next is published.

pub mod address;
#[cfg(feature = "orthoviews")]
pub mod checkpoint;
pub mod document;
pub mod packing;
pub mod page;
pub mod publish;
mod read;
#[cfg(test)]
mod tests;

pub use document::Document;
pub use read::{Pages, open, open_document};

use std::path::PathBuf;

/// Why a stored world cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum StoredError {
    /// A file cannot be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// Which.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The document is at fault.
    #[error("{}: {source}", file.display())]
    Document {
        /// The file.
        file: PathBuf,
        /// The fault.
        source: document::DocumentError,
    },
    /// A page is at fault.
    #[error("{}: {source}", page.display())]
    Page {
        /// The file.
        page: PathBuf,
        /// The fault, by its byte.
        source: page::PageError,
    },
    /// The nodes make no tree.
    #[error("{}: {source}", file.display())]
    Tree {
        /// The document.
        file: PathBuf,
        /// Why not.
        source: foresight_scheduler::lod_tree::LodTreeError,
    },
    /// Another build is at work.
    #[error("{}: another build is at work on this world; expected it to end first", lock.display())]
    Locked {
        /// The file that it holds.
        lock: PathBuf,
    },
}
