//! Files that are made while flying: numbered, written beside their place and then renamed to it.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Files of a kind in a folder; more are refused.
const FILES_MAX: u32 = 9999;

/// Why a file could not be made.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The file system refuses.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// All numbers are taken.
    #[error("{} has {FILES_MAX} files named {stem}-NNNN; expected a folder with room", folder.display())]
    Full {
        /// The folder.
        folder: PathBuf,
        /// What they are called.
        stem: &'static str,
    },
    /// What is to be written is no picture.
    #[error("a picture of {0} × {1} pixels in {2} bytes; expected 4 bytes a pixel")]
    Picture(u32, u32, usize),
    /// What is to be written is no pose.
    #[error(transparent)]
    Pose(#[from] foresight_traces::path::PathError),
}

/// A file that is being written.
#[derive(Debug)]
pub struct Beside {
    beside: PathBuf,
    file: PathBuf,
}

impl Beside {
    /// Opens the first free one of `STEM-0001.END`, `STEM-0002.END`, … in a folder, which is made if it is missing.
    ///
    /// # Errors
    /// What the file system says, or no free number.
    pub fn create(folder: &Path, stem: &'static str, end: &str) -> Result<(Beside, File), CaptureError> {
        let io = |file: &Path, source| CaptureError::Io { file: file.to_owned(), source };
        std::fs::create_dir_all(folder).map_err(|source| io(folder, source))?;
        for number in 1..=FILES_MAX {
            let file = folder.join(format!("{stem}-{number:04}.{end}"));
            let beside = folder.join(format!("{stem}-{number:04}.{end}.part"));
            if file.exists() {
                continue;
            }
            match File::create_new(&beside) {
                Ok(open) => return Ok((Beside { beside, file }, open)),
                Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
                Err(source) => return Err(io(&beside, source)),
            }
        }
        Err(CaptureError::Full { folder: folder.to_owned(), stem })
    }

    /// Where it will be.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Puts it into its place.
    ///
    /// # Errors
    /// What the file system says.
    pub fn keep(self) -> Result<PathBuf, CaptureError> {
        match std::fs::rename(&self.beside, &self.file) {
            Ok(()) => Ok(self.file),
            Err(source) => Err(CaptureError::Io { file: self.file, source }),
        }
    }

    /// Throws it away.
    pub fn discard(self) {
        // What cannot be deleted stays beside; its name says what it is.
        let _ = std::fs::remove_file(self.beside);
    }
}

/// Writes a picture as `screenshot-NNNN.png`: sRGB with opacity, the top row first.
///
/// # Errors
/// A size that does not fit the bytes, what the file system says, no free number.
pub fn screenshot(folder: &Path, [width, height]: [u32; 2], rgba: &[u8]) -> Result<PathBuf, CaptureError> {
    use image::ImageEncoder;
    if (u64::from(width) * u64::from(height)).saturating_mul(4) != rgba.len() as u64 || rgba.is_empty() {
        return Err(CaptureError::Picture(width, height, rgba.len()));
    }
    let (beside, file) = Beside::create(folder, "screenshot", "png")?;
    let written = image::codecs::png::PngEncoder::new(BufWriter::new(file)).write_image(
        rgba,
        width,
        height,
        image::ExtendedColorType::Rgba8,
    );
    match written {
        Ok(()) => beside.keep(),
        Err(error) => {
            let file = beside.file().to_owned();
            beside.discard();
            Err(CaptureError::Io { file, source: std::io::Error::other(error) })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn screenshots_are_numbered_and_whole() {
        let folder = tempfile::tempdir().unwrap();
        let rgba = [255, 0, 0, 255, 0, 255, 0, 255];
        let first = screenshot(folder.path(), [2, 1], &rgba).unwrap();
        let second = screenshot(folder.path(), [1, 2], &rgba).unwrap();
        assert!(first.ends_with("screenshot-0001.png") && second.ends_with("screenshot-0002.png"));
        let read = image::open(&first).unwrap().into_rgba8();
        assert_eq!((read.dimensions(), read.as_raw().as_slice()), ((2, 1), &rgba[..]));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
        for size in [[3, 1], [0, 0], [u32::MAX, u32::MAX]] {
            assert!(matches!(screenshot(folder.path(), size, &rgba), Err(CaptureError::Picture(..))));
        }
        let nowhere = first.join("below");
        assert!(screenshot(&nowhere, [2, 1], &rgba).unwrap_err().to_string().contains("below"));
    }
}
