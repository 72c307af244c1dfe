//! A real tileset instanced K × K times on the plane across up, under a quadtree of coarser tiles: a world of any
//! size in which every size on the wire and in memory is a real one.
//!
//! Written are one copy of the source's files, a root tileset, and a manifest by which all instances share that copy. The
//! same world can be had in memory, the source read where it lies.

use std::fs;
use std::path::{Path, PathBuf};

use foresight_scheduler::lod_tree::{Aabb, RepId};
use glam::DVec3;
use serde_json::{Value, json};

use super::staging::Staging;
use crate::import::tiles3d::{self, GltfUp, MOSAIC_SOURCE, Source, Tiles3dError};
use crate::manifest::{FORMAT, Manifest, SCHEMA_VERSION};
use crate::world::{World, WorldError, WorldKind};

/// Most instances along one axis.
pub const MAX_GRID: u32 = 512;

/// What was written.
#[derive(Clone, Debug, PartialEq)]
pub struct MosaicSummary {
    /// Instances of the source.
    pub instances: u64,
    /// Coarser tiles above them.
    pub coarse_tiles: u64,
    /// Representations of the whole: those of the instances and the coarser tiles.
    pub representations: u64,
    /// From instance to instance along the two axes across up, metres.
    pub pitch: [f64; 2],
    /// Files of the source that were copied.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Address of the content whose size the coarser tiles have.
    pub coarse_content: String,
}

/// Why there is no mosaic.
#[derive(Debug, thiserror::Error)]
pub enum MosaicError {
    /// The source cannot be opened.
    #[error(transparent)]
    Source(#[from] WorldError),
    /// The source is of another kind.
    #[error("{}: {found}; expected a 3D Tiles tileset", file.display())]
    Kind {
        /// The source.
        file: PathBuf,
        /// What it is.
        found: String,
    },
    /// The grid is out of range.
    #[error("a grid of {0}; expected 1 to {MAX_GRID}")]
    Grid(u32),
    /// The whole would have too many tiles.
    #[error("{0} tiles; expected at most {limit}", limit = tiles3d::MAX_TILES)]
    TooMany(u64),
    /// A file cannot be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
}

/// A mosaic that is ready to be written or opened.
struct Composed {
    tileset: Value,
    manifest: Manifest,
    /// Folder of the source, and its files.
    folder: PathBuf,
    files: Vec<String>,
    summary: MosaicSummary,
}

fn compose(source: &Path, grid: u32) -> Result<Composed, MosaicError> {
    if !(1..=MAX_GRID).contains(&grid) {
        return Err(MosaicError::Grid(grid));
    }
    let root_file = if source.is_dir() { source.join("tileset.json") } else { source.to_owned() };
    let opened =
        tiles3d::load(&root_file, tiles3d::MAX_TILES, false).map_err(|error: Tiles3dError| WorldError::from(error))?;
    if opened.world.kind != WorldKind::Tiles3d {
        return Err(MosaicError::Kind { file: root_file, found: format!("a {}", opened.world.kind) });
    }
    let tree = &opened.world.tree;
    // The coarsest content there is: the root's own, else that of the first tile in preorder that has one.
    let coarse = RepId(0);
    let name = root_file.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let plan = Plan {
        grid,
        bounds: tree.bounds(tree.root()),
        axes: axes(opened.world.up, tree.bounds(tree.root())),
        error: opened.root_error,
        tileset: name,
        extension: Path::new(opened.world.uri(coarse).as_ref())
            .extension()
            .map_or_else(String::new, |extension| format!(".{}", extension.to_string_lossy())),
    };
    let mut stand_ins = Vec::new();
    let root = plan.tile([0, grid, 0, grid], &mut stand_ins);
    let instances = u64::from(grid) * u64::from(grid);
    let representations = instances * tree.representations() as u64 + stand_ins.len() as u64;
    let tiles = instances * (tree.nodes() as u64 + 2) + stand_ins.len() as u64;
    if tiles > tiles3d::MAX_TILES as u64 {
        return Err(MosaicError::TooMany(tiles));
    }
    let coarse_file = opened.coarse_file;
    let coarse_tiles = stand_ins.len() as u64;
    let manifest = Manifest {
        format: FORMAT.to_owned(),
        schema_version: SCHEMA_VERSION,
        statement: STATEMENT.to_owned(),
        folders: plan.cells().map(|(x, y)| (format!("cells/{x}_{y}/"), MOSAIC_SOURCE.to_owned())).collect(),
        stand_ins: stand_ins.into_iter().map(|uri| (uri, format!("{MOSAIC_SOURCE}{coarse_file}"))).collect(),
    };
    let up_axis = match opened.gltf_up {
        GltfUp::X => "X",
        GltfUp::Y => "Y",
        GltfUp::Z => "Z",
    };
    let root_error = root["geometricError"].clone();
    let tileset = json!({
        "asset": { "version": opened.version, "gltfUpAxis": up_axis },
        "extras": { "synthetic": true, "statement": STATEMENT, "grid": grid },
        "geometricError": root_error,
        "root": root,
    });
    let summary = MosaicSummary {
        instances,
        coarse_tiles,
        representations,
        pitch: plan.axes.map(|axis| axis.length()),
        files: opened.files.len() as u64,
        bytes: 0,
        coarse_content: opened.world.uri(coarse).into_owned(),
    };
    let folder = root_file.parent().map_or_else(PathBuf::new, Path::to_path_buf);
    Ok(Composed { tileset, manifest, folder, files: opened.files, summary })
}

/// The world that [`mosaic`] would write, without a file written.
pub fn in_memory(source: &Path, grid: u32) -> Result<World, MosaicError> {
    Ok(loaded(source, grid, false)?.world)
}

/// The world of [`in_memory`] with its contents.
///
/// # Errors
/// As [`in_memory`].
#[cfg(feature = "orthoviews")]
pub fn with_contents(source: &Path, grid: u32) -> Result<(World, tiles3d::TileContents), MosaicError> {
    Ok(tiles3d::TileContents::of(loaded(source, grid, true)?))
}

fn loaded(source: &Path, grid: u32, placed: bool) -> Result<tiles3d::Loaded, MosaicError> {
    let Composed { tileset, manifest, folder, .. } = compose(source, grid)?;
    let io = |error: serde_json::Error| MosaicError::Io { file: source.to_owned(), source: error.into() };
    let tileset = serde_json::to_vec(&tileset).map_err(io)?;
    let source = Source::Mosaic { tileset, source: folder };
    let mut loaded = tiles3d::load_from(source, Some(manifest), "tileset.json", tiles3d::MAX_TILES, placed)
        .map_err(|error: Tiles3dError| WorldError::from(error))?;
    loaded.world.name = format!("mosaic of {grid} × {grid}");
    Ok(loaded)
}

/// Writes the folder `out`, which must not exist or be an empty folder: `source` (a `tileset.json`, or a folder with
/// one) on a grid of `grid` × `grid`, its instances as far apart as its contents reach. `progress` is told the bytes
/// copied so far and their sum.
pub fn mosaic(
    source: &Path,
    grid: u32,
    out: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<MosaicSummary, MosaicError> {
    let Composed { tileset, manifest, folder, files, summary } = compose(source, grid)?;
    let io = |file: &Path| {
        let file = file.to_owned();
        move |source| MosaicError::Io { file, source }
    };
    let staging = Staging::begin(out).map_err(io(out))?;
    let sizes = files.iter().map(|file| {
        let at = folder.join(file);
        fs::metadata(&at).map(|metadata| metadata.len()).map_err(io(&at))
    });
    let total: u64 = sizes.sum::<Result<u64, _>>()?;
    let mut copied = 0;
    progress(0, total);
    for file in &files {
        let place = staging.place(&format!("{MOSAIC_SOURCE}{file}")).map_err(io(out))?;
        let from = folder.join(file);
        // Read and written rather than copied, so that a read-only source does not make read-only copies.
        let bytes = fs::read(&from).map_err(io(&from))?;
        fs::write(&place, &bytes).map_err(io(&place))?;
        copied += bytes.len() as u64;
        progress(copied, total);
    }
    write_json(&staging, "manifest.json", &manifest).map_err(io(out))?;
    write_json(&staging, "tileset.json", &tileset).map_err(io(out))?;
    staging.finish().map_err(io(out))?;
    Ok(MosaicSummary { bytes: total, ..summary })
}

/// What a mosaic says of itself.
const STATEMENT: &str = "A real tileset instanced on a grid. The tiles above the instances are synthetic: they have the size of the \
source's coarsest content, and an error that doubles from level to level. No single place looks like this.";

fn write_json(staging: &Staging, name: &str, value: &impl serde::Serialize) -> std::io::Result<()> {
    let text = serde_json::to_vec(value)?;
    fs::write(staging.place(name)?, text)
}

/// The steps from instance to instance: along two axes across up, as far as the bounds reach. World axes where up is
/// one; else any two.
fn axes(up: DVec3, bounds: Aabb) -> [DVec3; 2] {
    let size = bounds.max - bounds.min;
    let (right, forward) = up.any_orthonormal_pair();
    // A flat or a single-point source still needs instances apart.
    [right, forward].map(|axis| axis * size.dot(axis.abs()).max(1.0))
}

struct Plan {
    grid: u32,
    bounds: Aabb,
    axes: [DVec3; 2],
    error: f64,
    tileset: String,
    extension: String,
}

impl Plan {
    fn cells(&self) -> impl Iterator<Item = (u32, u32)> {
        let grid = self.grid;
        (0..grid).flat_map(move |y| (0..grid).map(move |x| (x, y)))
    }

    fn offset(&self, x: u32, y: u32) -> DVec3 {
        self.axes[0] * f64::from(x) + self.axes[1] * f64::from(y)
    }

    /// The tile over instances from..to along both axes. Recursion halves the grid: at most 9 deep.
    fn tile(&self, [x0, x1, y0, y1]: [u32; 4], stand_ins: &mut Vec<String>) -> Value {
        let corners = [(x0, y0), (x1 - 1, y0), (x0, y1 - 1), (x1 - 1, y1 - 1)];
        let bounds = corners.iter().fold(Aabb::EMPTY, |sum, &(x, y)| {
            let offset = self.offset(x, y);
            sum.union(Aabb { min: self.bounds.min + offset, max: self.bounds.max + offset })
        });
        if x1 - x0 == 1 && y1 - y0 == 1 {
            let at = self.offset(x0, y0);
            return json!({
                "boundingVolume": volume(self.bounds),
                "transform": [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, at.x, at.y, at.z, 1.0],
                "geometricError": self.error,
                "refine": "REPLACE",
                "content": { "uri": format!("cells/{x0}_{y0}/{}", self.tileset) },
            });
        }
        let level = (x1 - x0).max(y1 - y0).next_power_of_two().trailing_zeros();
        let uri = format!("coarse/{level}/{x0}_{y0}{}", self.extension);
        stand_ins.push(uri.clone());
        let halves = |from: u32, to: u32| {
            let middle = from + (to - from).div_ceil(2);
            [(from, middle), (middle, to)].into_iter().filter(|(from, to)| from < to)
        };
        let mut children = Vec::new();
        for (y0, y1) in halves(y0, y1) {
            for (x0, x1) in halves(x0, x1) {
                children.push(self.tile([x0, x1, y0, y1], stand_ins));
            }
        }
        json!({
            "boundingVolume": volume(bounds),
            "geometricError": libm::ldexp(self.error, level as i32),
            "refine": "REPLACE",
            "extras": { "synthetic": true },
            "content": { "uri": uri },
            "children": children,
        })
    }
}

fn volume(bounds: Aabb) -> Value {
    let (middle, half) = (bounds.centre(), 0.5 * (bounds.max - bounds.min));
    json!({ "box": [middle.x, middle.y, middle.z, half.x, 0.0, 0.0, 0.0, half.y, 0.0, 0.0, 0.0, half.z] })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn every_grid_is_covered_once() {
        for grid in 1..=17 {
            let bounds = Aabb { min: DVec3::ZERO, max: DVec3::new(2.0, 3.0, 1.0) };
            let (tileset, extension) = ("t.json".to_owned(), ".glb".to_owned());
            let plan = Plan { grid, bounds, axes: axes(DVec3::Z, bounds), error: 5.0, tileset, extension };
            let mut coarse = Vec::new();
            let root = plan.tile([0, grid, 0, grid], &mut coarse);
            assert_eq!(coarse.iter().collect::<BTreeSet<_>>().len(), coarse.len(), "addresses of their own");
            let mut cells = Vec::new();
            let mut waiting = vec![(&root, f64::INFINITY)];
            while let Some((tile, above)) = waiting.pop() {
                let error = tile["geometricError"].as_f64().unwrap();
                assert!(error < above);
                match tile["children"].as_array() {
                    Some(children) => waiting.extend(children.iter().map(|child| (child, error))),
                    None => {
                        cells.push((tile["transform"][12].as_f64().unwrap(), tile["transform"][13].as_f64().unwrap()))
                    }
                }
            }
            cells.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.total_cmp(&b.0)));
            let expected: Vec<_> = plan.cells().map(|(x, y)| (2.0 * f64::from(x), 3.0 * f64::from(y))).collect();
            assert_eq!(cells, expected);
        }
    }

    #[test]
    fn instances_lie_across_up() {
        let bounds = Aabb { min: DVec3::ZERO, max: DVec3::new(2.0, 3.0, 4.0) };
        assert_eq!(
            axes(DVec3::Y, bounds).map(|axis| axis.abs()),
            [DVec3::new(2.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 4.0)]
        );
        for axis in axes(DVec3::new(0.6, 0.0, 0.8), bounds) {
            assert!(axis.dot(DVec3::new(0.6, 0.0, 0.8)).abs() < 1e-12);
        }
    }

    #[test]
    fn refuses_grids_out_of_range() {
        for grid in [0, MAX_GRID + 1] {
            let error = mosaic(Path::new("absent"), grid, Path::new("out"), &mut |_, _| {}).unwrap_err();
            assert!(matches!(error, MosaicError::Grid(_)), "{error}");
        }
    }
}
