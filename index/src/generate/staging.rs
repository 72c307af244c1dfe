//! A folder that appears whole or not at all: written beside its place, then renamed.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A folder being written. Dropped without [`Staging::finish`], it is removed.
#[derive(Debug)]
pub(crate) struct Staging {
    out: PathBuf,
    at: PathBuf,
    finished: bool,
}

impl Staging {
    /// Begins a folder that will be `out`, which must not exist or be an empty folder.
    pub(crate) fn begin(out: &Path) -> io::Result<Staging> {
        let taken = |text: String| io::Error::new(io::ErrorKind::AlreadyExists, text);
        match fs::read_dir(out).map(|mut entries| entries.next().is_some()) {
            Ok(true) => {
                return Err(taken("the folder is not empty; expected a new or an empty one".to_owned()));
            }
            Ok(false) => {}
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let name =
            out.file_name().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "not the name of a folder"))?;
        let at = out.with_file_name(format!(".{}.tmp", name.to_string_lossy()));
        if let Some(parent) = at.parent() {
            fs::create_dir_all(parent)?;
        }
        match fs::create_dir(&at) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(taken(format!(
                "{} is there, left by an earlier or by another run; expected it removed",
                at.display()
            ))),
            Err(error) => Err(error),
            Ok(()) => Ok(Staging { out: out.to_owned(), at, finished: false }),
        }
    }

    /// A place inside, its folders made. `file` is relative, with `/`.
    pub(crate) fn place(&self, file: &str) -> io::Result<PathBuf> {
        let place = self.at.join(file);
        if let Some(parent) = place.parent() {
            fs::create_dir_all(parent)?;
        }
        Ok(place)
    }

    /// Puts the folder in its place.
    pub(crate) fn finish(mut self) -> io::Result<()> {
        if self.out.is_dir() {
            // Refused by the file system if something was put there meanwhile.
            fs::remove_dir(&self.out)?;
        }
        fs::rename(&self.at, &self.out)?;
        self.finished = true;
        Ok(())
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.finished {
            // Nothing can be done about a folder that cannot be removed; the next run names it.
            fs::remove_dir_all(&self.at).unwrap_or_default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_or_not_at_all() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let out = folder.path().join("a/world");
        let staging = Staging::begin(&out)?;
        fs::write(staging.place("x/y.txt")?, "1")?;
        assert_eq!(Staging::begin(&out).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        drop(staging);
        assert!(fs::read_dir(folder.path().join("a"))?.next().is_none());
        fs::create_dir(&out)?;
        let staging = Staging::begin(&out)?;
        fs::write(staging.place("x/y.txt")?, "1")?;
        staging.finish()?;
        assert_eq!(fs::read_to_string(out.join("x/y.txt"))?, "1");
        assert_eq!(Staging::begin(&out).unwrap_err().kind(), io::ErrorKind::AlreadyExists);
        Ok(())
    }
}
