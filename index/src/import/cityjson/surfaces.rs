//! The surfaces of a city model at its finest level of detail, coloured by what an object is and, of buildings, by which
//! way a face looks.

use std::path::{Path, PathBuf};

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use super::{CityJsonError, Model, items};
use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::surface::{PIECE_TRIANGLES, Piece, SurfaceSource, file_identity};
use crate::world::Georeference;

/// Linear light by material.
const COLOURS: [[f32; 3]; 9] = [
    [0.42, 0.12, 0.07],
    [0.52, 0.48, 0.4],
    [0.3, 0.29, 0.27],
    [0.16, 0.2, 0.08],
    [0.06, 0.14, 0.04],
    [0.05, 0.12, 0.2],
    [0.13, 0.13, 0.13],
    [0.36, 0.34, 0.32],
    [0.5, 0.5, 0.5],
];
const ROOF: u32 = 0;
const WALL: u32 = 1;
const UNDERSIDE: u32 = 2;
const LAND: u32 = 3;
const PLANTS: u32 = 4;
const WATER: u32 = 5;
const ROAD: u32 = 6;
const STRUCTURE: u32 = 7;
const OTHER: u32 = 8;

/// A face of a building looks up or down if its normal is steeper than this: cos 60°.
const STEEP: f64 = 0.5;

/// The surfaces of a city model, which is in memory.
pub struct CityModelSurfaces {
    file: PathBuf,
    model: Model,
    /// Object and triangle, in order.
    triangles: Vec<(u32, [u32; 3])>,
    name: String,
    left_out: Vec<String>,
}

impl CityModelSurfaces {
    /// Reads a city model.
    ///
    /// # Errors
    /// As [`super::open`].
    pub fn open(file: &Path) -> Result<CityModelSurfaces, CityJsonError> {
        let bytes = std::fs::read(file).map_err(|source| CityJsonError::Io { file: file.to_owned(), source })?;
        let name = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let model =
            super::parse(&bytes, &name).map_err(|source| CityJsonError::Fault { file: file.to_owned(), source })?;
        let mut triangles = Vec::new();
        for (object, own) in items::finest(&model) {
            triangles.extend(own.iter().map(|&triangle| (object as u32, triangle)));
        }
        let left_out = model.notes.iter().map(|note| format!("{}: {}", note.place, note.text)).collect();
        Ok(CityModelSurfaces { file: file.to_owned(), model, triangles, name, left_out })
    }
}

fn look(kind: &str, normal: DVec3) -> u32 {
    match kind {
        "Building" | "BuildingPart" | "BuildingInstallation" | "BuildingUnit" | "BuildingStorey" => {
            if normal.z > STEEP {
                ROOF
            } else if normal.z < -STEEP {
                UNDERSIDE
            } else {
                WALL
            }
        }
        "TINRelief" | "LandUse" => LAND,
        "PlantCover" | "SolitaryVegetationObject" => PLANTS,
        "WaterBody" | "Waterway" => WATER,
        "Road" | "Railway" | "TransportSquare" => ROAD,
        kind if kind.starts_with("Bridge") || kind.starts_with("Tunnel") || kind == "OtherConstruction" => STRUCTURE,
        _ => OTHER,
    }
}

impl SurfaceSource for CityModelSurfaces {
    fn pieces(&self) -> usize {
        self.triangles.len().div_ceil(PIECE_TRIANGLES)
    }

    fn declared(&self, _: usize) -> Option<Aabb> {
        None
    }

    fn name(&self, _: usize) -> &str {
        &self.name
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let first = piece * PIECE_TRIANGLES;
        let own = &self.triangles[first..(first + PIECE_TRIANGLES).min(self.triangles.len())];
        let triangles = own.iter().map(|&(object, corners)| {
            let corners = corners.map(|at| self.model.vertices[at as usize]);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
            let material = look(&self.model.objects[object as usize].kind, normal);
            // Terrain and other faces are not always turned the right way.
            Triangle { corners, material, two_sided: true, ..Triangle::default() }
        });
        let materials = COLOURS.map(|base| Material { base, ..Material::default() }).to_vec();
        let left_out = if piece == 0 { self.left_out.clone() } else { Vec::new() };
        Ok(Piece { triangles: triangles.collect(), materials, left_out, ..Piece::default() })
    }

    fn up(&self) -> DVec3 {
        DVec3::Z
    }

    fn georeference(&self) -> Option<Georeference> {
        self.model.georeference
    }

    fn identity(&self) -> Result<[u8; 32], ContentError> {
        file_identity("foresight-surfaces-cityjson-1", &self.file)
    }
}
