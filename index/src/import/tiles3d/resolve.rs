//! From the addresses in a tileset to files in its folder.

use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;

use super::limits::MAX_INFLATED;
use super::source::Source;
use crate::manifest::Manifest;

/// The folder of a root tileset, with the manifest beside it if there is one.
#[derive(Debug)]
pub(crate) struct Folder {
    pub(crate) source: Source,
    pub(crate) manifest: Option<Manifest>,
}

/// What an address leads to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// A file in the folder.
    File {
        /// Path relative to the folder, with `/`.
        file: String,
        /// True if it only stands in for what the address means.
        stand_in: bool,
    },
    /// Another scheme: on another host, or inline.
    Elsewhere,
    /// A path out of the folder.
    Outside,
}

impl Folder {
    /// Resolves `uri` as written in a document whose own address has the folder `base` (ending in `/`, or empty).
    pub(crate) fn resolve(&self, base: &str, uri: &str) -> Target {
        if has_scheme(uri) || uri.starts_with("//") {
            return Target::Elsewhere;
        }
        let Some(address) = normalised(base, path_of(uri)) else {
            return Target::Outside;
        };
        let (file, stand_in) = match &self.manifest {
            Some(manifest) => manifest.file(&address),
            None => (address, false),
        };
        Target::File { file, stand_in }
    }

    /// The whole content of a file of the folder, inflated if it is stored as gzip.
    pub(crate) fn read(&self, file: &str) -> std::io::Result<Vec<u8>> {
        Ok(self.read_stored(file)?.0)
    }

    /// As [`Folder::read`], with the bytes that the file has as it is stored and sent.
    pub(crate) fn read_stored(&self, file: &str) -> std::io::Result<(Vec<u8>, u64)> {
        let stored = self.source.read(file)?;
        let length = stored.len() as u64;
        if !stored.starts_with(b"\x1F\x8B") {
            return Ok((stored, length));
        }
        let mut bytes = Vec::new();
        MultiGzDecoder::new(stored.as_slice()).take(MAX_INFLATED + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > MAX_INFLATED {
            let text = format!("gzip of more than {MAX_INFLATED} bytes; expected at most that");
            return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, text));
        }
        Ok((bytes, length))
    }

    /// Where a file of the folder lies: its path, or its URL.
    pub(crate) fn at(&self, file: &str) -> PathBuf {
        self.source.at(file)
    }

    /// Reads what `uri` names in a document at `base`: the file and its bytes. `None` if it is not a file of the folder.
    pub(crate) fn fetch(&self, base: &str, uri: &str) -> Option<(String, Vec<u8>)> {
        match self.resolve(base, uri) {
            Target::File { file, .. } => {
                let bytes = self.read(&file).ok()?;
                Some((file, bytes))
            }
            Target::Elsewhere | Target::Outside => None,
        }
    }

    /// True for a tileset: by its name, or where the name says nothing by a first byte that begins JSON.
    pub(crate) fn is_document(&self, file: &str) -> bool {
        let extension = Path::new(file).extension().map(|extension| extension.to_string_lossy().to_ascii_lowercase());
        match extension.as_deref() {
            Some("json") => true,
            Some("b3dm" | "glb" | "gltf" | "i3dm" | "pnts" | "cmpt") => false,
            // JSON, or gzip, in which there is JSON rather than a content without an extension.
            _ => matches!(self.source.first_byte(file), Some(b'{' | 0x1F)),
        }
    }
}

/// The folder of an address: up to and with its last `/`, its query left out.
pub(crate) fn folder_of(address: &str) -> &str {
    let path = path_of(address);
    path.rfind('/').map_or("", |end| &path[..=end])
}

/// Without query and fragment.
fn path_of(uri: &str) -> &str {
    uri.find(['?', '#']).map_or(uri, |end| &uri[..end])
}

fn has_scheme(uri: &str) -> bool {
    let Some((scheme, _)) = uri.split_once(':') else {
        return false;
    };
    scheme.starts_with(|c: char| c.is_ascii_alphabetic())
        && scheme.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.'))
}

/// `base` and `path` joined, percent signs decoded, `.` and `..` taken out. `None` if it leaves the root, is absolute,
/// or names no file.
fn normalised(base: &str, path: &str) -> Option<String> {
    let path = percent_decoded(path)?;
    if path.starts_with('/') || path.contains(['\\', '\0']) {
        return None;
    }
    let mut parts: Vec<&str> = Vec::new();
    for part in base.split('/').chain(path.split('/')) {
        match part {
            "" | "." => {}
            ".." => {
                parts.pop()?;
            }
            part => parts.push(part),
        }
    }
    (!parts.is_empty()).then(|| parts.join("/"))
}

pub(super) fn percent_decoded(text: &str) -> Option<String> {
    if !text.contains('%') {
        return Some(text.to_owned());
    }
    let bytes = text.as_bytes();
    let mut decoded = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let hex = (bytes[at] == b'%').then(|| text.get(at + 1..at + 3)).flatten();
        match hex.and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => {
                decoded.push(byte);
                at += 3;
            }
            None => {
                decoded.push(bytes[at]);
                at += 1;
            }
        }
    }
    String::from_utf8(decoded).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_stay_inside() {
        let folder = Folder { source: Source::Files(PathBuf::from("w")), manifest: None };
        let file = |base: &str, uri: &str| match folder.resolve(base, uri) {
            Target::File { file, .. } => file,
            other => format!("{other:?}"),
        };
        assert_eq!(file("", "a/b.glb?v=3#x"), "a/b.glb");
        assert_eq!(file("a/b/", "../c%20d.glb"), "a/c d.glb");
        assert_eq!(file("a/", "./x/../y.glb"), "a/y.glb");
        assert_eq!(file("a/", "50%_off.glb"), "a/50%_off.glb");
        for outside in ["../x", "a/../../x", "/etc/x", "%2e%2e/x", "..\\x", "", "."] {
            assert_eq!(file("", outside), "Outside", "{outside}");
        }
        for elsewhere in ["https://h/x.glb", "data:application/json;base64,e30=", "//h/x.glb", "C:/x.glb"] {
            assert_eq!(file("", elsewhere), "Elsewhere", "{elsewhere}");
        }
        assert_eq!((folder_of("a/b/c.json?d/e"), folder_of("c.json")), ("a/b/", ""));
    }
}
