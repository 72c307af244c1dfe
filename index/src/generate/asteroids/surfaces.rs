//! The surfaces of a field of models at their finest, some models a piece. The shapes are in memory, the models are placed when they
//! are read.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use rayon::prelude::*;

use super::super::document::{GenerateError, Params};
use super::shape::{self, Mesh};
use super::{AsteroidParams, Model, segments};
use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::surface::{PIECE_TRIANGLES, Piece, SurfaceSource, parameters_identity};
use crate::world::Georeference;

/// Linear light of landmarks and of all others.
pub(super) const BRIGHT: [f32; 3] = [0.45, 0.4, 0.33];
pub(super) const GREY: [f32; 3] = [0.17, 0.165, 0.16];

/// The surfaces of a field.
pub struct AsteroidSurfaces {
    params: AsteroidParams,
    models: Vec<Model>,
    shapes: Vec<Mesh>,
    /// Models a piece.
    together: usize,
}

impl AsteroidSurfaces {
    /// The surfaces of the field of these parameters.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn new(params: &AsteroidParams) -> Result<AsteroidSurfaces, GenerateError> {
        params.check()?;
        let finest = segments(params.triangles).pop().unwrap_or(1);
        let shapes: Vec<Mesh> = params.seeds().par_iter().map(|&seed| shape::mesh(seed, finest)).collect();
        let own = shapes.first().map_or(1, |mesh| mesh.triangles.len());
        let together = (PIECE_TRIANGLES / own.max(1)).max(1);
        Ok(AsteroidSurfaces { params: params.clone(), models: params.models(), shapes, together })
    }

    fn models(&self, piece: usize) -> &[Model] {
        let first = piece * self.together;
        &self.models[first..(first + self.together).min(self.models.len())]
    }
}

impl SurfaceSource for AsteroidSurfaces {
    fn pieces(&self) -> usize {
        self.models.len().div_ceil(self.together)
    }

    fn declared(&self, piece: usize) -> Option<Aabb> {
        let bounds = self.models(piece).iter().map(|model| {
            let own = self.shapes[usize::from(model.kind)].bounds();
            Aabb { min: model.at + model.radius * own.min, max: model.at + model.radius * own.max }
        });
        Some(bounds.fold(Aabb::EMPTY, Aabb::union))
    }

    fn name(&self, _: usize) -> &str {
        "generated asteroids"
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let mut out = Piece::default();
        for model in self.models(piece) {
            let mesh = &self.shapes[usize::from(model.kind)];
            let place = |at: u32| model.at + model.radius * mesh.positions[at as usize];
            let material = u32::from(model.is_landmark);
            let placed = |corners: &[u32; 3]| Triangle { corners: corners.map(place), material, ..Triangle::default() };
            out.triangles.extend(mesh.triangles.iter().map(placed));
        }
        out.materials = [GREY, BRIGHT].map(|base| Material { base, ..Material::default() }).to_vec();
        Ok(out)
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
