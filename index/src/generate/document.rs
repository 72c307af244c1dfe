//! Generated worlds as documents: a small JSON file holds the parameters, and the world is made from it on opening.
//! The same parameters make the same world on every machine.

use std::path::{Path, PathBuf};

use foresight_scheduler::lod_tree::LodTreeError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::staging::Staging;
use crate::world::World;

/// Most representations of a generated world.
pub const MAX_REPRESENTATIONS: u64 = 1 << 24;

/// What a world is made from.
pub trait Params: Clone + Default + Serialize + DeserializeOwned + 'static {
    /// What the document says it is.
    const FORMAT: &'static str;
    /// The version that is read and written. It names the generator too: another version may make another world.
    const SCHEMA_VERSION: u32;
    /// Name of the document in its folder.
    const FILE_NAME: &'static str;
    /// What can be set by name.
    const KEYS: &'static [Key<Self>];

    /// Whether every parameter is in range.
    fn check(&self) -> Result<(), ParamError>;

    /// The world.
    fn build(&self) -> Result<World, GenerateError>;
}

/// A parameter by its name on the command line.
pub struct Key<P> {
    /// Its name.
    pub name: &'static str,
    /// What is expected after the equals sign.
    pub expected: &'static str,
    /// Sets it; `None` if the text cannot be read.
    pub set: fn(&mut P, &str) -> Option<()>,
}

/// Why there is no generated world.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// A file cannot be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A document is at fault.
    #[error("{}: {source}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The fault.
        source: DocumentError,
    },
    /// A parameter is out of range.
    #[error(transparent)]
    Param(#[from] ParamError),
    /// A parameter named on the command line is at fault.
    #[error("{given:?}; expected {expected}")]
    Key {
        /// What was given.
        given: String,
        /// The names and what follows them.
        expected: String,
    },
    /// More representations than a world may have, or more tiles than are written.
    #[error("{found} {what}; expected at most {limit}")]
    TooMany {
        /// How many there would be.
        found: u64,
        /// Of what.
        what: &'static str,
        /// The most, and what can be done.
        limit: String,
    },
    /// The surface cannot be sampled.
    #[cfg(feature = "terrain")]
    #[error("the generated terrain: {0}")]
    Terrain(crate::terrain::TerrainError),
    /// The tree cannot be built.
    #[error("the generated world: {0}")]
    Tree(#[from] LodTreeError),
}

/// A parameter out of range.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {value}; expected {expected}")]
pub struct ParamError {
    name: &'static str,
    value: f64,
    expected: String,
}

/// A fault in a document.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct DocumentError {
    /// JSON path, or line and column.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document<P> {
    format: String,
    schema_version: u32,
    params: P,
}

/// Checks that a parameter lies in a range, both ends included.
#[cfg_attr(
    not(any(feature = "city", feature = "terrain", feature = "asteroids")),
    expect(dead_code, reason = "for generators")
)]
pub(super) fn range(name: &'static str, value: f64, from: f64, to: f64) -> Result<(), ParamError> {
    let inside = (from..=to).contains(&value);
    if inside { Ok(()) } else { Err(ParamError { name, value, expected: format!("{from} to {to}") }) }
}

/// Sets a parameter to what was read, if it could be.
#[cfg_attr(
    not(any(feature = "city", feature = "terrain", feature = "asteroids")),
    expect(dead_code, reason = "for generators")
)]
pub(super) fn put<T>(param: &mut T, read: Option<T>) -> Option<()> {
    *param = read?;
    Some(())
}

/// Reads the parameters in a document.
pub fn parse<P: Params>(bytes: &[u8]) -> Result<P, DocumentError> {
    let file: Document<P> = serde_json::from_slice(bytes).map_err(|error| DocumentError {
        place: format!("line {}, column {}", error.line(), error.column()),
        fault: error.to_string(),
    })?;
    let fault = |place: &str, fault: String| Err(DocumentError { place: place.to_owned(), fault });
    if file.format != P::FORMAT {
        return fault("$.format", format!("{:?}; expected {:?}", file.format, P::FORMAT));
    }
    if file.schema_version != P::SCHEMA_VERSION {
        return fault("$.schema_version", format!("{}; expected {}", file.schema_version, P::SCHEMA_VERSION));
    }
    match file.params.check() {
        Ok(()) => Ok(file.params),
        Err(error) => fault(&format!("$.params.{}", error.name), error.to_string()),
    }
}

/// Opens the world that a document describes.
pub fn open<P: Params>(file: &Path) -> Result<World, GenerateError> {
    let bytes = std::fs::read(file).map_err(|source| GenerateError::Io { file: file.to_owned(), source })?;
    let params: P = parse(&bytes).map_err(|source| GenerateError::File { file: file.to_owned(), source })?;
    params.build()
}

/// Writes the folder `out` with a document of the parameters. `out` must not exist or be an empty folder.
pub fn write<P: Params>(params: &P, out: &Path) -> Result<(), GenerateError> {
    params.check()?;
    let io = |source| GenerateError::Io { file: out.to_owned(), source };
    let file = Document { format: P::FORMAT.to_owned(), schema_version: P::SCHEMA_VERSION, params: params.clone() };
    let mut text = serde_json::to_string_pretty(&file).map_err(|error| io(error.into()))?;
    text.push('\n');
    let staging = Staging::begin(out).map_err(io)?;
    std::fs::write(staging.place(P::FILE_NAME).map_err(io)?, text).map_err(io)?;
    staging.finish().map_err(io)
}

/// Parameters from `key=value` parts separated by commas; what is not named keeps its default.
pub fn from_parts<P: Params>(parts: &str) -> Result<P, GenerateError> {
    let mut params = P::default();
    for part in parts.split(',').filter(|part| !part.is_empty()) {
        let fault = |expected: String| Err(GenerateError::Key { given: part.to_owned(), expected });
        let (name, value) = part.split_once('=').unwrap_or((part, ""));
        let Some(key) = P::KEYS.iter().find(|key| key.name == name) else {
            let known: Vec<String> = P::KEYS.iter().map(|key| format!("{}={}", key.name, key.expected)).collect();
            return fault(known.join(", "));
        };
        if (key.set)(&mut params, value).is_none() {
            return fault(format!("{name}={}", key.expected));
        }
    }
    params.check()?;
    Ok(params)
}

/// A length with its unit, `40km`, `250m`, or a number of metres.
pub fn length(text: &str) -> Option<f64> {
    let (digits, unit) = match (text.strip_suffix("km"), text.strip_suffix('m')) {
        (Some(digits), _) => (digits, 1000.0),
        (None, Some(digits)) => (digits, 1.0),
        (None, None) => (text, 1.0),
    };
    digits.parse::<f64>().ok().map(|value| value * unit).filter(|value| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_their_units() {
        assert_eq!((length("40km"), length("2.5m"), length("17")), (Some(40e3), Some(2.5), Some(17.0)));
        for text in ["", "m", "km", "4 0m", "1e999", "nan", "3mm"] {
            assert_eq!(length(text), None, "{text}");
        }
    }
}
