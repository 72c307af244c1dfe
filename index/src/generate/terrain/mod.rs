//! Made-up terrain of any extent: a quadtree of tiles of 64 × 64 cells over a fractal surface, each with its imagery.
//! z is up, the middle of the square is the origin.
//!
//! Of the catalogue alone, errors and sizes are modelled, see `model`; where the geometry is written they are its own.

mod fractal;
mod geometry;
mod model;
#[cfg(feature = "orthoviews")]
mod surfaces;

pub use geometry::{MAX_WRITTEN_TILES, write};
#[cfg(feature = "orthoviews")]
pub use surfaces::TerrainSurfaces;

use std::collections::VecDeque;
use std::sync::Arc;

use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, Representation};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::fractal::Fractal;
use self::model::TileModel;
use super::document::{GenerateError, Key, MAX_REPRESENTATIONS, ParamError, Params, length, put, range};
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
        Key {
            name: "size",
            expected: "a length such as 40km",
            set: |params, text| put(&mut params.size, length(text)),
        },
        Key {
            name: "resolution",
            expected: "a length such as 10m",
            set: |params, text| put(&mut params.resolution, length(text)),
        },
        Key { name: "seed", expected: "a whole number", set: |params, text| put(&mut params.seed, text.parse().ok()) },
        Key {
            name: "relief",
            expected: "a length such as 2km",
            set: |params, text| put(&mut params.relief, length(text)),
        },
        Key {
            name: "texels",
            expected: "a whole number",
            set: |params, text| put(&mut params.texels, text.parse().ok()),
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
    let mut uris = UriTableBuilder::default();
    let files = (0..shape.across).map(|y| uris.intern(&format!("{y}.glb"))).collect();
    let mut folders = Vec::new();
    for level in 0..shape.levels {
        let across = shape.across.div_ceil(shape.tiles(level));
        folders.push((0..across).map(|x| uris.intern(&format!("{level}/{x}/"))).collect());
    }
    let fractal = params.fractal(&shape);
    let ahead = Ahead::new(&shape);
    let builder = LodTreeBuilder::default();
    let mut catalogue = Catalogue { params, shape, fractal, builder, uris, files, folders, ahead };
    catalogue.tile(0, 0, 0, f64::INFINITY)?;
    Ok(World {
        name: "terrain".to_owned(),
        kind: WorldKind::GeneratedTerrain,
        tree: catalogue.builder.finish()?,
        uris: catalogue.uris.finish(),
        up: DVec3::Z,
        ground: Ground::Surface(Arc::new(catalogue.fractal)),
        georeference: None,
        root_sample: None,
        notes: Vec::new(),
    })
}

/// Levels of the subtrees that are modelled side by side.
const SUBTREE_LEVELS: u32 = 6;
/// Subtrees modelled at a time: at most 4 MB.
const SUBTREES: usize = 32;

impl Shape {
    /// Finest tiles along a side of a tile of a level, counted from the root.
    fn tiles(&self, level: u32) -> u64 {
        1 << (self.levels - 1 - level)
    }

    /// Whether the (x, y)-th tile of a level is there.
    fn has(&self, level: u32, x: u64, y: u64) -> bool {
        let tiles = self.tiles(level);
        x * tiles < self.across && y * tiles < self.across
    }

    /// Appends a tile and those beneath it, down to a level, in preorder.
    fn preorder(&self, [level, last]: [u32; 2], x: u64, y: u64, to: &mut Vec<(u32, u64, u64)>) {
        if !self.has(level, x, y) {
            return;
        }
        to.push((level, x, y));
        if level < last {
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                self.preorder([level + 1, last], 2 * x + dx, 2 * y + dy, to);
            }
        }
    }
}

/// Tiles that are modelled, a batch of subtrees in parallel, before the tree takes them one by one.
struct Ahead {
    /// Level of the subtrees' roots, and these, in preorder.
    level: u32,
    roots: std::vec::IntoIter<(u32, u64, u64)>,
    ready: VecDeque<Vec<TileModel>>,
    current: std::vec::IntoIter<TileModel>,
}

impl Ahead {
    fn new(shape: &Shape) -> Ahead {
        let level = shape.levels.saturating_sub(SUBTREE_LEVELS);
        let mut roots = Vec::new();
        shape.preorder([0, level], 0, 0, &mut roots);
        roots.retain(|root| root.0 == level);
        Ahead { level, roots: roots.into_iter(), ready: VecDeque::new(), current: Vec::new().into_iter() }
    }
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
    ahead: Ahead,
}

impl Catalogue<'_> {
    /// The model of the next tile in preorder.
    fn model(&mut self, level: u32, x: u64, y: u64) -> TileModel {
        let (params, shape, fractal) = (self.params, &self.shape, &self.fractal);
        let model = |(level, x, y)| model::tile(params, shape, fractal, shape.tiles(level), x, y);
        if level == self.ahead.level {
            if self.ahead.ready.is_empty() {
                let batch: Vec<_> = self.ahead.roots.by_ref().take(SUBTREES).collect();
                let modelled = batch.into_par_iter().map(|(level, x, y)| {
                    let mut tiles = Vec::new();
                    shape.preorder([level, shape.levels - 1], x, y, &mut tiles);
                    tiles.into_iter().map(model).collect()
                });
                self.ahead.ready = modelled.collect::<Vec<_>>().into();
            }
            self.ahead.current = self.ahead.ready.pop_front().unwrap_or_default().into_iter();
        }
        let ready = if level < self.ahead.level { None } else { self.ahead.current.next() };
        ready.unwrap_or_else(|| model((level, x, y)))
    }

    /// Adds tile (x, y) of a level and those beneath it. Recursion goes down the levels: at most 14.
    fn tile(&mut self, level: u32, x: u64, y: u64, above: f64) -> Result<(), LodTreeError> {
        if !self.shape.has(level, x, y) {
            return Ok(());
        }
        let TileModel { low, high, error, wire_bytes, decoded_bytes, min, max } = self.model(level, x, y);
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
        if level + 1 < self.shape.levels {
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
