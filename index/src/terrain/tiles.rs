//! The quadtree of tiles over a height field.

use std::sync::Arc;

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, Representation};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::encode::{decoded_bytes, encode_heights};
use super::field::{HeightField, HeightFieldError, on_cell};
use crate::ground::Ground;
use crate::uris::{UriTable, UriTableBuilder};
use crate::world::{Georeference, Note, Severity, World, WorldKind};

/// Cells along a side of a tile.
pub const TILE_CELLS: u32 = 64;

/// Why there is no terrain.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TerrainError {
    /// The height field does not hold.
    #[error(transparent)]
    Field(#[from] HeightFieldError),
    /// The tree cannot be built.
    #[error(transparent)]
    Tree(#[from] LodTreeError),
}

/// A tile as measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tile {
    /// Largest vertical distance from the samples beneath, and not less than that of any tile beneath, metres.
    pub(crate) error: f64,
    pub(crate) bounds: Aabb,
    wire_bytes: u32,
    decoded_bytes: u32,
}

/// The tiles of one level by row and column; `None` where no sample has a height.
pub(crate) struct Level {
    across: u32,
    tiles: Vec<Option<Tile>>,
}

/// The world of a height field. z is up; the levels' errors are exact, those of the finest tiles 0; what quantisation on
/// the wire adds, at most 1/131070 of a tile's range of heights, is not counted.
pub fn terrain(
    name: String,
    file: &str,
    field: HeightField,
    georeference: Option<Georeference>,
) -> Result<World, TerrainError> {
    let levels = measure(&field)?;
    let (tree, uris) = build(&levels)?;
    let mut notes = Vec::new();
    let mut note = |severity, text| {
        notes.push(Note { severity, file: file.to_owned(), place: String::new(), text });
    };
    let missing = field.missing();
    if missing > 0 {
        let of = u64::from(field.columns()) * u64::from(field.rows());
        note(
            Severity::Repair,
            format!("{missing} of {of} samples have no height: they stand at the nearest one that has"),
        );
    }
    note(
        Severity::Trap,
        format!(
            "tiles of {TILE_CELLS} × {TILE_CELLS} cells were made from the grid: their errors are measured against it, and their sizes are those of an encoding of their heights alone, without imagery"
        ),
    );
    let ground = Ground::Surface(Arc::new(field));
    Ok(World {
        name,
        kind: WorldKind::Terrain,
        tree,
        uris,
        up: DVec3::Z,
        ground,
        georeference,
        root_sample: None,
        notes,
    })
}

/// Levels from the finest to the one of a single tile.
pub(crate) fn measure(field: &HeightField) -> Result<Vec<Level>, HeightFieldError> {
    let cells = [field.columns() - 1, field.rows() - 1];
    let mut levels: Vec<Level> = Vec::new();
    loop {
        let stride = 1_u32 << levels.len();
        let [across, down] = cells.map(|cells| cells.div_ceil(TILE_CELLS * stride));
        let tiles: Result<Vec<Option<Tile>>, HeightFieldError> = (0..across * down)
            .into_par_iter()
            .map(|at| {
                let (x, y) = (at % across, at / across);
                let Some(mut tile) = measure_tile(field, stride, x, y)? else { return Ok(None) };
                if let Some(finer) = levels.last() {
                    tile.error = finer.beneath(x, y).map(|tile| tile.error).fold(tile.error, f64::max);
                }
                Ok(Some(tile))
            })
            .collect();
        levels.push(Level { across, tiles: tiles? });
        if across == 1 && down == 1 {
            return Ok(levels);
        }
    }
}

impl Level {
    pub(crate) fn get(&self, x: u32, y: u32) -> Option<&Tile> {
        if x >= self.across { None } else { self.tiles.get((y * self.across + x) as usize)?.as_ref() }
    }

    /// Up to four tiles of this level beneath tile (x, y) of the next.
    fn beneath(&self, x: u32, y: u32) -> impl Iterator<Item = &Tile> {
        [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().filter_map(move |(dx, dy)| self.get(2 * x + dx, 2 * y + dy))
    }
}

/// Every `stride`-th of `first..=last`, and `last`.
fn lines(first: u32, last: u32, stride: u32) -> Vec<u32> {
    let mut lines: Vec<u32> = (first..last).step_by(stride as usize).collect();
    lines.push(last);
    lines
}

fn measure_tile(field: &HeightField, stride: u32, x: u32, y: u32) -> Result<Option<Tile>, HeightFieldError> {
    let side = TILE_CELLS * stride;
    let (x0, y0) = (x * side, y * side);
    let (x1, y1) = (x0.saturating_add(side).min(field.columns() - 1), y0.saturating_add(side).min(field.rows() - 1));
    if !(y0..=y1).any(|y| (x0..=x1).any(|x| field.is_there(x, y))) {
        return Ok(None);
    }
    let (columns, rows) = (lines(x0, x1, stride), lines(y0, y1, stride));
    let samples: Vec<f32> =
        rows.iter().flat_map(|&y| columns.iter().map(move |&x| (x, y))).map(|(x, y)| field.at(x, y)).collect();
    let low = samples.iter().copied().fold(f32::INFINITY, f32::min);
    let high = samples.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let mut error = 0.0;
    if stride > 1 {
        for rows in rows.windows(2) {
            for columns in columns.windows(2) {
                error = cell_error(field, [columns[0], rows[0], columns[1], rows[1]]).max(error);
            }
        }
    }
    let (min, max) = field.footprint([x0, y0, x1, y1])?;
    Ok(Some(Tile {
        error,
        bounds: Aabb { min: min.extend(f64::from(low)), max: max.extend(f64::from(high)) },
        wire_bytes: encode_heights(&samples, columns.len()).len() as u32,
        decoded_bytes: decoded_bytes(columns.len() as u32, rows.len() as u32),
    }))
}

/// Largest vertical distance between a coarse cell's two triangles and the samples' own surface. Both are linear on
/// triangles, so it is taken at a sample or where the coarse diagonal crosses lines between samples; in a square cell the
/// diagonal runs along the samples' own diagonals and crosses none.
fn cell_error(field: &HeightField, [x0, y0, x1, y1]: [u32; 4]) -> f64 {
    let corners = [(x0, y0), (x1, y0), (x0, y1), (x1, y1)].map(|(x, y)| f64::from(field.at(x, y)));
    let (origin, size) = (DVec2::new(f64::from(x0), f64::from(y0)), DVec2::new(f64::from(x1 - x0), f64::from(y1 - y0)));
    let mut error = 0.0_f64;
    for y in y0..=y1 {
        for x in x0..=x1 {
            let at = (DVec2::new(f64::from(x), f64::from(y)) - origin) / size;
            error = error.max((on_cell(corners, at) - f64::from(field.at(x, y))).abs());
        }
    }
    if size.x != size.y {
        let mut crossing = |part: f64| {
            let at = DVec2::splat(part);
            error = error.max((on_cell(corners, at) - field.between(origin + at * size)).abs());
        };
        // Lines of constant x, of constant y, and the samples' diagonals, of constant x − y.
        for count in [size.x, size.y, (size.x - size.y).abs()] {
            for line in 1..count as u32 {
                crossing(f64::from(line) / count);
            }
        }
    }
    error
}

fn build(levels: &[Level]) -> Result<(LodTree, UriTable), LodTreeError> {
    let mut builder = LodTreeBuilder::default();
    let mut uris = UriTableBuilder::default();
    add(levels, levels.len() - 1, 0, 0, &mut builder, &mut uris)?;
    Ok((builder.finish()?, uris.finish()))
}

/// Adds a tile and those beneath it, if it is there. Recursion goes down the levels: at most 22.
fn add(
    levels: &[Level],
    level: usize,
    x: u32,
    y: u32,
    builder: &mut LodTreeBuilder,
    uris: &mut UriTableBuilder,
) -> Result<(), LodTreeError> {
    let Some(tile) = levels[level].get(x, y) else { return Ok(()) };
    builder.open()?;
    builder.add(Representation {
        wire_bytes: tile.wire_bytes,
        decoded_bytes: tile.decoded_bytes,
        error: narrow_error(tile.error),
        prerequisite: None,
        direction: None,
    })?;
    let (prefix, tail) =
        (uris.intern(&format!("{}/{x}/", levels.len() - 1 - level)), uris.intern(&format!("{y}.terrain")));
    uris.push(prefix, tail);
    if level > 0 {
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            add(levels, level - 1, 2 * x + dx, 2 * y + dy, builder, uris)?;
        }
    }
    builder.close(Some(tile.bounds), 1.0)
}

/// To an f32 not below it.
#[expect(clippy::cast_possible_truncation, reason = "metres to 7 digits, rounded upwards")]
fn narrow_error(error: f64) -> f32 {
    let narrow = error as f32;
    if f64::from(narrow) < error { narrow.next_up() } else { narrow }
}

#[cfg(test)]
mod tests {
    use foresight_scheduler::lod_tree::{NodeId, RepId};

    use super::*;
    use crate::terrain::Frame;

    fn world(columns: u32, rows: u32, height: impl Fn(f64, f64) -> f32) -> World {
        let frame =
            Frame { origin: DVec2::ZERO, column: DVec2::new(2.0, 0.0), row: DVec2::new(0.0, 3.0), projection: None };
        let samples = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        let heights = samples.map(|(x, y)| height(f64::from(x), f64::from(y))).collect();
        terrain("t".to_owned(), "t.npz", HeightField::new(columns, rows, heights, frame).unwrap(), None).unwrap()
    }

    fn errors(world: &World) -> Vec<f64> {
        (0..world.tree.representations() as u32).map(|rep| world.tree.error(RepId(rep))).collect()
    }

    #[test]
    fn a_plane_has_no_error() {
        for (columns, rows) in [(257, 257), (300, 150), (2, 400)] {
            let world = world(columns, rows, |x, y| (3.0 * x - 2.0 * y) as f32);
            assert!(errors(&world).iter().all(|&error| error < 1e-9), "{:?}", errors(&world));
            let bounds = world.summary().bounds;
            assert_eq!(bounds.max.truncate(), DVec2::new(2.0 * f64::from(columns - 1), 3.0 * f64::from(rows - 1)));
        }
    }

    #[test]
    fn a_spike_is_lost_where_it_lies_between_samples() {
        // 256 cells: a root over 4 tiles over 16.
        let world = world(257, 257, |x, y| if (x, y) == (130.0, 66.0) { 40.0 } else { 0.0 });
        assert_eq!(world.tree.representations(), 21);
        let root = world.tree.error(RepId(0));
        assert_eq!(root, 40.0);
        let above: Vec<f64> = (1..21).map(|rep| world.tree.error(RepId(rep))).filter(|&error| error > 0.0).collect();
        // 130 and 66 are even: a tile of level 1 has the top, and slopes twice as long.
        assert_eq!(above, [20.0]);
    }

    #[test]
    fn a_ridge_between_samples_costs_half_its_height() {
        // |x − 65| at stride 2: samples at 64 and 66 are both 1, the ridge line at 65 is 0; at stride 4 one of 64 and 68,
        // 1 and 3: at 65 the chord is 1.5.
        let world = world(257, 257, |x, _| (x - 65.0).abs() as f32);
        let tree = &world.tree;
        assert_eq!(tree.error(RepId(0)), 1.5);
        let level_1: Vec<f64> =
            tree.children(tree.root()).map(|node| tree.error(tree.own(node).next().unwrap())).collect();
        assert_eq!(level_1, [1.0, 0.0, 1.0, 0.0]);
    }

    #[test]
    fn the_error_is_what_dense_sampling_finds() {
        // Grids that are no multiple of the tiles: partial cells with diagonals of their own.
        let wave = |x: f64, y: f64| (20.0 * libm::sin(0.31 * x) * libm::cos(0.23 * y) + libm::sin(3.0 * x + y)) as f32;
        let frame = Frame { origin: DVec2::ZERO, column: DVec2::X, row: DVec2::Y, projection: None };
        let heights = (0..21).flat_map(|y| (0..21).map(move |x| wave(f64::from(x), f64::from(y)))).collect();
        let field = HeightField::new(21, 21, heights, frame).unwrap();
        for cell in [[0, 0, 8, 8], [16, 0, 20, 8], [3, 5, 4, 20], [2, 2, 13, 9]] {
            let [x0, y0, x1, y1] = cell.map(f64::from);
            let corners =
                [(0, 1), (2, 1), (0, 3), (2, 3)].map(|(x, y): (usize, usize)| f64::from(field.at(cell[x], cell[y])));
            let mut dense = 0.0_f64;
            for at in 0..=240 * 240 {
                let at = DVec2::new(f64::from(at % 241), f64::from(at / 241)) / 240.0;
                let fine = field.between(DVec2::new(x0, y0) + at * DVec2::new(x1 - x0, y1 - y0));
                dense = dense.max((on_cell(corners, at) - fine).abs());
            }
            let exact = cell_error(&field, cell);
            assert!(dense <= exact + 1e-9 && exact < dense * 1.01 + 1e-9, "{cell:?}: {dense} {exact}");
        }
    }

    #[test]
    fn errors_rise_and_bounds_are_tight() {
        let world = world(301, 211, |x, y| (10.0 * libm::sin(0.1 * x) + 7.0 * libm::cos(0.17 * y)) as f32);
        let tree = &world.tree;
        for node in (0..tree.nodes() as u32).map(NodeId) {
            let own = tree.own(node).next().unwrap();
            if let Some(parent) = tree.parent(node) {
                assert!(tree.error(own) <= tree.error(tree.own(parent).next().unwrap()));
            }
            let bounds = tree.bounds(node);
            assert!(bounds.max.z - bounds.min.z <= 34.1 && bounds.max.z - bounds.min.z > 0.5, "{bounds:?}");
        }
        assert_eq!(world.ground_height(DVec3::ZERO), Some(7.0));
    }

    #[test]
    fn tiles_without_a_height_are_left_out() {
        let world = world(257, 257, |x, _| if x > 120.0 { f32::NAN } else { 1.0 });
        assert_eq!(world.tree.representations(), 1 + 2 + 8);
        assert!(world.notes[0].to_string().contains("34952 of 66049 samples"), "{}", world.notes[0]);
    }
}
