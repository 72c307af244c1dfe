//! The worlds that a server has.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use foresight_index::manifest::{self, Manifest};
use foresight_index::specification::{self, Progress};
use foresight_index::world::{Georeference, World, WorldError, WorldKind};
use foresight_scheduler::lod_tree::RepId;
use serde::{Deserialize, Serialize};

use super::path;

/// Longest name of a world, bytes.
const NAME_BYTES_MAX: usize = 64;
/// Notes on a world that are listed.
const NOTES_MAX: usize = 20;

/// Why a world cannot be served.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// It cannot be opened.
    #[error(transparent)]
    World(#[from] WorldError),
    /// Its folder cannot be read.
    #[error("{}: {source}", folder.display())]
    Folder {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The manifest of its mosaic is at fault.
    #[error("{}: {source}", file.display())]
    Manifest {
        /// The manifest.
        file: PathBuf,
        /// Why not.
        source: manifest::ManifestError,
    },
    /// Two of one name.
    #[error("two worlds are called `{0}`; expected distinct names: give one as NAME=PATH")]
    Twice(String),
    /// None.
    #[error("no world given; expected --world PATH at least once")]
    None,
}

/// A world, its files, and what is told about it.
#[derive(Debug)]
pub struct HostedWorld {
    /// The world.
    pub world: World,
    /// What is told about it; its name, identity and base are part of that.
    pub facts: WorldFacts,
    files: Option<Files>,
    addresses: Addresses,
}

/// What is told about a world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WorldFacts {
    /// Its name in addresses and in a session's `hello`.
    pub name: String,
    /// What it was made from.
    pub kind: String,
    /// A hash of its tree and addresses, 64 hexadecimal digits.
    pub identity: String,
    /// Representations' addresses are relative to this; what lies below never changes.
    pub base: String,
    /// Root tileset for stock clients, revalidated at each use; null where the world has none.
    pub entry: Option<String>,
    /// `files`, or `generated filler`: a world without content files, whose representations are pseudo-random bytes of the
    /// declared length.
    pub content: String,
    /// Least corner of its bounds, metres.
    pub min: [f64; 3],
    /// Greatest corner of its bounds, metres.
    pub max: [f64; 3],
    /// Away from the ground, unit length.
    pub up: [f64; 3],
    /// Coordinate system, such as `EPSG:4978`; null where it lies nowhere on the Earth.
    pub georeference: Option<String>,
    /// Nodes of its tree.
    pub nodes: u64,
    /// Representations.
    pub representations: u64,
    /// Sum of the bytes on the wire.
    pub wire_bytes: u64,
    /// Sum of the bytes in memory.
    pub decoded_bytes: u64,
    /// What was repaired, looks wrong or is missing; the first 20.
    pub notes: Vec<String>,
}

/// A world's folder. What leads out of it, by `..` or a link, is not found.
#[derive(Debug)]
pub struct Files {
    /// The folder.
    pub folder: cap_std::fs::Dir,
    manifest: Option<Manifest>,
}

impl Files {
    fn open(folder: PathBuf, follows_manifest: bool) -> Result<Files, HostError> {
        let dir = cap_std::fs::Dir::open_ambient_dir(&folder, cap_std::ambient_authority())
            .map_err(|source| HostError::Folder { folder: folder.clone(), source })?;
        let manifest = if follows_manifest {
            let file = folder.join("manifest.json");
            let bytes = std::fs::read(&file).map_err(|source| HostError::Folder { folder: file.clone(), source })?;
            Some(manifest::parse(&bytes).map_err(|source| HostError::Manifest { file, source })?)
        } else {
            None
        };
        Ok(Files { folder: dir, manifest })
    }

    /// The file that answers for an address.
    pub fn file(&self, address: &str) -> String {
        self.manifest.as_ref().map_or_else(|| address.to_owned(), |manifest| manifest.file(address).0)
    }
}

/// Representations by address: hashes in order, so that a million of them take 16 MB.
#[derive(Debug)]
struct Addresses(Vec<(u64, RepId)>);

impl Addresses {
    fn new(world: &World) -> Addresses {
        let reps = (0..world.tree.representations() as u32).map(RepId);
        let mut sorted: Vec<_> = reps.map(|rep| (hash(&world.uri(rep)), rep)).collect();
        sorted.sort_unstable();
        Addresses(sorted)
    }

    /// The representation of the lowest id at an address.
    fn find(&self, world: &World, address: &str) -> Option<RepId> {
        let wanted = hash(address);
        let first = self.0.partition_point(|&(hash, _)| hash < wanted);
        let same = self.0[first..].iter().take_while(|&&(hash, _)| hash == wanted);
        same.map(|&(_, rep)| rep).find(|&rep| world.uri(rep) == address)
    }
}

/// FNV-1a, 64 bits.
fn hash(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

impl HostedWorld {
    /// Opens what `argument` names: `PATH` or `NAME=PATH`, the path as [`specification::open`] takes it.
    ///
    /// # Errors
    /// A world that cannot be opened, or a folder that cannot be read.
    pub fn open(argument: &str) -> Result<HostedWorld, HostError> {
        let (name, source) = split_name(argument);
        let progress: Progress = Arc::new(|_, _| {});
        let world = specification::open(source, &progress)?;
        let files = if specification::is_specification(source) {
            None
        } else {
            let path = Path::new(source);
            let folder = if path.is_dir() {
                Some(path.to_owned())
            } else if matches!(world.kind, WorldKind::Tiles3d | WorldKind::Mosaic | WorldKind::Built) {
                path.parent()
                    .map(|parent| if parent.as_os_str().is_empty() { PathBuf::from(".") } else { parent.to_owned() })
            } else {
                // The folder of a lone file is not part of the world.
                None
            };
            folder.map(|folder| Files::open(folder, world.kind == WorldKind::Mosaic)).transpose()?
        };
        let name = name.map_or_else(|| own_name(source, &world), str::to_owned);
        let addresses = Addresses::new(&world);
        let root =
            Path::new(source).file_name().filter(|_| Path::new(source).is_file()).map(|name| name.to_string_lossy());
        let facts = facts(name, &world, files.as_ref(), root.as_deref().unwrap_or("tileset.json"));
        Ok(HostedWorld { world, facts, files, addresses })
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.facts.name
    }

    /// Its identity, 64 hexadecimal digits.
    pub fn identity(&self) -> &str {
        &self.facts.identity
    }

    /// Where a representation is fetched, relative to [`WorldFacts::base`], escaped as an address.
    pub fn uri(&self, rep: RepId) -> String {
        path::encode(&self.world.uri(rep))
    }

    /// Its folder, if it has one.
    pub fn files(&self) -> Option<&Files> {
        self.files.as_ref()
    }

    /// The representation at an address (not escaped).
    pub fn representation(&self, address: &str) -> Option<RepId> {
        self.addresses.find(&self.world, address)
    }
}

/// The worlds by name. They live as long as the process.
#[derive(Clone, Debug, Default)]
pub struct Worlds(BTreeMap<String, &'static HostedWorld>);

impl Worlds {
    /// Opens worlds as [`HostedWorld::open`] does, and keeps them until the process ends.
    ///
    /// # Errors
    /// Those of [`HostedWorld::open`], no world, and two of one name.
    pub fn open(arguments: &[String]) -> Result<Worlds, HostError> {
        if arguments.is_empty() {
            return Err(HostError::None);
        }
        let mut worlds = BTreeMap::new();
        for argument in arguments {
            let world = HostedWorld::open(argument)?;
            let name = world.name().to_owned();
            if worlds.contains_key(&name) {
                return Err(HostError::Twice(name));
            }
            worlds.insert(name, &*Box::leak(Box::new(world)));
        }
        Ok(Worlds(worlds))
    }

    /// A world by name.
    pub fn get(&self, name: &str) -> Option<&'static HostedWorld> {
        self.0.get(name).copied()
    }

    /// All, by name.
    pub fn iter(&self) -> impl Iterator<Item = &'static HostedWorld> {
        self.0.values().copied()
    }
}

/// `NAME=PATH` where the name is one and no such path exists; else a path.
fn split_name(argument: &str) -> (Option<&str>, &str) {
    match argument.split_once('=') {
        Some((name, rest)) if is_name(name) && !Path::new(argument).exists() => (Some(name), rest),
        _ => (None, argument),
    }
}

fn is_name(text: &str) -> bool {
    !text.is_empty()
        && text.len() <= NAME_BYTES_MAX
        && !text.starts_with('.')
        && text.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte))
}

/// The name of its folder, or of its file without endings; of a generated world its kind. What a name cannot hold
/// becomes `-`.
fn own_name(source: &str, world: &World) -> String {
    let path = Path::new(source);
    let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let named = if specification::is_specification(source) {
        Some(source.split(':').next().unwrap_or_default().to_owned())
    } else if path.is_dir() {
        path.file_name().map(|name| name.to_string_lossy().into_owned())
    } else if matches!(world.kind, WorldKind::Tiles3d | WorldKind::Mosaic | WorldKind::Built) {
        path.parent().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned())
    } else {
        let file = path.file_name().map(|name| name.to_string_lossy().into_owned());
        file.map(|name| name.split('.').find(|part| !part.is_empty()).unwrap_or_default().to_owned())
    };
    let mut name: String = named
        .unwrap_or_default()
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' })
        .take(NAME_BYTES_MAX)
        .collect();
    if name.starts_with('.') {
        name.replace_range(..1, "-");
    }
    if name.is_empty() { "world".to_owned() } else { name }
}

/// `root` is the name of the root tileset, if there is one.
fn facts(name: String, world: &World, files: Option<&Files>, root: &str) -> WorldFacts {
    let summary = world.summary();
    let identity = world.hash().to_hex().to_string();
    let tiles = matches!(world.kind, WorldKind::Tiles3d | WorldKind::Mosaic);
    let has_entry = tiles && files.is_some_and(|files| files.folder.is_file(root));
    // A folder may hold a generated world's parameters and nothing else.
    let first = world.uri(RepId(0));
    let has_content =
        world.tree.representations() > 0 && files.is_some_and(|files| files.folder.exists(files.file(&first)));
    WorldFacts {
        kind: world.kind.to_string(),
        base: format!("/worlds/{name}/{identity}/"),
        entry: has_entry.then(|| format!("/worlds/{name}/files/{}", path::encode(root))),
        content: if has_content { "files" } else { "generated filler" }.to_owned(),
        min: summary.bounds.min.to_array(),
        max: summary.bounds.max.to_array(),
        up: world.up.to_array(),
        georeference: world.georeference.map(|georeference| match georeference {
            Georeference::Ecef => "EPSG:4978".to_owned(),
            Georeference::Epsg(code) => format!("EPSG:{code}"),
        }),
        nodes: summary.nodes,
        representations: summary.representations,
        wire_bytes: summary.wire_bytes,
        decoded_bytes: summary.decoded_bytes,
        notes: world.notes.iter().take(NOTES_MAX).map(ToString::to_string).collect(),
        name,
        identity,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_told_from_paths() {
        assert_eq!(split_name("old=tiles/"), (Some("old"), "tiles/"));
        assert_eq!(split_name("city:blocks=3"), (None, "city:blocks=3"));
        assert_eq!(split_name("small=city:blocks=3"), (Some("small"), "city:blocks=3"));
        assert_eq!(split_name("a/b=c"), (None, "a/b=c"));
        assert_eq!(split_name(".x=c"), (None, ".x=c"));
    }

    #[test]
    fn representations_are_found_by_address() {
        let world = HostedWorld::open("small=city:blocks=2").unwrap();
        assert_eq!((world.name(), world.facts.content.as_str()), ("small", "generated filler"));
        for rep in (0..world.world.tree.representations() as u32).map(RepId) {
            let found = world.representation(&world.world.uri(rep)).unwrap();
            assert_eq!(world.world.uri(found), world.world.uri(rep));
        }
        assert_eq!(world.representation("no/such.glb"), None);
    }

    #[test]
    fn two_worlds_need_two_names() {
        let message = Worlds::open(&["city:blocks=1".to_owned(), "city:blocks=2".to_owned()]).unwrap_err().to_string();
        assert!(message.contains("two worlds are called `city`"), "{message}");
        assert!(Worlds::open(&[]).is_err());
    }
}
