//! Where a tileset's files come from.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

#[cfg(feature = "http")]
use super::http::Http;

/// Folder of a mosaic in which its source lies.
pub(crate) const MOSAIC_SOURCE: &str = "source/";

/// Where a tileset's files come from. Names are relative, with `/`, and never lead out.
#[derive(Debug)]
pub(crate) enum Source {
    /// A folder.
    Files(PathBuf),
    /// A mosaic that is not written: its root document, and the source's folder as [`MOSAIC_SOURCE`].
    Mosaic {
        /// The root document.
        tileset: Vec<u8>,
        /// The source's folder.
        source: PathBuf,
    },
    /// A folder of a server.
    #[cfg(feature = "http")]
    Http(Http),
}

impl Source {
    /// The bytes of a file as they are stored and sent.
    pub(crate) fn read(&self, file: &str) -> io::Result<Vec<u8>> {
        match self {
            Source::Files(_) => std::fs::read(self.at(file)),
            Source::Mosaic { tileset, .. } if !file.starts_with(MOSAIC_SOURCE) => Ok(tileset.clone()),
            Source::Mosaic { .. } => std::fs::read(self.at(file)),
            #[cfg(feature = "http")]
            Source::Http(http) => http.read(file),
        }
    }

    /// The first byte of a file, if there is one.
    pub(crate) fn first_byte(&self, file: &str) -> Option<u8> {
        match self {
            #[cfg(feature = "http")]
            Source::Http(http) => http.first_byte(file),
            _ => {
                let mut first = [0];
                File::open(self.at(file)).and_then(|mut file| file.read_exact(&mut first)).ok()?;
                Some(first[0])
            }
        }
    }

    /// Where a file lies: its path, or its URL.
    pub(crate) fn at(&self, file: &str) -> PathBuf {
        match self {
            Source::Files(folder) => folder.join(Path::new(file)),
            Source::Mosaic { source, .. } => match file.strip_prefix(MOSAIC_SOURCE) {
                Some(file) => source.join(Path::new(file)),
                None => PathBuf::from(file),
            },
            #[cfg(feature = "http")]
            Source::Http(http) => PathBuf::from(http.url(file)),
        }
    }

    /// Runs work that reads many files in parallel, as far as that serves the source.
    pub(crate) fn in_parallel<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        match self {
            #[cfg(feature = "http")]
            Source::Http(http) => http.in_parallel(work),
            _ => work(),
        }
    }
}
