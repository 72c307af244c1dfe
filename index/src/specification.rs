//! Worlds as a command line names them: files and folders, generated worlds by their parameters, mosaics in memory, URLs.

use std::path::{Path, PathBuf};

use crate::world::{self, World, WorldError};

/// Told how many files of a remote world are there, and their bytes.
pub type Progress = std::sync::Arc<dyn Fn(u64, u64) + Send + Sync>;

/// A fault in what names a world.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{given:?}; expected {expected}")]
pub struct SpecificationError {
    given: String,
    expected: &'static str,
}

#[cfg(feature = "tiles3d")]
const MOSAIC: &str = "mosaic:TILESET,grid=K, K a whole number";
/// What the kinds of world are called before their colon.
const KINDS: [&str; 4] = ["city", "terrain", "asteroids", "mosaic"];

/// True if the text names a world that is neither a file nor a folder: `city:…`, `terrain:…`, `asteroids:…`, `mosaic:…`,
/// `http://…` or `https://…`. A file of that name goes first.
pub fn is_specification(text: &str) -> bool {
    let kind = text.split(':').next().unwrap_or_default();
    let named = KINDS.contains(&kind) || (matches!(kind, "http" | "https") && text.contains("://"));
    named && !Path::new(text).exists()
}

/// Opens what `text` names: see [`is_specification`]; anything else is a path. The parameters of a generated world are
/// `key=value` parts separated by commas, those not named as by default.
pub fn open(text: &str, progress: &Progress) -> Result<World, WorldError> {
    if !is_specification(text) {
        return world::open(Path::new(text));
    }
    let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
    match kind {
        "mosaic" => mosaic(rest),
        "http" | "https" => url(text, progress),
        _ => generated(kind, rest),
    }
}

#[cfg(any(feature = "city", feature = "terrain", feature = "asteroids"))]
fn generated(kind: &str, parts: &str) -> Result<World, WorldError> {
    use crate::generate::document::{Params, from_parts};
    match kind {
        #[cfg(feature = "city")]
        "city" => Ok(from_parts::<crate::generate::city::CityParams>(parts)?.build()?),
        #[cfg(feature = "terrain")]
        "terrain" => Ok(from_parts::<crate::generate::terrain::TerrainParams>(parts)?.build()?),
        #[cfg(feature = "asteroids")]
        "asteroids" => Ok(from_parts::<crate::generate::asteroids::AsteroidParams>(parts)?.build()?),
        _ => Err(WorldError::NotBuilt { file: PathBuf::from(kind), kind: "generated worlds of this kind" }),
    }
}

#[cfg(not(any(feature = "city", feature = "terrain", feature = "asteroids")))]
fn generated(kind: &str, _: &str) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: PathBuf::from(kind), kind: "generated worlds" })
}

#[cfg(feature = "tiles3d")]
fn mosaic(rest: &str) -> Result<World, WorldError> {
    let fault = || WorldError::Specification(SpecificationError { given: format!("mosaic:{rest}"), expected: MOSAIC });
    let (source, grid) = rest.rsplit_once(",grid=").ok_or_else(fault)?;
    let grid = grid.parse().map_err(|_| fault())?;
    crate::generate::mosaic::in_memory(Path::new(source), grid).map_err(|error| WorldError::Mosaic(Box::new(error)))
}

#[cfg(not(feature = "tiles3d"))]
fn mosaic(rest: &str) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: PathBuf::from(rest), kind: "3D Tiles" })
}

#[cfg(feature = "http")]
fn url(url: &str, progress: &Progress) -> Result<World, WorldError> {
    Ok(crate::import::tiles3d::open_url(url, progress.clone())?)
}

#[cfg(not(feature = "http"))]
fn url(url: &str, _: &Progress) -> Result<World, WorldError> {
    Err(WorldError::NotBuilt { file: PathBuf::from(url), kind: "URL (its feature http is off)" })
}

#[cfg(all(test, feature = "city", feature = "terrain", feature = "asteroids", feature = "tiles3d"))]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::generate::asteroids::{AsteroidParams, asteroids};
    use crate::generate::city::{CityParams, city};
    use crate::generate::terrain::{TerrainParams, terrain};

    fn named(text: &str) -> Result<World, String> {
        open(text, &(Arc::new(|_, _| {}) as Progress)).map_err(|error| error.to_string())
    }

    #[test]
    fn parameters_name_a_world() {
        let hash = |text: &str| named(text).unwrap().hash();
        let params = CityParams { blocks_x: 3, blocks_y: 3, seed: 7, ..CityParams::default() };
        assert_eq!(hash("city:blocks=3,seed=7"), city(&params).unwrap().hash());
        assert_eq!(hash("city:"), world::built_in_city().hash());
        let params = TerrainParams { size: 3000.0, resolution: 12.5, relief: 900.0, ..TerrainParams::default() };
        assert_eq!(hash("terrain:size=3km,resolution=12.5m,relief=900"), terrain(&params).unwrap().hash());
        let params = AsteroidParams { count: 30, triangles: 300, ..AsteroidParams::default() };
        assert_eq!(hash("asteroids:count=30,triangles=300"), asteroids(&params).unwrap().hash());
    }

    #[test]
    fn faults_are_named() {
        for (text, part) in [
            ("city:bloks=3", "\"bloks=3\"; expected blocks=blocks along each side, seed=a whole number"),
            ("city:blocks=many", "\"blocks=many\"; expected blocks=blocks along each side"),
            ("city:blocks=0", "blocks_x is 0; expected 1 to 65536"),
            ("terrain:size", "\"size\"; expected size=a length such as 40km"),
            ("terrain:size=9e9km", "size is"),
            ("asteroids:count=-1", "expected count=models, a whole number"),
            ("mosaic:tiles", "expected mosaic:TILESET,grid=K"),
            ("mosaic:tiles,grid=x", "expected mosaic:TILESET,grid=K"),
            ("mosaic:absent,grid=2", "absent"),
            ("mosaic:absent,grid=0", "a grid of 0; expected 1 to 512"),
            ("town:blocks=3", "town:blocks=3"),
        ] {
            let message = named(text).unwrap_err();
            assert!(message.contains(part), "{text}: {message}");
        }
    }

    #[cfg(not(feature = "http"))]
    #[test]
    fn urls_need_their_feature() {
        let message = named("https://example.org/tileset.json").unwrap_err();
        assert!(message.contains("this build reads no URL"), "{message}");
    }
}
