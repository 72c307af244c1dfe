//! A city's surfaces at their finest, a block a piece, made when they are read: a city of any size is never whole in memory.
//! Façades, grounds and crowns show a few textures each, which repeat over the city.

use std::sync::{Arc, OnceLock};

use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder};
use glam::{DVec2, DVec3};

use super::super::document::{GenerateError, Params};
use super::super::random::Random;
use super::facade::{self, Pattern};
use super::geometry::{BARK, GROUND_TEXTURE, ROOF, shifted};
use super::model::{self, Detail, Shell};
use super::{City, CityParams, Standing};
use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::surface::{Piece, SurfaceSource, parameters_identity};
use crate::uris::UriTableBuilder;
use crate::world::Georeference;

/// Textures of façades, grounds and crowns.
const FACADES: usize = 64;
const GROUNDS: usize = 8;
const CROWNS: usize = 8;
const TEXTURES: usize = FACADES + GROUNDS + CROWNS;

/// The stream of random numbers that chooses textures.
const TEXTURE: u64 = 111;

/// The surfaces of a city.
pub struct CitySurfaces {
    params: CityParams,
    textures: Vec<OnceLock<Arc<[u8]>>>,
}

impl CitySurfaces {
    /// The surfaces of the city of these parameters.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn new(params: &CityParams) -> Result<CitySurfaces, GenerateError> {
        params.check()?;
        Ok(CitySurfaces { params: params.clone(), textures: (0..TEXTURES).map(|_| OnceLock::new()).collect() })
    }

    fn texture(&self, number: usize) -> Arc<[u8]> {
        let make = || {
            let seed = Random::at(self.params.seed, TEXTURE, number as u64, 1).next();
            let pattern = match number {
                0..FACADES => Pattern::Facade { side: 256, seed },
                number if number < FACADES + GROUNDS => Pattern::Ground { side: 128, seed },
                _ => Pattern::Foliage { side: 64, seed },
            };
            facade::png(pattern).into()
        };
        self.textures[number].get_or_init(make).clone()
    }

    fn standing(&self, x: u32, y: u32) -> Result<Vec<Standing>, ContentError> {
        let (builder, uris) = (LodTreeBuilder::default(), UriTableBuilder::default());
        let mut city = City { params: &self.params, builder, uris, standing: Vec::new() };
        let fault = |error: foresight_scheduler::lod_tree::LodTreeError| ContentError {
            place: format!("block {x}, {y}"),
            fault: error.to_string(),
        };
        city.block(x, y).map_err(fault)?;
        Ok(city.standing)
    }

    /// Adds what stands in a block. Materials: the textures, then roof and bark.
    fn block(&self, piece: usize, out: &mut Vec<Triangle>) -> Result<(), ContentError> {
        let across = self.params.blocks_x as usize;
        let (x, y) = ((piece % across) as u32, (piece / across) as u32);
        for (index, standing) in self.standing(x, y)?.into_iter().enumerate() {
            let mut random = Random::at(self.params.seed, TEXTURE, piece as u64, index as u64 + 2);
            let mut one_of = |first: usize, count: usize| first + (random.unit() * count as f64) as usize;
            match standing {
                Standing::Ground(whole) => {
                    let shell = model::ground(shifted(whole, DVec2::ZERO), GROUND_TEXTURE);
                    add(&shell, one_of(FACADES, GROUNDS), out);
                }
                Standing::Tree { at, radius, height } => {
                    let tree = model::tree(at, radius, height, 3);
                    add(&tree.trunk, TEXTURES + 1, out);
                    add(&tree.crown, one_of(FACADES + GROUNDS, CROWNS), out);
                }
                Standing::Building { footprint, height } => {
                    let building = model::building(footprint, height, Detail::Windows);
                    add(&building.walls, one_of(0, FACADES), out);
                    add(&building.roof, TEXTURES, out);
                }
            }
        }
        Ok(())
    }
}

fn add(shell: &Shell, material: usize, out: &mut Vec<Triangle>) {
    out.extend(shell.faces().map(|(corners, uv)| Triangle {
        corners,
        uv: uv.map(|uv| DVec2::from_array(uv.map(f64::from))),
        material: material as u32,
        ..Triangle::default()
    }));
}

impl SurfaceSource for CitySurfaces {
    fn pieces(&self) -> usize {
        self.params.blocks_x as usize * self.params.blocks_y as usize
    }

    fn declared(&self, piece: usize) -> Option<Aabb> {
        let across = self.params.blocks_x as usize;
        let standing = self.standing((piece % across) as u32, (piece / across) as u32).ok()?;
        Some(standing.into_iter().map(Standing::bounds).fold(Aabb::EMPTY, Aabb::union))
    }

    fn name(&self, _: usize) -> &str {
        "generated city"
    }

    fn triangles(&self, piece: usize) -> Result<Vec<Triangle>, ContentError> {
        let mut triangles = Vec::new();
        self.block(piece, &mut triangles)?;
        Ok(triangles)
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let triangles = self.triangles(piece)?;
        let mut images = vec![None; TEXTURES];
        for triangle in &triangles {
            if let Some(image) = images.get_mut(triangle.material as usize)
                && image.is_none()
            {
                *image = Some(self.texture(triangle.material as usize));
            }
        }
        let textured = (0..TEXTURES).map(|texture| Material { texture: Some(texture), ..Material::default() });
        let plain = [ROOF, BARK].map(|base| Material { base, ..Material::default() });
        Ok(Piece { triangles, materials: textured.chain(plain).collect(), images, ..Piece::default() })
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
