//! Contents of a field by representation, made when they are asked for: models at their levels, and the merged meshes of cells.

use glam::DVec3;
use rayon::prelude::*;

use super::super::document::{GenerateError, Params};
use super::geometry::stand_ins;
use super::shape::{self, Mesh};
use super::surfaces::{BRIGHT, GREY};
use super::{AsteroidParams, Cell, MAX_DEPTH, Model, segments};
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::surface::Piece;
use crate::world::World;

/// The contents of a field.
#[derive(Debug)]
pub struct AsteroidContents {
    side: f64,
    /// By id.
    models: Vec<Model>,
    seeds: Vec<u64>,
    /// Segments an edge by level, coarsest first.
    segments: Vec<i64>,
    /// Meshes of 1, 2 and 3 segments an edge by shape.
    coarse: Vec<[Mesh; 3]>,
}

impl AsteroidContents {
    /// The field of these parameters with its contents.
    ///
    /// # Errors
    /// As [`super::asteroids`].
    pub fn open(params: &AsteroidParams) -> Result<(World, AsteroidContents), GenerateError> {
        params.check()?;
        let world = super::asteroids(params)?;
        let seeds = params.seeds();
        let coarse = seeds.par_iter().map(|&seed| [1, 2, 3].map(|n| shape::mesh(seed, n))).collect();
        let (side, models) = (params.side(), params.models());
        Ok((world, AsteroidContents { side, models, seeds, segments: segments(params.triangles), coarse }))
    }

    /// What is fetched at an address of the field's; `None` where there is nothing.
    pub fn piece(&self, uri: &str) -> Option<Piece> {
        let materials = [GREY, BRIGHT].map(|base| Material { base, ..Material::default() }).to_vec();
        let mut out = Piece { materials, ..Piece::default() };
        let (kind, rest) = uri.split_once('/')?;
        let (folder, name) = rest.split_once('/')?;
        let name = name.strip_suffix(".glb")?;
        match kind {
            "models" => {
                let (within, level) = name.split_once('-')?;
                let id = folder.parse::<usize>().ok()?.checked_mul(1024)?.checked_add(within.parse().ok()?)?;
                let (model, n) = (self.models.get(id)?, *self.segments.get(level.parse::<usize>().ok()?)?);
                let mesh = shape::mesh(*self.seeds.get(usize::from(model.kind))?, n);
                add(&mesh, model.at, model.radius, u32::from(model.is_landmark), &mut out);
            }
            "cells" => {
                let depth = folder.parse().ok().filter(|depth| *depth <= MAX_DEPTH)?;
                let mut at = name.split('_').map(|number| number.parse::<u64>().ok());
                let at = [at.next()??, at.next()??, at.next()??];
                let (cell, models) = self.cell(depth, at)?;
                for (kind, level, at, radius) in stand_ins(&models, &cell) {
                    add(&self.coarse.get(usize::from(kind))?[level], at, radius, 0, &mut out);
                }
            }
            _ => return None,
        }
        Some(out)
    }

    /// A cell with its models: those that lie in the same halves, halving by halving.
    fn cell(&self, depth: u32, at: [u64; 3]) -> Option<(Cell, Vec<Model>)> {
        let mut cell = Cell { depth: 0, at: [0; 3], min: DVec3::splat(-0.5 * self.side), side: self.side };
        let mut models = self.models.clone();
        for step in (0..depth).rev() {
            let mut halves = cell.halves(&mut models);
            let wanted = at.map(|at| at >> step);
            let found = halves.iter().position(|(half, _)| half.at == wanted)?;
            let (half, own) = halves.swap_remove(found);
            let own = own.to_vec();
            (cell, models) = (half, own);
        }
        Some((cell, models))
    }
}

fn add(mesh: &Mesh, at: DVec3, radius: f64, material: u32, out: &mut Piece) {
    for corners in &mesh.triangles {
        let place = corners.map(|corner| at + radius * mesh.positions[corner as usize]);
        out.triangles.push(Triangle { corners: place, material, ..Triangle::default() });
        #[expect(clippy::cast_possible_truncation, reason = "unit vectors")]
        out.normals.push(corners.map(|corner| mesh.normals[corner as usize].to_array().map(|v| v as f32)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_scheduler::lod_tree::RepId;

    #[test]
    fn every_representation_is_made_within_its_bounds() {
        let params = AsteroidParams { count: 40, triangles: 600, ..AsteroidParams::default() };
        let (world, contents) = AsteroidContents::open(&params).expect("in range");
        for rep in (0..world.tree.representations() as u32).map(RepId) {
            let uri = world.uri(rep);
            let piece = contents.piece(&uri).unwrap_or_else(|| panic!("{uri}"));
            assert_eq!(piece.triangles.len(), piece.normals.len());
            let bounds = world.tree.bounds(world.tree.node_of(rep));
            // A coarse mesh may reach a little beyond the fine one.
            let slack = world.tree.error(rep) + 1e-3;
            for at in piece.triangles.iter().flat_map(|t| t.corners) {
                assert!((at - bounds.min + slack).min_element() >= 0.0, "{uri}: {at} {bounds:?}");
                assert!((bounds.max - at + slack).min_element() >= 0.0, "{uri}: {at} {bounds:?}");
            }
        }
        for uri in ["", "cells/", "cells/0/0_0.glb", "cells/31/0_0_0.glb", "models/9/0-0.glb", "models/0/0-99.glb"] {
            assert!(contents.piece(uri).is_none(), "{uri}");
        }
    }
}
