//! The bytes of a source's files.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::import::tiles3d::{ContentError, Source, Target, TilesetFolder};

/// Bytes read at a time.
const BUFFER: usize = 1 << 20;

/// A fault in a file.
pub(super) fn fault(file: &Path, place: &str, fault: impl Into<String>) -> ContentError {
    let separator = if place.is_empty() { "" } else { ": " };
    ContentError { place: format!("{}{separator}{place}", file.display()), fault: fault.into() }
}

/// What could not be read of a file.
pub(super) fn unreadable(file: &Path, error: &io::Error) -> ContentError {
    fault(file, "", format!("{error}; expected a file that can be read"))
}

/// The hash over what kind of source it is, its settings, and the bytes of its files.
pub(super) fn identity<'f>(
    kind: &str,
    settings: &[u8],
    files: impl IntoIterator<Item = &'f Path>,
) -> Result<[u8; 32], ContentError> {
    let mut hasher = blake3::Hasher::new();
    let sized = |hasher: &mut blake3::Hasher, bytes: &[u8]| {
        hasher.update(&(bytes.len() as u64).to_le_bytes());
        hasher.update(bytes);
    };
    sized(&mut hasher, kind.as_bytes());
    sized(&mut hasher, settings);
    let mut buffer = vec![0; BUFFER];
    for path in files {
        let mut own = blake3::Hasher::new();
        let mut file = File::open(path).map_err(|error| unreadable(path, &error))?;
        loop {
            match file.read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => own.update(&buffer[..count]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(unreadable(path, &error)),
            };
        }
        sized(&mut hasher, own.finalize().as_bytes());
    }
    Ok(*hasher.finalize().as_bytes())
}

/// Where a file lies that `file` names; `None` for another host, an absolute path, and what leads out of its folder.
pub(super) fn beside(file: &Path, uri: &str) -> Option<PathBuf> {
    let folder = file.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    let folder = TilesetFolder { source: Source::Files(folder), manifest: None };
    match folder.resolve("", uri) {
        Target::File { file, .. } => Some(folder.at(&file)),
        Target::Elsewhere | Target::Outside => None,
    }
}

/// The hash over one file.
#[cfg(feature = "cityjson")]
pub(crate) fn file_identity(kind: &str, file: &Path) -> Result<[u8; 32], ContentError> {
    identity(kind, &[], [file])
}

/// The hash over the parameters of what is generated.
#[cfg(any(feature = "textures", feature = "terrain", feature = "asteroids"))]
pub(crate) fn parameters_identity<P: crate::generate::document::Params>(params: &P) -> Result<[u8; 32], ContentError> {
    let json = serde_json::to_vec(params);
    let json = json.map_err(|error| ContentError { place: P::FORMAT.to_owned(), fault: error.to_string() })?;
    identity(&format!("{}-surfaces-1-{}", P::FORMAT, P::SCHEMA_VERSION), &json, [])
}
