//! From what a command line names to a source of surfaces.

use std::path::{Path, PathBuf};

use super::SurfaceSource;
use crate::import::tiles3d::surface::FinestContents;
use crate::import::tiles3d::{ContentError, Tiles3dError};
use crate::specification::Progress;

/// Why there are no surfaces to be had.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceError {
    /// It cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// What was to be read.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A tileset is at fault.
    #[error(transparent)]
    Tiles3d(#[from] Tiles3dError),
    /// What a file holds is at fault.
    #[error(transparent)]
    Content(#[from] ContentError),
}

/// Opens the surfaces of `input`, recognised by its content: a folder with a `tileset.json`, or a tileset.
///
/// # Errors
/// What cannot be read or is not recognised.
pub fn open(input: &str, progress: &Progress) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    progress(0, 1);
    let path = Path::new(input);
    let file = if path.is_dir() { path.join("tileset.json") } else { path.to_owned() };
    let source = FinestContents::open(&file)?;
    progress(1, 1);
    Ok(Box::new(source))
}
