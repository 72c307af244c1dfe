//! A field with its geometry. Models of one shape share the files of their levels: each level is a tile of its own under
//! the coarser one, with the model's place and scale as the transform of the coarsest.

use std::path::Path;

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::super::document::{GenerateError, Params};
use super::super::tileset::{self, Written, volume};
use super::shape::{self, Mesh};
use super::{AsteroidParams, CELL_MODELS, CLUSTERS, Cell, Kind, MAX_DEPTH, Model, merged, merged_segments, segments};
use crate::format::glb::{self, narrowed};

/// Most tiles that are written: enough for the scene of the paper.
pub const MAX_WRITTEN_TILES: u64 = 200_000;

/// Writes the folder `out` with a 3D Tiles tileset and its contents. `out` must not exist or be an empty folder.
/// `progress` is told how many files are written, and of how many.
pub fn write(
    params: &AsteroidParams,
    out: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Written, GenerateError> {
    params.check()?;
    let segments = segments(params.triangles);
    tileset::check_tiles(u64::from(params.count) * segments.len() as u64, MAX_WRITTEN_TILES)?;
    let seeds = params.seeds();
    let kinds: Vec<Kind> = seeds.par_iter().map(|&seed| Kind::new(seed, &segments)).collect();
    let coarse = seeds.iter().map(|&seed| [1, 2, 3].map(|n| shape::mesh(seed, n))).collect();
    let mut tiles = Tiles { kinds, coarse, parts: Vec::new(), count: 0 };
    for (kind, &seed) in seeds.iter().enumerate() {
        let levels = segments.iter().enumerate();
        tiles.parts.extend(levels.map(|(level, &n)| (format!("shapes/{kind}-{level}.glb"), Part::Shape(seed, n))));
    }
    let mut models = params.models();
    let side = params.side();
    let (root, _, error) = tiles.cell(&mut models, Cell { depth: 0, at: [0; 3], min: DVec3::splat(-0.5 * side), side });
    tileset::check_tiles(tiles.count, MAX_WRITTEN_TILES)?;
    let content = |(file, part): &(String, Part)| {
        let mesh = match part {
            Part::Shape(seed, n) => shape::mesh(*seed, *n),
            Part::Merged(models) => tiles.merge(models),
        };
        let (positions, normals) = (narrowed(&mesh.positions), narrowed(&mesh.normals));
        let mesh = glb::Mesh { origin: None, positions: &positions, normals: &normals, triangles: &mesh.triangles };
        (file.clone(), glb::encode(&mesh))
    };
    tileset::write(out, &tiles.parts, content, (2.0 * error, root), tiles.count, progress)
}

/// What a file shows.
enum Part {
    /// A shape by its seed, of so many segments an edge.
    Shape(u64, i64),
    /// Shapes at their places: which, its level of the merged ones, centre and radius.
    Merged(Vec<(u16, usize, DVec3, f64)>),
}

struct Tiles {
    kinds: Vec<Kind>,
    /// Meshes of 1, 2 and 3 segments an edge by shape.
    coarse: Vec<[Mesh; 3]>,
    parts: Vec<(String, Part)>,
    count: u64,
}

impl Tiles {
    /// The JSON of a cell with its bounds and its error. Recursion: at most [`MAX_DEPTH`] deep.
    fn cell(&mut self, models: &mut [Model], cell: Cell) -> (Value, Aabb, f64) {
        if let [model] = models {
            return self.model(model);
        }
        let shown = merged(models, cell.side, |model, n| self.kinds[usize::from(model.kind)].merged[n - 1]);
        let [x, y, z] = cell.at;
        let file = format!("cells/{}/{x}_{y}_{z}.glb", cell.depth);
        self.parts.push((file.clone(), Part::Merged(stand_ins(models, &cell))));
        self.count += 1;
        let mut bounds = Aabb::EMPTY;
        let mut children = Vec::new();
        let mut add = |(json, own, _): (Value, Aabb, f64)| {
            bounds = bounds.union(own);
            children.push(json);
        };
        if models.len() <= CELL_MODELS || cell.depth == MAX_DEPTH {
            models.iter().for_each(|model| add(self.model(model)));
        } else {
            cell.halves(models).into_iter().for_each(|(half, own)| add(self.cell(own, half)));
        }
        let json = json!({
            "boundingVolume": volume(bounds),
            "geometricError": shown.error,
            "refine": "REPLACE",
            "content": { "uri": file },
            "children": children,
        });
        (json, bounds, shown.error)
    }

    fn model(&mut self, model: &Model) -> (Value, Aabb, f64) {
        let kind = &self.kinds[usize::from(model.kind)];
        let mut json = Value::Null;
        let last = kind.levels.len() - 1;
        for (level, own) in kind.levels.iter().enumerate().rev() {
            let mut tile = json!({
                "boundingVolume": volume(kind.bounds),
                // Scaled by the transform, as 3D Tiles has it.
                "geometricError": own.error,
                "refine": "REPLACE",
                "content": { "uri": format!("shapes/{}-{level}.glb", model.kind) },
            });
            if level < last {
                tile["children"] = json!([json]);
            }
            json = tile;
        }
        let (r, at) = (model.radius, model.at);
        json["transform"] = json!([r, 0.0, 0.0, 0.0, 0.0, r, 0.0, 0.0, 0.0, 0.0, r, 0.0, at.x, at.y, at.z, 1.0]);
        self.count += kind.levels.len() as u64;
        let bounds = Aabb { min: at + r * kind.bounds.min, max: at + r * kind.bounds.max };
        (json, bounds, r * kind.levels[0].error)
    }

    fn merge(&self, models: &[(u16, usize, DVec3, f64)]) -> Mesh {
        let mut whole = Mesh { positions: Vec::new(), normals: Vec::new(), triangles: Vec::new() };
        for &(kind, level, at, radius) in models {
            let mesh = &self.coarse[usize::from(kind)][level];
            let first = whole.positions.len() as u32;
            whole.positions.extend(mesh.positions.iter().map(|place| at + radius * *place));
            whole.normals.extend(&mesh.normals);
            whole.triangles.extend(mesh.triangles.iter().map(|triangle| triangle.map(|index| first + index)));
        }
        whole
    }
}

/// What a cell's merged mesh is made of: its models, or where they are too many a cluster for each occupied part.
pub(super) fn stand_ins(models: &[Model], cell: &Cell) -> Vec<(u16, usize, DVec3, f64)> {
    if let Some(n) = merged_segments(models.len() as u64) {
        return models.iter().map(|model| (model.kind, n as usize - 1, model.at, model.radius)).collect();
    }
    let mut clusters = std::collections::BTreeMap::new();
    for model in models {
        let part =
            ((model.at - cell.min) * (CLUSTERS / cell.side)).floor().clamp(DVec3::ZERO, DVec3::splat(CLUSTERS - 1.0));
        let key = part.to_array().map(|value| value as u32);
        let (count, at, radius, _) = clusters.entry(key).or_insert((0.0, DVec3::ZERO, 0.0, model.kind));
        *count += 1.0;
        *at += model.at;
        *radius += model.radius;
    }
    clusters.into_values().map(|(count, at, radius, kind)| (kind, 0, at / count, radius / count)).collect()
}
