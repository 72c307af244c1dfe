//! Made-up terrain of any extent: a quadtree of tiles of 64 × 64 cells over a fractal surface, each with its imagery.
//! z is up, the middle of the square is the origin.
//!
//! Of the catalogue alone, errors and sizes are modelled, see `model`; where the geometry is written they are its own.

mod fractal;
mod geometry;
mod model;

pub use geometry::{MAX_WRITTEN_TILES, write};

use std::sync::Arc;

use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, Representation};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use self::fractal::Fractal;
use self::model::TileModel;
use super::document::{GenerateError, Key, MAX_REPRESENTATIONS, ParamError, Params, length, range};
use crate::ground::Ground;
use crate::terrain::TILE_CELLS;
use crate::uris::UriTableBuilder;
use crate::world::{World, WorldKind};

/// What a terrain is made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TerrainParams {
    /// Side of the square, metres, rounded up to whole tiles of 64 cells.
    pub size: f64,
    /// Between samples of the finest tiles, metres, 0.01 to 1000.
    pub resolution: f64,
    /// Names the terrain among those of its size.
    pub seed: u64,
    /// From the deepest valley to the highest summit that there could be, metres, 0 to 20,000.
    pub relief: f64,
    /// Texels along a side of a tile's imagery, 0 for none, at most 4096.
    pub texels: u32,
}

impl Default for TerrainParams {
    /// 40 km × 40 km.
    fn default() -> TerrainParams {
        TerrainParams { size: 40_000.0, resolution: 10.0, seed: 1, relief: 2000.0, texels: 512 }
    }
}

impl Params for TerrainParams {
    const FORMAT: &'static str = "foresight-terrain";
    const SCHEMA_VERSION: u32 = 1;
    const FILE_NAME: &'static str = "terrain.json";
    const KEYS: &'static [Key<TerrainParams>] = &[
        Key { name: "size", expected: "a length such as 40km", set: |params, text| Some(params.size = length(text)?) },
        Key {
            name: "resolution",
            expected: "a length such as 10m",
            set: |params, text| Some(params.resolution = length(text)?),
        },
        Key { name: "seed", expected: "a whole number", set: |params, text| Some(params.seed = text.parse().ok()?) },
        Key {
            name: "relief",
            expected: "a length such as 2km",
            set: |params, text| Some(params.relief = length(text)?),
        },
        Key {
            name: "texels",
            expected: "a whole number",
            set: |params, text| Some(params.texels = text.parse().ok()?),
        },
    ];

    fn check(&self) -> Result<(), ParamError> {
        range("resolution", self.resolution, 0.01, 1000.0)?;
        range("size", self.size, self.resolution, 20_000_000.0)?;
        range("relief", self.relief, 0.0, 20_000.0)?;
        range("texels", f64::from(self.texels), 0.0, 4096.0)
    }

    fn build(&self) -> Result<World, GenerateError> {
        terrain(self)
    }
}

/// The quadtree's shape.
#[derive(Clone, Copy, Debug)]
struct Shape {
    /// Finest tiles along a side.
    across: u64,
    /// Levels, the root's counted.
    levels: u32,
    /// Side of a finest tile, metres.
    side: f64,
}

impl TerrainParams {
    fn shape(&self) -> Result<Shape, GenerateError> {
        let side = self.resolution * f64::from(TILE_CELLS);
        let across = (self.size / side).ceil().max(1.0) as u64;
        let levels = across.next_power_of_two().trailing_zeros() + 1;
        let found = (0..levels)
            .map(|level| across.div_ceil(1 << level))
            .map(|n| n.saturating_mul(n))
            .fold(0, u64::saturating_add);
        if found > MAX_REPRESENTATIONS {
            let limit = MAX_REPRESENTATIONS.to_string();
            return Err(GenerateError::TooMany { found, what: "representations", limit });
        }
        Ok(Shape { across, levels, side })
    }

    fn fractal(&self, shape: &Shape) -> Fractal {
        let origin = DVec2::splat(-0.5 * shape.side * shape.across as f64);
        let samples = shape.across * u64::from(TILE_CELLS) + 1;
        Fractal::new(self.seed, self.relief, origin, self.resolution, samples)
    }
}

/// Builds the catalogue of a terrain. The same parameters give the same world on every machine.
pub fn terrain(params: &TerrainParams) -> Result<World, GenerateError> {
    params.check()?;
    let shape = params.shape()?;
    let fractal = params.fractal(&shape);
    let mut uris = UriTableBuilder::default();
    let files = (0..shape.across).map(|y| uris.intern(&format!("{y}.glb"))).collect();
    let mut catalogue =
        Catalogue { params, shape, fractal, builder: LodTreeBuilder::default(), uris, files, folders: Vec::new() };
    for level in 0..shape.levels {
        let across = shape.across.div_ceil(1 << (shape.levels - 1 - level));
        let folders = (0..across).map(|x| catalogue.uris.intern(&format!("{level}/{x}/"))).collect();
        catalogue.folders.push(folders);
    }
    catalogue.tile(0, 0, 0, f64::INFINITY)?;
    Ok(World {
        name: "terrain".to_owned(),
        kind: WorldKind::GeneratedTerrain,
        tree: catalogue.builder.finish()?,
        uris: catalogue.uris.finish(),
        up: DVec3::Z,
        ground: Ground::Surface(Arc::new(catalogue.fractal)),
        georeference: None,
        notes: Vec::new(),
    })
}

struct Catalogue<'a> {
    params: &'a TerrainParams,
    shape: Shape,
    fractal: Fractal,
    builder: LodTreeBuilder,
    uris: UriTableBuilder,
    /// Ids of the files' names by row.
    files: Vec<u32>,
    /// Ids of the folders' names by level and column.
    folders: Vec<Vec<u32>>,
}

impl Catalogue<'_> {
    /// Adds tile (x, y) of a level counted from the root, and those beneath it. Recursion goes down the levels: at most 14.
    fn tile(&mut self, level: u32, x: u64, y: u64, above: f64) -> Result<(), LodTreeError> {
        let tiles = 1 << (self.shape.levels - 1 - level);
        if x * tiles >= self.shape.across || y * tiles >= self.shape.across {
            return Ok(());
        }
        let TileModel { low, high, error, wire_bytes, decoded_bytes, min, max } =
            model::tile(self.params, &self.shape, &self.fractal, tiles, x, y);
        // Not above that of the tile that it refines.
        let error = error.min(above);
        self.builder.open()?;
        #[expect(clippy::cast_possible_truncation, reason = "metres to 7 digits")]
        let narrow = error as f32;
        self.builder.add(Representation {
            wire_bytes,
            decoded_bytes,
            error: narrow,
            prerequisite: None,
            direction: None,
        })?;
        self.uris.push(self.folders[level as usize][x as usize], self.files[y as usize]);
        if tiles > 1 {
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                self.tile(level + 1, 2 * x + dx, 2 * y + dy, error)?;
            }
            return self.builder.close(None, 1.0);
        }
        self.builder.close(Some(Aabb { min: min.extend(low), max: max.extend(high) }), 1.0)
    }
}

#[cfg(test)]
mod tests;
