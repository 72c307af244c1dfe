//! What the end-to-end tests share: running the built programs, inputs written by the test itself, recorded data, the
//! byte-level parsers that the fuzz corpora exercise, a browser, the comparison with real viewers, the sidecar's programs, and what a stored world has to show, a desktop.

pub mod chromium;
pub mod delivery;
pub mod desktop;
pub mod fidelity;
pub mod input;
pub mod parser;
pub mod postgres;
pub mod program;
pub mod session;
pub mod sidecar;
pub mod stored;

use std::path::{Path, PathBuf};

pub use parser::entry;

/// Whether the long tests are asked for. If not, the caller prints the returned reason and returns.
pub fn full() -> Result<(), &'static str> {
    if std::env::var_os("FORESIGHT_FULL").is_some_and(|value| value == "1") {
        Ok(())
    } else {
        Err("skipped: needs tests/run --full")
    }
}

/// Folder of recorded worlds, paths and links: `FORESIGHT_DATA`, else `../shared/data` beside the workspace.
///
/// `None`, with a line that says so, where there is none.
///
/// # Panics
/// Where there is none and the environment has `CI=true`.
pub fn data() -> Option<PathBuf> {
    if let Some(folder) = data_folder() {
        return Some(folder);
    }
    let folder = data_place();
    assert!(
        std::env::var_os("CI").is_none_or(|value| value != "true"),
        "no test data at {}; expected a folder there or in FORESIGHT_DATA",
        folder.display()
    );
    println!("skipped: no test data at {}", folder.display());
    None
}

/// The same folder without a word where it is absent.
pub fn data_folder() -> Option<PathBuf> {
    Some(data_place()).filter(|folder| folder.is_dir())
}

fn data_place() -> PathBuf {
    match std::env::var_os("FORESIGHT_DATA") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
    }
}
