//! Files that appear whole, the lock of a build, and the change from one version to the next.

use super::document::{Document, OctreeParts};
use super::read::Pages;
use super::{StoredError, address};
use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

fn io(file: &Path) -> impl FnOnce(io::Error) -> StoredError + '_ {
    |source| StoredError::Io { file: file.to_owned(), source }
}

/// A world's folder, held by one build: the lock goes with the process, however that ends.
#[derive(Debug)]
pub struct Workplace {
    folder: PathBuf,
    _lock: File,
}

impl Workplace {
    /// Makes the folder if it is not there, and takes its lock. A folder that holds something else is refused.
    ///
    /// # Errors
    /// A folder that cannot be written or holds something else, and a build that is at work.
    pub fn take(folder: &Path) -> Result<Workplace, StoredError> {
        fs::create_dir_all(folder).map_err(io(folder))?;
        let known = [address::DOCUMENT, address::BUILDING, address::LOCK];
        let mut entries = fs::read_dir(folder).map_err(io(folder))?;
        if !known.iter().any(|name| folder.join(name).exists()) && entries.next().is_some() {
            let text = "the folder holds something else; expected a stored world, an empty or a new folder";
            return Err(io(folder)(io::Error::new(io::ErrorKind::AlreadyExists, text)));
        }
        let lock = folder.join(address::LOCK);
        let file = File::options().create(true).truncate(false).write(true).open(&lock).map_err(io(&lock))?;
        match file.try_lock() {
            Ok(()) => Ok(Workplace { folder: folder.to_owned(), _lock: file }),
            Err(TryLockError::WouldBlock) => Err(StoredError::Locked { lock }),
            Err(TryLockError::Error(source)) => Err(StoredError::Io { file: lock, source }),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Writes a file whose name holds its content's hash, unless it is there already: beside its place, then moved there.
    ///
    /// # Errors
    /// A file that cannot be written, a full disk say.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), StoredError> {
        let file = self.folder.join(name);
        if fs::metadata(&file).is_ok_and(|facts| facts.is_file() && facts.len() == bytes.len() as u64) {
            return Ok(());
        }
        self.replace(&file, bytes, false)
    }

    fn replace(&self, file: &Path, bytes: &[u8], durably: bool) -> Result<(), StoredError> {
        let folder = file.parent().unwrap_or(&self.folder);
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        let beside = folder.join(format!("{name}.tmp"));
        let write = || {
            let mut out = match File::create(&beside) {
                Err(error) if error.kind() == io::ErrorKind::NotFound => {
                    fs::create_dir_all(folder)?;
                    File::create(&beside)?
                }
                other => other?,
            };
            out.write_all(bytes)?;
            if durably {
                out.sync_all()?;
            }
            drop(out);
            fs::rename(&beside, file)
        };
        write().map_err(|source| {
            // What is wrong is told; that half a file cannot be removed either is no news.
            let _ = fs::remove_file(&beside);
            StoredError::Io { file: file.to_owned(), source }
        })
    }

    /// Puts a file of the build in progress into its place.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn note(&self, name: &str, bytes: &[u8]) -> Result<(), StoredError> {
        self.replace(&self.folder.join(address::BUILDING).join(name), bytes, false)
    }

    /// Path of a file of the build in progress.
    pub fn noted(&self, name: &str) -> PathBuf {
        self.folder.join(address::BUILDING).join(name)
    }

    /// Removes a file of the build in progress, if it is there.
    ///
    /// # Errors
    /// A file that cannot be removed.
    pub fn strike(&self, name: &str) -> Result<(), StoredError> {
        let file = self.noted(name);
        match fs::remove_file(&file) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io(&file)(error)),
            _ => Ok(()),
        }
    }

    /// Forgets a build in progress.
    ///
    /// # Errors
    /// Files that cannot be removed.
    pub fn forget(&self) -> Result<(), StoredError> {
        let folder = self.folder.join(address::BUILDING);
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(io(&folder)(error)),
            _ => Ok(()),
        }
    }

    /// Publishes a version: everything it names is on the disk before `world.toml` names it.
    ///
    /// # Errors
    /// What cannot be written; then the version before still counts.
    pub fn publish(&self, document: &Document) -> Result<(), StoredError> {
        let file = self.folder.join(address::DOCUMENT);
        let text = document.to_toml().map_err(|error| io(&file)(io::Error::other(error)))?;
        flush(&self.folder).map_err(io(&self.folder))?;
        self.replace(&file, text.as_bytes(), true)?;
        flush(&self.folder).map_err(io(&self.folder))
    }

    /// Removes what neither this version nor the one before names. Returns how many files went.
    ///
    /// # Errors
    /// Pages that cannot be read, files that cannot be removed.
    pub fn sweep(&self, document: &Document) -> Result<u64, StoredError> {
        let mut keep = BTreeSet::new();
        self.named(&document.root, &document.octree, &mut keep)?;
        keep.insert(document.catalogue.clone());
        if let Some(previous) = &document.previous {
            // A version before that is damaged is none: what remains of it goes.
            let mut named = BTreeSet::new();
            if self.named(&previous.root, &previous.octree, &mut named).is_ok() {
                keep.append(&mut named);
            }
            keep.insert(previous.catalogue.clone());
        }
        let mut gone = 0;
        for folder in ["nodes", "orthoviews", "geometry"] {
            self.sweep_folder(folder, &keep, &mut gone)?;
        }
        let entries = fs::read_dir(&self.folder).map_err(io(&self.folder))?;
        for entry in entries {
            let name = entry.map_err(io(&self.folder))?.file_name().to_string_lossy().into_owned();
            if name.starts_with("catalogue.") && !keep.contains(&name) {
                let file = self.folder.join(&name);
                fs::remove_file(&file).map_err(io(&file))?;
                gone += 1;
            }
        }
        Ok(gone)
    }

    /// Names of a version's files.
    fn named(&self, root: &str, octree: &OctreeParts, names: &mut BTreeSet<String>) -> Result<(), StoredError> {
        let Some(octree) = octree.octree() else { return Ok(()) };
        let pages = Pages::new(&self.folder, octree);
        let node = pages.root(root)?;
        pages.visit::<StoredError>(&node, root, &mut |node, page| {
            if !names.contains(page) {
                names.insert(page.to_owned());
            }
            names.extend(node.representations.iter().map(|rep| {
                let (folder, name) = address::representation(node.cell, rep.kind, &rep.hash);
                folder + &name
            }));
            Ok(())
        })
    }

    /// Four levels of folders at most: kind, level, cell, file.
    fn sweep_folder(&self, name: &str, keep: &BTreeSet<String>, gone: &mut u64) -> Result<(), StoredError> {
        let folder = self.folder.join(name);
        let entries = match fs::read_dir(&folder) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            entries => entries.map_err(io(&folder))?,
        };
        let mut is_empty = true;
        for entry in entries {
            let entry = entry.map_err(io(&folder))?;
            let inner = format!("{name}/{}", entry.file_name().to_string_lossy());
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) && inner.split('/').count() <= 3 {
                self.sweep_folder(&inner, keep, gone)?;
                is_empty &= !self.folder.join(&inner).exists();
            } else if keep.contains(&inner) {
                is_empty = false;
            } else {
                let file = self.folder.join(&inner);
                fs::remove_file(&file).map_err(io(&file))?;
                *gone += 1;
            }
        }
        if is_empty && name.contains('/') {
            fs::remove_dir(&folder).map_err(io(&folder))?;
        }
        Ok(())
    }
}

/// Brings everything that was written to the disk.
#[cfg(target_os = "linux")]
fn flush(folder: &Path) -> io::Result<()> {
    Ok(rustix::fs::syncfs(File::open(folder)?)?)
}

/// Elsewhere the system decides when.
#[cfg(not(target_os = "linux"))]
fn flush(_: &Path) -> io::Result<()> {
    Ok(())
}
