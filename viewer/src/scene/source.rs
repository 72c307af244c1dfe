//! Where contents come from, and where in the world they stand: a world's folder, or a generated world whose contents are made when they
//! are asked for.

use crate::gpu::Sky;
use foresight_index::generate::asteroids::{AsteroidContents, AsteroidParams};
use foresight_index::generate::city::CityParams;
use foresight_index::generate::city::geometry::CityContents;
use foresight_index::generate::document::{GenerateError, Params, from_parts, parse};
use foresight_index::ground::Ground;
use foresight_index::import::cityjson::CityModelContents;
use foresight_index::import::tiles3d::TileContents;
use foresight_index::octree::Octree;
use foresight_index::specification::{self, is_specification};
use foresight_index::stored;
use foresight_index::surface::{Piece, read_glb};
use foresight_index::terrain::tile_surface;
use foresight_index::world::{self, World, WorldError, WorldKind};
use foresight_scheduler::lod_tree::RepId;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most bytes of a representation, as they are stored and once they are inflated.
const BYTES_MAX: u64 = 1 << 30;

/// How contents lie in the world.
#[derive(Debug)]
pub enum Placing {
    /// A stored world's: orthoviews on the lattices of its octree, geometry where it is.
    Stored {
        /// The octree.
        octree: Octree,
        /// Side of a leaf's pixel, metres.
        pixel: f64,
    },
    /// A tileset's, each with the transform of its tile.
    Tiles(Box<TileContents>),
    /// Made here, whatever comes over the network: a generated world, or a file that is imported whole.
    Made(Made),
    /// There are none: why.
    Nowhere(&'static str),
}

/// Contents that are made when they are asked for.
#[derive(Debug)]
pub enum Made {
    /// A generated city.
    City(CityContents),
    /// A generated field of models.
    Asteroids(AsteroidContents),
    /// A city model.
    CityModel(CityModelContents),
    /// Terrain, generated or from a grid: its ground's surface.
    Terrain,
}

impl Made {
    /// What a representation shows.
    pub(super) fn piece(&self, world: &World, rep: RepId) -> Result<Piece, String> {
        let made = match self {
            Made::City(city) => return read_glb(&city.content(&world.tree, rep)).map_err(|error| error.to_string()),
            Made::Asteroids(field) => field.piece(&world.uri(rep)),
            Made::CityModel(model) => model.piece(rep),
            Made::Terrain => tile_surface(world, rep),
        };
        made.ok_or_else(|| "nothing is made there; expected a representation of the world".to_owned())
    }
}

/// What brings bytes.
#[derive(Debug)]
enum Bytes {
    Folder(PathBuf),
    Tiles,
    /// None are needed, or there are none.
    None,
}

/// Where the contents of a world come from.
#[derive(Debug)]
pub struct Source {
    placing: Placing,
    bytes: Bytes,
    credit: Option<String>,
    /// Whether all that the world was built from says that it is in space.
    in_space: bool,
}

/// Bytes that are not to be had.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("representation {} ({uri}): {fault}", rep.0)]
pub struct SourceError {
    /// Of what.
    pub rep: RepId,
    /// Where it is fetched.
    pub uri: String,
    /// Why not, and what was expected.
    pub fault: String,
}

const SIZES_ONLY: &str = "the world has sizes only; expected one with contents: a tileset, a stored world, a generated world written with its geometry";

impl Source {
    /// Opens the world that a command line names, with its contents.
    ///
    /// # Errors
    /// As [`specification::open`].
    pub fn open(name: &str) -> Result<(World, Source), WorldError> {
        if is_specification(name) {
            let (kind, rest) = name.split_once(':').unwrap_or((name, ""));
            return match kind {
                "city" => Source::city(&from_parts::<CityParams>(rest)?),
                "asteroids" => Source::asteroids(&from_parts::<AsteroidParams>(rest)?),
                "mosaic" => Source::mosaic(rest, name),
                _ => {
                    let world = specification::open(name, &(Arc::new(|_, _| {}) as specification::Progress))?;
                    let source = match world.kind {
                        WorldKind::GeneratedTerrain => Source::made(Made::Terrain),
                        _ => Source::sizes_only(),
                    };
                    Ok((world, source))
                }
            };
        }
        let path = Path::new(name);
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
        let world = world::open(path)?;
        match world.kind {
            WorldKind::Built => {
                let document = stored::open_document(folder)?;
                Ok((world, Source::stored(folder, &document)))
            }
            WorldKind::Tiles3d | WorldKind::Mosaic => {
                let file = if path.is_dir() { path.join("tileset.json") } else { path.to_owned() };
                let (world, tiles) = TileContents::open(&file)?;
                Ok((world, Source::tiles(tiles)))
            }
            WorldKind::City => Source::city(&document(path)?),
            WorldKind::Asteroids => Source::asteroids(&document(path)?),
            WorldKind::CityJson => {
                let (world, contents) = CityModelContents::open(path)?;
                Ok((world, Source::made(Made::CityModel(contents))))
            }
            WorldKind::Terrain | WorldKind::GeneratedTerrain => Ok((world, Source::made(Made::Terrain))),
        }
    }

    /// Of a stored world, whose document may be elsewhere: without its folder, bytes come over the network.
    pub fn stored(folder: &Path, document: &stored::Document) -> Source {
        let placing = match document.octree.octree() {
            Some(octree) => Placing::Stored { octree, pixel: document.orthoviews.pixel },
            None => Placing::Nowhere("the world's document has no octree; expected origin, leaf_side and splits"),
        };
        let in_space = are_in_space(document.inputs.iter().map(|input| input.name.as_str()));
        Source { in_space, ..Source::in_folder(folder, placing) }
    }

    pub(super) fn in_folder(folder: &Path, placing: Placing) -> Source {
        Source { placing, bytes: Bytes::Folder(folder.to_owned()), credit: None, in_space: false }
    }

    fn tiles(tiles: TileContents) -> Source {
        let credit = tiles.credit().map(str::to_owned);
        Source { placing: Placing::Tiles(Box::new(tiles)), bytes: Bytes::Tiles, credit, in_space: false }
    }

    fn city(params: &CityParams) -> Result<(World, Source), WorldError> {
        let (world, contents) = CityContents::open(params)?;
        let source = match contents {
            Some(contents) => Source::made(Made::City(contents)),
            None => Source::sizes_only(),
        };
        Ok((world, source))
    }

    fn asteroids(params: &AsteroidParams) -> Result<(World, Source), WorldError> {
        let (world, contents) = AsteroidContents::open(params)?;
        Ok((world, Source::made(Made::Asteroids(contents))))
    }

    fn made(made: Made) -> Source {
        Source { placing: Placing::Made(made), bytes: Bytes::None, credit: None, in_space: false }
    }

    fn mosaic(rest: &str, name: &str) -> Result<(World, Source), WorldError> {
        let parts = rest.rsplit_once(",grid=").and_then(|(source, grid)| Some((source, grid.parse().ok()?)));
        let Some((source, grid)) = parts else {
            // Says what is wrong with it.
            let world = specification::open(name, &(Arc::new(|_, _| {}) as specification::Progress))?;
            return Ok((world, Source::sizes_only()));
        };
        let opened = foresight_index::generate::mosaic::with_contents(Path::new(source), grid);
        let (world, tiles) = opened.map_err(|error| WorldError::Mosaic(Box::new(error)))?;
        Ok((world, Source::tiles(tiles)))
    }

    fn sizes_only() -> Source {
        Source { placing: Placing::Nowhere(SIZES_ONLY), bytes: Bytes::None, credit: None, in_space: false }
    }

    /// How contents lie in the world.
    pub fn placing(&self) -> &Placing {
        &self.placing
    }

    /// Why nothing of the world can be drawn, if so.
    pub fn refusal(&self) -> Option<&'static str> {
        match &self.placing {
            Placing::Nowhere(why) => Some(why),
            _ => None,
        }
    }

    /// What is behind the world: space where it has no ground, as a world of asteroids says of itself, and one built from
    /// `asteroids:…`.
    pub fn sky(&self, world: &World) -> Sky {
        if self.in_space || matches!(world.ground, Ground::Absent) { Sky::Space } else { Sky::Horizon }
    }

    /// Whose the world is, as it says itself.
    pub fn credit(&self) -> Option<&str> {
        self.credit.as_deref()
    }

    /// The bytes of a representation as they are stored; none for what is made.
    ///
    /// # Errors
    /// A file that is not there, lies outside of the world's folder or has another length than the world says; a world without contents.
    pub fn bytes(&self, world: &World, rep: RepId) -> Result<Vec<u8>, SourceError> {
        let fault = |fault: String| SourceError { rep, uri: world.uri(rep).into_owned(), fault };
        if rep.index() >= world.tree.representations() {
            return Err(fault(format!("not there; expected one of {}", world.tree.representations())));
        }
        match (&self.bytes, &self.placing) {
            (Bytes::Folder(folder), _) => {
                let bytes = read_within(folder, &world.uri(rep)).map_err(&fault)?;
                let expected = world.tree.wire_bytes(rep);
                if bytes.len() as u64 == expected {
                    Ok(bytes)
                } else {
                    Err(fault(format!("{} bytes; expected {expected}", bytes.len())))
                }
            }
            (Bytes::Tiles, Placing::Tiles(tiles)) => {
                tiles.bytes(rep).map_err(|error| fault(format!("{error}; expected a file")))
            }
            (Bytes::None, Placing::Made(_)) => Ok(Vec::new()),
            _ => Err(fault(SIZES_ONLY.to_owned())),
        }
    }
}

/// Whether all of a world's inputs, as they were named, are in space.
fn are_in_space<'a>(names: impl Iterator<Item = &'a str>) -> bool {
    let mut kinds = names.map(|name| name.split(':').next() == Some("asteroids")).peekable();
    kinds.peek().is_some() && kinds.all(|is_in_space| is_in_space)
}

/// The parameters of a generated world whose document, or its folder, is at `path`.
fn document<P: Params>(path: &Path) -> Result<P, WorldError> {
    let file = if path.is_dir() { path.join(P::FILE_NAME) } else { path.to_owned() };
    let bytes = std::fs::read(&file).map_err(|source| WorldError::Io { file: file.clone(), source })?;
    Ok(parse(&bytes).map_err(|source| GenerateError::File { file, source })?)
}

/// The bytes of a file in a folder; links that lead out of it are not followed.
fn read_within(folder: &Path, file: &str) -> Result<Vec<u8>, String> {
    let within = || -> std::io::Result<Option<PathBuf>> {
        let path = folder.join(file).canonicalize()?;
        Ok(path.starts_with(folder.canonicalize()?).then_some(path))
    };
    let path = within().map_err(|error| format!("{error}; expected a file"))?;
    let path = path.ok_or("outside of the world's folder; expected a file inside")?;
    let mut bytes = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(BYTES_MAX + 1).read_to_end(&mut bytes));
    read.map_err(|error| format!("{error}; expected a file"))?;
    if bytes.len() as u64 > BYTES_MAX { Err(format!("more than {BYTES_MAX} bytes; expected less")) } else { Ok(bytes) }
}

/// What gzip holds; `None` for what is none.
pub(super) fn inflated(bytes: &[u8]) -> Result<Option<Vec<u8>>, String> {
    if !bytes.starts_with(b"\x1F\x8B") {
        return Ok(None);
    }
    let mut plain = Vec::new();
    let read = flate2::read::MultiGzDecoder::new(bytes).take(BYTES_MAX + 1).read_to_end(&mut plain);
    read.map_err(|error| format!("{error}; expected gzip"))?;
    if plain.len() as u64 > BYTES_MAX {
        return Err(format!("gzip of more than {BYTES_MAX} bytes; expected at most that"));
    }
    Ok(Some(plain))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn worlds_without_ground_are_in_space() {
        let sky = |name: &str| {
            let (world, source) = Source::open(name).expect("a world");
            source.sky(&world)
        };
        assert_eq!(sky("asteroids:count=3,triangles=300"), Sky::Space);
        assert_eq!(sky("city:blocks=1"), Sky::Horizon);
        assert_eq!(sky("terrain:size=3km,resolution=20m"), Sky::Horizon);
        let cases: [(&[&str], bool); 4] = [
            (&["asteroids:count=3", "asteroids"], true),
            (&["asteroids:count=3", "city"], false),
            (&["asteroids.json"], false),
            (&[], false),
        ];
        for (names, expected) in cases {
            assert_eq!(are_in_space(names.iter().copied()), expected, "{names:?}");
        }
    }
}
