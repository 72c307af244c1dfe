//! Contents of a city model by representation: what importing has packed into its tiles, kept.

use std::path::Path;

use foresight_scheduler::lod_tree::RepId;
use glam::DVec3;

use super::CityJsonError;
use crate::mesh::Mesh;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::surface::Piece;
use crate::world::World;

/// Linear light of what looks up, down, and to the side: east or west, and north or south.
const COLOURS: [[f32; 3]; 4] = [[0.42, 0.2, 0.14], [0.3, 0.29, 0.27], [0.52, 0.48, 0.4], [0.44, 0.41, 0.35]];

/// A face looks up or down if its normal is steeper than this: cos 60°.
const STEEP: f64 = 0.5;

/// The contents of a city model, in memory.
#[derive(Debug)]
pub struct CityModelContents {
    /// By representation.
    meshes: Vec<Mesh>,
}

impl CityModelContents {
    /// Opens the world that a file holds, with its contents.
    ///
    /// # Errors
    /// As [`super::open`].
    pub fn open(file: &Path) -> Result<(World, CityModelContents), CityJsonError> {
        let (world, meshes) = super::opened(file)?;
        Ok((world, CityModelContents { meshes }))
    }

    /// What a representation shows, coloured by which way its faces look; `None` for one that there is not.
    pub fn piece(&self, rep: RepId) -> Option<Piece> {
        let mesh = self.meshes.get(rep.index())?;
        let triangle = |corners: [DVec3; 3]| {
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            let material = match normal.z {
                z if z > STEEP => 0,
                z if z < -STEEP => 1,
                _ => 2 + u32::from(normal.y.abs() > normal.x.abs()),
            };
            // Terrain and other faces are not always turned the right way.
            Triangle { corners, material, two_sided: true, ..Triangle::default() }
        };
        Some(Piece {
            triangles: mesh.corners().into_iter().map(triangle).collect(),
            materials: COLOURS.map(|base| Material { base, ..Material::default() }).to_vec(),
            ..Piece::default()
        })
    }
}
