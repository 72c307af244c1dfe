//! Models floating in space, as in the second scene of \[HIBR\] §7: 29,264 of them with 97,000 triangles each, under an
//! octree. There is no ground; z is called up.
//!
//! Each model is one of a few seeded shapes, scaled, with levels of detail that halve the segments of its mesh: their
//! errors are measured against the finest and their sizes are those of real encodings. A cell of the octree shows its models
//! merged, each of a few triangles, or where there are too many for that, as clusters. Where the models lie, how large
//! they are and how much they matter is drawn from the seed; the paper tells none of that.

#[cfg(feature = "orthoviews")]
mod contents;
mod geometry;
mod shape;
#[cfg(feature = "orthoviews")]
mod surfaces;

#[cfg(feature = "orthoviews")]
pub use contents::AsteroidContents;
pub use geometry::{MAX_WRITTEN_TILES, write};
#[cfg(feature = "orthoviews")]
pub use surfaces::AsteroidSurfaces;

use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, Representation};
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::document::{GenerateError, Key, MAX_REPRESENTATIONS, ParamError, Params, length, put, range};
use super::random::Random;
use crate::ground::Ground;
use crate::uris::UriTableBuilder;
use crate::world::{World, WorldKind};

/// What a field of asteroids is made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AsteroidParams {
    /// Models.
    pub count: u32,
    /// Names the field among those of its size.
    pub seed: u64,
    /// Triangles of a model's finest level, 200 to 1,000,000; rounded to 8n².
    pub triangles: u32,
    /// Mean distance between neighbours, metres: the cube that holds the models has the side spacing · ∛count.
    pub spacing: f64,
    /// Mean radius of the largest models, metres, at most a quarter of the spacing; that of the smallest is a tenth.
    pub radius: f64,
}

impl Default for AsteroidParams {
    fn default() -> AsteroidParams {
        AsteroidParams { count: 29_264, seed: 1, triangles: 97_000, spacing: 1000.0, radius: 200.0 }
    }
}

impl Params for AsteroidParams {
    const FORMAT: &'static str = "foresight-asteroids";
    const SCHEMA_VERSION: u32 = 1;
    const FILE_NAME: &'static str = "asteroids.json";
    const KEYS: &'static [Key<AsteroidParams>] = &[
        Key {
            name: "count",
            expected: "models, a whole number",
            set: |params, text| put(&mut params.count, text.parse().ok()),
        },
        Key { name: "seed", expected: "a whole number", set: |params, text| put(&mut params.seed, text.parse().ok()) },
        Key {
            name: "triangles",
            expected: "triangles of a model",
            set: |params, text| put(&mut params.triangles, text.parse().ok()),
        },
        Key {
            name: "spacing",
            expected: "a length such as 1km",
            set: |params, text| put(&mut params.spacing, length(text)),
        },
        Key {
            name: "radius",
            expected: "a length such as 200m",
            set: |params, text| put(&mut params.radius, length(text)),
        },
    ];

    fn check(&self) -> Result<(), ParamError> {
        range("count", f64::from(self.count), 1.0, MAX_REPRESENTATIONS as f64)?;
        range("triangles", f64::from(self.triangles), 200.0, 1e6)?;
        range("spacing", self.spacing, 1.0, 1e6)?;
        range("radius", self.radius, 0.01, 0.25 * self.spacing)
    }

    fn build(&self) -> Result<World, GenerateError> {
        asteroids(self)
    }
}

/// Shapes that models are copies of.
const SHAPES: u64 = 16;
/// Models that a cell of the octree may hold without being divided.
const CELL_MODELS: usize = 4;
/// Deepest cell: models that lie in one point are not divided for ever.
const MAX_DEPTH: u32 = 30;
/// Coarsest level of a model, segments an edge.
const COARSEST: i64 = 6;
/// Segments an edge of models in a merged mesh, at most and at least.
const MERGED: std::ops::RangeInclusive<i64> = 1..=3;
/// Most triangles of a merged mesh.
const MERGED_TRIANGLES: u64 = 4096;
/// Clusters along a cell's side, where not even 8 triangles a model fit in.
const CLUSTERS: f64 = 8.0;
/// Share of the models that matter more, and how much.
const LANDMARKS: f64 = 0.05;
const LANDMARK_IMPORTANCE: f32 = 4.0;

/// Streams of random numbers.
const MODEL: u64 = 1;
const SHAPE: u64 = 2;

/// A level of detail of a shape of mean radius 1.
struct Level {
    error: f64,
    wire_bytes: u32,
    decoded_bytes: u32,
}

/// A shape with its levels.
struct Kind {
    /// Coarsest first.
    levels: Vec<Level>,
    bounds: Aabb,
    /// Errors of the merged meshes, for 1, 2 and 3 segments an edge.
    merged: [f64; 3],
}

/// A model in space.
#[derive(Clone, Copy, Debug)]
struct Model {
    at: DVec3,
    radius: f64,
    id: u32,
    kind: u16,
    is_landmark: bool,
}

/// Segments an edge of a model's levels, coarsest first.
fn segments(triangles: u32) -> Vec<i64> {
    let mut n = (f64::from(triangles) / 8.0).sqrt().round() as i64;
    let mut levels = vec![n];
    while n / 2 >= COARSEST {
        n /= 2;
        levels.push(n);
    }
    levels.reverse();
    levels
}

impl Kind {
    fn new(seed: u64, segments: &[i64]) -> Kind {
        let finest = segments.last().copied().unwrap_or(COARSEST);
        let radii = shape::radii(seed, finest);
        let mut bounds = Aabb::EMPTY;
        let levels = segments.iter().map(|&n| {
            let mesh = shape::mesh(seed, n);
            bounds = bounds.union(mesh.bounds());
            let error = if n == finest { 0.0 } else { shape::error(seed, n, finest, &radii) };
            Level { error, wire_bytes: mesh.wire_bytes(), decoded_bytes: mesh.decoded_bytes() }
        });
        let mut levels: Vec<Level> = levels.collect();
        // A finer mesh may by chance be further off somewhere: no level is said to be better than the next.
        let mut least = 0.0_f64;
        for level in levels.iter_mut().rev() {
            least = least.max(level.error);
            level.error = least;
        }
        let merged = [1, 2, 3].map(|n| shape::error(seed, n, finest, &radii).max(least));
        Kind { levels, bounds, merged }
    }
}

impl AsteroidParams {
    /// Side of the cube around the models' centres, metres.
    fn side(&self) -> f64 {
        self.spacing * libm::cbrt(f64::from(self.count))
    }

    /// Seeds of the shapes.
    fn seeds(&self) -> Vec<u64> {
        (0..SHAPES).map(|kind| Random::at(self.seed, SHAPE, kind, 0).next()).collect()
    }

    fn models(&self) -> Vec<Model> {
        let half = 0.5 * self.side();
        let model = |id: u32| {
            let mut random = Random::at(self.seed, MODEL, u64::from(id), 0);
            let mut coordinate = || random.within(-half, half);
            let at = DVec3::new(coordinate(), coordinate(), coordinate());
            // Many small ones, few large ones.
            let size = random.unit();
            let radius = self.radius * (0.1 + 0.9 * size * size * size);
            let kind = (random.unit() * SHAPES as f64) as u16;
            Model { at, radius, id, kind, is_landmark: random.unit() < LANDMARKS }
        };
        (0..self.count).map(model).collect()
    }
}

/// Builds the catalogue of a field. The same parameters give the same world on every machine.
pub fn asteroids(params: &AsteroidParams) -> Result<World, GenerateError> {
    params.check()?;
    let segments = segments(params.triangles);
    let at_least = u64::from(params.count) * segments.len() as u64;
    if at_least > MAX_REPRESENTATIONS {
        let limit = MAX_REPRESENTATIONS.to_string();
        return Err(GenerateError::TooMany { found: at_least, what: "representations of models", limit });
    }
    let kinds: Vec<Kind> = params.seeds().into_par_iter().map(|seed| Kind::new(seed, &segments)).collect();
    let coarsest: f64 = kinds.iter().map(|kind| f64::from(kind.levels[0].wire_bytes)).sum();
    let triangles = 8 * segments[0] * segments[0] * SHAPES as i64;
    let mut uris = UriTableBuilder::default();
    let names = (0..1024 * segments.len())
        .map(|at| uris.intern(&format!("{}-{}.glb", at / segments.len(), at % segments.len())));
    let names = names.collect();
    let folders = (0..=params.count >> 10).map(|at| uris.intern(&format!("models/{at}/"))).collect();
    let mut field = Field {
        kinds,
        bytes_per_triangle: coarsest / triangles as f64,
        builder: LodTreeBuilder::default(),
        uris,
        names,
        folders,
    };
    let mut models = params.models();
    let side = params.side();
    field.cell(&mut models, Cell { depth: 0, at: [0; 3], min: DVec3::splat(-0.5 * side), side })?;
    Ok(World {
        name: "asteroids".to_owned(),
        kind: WorldKind::Asteroids,
        tree: field.builder.finish()?,
        uris: field.uris.finish(),
        up: DVec3::Z,
        ground: Ground::Absent,
        georeference: None,
        root_sample: None,
        notes: Vec::new(),
    })
}

/// A cell of the octree.
#[derive(Clone, Copy)]
struct Cell {
    depth: u32,
    /// Which of the cells of its depth.
    at: [u64; 3],
    min: DVec3,
    side: f64,
}

impl Cell {
    /// The eight halves in Morton order, each with its models, which are put in that order.
    fn halves<'a>(&self, models: &'a mut [Model]) -> Vec<(Cell, &'a mut [Model])> {
        let middle = self.min + 0.5 * self.side;
        let octant = |model: &Model| {
            let upper = model.at.cmpge(middle);
            u64::from(upper.bitmask())
        };
        models.sort_by_key(|model| (octant(model), model.id));
        let mut halves = Vec::new();
        let mut rest = models;
        for half in 0..8 {
            let count = rest.partition_point(|model| octant(model) <= half);
            let (own, others) = rest.split_at_mut(count);
            rest = others;
            if own.is_empty() {
                continue;
            }
            let bit = |axis: usize| half >> axis & 1;
            let at = std::array::from_fn(|axis| 2 * self.at[axis] + bit(axis));
            let step = DVec3::new(bit(0) as f64, bit(1) as f64, bit(2) as f64);
            let side = 0.5 * self.side;
            halves.push((Cell { depth: self.depth + 1, at, min: self.min + step * side, side }, own));
        }
        halves
    }
}

/// How a cell shows its models: how many triangles, and the error, metres.
struct Merged {
    triangles: u64,
    error: f64,
}

struct Field {
    kinds: Vec<Kind>,
    bytes_per_triangle: f64,
    builder: LodTreeBuilder,
    uris: UriTableBuilder,
    /// Ids of the models' file names, by the last ten bits of the model's id and by level.
    names: Vec<u32>,
    /// Ids of the models' folders by the upper bits.
    folders: Vec<u32>,
}

impl Field {
    /// Adds a cell with its models and those beneath it. Recursion: at most [`MAX_DEPTH`] deep.
    fn cell(&mut self, models: &mut [Model], cell: Cell) -> Result<(), LodTreeError> {
        if let [model] = models {
            return self.model(model);
        }
        let merged = merged(models, cell.side, |model, n| self.kinds[usize::from(model.kind)].merged[n - 1]);
        self.builder.open()?;
        let bytes = merged.triangles as f64;
        self.add(bytes * self.bytes_per_triangle, bytes * 24.0, merged.error)?;
        let [x, y, z] = cell.at;
        let (folder, file) = (format!("cells/{}/{x}_{y}_", cell.depth), format!("{z}.glb"));
        let (folder, file) = (self.uris.intern(&folder), self.uris.intern(&file));
        self.uris.push(folder, file);
        if models.len() <= CELL_MODELS || cell.depth == MAX_DEPTH {
            for model in models.iter() {
                self.model(model)?;
            }
        } else {
            for (half, own) in cell.halves(models) {
                self.cell(own, half)?;
            }
        }
        self.builder.close(None, 1.0)
    }

    fn model(&mut self, model: &Model) -> Result<(), LodTreeError> {
        self.builder.open()?;
        let kind = usize::from(model.kind);
        let levels = self.kinds[kind].levels.len();
        for level in 0..levels {
            let Level { error, wire_bytes, decoded_bytes } = self.kinds[kind].levels[level];
            self.add(f64::from(wire_bytes), f64::from(decoded_bytes), error * model.radius)?;
            let folder = self.folders[(model.id >> 10) as usize];
            self.uris.push(folder, self.names[(model.id & 1023) as usize * levels + level]);
        }
        let Aabb { min, max } = self.kinds[kind].bounds;
        let bounds = Aabb { min: model.at + model.radius * min, max: model.at + model.radius * max };
        self.builder.close(Some(bounds), if model.is_landmark { LANDMARK_IMPORTANCE } else { 1.0 })
    }

    fn add(&mut self, wire: f64, decoded: f64, error: f64) -> Result<(), LodTreeError> {
        #[expect(clippy::cast_possible_truncation, reason = "metres to 7 digits")]
        let error = error as f32;
        let (wire_bytes, decoded_bytes) = ((wire as u32).max(1), decoded as u32);
        self.builder.add(Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: None })?;
        Ok(())
    }
}

/// Segments an edge of each of so many models in a merged mesh; `None` where not even the coarsest fit in.
fn merged_segments(count: u64) -> Option<i64> {
    MERGED.rev().find(|n| count * 8 * (n * n) as u64 <= MERGED_TRIANGLES)
}

/// A cell of several models: each of as many triangles as the budget allows, or clusters that lose half their diagonal.
fn merged(models: &[Model], side: f64, error: impl Fn(&Model, usize) -> f64) -> Merged {
    let count = models.len() as u64;
    match merged_segments(count) {
        Some(n) => {
            let error = models.iter().map(|model| model.radius * error(model, n as usize)).fold(0.0, f64::max);
            Merged { triangles: count * 8 * (n * n) as u64, error }
        }
        None => Merged { triangles: MERGED_TRIANGLES, error: 0.5 * 3.0_f64.sqrt() * side / CLUSTERS },
    }
}

#[cfg(test)]
mod tests;
