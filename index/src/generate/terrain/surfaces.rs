//! A terrain's surface at its finest, a square of cells a piece, sampled when it is read. Grass, rock and snow by height and slope
//! are the colours of its vertices.

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};

use super::super::document::{GenerateError, Params};
use super::TerrainParams;
use super::fractal::Fractal;
use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::{Material, encoded};
use crate::surface::{Piece, SurfaceSource, parameters_identity};
use crate::terrain::TILE_CELLS;
use crate::world::Georeference;

/// Cells along a side of a piece.
const CELLS: u64 = 256;

/// Linear light.
const GRASS: [f32; 3] = [0.1, 0.16, 0.04];
const ROCK: [f32; 3] = [0.2, 0.18, 0.16];
const SNOW: [f32; 3] = [0.85, 0.87, 0.9];

/// The surface of a terrain.
pub struct TerrainSurfaces {
    params: TerrainParams,
    fractal: Fractal,
    /// Of the first sample, metres.
    origin: DVec2,
    /// Along a side.
    cells: u64,
}

impl TerrainSurfaces {
    /// The surface of the terrain of these parameters.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn new(params: &TerrainParams) -> Result<TerrainSurfaces, GenerateError> {
        params.check()?;
        let shape = params.shape()?;
        let cells = shape.across * u64::from(TILE_CELLS);
        let origin = DVec2::splat(-0.5 * shape.side * shape.across as f64);
        Ok(TerrainSurfaces { params: params.clone(), fractal: params.fractal(&shape), origin, cells })
    }

    /// The cells of a piece, from and up to.
    fn range(&self, piece: usize) -> [(u64, u64); 2] {
        let across = self.cells.div_ceil(CELLS);
        let range = |at: u64| (at * CELLS, (at * CELLS + CELLS).min(self.cells));
        [range(piece as u64 % across), range(piece as u64 / across)]
    }

    fn tint(&self, height: f64, normal: DVec3) -> [u8; 3] {
        #[expect(clippy::cast_possible_truncation, reason = "shares from 0 to 1")]
        let [snow, rock] = [
            ((height / self.fractal.relief().max(1.0) - 0.55) * 8.0).clamp(0.0, 1.0),
            ((0.85 - normal.z) * 5.0).clamp(0.0, 1.0),
        ]
        .map(|share| share as f32);
        let mixed = |c: usize| {
            let ground = GRASS[c] + (SNOW[c] - GRASS[c]) * snow;
            ground + (ROCK[c] - ground) * rock
        };
        [0, 1, 2].map(|c| encoded(mixed(c)))
    }
}

impl SurfaceSource for TerrainSurfaces {
    fn pieces(&self) -> usize {
        let across = self.cells.div_ceil(CELLS) as usize;
        across * across
    }

    fn declared(&self, piece: usize) -> Option<Aabb> {
        let [x, y] = self.range(piece);
        let at = |x: u64, y: u64| self.origin + self.params.resolution * DVec2::new(x as f64, y as f64);
        Some(Aabb { min: at(x.0, y.0).extend(0.0), max: at(x.1, y.1).extend(self.fractal.relief()) })
    }

    fn name(&self, _: usize) -> &str {
        "generated terrain"
    }

    fn triangles(&self, piece: usize) -> Result<Vec<Triangle>, ContentError> {
        let [(x0, x1), (y0, y1)] = self.range(piece);
        let width = (x1 - x0 + 1) as usize;
        let mut places = Vec::with_capacity(width * (y1 - y0 + 1) as usize);
        for y in y0..=y1 {
            for x in x0..=x1 {
                let at = self.origin + self.params.resolution * DVec2::new(x as f64, y as f64);
                places.push(at.extend(self.fractal.sample(x, y)));
            }
        }
        let height = places.len() / width;
        // Slopes between the neighbours in the piece.
        let tint = |at: usize| {
            let (i, j) = (at % width, at / width);
            let across = places[j * width + (i + 1).min(width - 1)] - places[j * width + i.saturating_sub(1)];
            let along = places[(j + 1).min(height - 1) * width + i] - places[j.saturating_sub(1) * width + i];
            self.tint(places[at].z, across.cross(along).normalize_or(DVec3::Z))
        };
        let tints: Vec<[u8; 3]> = (0..places.len()).map(tint).collect();
        let mut triangles = Vec::with_capacity(2 * (width - 1) * (height - 1));
        for j in 0..height - 1 {
            for i in 0..width - 1 {
                let at = j * width + i;
                let [a, b, c, d] = [at, at + 1, at + width, at + width + 1];
                triangles.extend([[a, b, d], [a, d, c]].map(|corners| Triangle {
                    corners: corners.map(|at| places[at]),
                    tint: corners.map(|at| tints[at]),
                    ..Triangle::default()
                }));
            }
        }
        Ok(triangles)
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let triangles = self.triangles(piece)?;
        Ok(Piece { triangles, materials: vec![Material::default()], ..Piece::default() })
    }

    fn up(&self) -> DVec3 {
        DVec3::Z
    }

    fn georeference(&self) -> Option<Georeference> {
        None
    }

    fn identity(&self) -> Result<[u8; 32], ContentError> {
        parameters_identity(&self.params)
    }
}
