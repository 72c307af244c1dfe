//! CityJSON 1.0, 1.1 and 2.0, and CityJSONSeq: city models as surfaces of objects with levels of detail.
//!
//! Objects are batched into tiles, their levels in the file become levels of the tiles, and tiles above hold simplified
//! surfaces. Errors are measured distances between surfaces. World space is the file's reference system:
//! x east, y north, z up, metres. The same file gives the same world wherever the simplifier computes in plain
//! single precision, without fused multiply-add: on every x86-64.

#[cfg(feature = "orthoviews")]
mod contents;
mod document;
mod georeference;
mod items;
mod limits;
mod model;
#[cfg(feature = "orthoviews")]
mod surfaces;
mod tiles;
mod triangulate;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};

use foresight_scheduler::lod_tree::{LodTreeBuilder, LodTreeError, Representation};
use glam::DVec3;

#[cfg(feature = "orthoviews")]
pub use contents::CityModelContents;
pub use model::Model;
#[cfg(feature = "orthoviews")]
pub use surfaces::CityModelSurfaces;

use crate::ground::{Ground, GroundSurface};
use crate::mesh::Mesh;
use crate::uris::UriTableBuilder;
use crate::world::{Note, Severity, World, WorldKind};
use tiles::Tile;

/// Why a city model cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum CityJsonError {
    /// The file cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// The file is at fault.
    #[error("{}: {source}", file.display())]
    Fault {
        /// The file.
        file: PathBuf,
        /// The fault.
        source: CityJsonFault,
    },
    /// The tree cannot be built.
    #[error("{}: {source}", file.display())]
    Tree {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: LodTreeError,
    },
}

/// A fault in a city model.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct CityJsonFault {
    /// JSON path, in a sequence after the line; or line and column.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

impl CityJsonFault {
    fn new(place: impl Into<String>, fault: impl Into<String>) -> CityJsonFault {
        CityJsonFault { place: place.into(), fault: fault.into() }
    }
}

/// Reads a city model, CityJSON or CityJSONSeq, as far as its surfaces; its notes name `file`.
pub fn parse(bytes: &[u8], file: &str) -> Result<Model, CityJsonFault> {
    model::resolve(&document::read(bytes)?, file)
}

/// Opens the world that a file holds.
pub fn open(file: &Path) -> Result<World, CityJsonError> {
    Ok(opened(file)?.0)
}

/// A world with the mesh of each representation.
fn opened(file: &Path) -> Result<(World, Vec<Mesh>), CityJsonError> {
    let bytes = std::fs::read(file).map_err(|source| CityJsonError::Io { file: file.to_owned(), source })?;
    let fault = |source| CityJsonError::Fault { file: file.to_owned(), source };
    let name = file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let model = parse(&bytes, &name).map_err(fault)?;
    drop(bytes);
    let items = items::items(&model);
    let root = tiles::pack(&items, &model.vertices).ok_or_else(|| {
        fault(CityJsonFault::new(
            "$.CityObjects",
            "nothing is left at the precision of 32-bit floats; expected a surface",
        ))
    })?;
    let mut out = Output {
        builder: LodTreeBuilder::default(),
        uris: UriTableBuilder::default(),
        meshes: Vec::new(),
        left_out: 0,
        loose: 0,
    };
    let tree = out.tile(root, f32::INFINITY, "r").and_then(|()| out.builder.finish());
    let tree = tree.map_err(|source| CityJsonError::Tree { file: file.to_owned(), source })?;
    let ground = ground(&model, &items);
    let mut notes = model.notes;
    if out.left_out > 0 {
        let text =
            format!("{} levels of detail show less than the simplified tile above them does: left out", out.left_out);
        notes.push(Note { severity: Severity::Missing, file: name.clone(), place: String::new(), text });
    }
    if out.loose > 0 {
        let text = format!("{} errors are upper bounds that may be well above the true ones", out.loose);
        notes.push(Note { severity: Severity::Trap, file: name.clone(), place: String::new(), text });
    }
    let world = World {
        name: name.split('.').next().unwrap_or_default().to_owned(),
        kind: WorldKind::CityJson,
        tree,
        uris: out.uris.finish(),
        up: DVec3::Z,
        ground,
        georeference: model.georeference,
        root_sample: None,
        notes,
    };
    Ok((world, out.meshes))
}

/// The ground: terrain if there is any, else surfaces of land use, transport and water; else the lowest corner of each object.
fn ground(model: &Model, items: &[items::Item]) -> Ground {
    const ON_THE_GROUND: [&str; 7] =
        ["LandUse", "PlantCover", "Railway", "Road", "TransportSquare", "WaterBody", "Waterway"];
    let at = |corner: u32| model.vertices[corner as usize];
    let surfaces = |is_ground: &dyn Fn(&str) -> bool| -> Vec<[DVec3; 3]> {
        let objects = model.objects.iter().filter(|object| is_ground(&object.kind));
        let finest = objects.filter_map(|object| object.levels.values().next_back());
        finest.flatten().map(|triangle| triangle.map(at)).collect()
    };
    let mut triangles = surfaces(&|kind| kind == "TINRelief");
    if triangles.is_empty() {
        triangles = surfaces(&|kind| ON_THE_GROUND.contains(&kind));
    }
    if triangles.is_empty() {
        let lowest = items.iter().filter_map(|item| {
            let corners = item.patches.iter().flat_map(|patch| patch.triangles.iter().flatten());
            corners.map(|&corner| at(corner)).min_by(|a, b| a.z.total_cmp(&b.z))
        });
        // A point is a triangle without area.
        triangles = lowest.map(|point| [point; 3]).collect();
    }
    Ground::Triangles(GroundSurface::new(triangles))
}

/// The tree being written.
struct Output {
    builder: LodTreeBuilder,
    uris: UriTableBuilder,
    meshes: Vec<Mesh>,
    left_out: u64,
    loose: u64,
}

impl Output {
    /// Writes a tile; levels with an error larger than `above`, the least at the tiles above, are left out. Recursion is
    /// as deep as the packing, which at least halves.
    fn tile(&mut self, tile: Tile, above: f32, path: &str) -> Result<(), LodTreeError> {
        self.builder.open()?;
        let mut least = above;
        let (is_leaf, count) = (tile.children.is_empty(), tile.levels.len());
        for (number, level) in tile.levels.into_iter().enumerate() {
            let error = narrow_up(level.error);
            if error > above {
                self.left_out += 1;
                continue;
            }
            self.builder.add(Representation {
                wire_bytes: level.wire_bytes,
                decoded_bytes: level.decoded_bytes,
                error,
                prerequisite: None,
                direction: None,
            })?;
            let tail = if count > 1 { format!("{path}-{number}.glb") } else { format!("{path}.glb") };
            let (prefix, tail) = (self.uris.intern("tiles/"), self.uris.intern(&tail));
            self.uris.push(prefix, tail);
            self.meshes.push(level.mesh);
            self.loose += u64::from(level.is_loose);
            least = least.min(error);
        }
        for (number, child) in tile.children.into_iter().enumerate() {
            self.tile(child, least, &format!("{path}{number}"))?;
        }
        self.builder.close(is_leaf.then_some(tile.bounds), 1.0)
    }
}

/// An error as f32, not less than it is.
#[expect(clippy::cast_possible_truncation, reason = "the narrowing itself; next_up gives back what it loses")]
fn narrow_up(error: f64) -> f32 {
    let narrow = error as f32;
    if f64::from(narrow) < error { narrow.next_up() } else { narrow }
}
