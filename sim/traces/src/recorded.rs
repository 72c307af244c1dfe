//! Where the tests find recorded paths and links.

use std::path::PathBuf;

/// A folder of the recordings, or `None` where they are absent and that is allowed.
pub(crate) fn data(folder: &str) -> Option<PathBuf> {
    let root = std::env::var_os("FORESIGHT_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let folder = root.join(folder);
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(std::env::var("CI").as_deref() != Ok("true"), "{} is absent", folder.display());
    println!("skipped: {} is absent", folder.display());
    None
}
