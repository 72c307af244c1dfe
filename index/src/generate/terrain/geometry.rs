//! A terrain with its geometry: the surface sampled, tiles measured against the samples, a GLB each with a skirt.
//! Imagery is not made: sizes are those of positions, normals and triangles.

use std::path::Path;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use serde_json::{Value, json};

use super::super::document::{GenerateError, Params};
use super::super::tileset::{self, Written, volume};
use super::TerrainParams;
use crate::format::glb::{self, narrowed};
use crate::terrain::{Frame, HeightField, Level, TILE_CELLS, TerrainError, measure};

/// Most tiles that are written.
pub const MAX_WRITTEN_TILES: u64 = 40_000;

/// Writes the folder `out` with a 3D Tiles tileset and its contents. `out` must not exist or be an empty folder.
/// `progress` is told how many files are written, and of how many.
pub fn write(params: &TerrainParams, out: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Written, GenerateError> {
    params.check()?;
    let shape = params.shape()?;
    let count = (0..shape.levels).map(|level| shape.across.div_ceil(1 << level)).map(|n| n * n).sum();
    tileset::check_tiles(count, MAX_WRITTEN_TILES)?;
    let fractal = params.fractal(&shape);
    let side = shape.across * u64::from(TILE_CELLS) + 1;
    #[expect(clippy::cast_possible_truncation, reason = "metres to 7 digits")]
    let row = |y: u64| (0..side).map(|x| fractal.sample(x, y) as f32).collect::<Vec<f32>>();
    let heights: Vec<f32> = (0..side).into_par_iter().flat_map_iter(row).collect();
    let frame = Frame {
        origin: DVec2::splat(-0.5 * shape.side * shape.across as f64),
        column: DVec2::new(params.resolution, 0.0),
        row: DVec2::new(0.0, params.resolution),
        projection: None,
    };
    let made = HeightField::new(side as u32, side as u32, heights, frame);
    let field = made.map_err(|error| GenerateError::Terrain(TerrainError::from(error)))?;
    let levels = measure(&field).map_err(|error| GenerateError::Terrain(TerrainError::from(error)))?;
    let mut parts = Vec::new();
    let root = tile(&levels, levels.len() - 1, 0, 0, &mut parts);
    let top = levels.last().and_then(|level| level.get(0, 0)).map_or(0.0, |tile| tile.error);
    let content = |part: &Part| (part.file.clone(), mesh(params, &field, &levels, part));
    tileset::write(out, &parts, content, (2.0 * top, root), count, progress)
}

/// A tile to be meshed, its level counted from the finest.
struct Part {
    file: String,
    level: usize,
    x: u32,
    y: u32,
}

/// The JSON of a tile and of those beneath it. Recursion goes down the levels: at most 9.
fn tile(levels: &[Level], level: usize, x: u32, y: u32, parts: &mut Vec<Part>) -> Value {
    let Some(measured) = levels[level].get(x, y) else { return Value::Null };
    let file = format!("{}/{x}/{y}.glb", levels.len() - 1 - level);
    parts.push(Part { file: file.clone(), level, x, y });
    let skirt = DVec3::new(0.0, 0.0, skirt(levels, level, x, y));
    let bounds = Aabb { min: measured.bounds.min - skirt, max: measured.bounds.max };
    let mut json = json!({
        "boundingVolume": volume(bounds),
        "geometricError": measured.error,
        "refine": "REPLACE",
        "content": { "uri": file },
    });
    if level > 0 {
        let halves = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| (2 * x + dx, 2 * y + dy));
        let there = halves.into_iter().filter(|&(x, y)| levels[level - 1].get(x, y).is_some());
        json["children"] = there.map(|(x, y)| tile(levels, level - 1, x, y, parts)).collect();
    }
    json
}

/// Depth of a tile's skirt, metres: as far as a neighbour that is one level coarser may lie off.
fn skirt(levels: &[Level], level: usize, x: u32, y: u32) -> f64 {
    let above = levels.get(level + 1).and_then(|coarser| coarser.get(x / 2, y / 2));
    above.or_else(|| levels[level].get(x, y)).map_or(0.0, |tile| tile.error)
}

fn mesh(params: &TerrainParams, field: &HeightField, levels: &[Level], part: &Part) -> Vec<u8> {
    let stride = 1_u32 << part.level;
    let cells = TILE_CELLS * stride;
    let lines = |at: u32, last: u32| {
        let first = at * cells;
        let end = first.saturating_add(cells).min(last);
        (first..end).step_by(stride as usize).chain([end]).collect::<Vec<u32>>()
    };
    let (columns, rows) = (lines(part.x, field.columns() - 1), lines(part.y, field.rows() - 1));
    let place = |x: u32, y: u32| {
        let native = field.frame().origin + params.resolution * DVec2::new(f64::from(x), f64::from(y));
        native.extend(f64::from(field.at(x, y)))
    };
    // Slopes between the neighbours in the finest grid.
    let normal = |x: u32, y: u32| {
        let across = place((x + 1).min(field.columns() - 1), y) - place(x.saturating_sub(1), y);
        let along = place(x, (y + 1).min(field.rows() - 1)) - place(x, y.saturating_sub(1));
        across.cross(along).normalize_or(DVec3::Z)
    };
    let grid: Vec<(u32, u32)> = rows.iter().flat_map(|&y| columns.iter().map(move |&x| (x, y))).collect();
    let mut positions: Vec<DVec3> = grid.iter().map(|&(x, y)| place(x, y)).collect();
    let mut normals: Vec<DVec3> = grid.iter().map(|&(x, y)| normal(x, y)).collect();
    let (width, height) = (columns.len() as u32, rows.len() as u32);
    let at = |i: u32, j: u32| j * width + i;
    let mut triangles = Vec::new();
    for j in 0..height - 1 {
        for i in 0..width - 1 {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)];
            triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    // Around the tile, seen from above to the left of what lies inside.
    let south = (0..width).map(|i| at(i, 0));
    let east = (1..height).map(|j| at(width - 1, j));
    let north = (0..width - 1).rev().map(|i| at(i, height - 1));
    let west = (0..height - 1).rev().map(|j| at(0, j));
    let around: Vec<u32> = south.chain(east).chain(north).chain(west).collect();
    let down = DVec3::new(0.0, 0.0, skirt(levels, part.level, part.x, part.y));
    if down.z > 0.0 {
        let first = positions.len() as u32;
        for &top in &around[..around.len() - 1] {
            positions.push(positions[top as usize] - down);
            normals.push(normals[top as usize]);
        }
        let foot = |step: usize| first + (step % (around.len() - 1)) as u32;
        for (step, pair) in around.windows(2).enumerate() {
            triangles.extend([[pair[0], foot(step), pair[1]], [pair[1], foot(step), foot(step + 1)]]);
        }
    }
    let (positions, normals) = (narrowed(&positions), narrowed(&normals));
    glb::encode(&glb::Mesh { origin: None, positions: &positions, normals: &normals, triangles: &triangles })
}
