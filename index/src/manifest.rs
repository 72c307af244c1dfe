//! The manifest of a mosaic: folders and files that many addresses share.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What [`Manifest::format`] says.
pub const FORMAT: &str = "foresight-mosaic";
/// The newest [`Manifest::schema_version`] that is read and the one that is written.
pub const SCHEMA_VERSION: u32 = 1;

/// Which addresses of a world are answered from where. Paths are relative to the world's folder, with `/`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// What the world is, for readers.
    pub statement: String,
    /// Prefix of addresses to the folder that holds their files. Both end in `/`; no prefix lies inside another.
    pub folders: BTreeMap<String, String>,
    /// Address to a file that stands in for it: it has the right size, and shows another place.
    pub stand_ins: BTreeMap<String, String>,
}

/// A fault in a manifest.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct ManifestError {
    /// JSON path, or line and column.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

/// Reads a manifest.
pub fn parse(bytes: &[u8]) -> Result<Manifest, ManifestError> {
    let fault = |place: &str, fault: String| Err(ManifestError { place: place.to_owned(), fault });
    let manifest: Manifest = match serde_json::from_slice(bytes) {
        Ok(manifest) => manifest,
        Err(error) => return fault(&format!("line {}, column {}", error.line(), error.column()), error.to_string()),
    };
    if manifest.format != FORMAT {
        return fault("$.format", format!("{:?}; expected {FORMAT:?}", manifest.format));
    }
    if manifest.schema_version != SCHEMA_VERSION {
        return fault("$.schema_version", format!("{}; expected {SCHEMA_VERSION}", manifest.schema_version));
    }
    let mut last: Option<&str> = None;
    for (prefix, folder) in &manifest.folders {
        let place = format!("$.folders[{prefix:?}]");
        if !prefix.ends_with('/') || !folder.ends_with('/') {
            return fault(&place, format!("{folder:?}; expected a prefix and a folder that end in \"/\""));
        }
        if !is_inside(prefix) || !is_inside(folder) {
            return fault(&place, format!("{folder:?}; expected paths inside the world's folder"));
        }
        // In order, so whatever lies inside a prefix follows it.
        if let Some(outer) = last.filter(|last| prefix.starts_with(last)) {
            return fault(&place, format!("inside {outer:?}; expected prefixes outside each other"));
        }
        last = Some(prefix);
    }
    for (uri, file) in &manifest.stand_ins {
        if !is_inside(uri) || !is_inside(file) || file.ends_with('/') {
            return fault(
                &format!("$.stand_ins[{uri:?}]"),
                format!("{file:?}; expected files inside the world's folder"),
            );
        }
    }
    Ok(manifest)
}

/// True for a relative path that never leaves its folder.
fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && !path.contains(['\\', ':'])
        && path.strip_suffix('/').unwrap_or(path).split('/').all(|part| !matches!(part, "" | "." | ".."))
}

impl Manifest {
    /// The prefix that an address begins with, and the folder behind it.
    pub(crate) fn folder(&self, uri: &str) -> Option<(&str, &str)> {
        let (prefix, folder) =
            self.folders.range::<str, _>((std::ops::Bound::Unbounded, std::ops::Bound::Included(uri))).next_back()?;
        uri.starts_with(prefix.as_str()).then_some((prefix, folder))
    }

    /// The file that answers for an address, and whether it only stands in for it.
    pub fn file(&self, uri: &str) -> (String, bool) {
        if let Some(file) = self.stand_ins.get(uri) {
            return (file.clone(), true);
        }
        match self.folder(uri) {
            Some((prefix, folder)) => (format!("{folder}{}", &uri[prefix.len()..]), false),
            None => (uri.to_owned(), false),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest(folders: &[(&str, &str)]) -> Result<Manifest, ManifestError> {
        let given = Manifest {
            format: FORMAT.to_owned(),
            schema_version: SCHEMA_VERSION,
            statement: String::new(),
            folders: folders.iter().map(|&(a, b)| (a.to_owned(), b.to_owned())).collect(),
            stand_ins: BTreeMap::from([("coarse/0.glb".to_owned(), "source/r.glb".to_owned())]),
        };
        parse(&serde_json::to_vec(&given).unwrap())
    }

    #[test]
    fn the_prefix_decides() {
        let manifest = manifest(&[("cells/0_0/", "source/"), ("cells/10_0/", "other/")]).unwrap();
        assert_eq!(manifest.file("cells/0_0/a/b.glb"), ("source/a/b.glb".to_owned(), false));
        assert_eq!(manifest.file("cells/10_0/b.glb"), ("other/b.glb".to_owned(), false));
        assert_eq!(manifest.file("cells/1_0/b.glb"), ("cells/1_0/b.glb".to_owned(), false));
        assert_eq!(manifest.file("coarse/0.glb"), ("source/r.glb".to_owned(), true));
    }

    #[test]
    fn refuses_what_leaves_the_folder_or_overlaps() {
        for folders in [[("a/", "../b/")], [("/a/", "b/")], [("a/", "b")], [("", "b/")], [("a//", "b/")]] {
            assert!(manifest(&folders).is_err(), "{folders:?}");
        }
        assert!(manifest(&[("a/", "s/"), ("a/b/", "t/")]).unwrap_err().fault.contains("outside each other"));
        assert!(parse(b"{}").is_err() && parse(b"").is_err());
    }
}
