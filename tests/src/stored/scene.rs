//! Worlds to measure: a city made for it, or a tileset, with what each leaf of its octree holds.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use foresight_index::generate::city::{CityParams, geometry};
use foresight_index::generate::document::from_parts;
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::build::{LeafContent, Made, Workshop, build};
use foresight_index::orthoview::direction::nine_about;
use foresight_index::orthoview::raster::{Surface, Triangle};
use foresight_index::orthoview::{Direction, Lattice, Orthoview};
use foresight_index::specification::Progress;
use foresight_index::surface::{SurfaceSource, Surfaces, open};
use foresight_scheduler::lod_tree::{Aabb, NodeId, RepId};
use rayon::prelude::*;

use super::Fault;
use super::sizes::{Geometry, Size};

/// A tileset cut into leaves. Contents are read when they are needed.
pub struct Scene {
    /// As it was asked for.
    pub name: String,
    contents: Box<dyn SurfaceSource>,
    /// Cells over it.
    pub octree: Octree,
    /// Side of a leaf's pixel, metres.
    pub pitch: f64,
    /// Triangles of the finest contents.
    pub triangles: u64,
    /// Bytes of the files of the finest contents.
    pub finest_bytes: u64,
    /// Nine directions for its up.
    pub directions: [Direction; 9],
    /// The tileset.
    file: PathBuf,
    of_leaf: BTreeMap<[u64; 3], Vec<usize>>,
    occupied: BTreeSet<Cell>,
    /// Where it was written, if it was made for this.
    _folder: Option<tempfile::TempDir>,
}

/// Levels of detail of what stands in a leaf, finest first, and its height in metres.
pub type Standing = (Vec<Geometry>, f64);

/// What a leaf, or any cell, holds.
pub struct Holding {
    /// A content each.
    pub surfaces: Vec<Surfaces>,
}

impl Holding {
    /// Its meshes as the rasteriser takes them.
    pub fn meshes(&self) -> impl Iterator<Item = (&[Triangle], &dyn Surface)> {
        self.surfaces.iter().map(|s| (&s.triangles[..], &s.materials as &dyn Surface))
    }
}

impl Scene {
    /// Opens `world`: a tileset, or `city:blocks=N,…`, which is written to a temporary folder first. Leaves are `leaf`
    /// metres wide, of `pixels` pixels.
    ///
    /// # Errors
    /// What cannot be made, read or cut.
    pub fn open(world: &str, leaf: f64, pixels: f64) -> Result<Scene, Fault> {
        let (file, folder) = match world.strip_prefix("city:") {
            Some(parts) => {
                let params: CityParams = from_parts(parts).map_err(|e| Fault::new(world, e))?;
                let folder = tempfile::tempdir().map_err(|e| Fault::new(world, e))?;
                let out = folder.path().join("city");
                geometry::write(&params, &out, &mut |_, _| {}).map_err(|e| Fault::new(world, e))?;
                (out.join("tileset.json"), Some(folder))
            }
            None => (PathBuf::from(world), None),
        };
        let quiet: Progress = Arc::new(|_, _| {});
        let contents = open(&file.to_string_lossy(), &quiet).map_err(|e| Fault::new(world, e))?;
        let base = file.parent().unwrap_or(Path::new("."));
        let sizes: Vec<(Aabb, usize, u64)> = (0..contents.pieces())
            .into_par_iter()
            .map(|index| {
                let surfaces = contents.load(index).map_err(|e| Fault::new(world, e))?;
                let bytes = std::fs::metadata(base.join(contents.name(index))).map_or(0, |m| m.len());
                Ok((surfaces.bounds(), surfaces.triangles.len(), bytes))
            })
            .collect::<Result<_, Fault>>()?;
        let bounds = sizes.iter().fold(Aabb::EMPTY, |all, (b, ..)| all.union(*b));
        let octree = Octree::over(bounds, leaf).map_err(|e| Fault::new(world, e))?;
        let (mut of_leaf, mut occupied) = (BTreeMap::<_, Vec<usize>>::new(), BTreeSet::new());
        for (index, (bounds, ..)) in sizes.iter().enumerate().filter(|(_, (b, ..))| !b.is_empty()) {
            let [x, y, z] = octree.leaves(bounds);
            for place in places(x, y, z) {
                of_leaf.entry(place).or_default().push(index);
                let mut cell = Some(Cell { level: 0, place });
                while let Some(at) = cell.filter(|c| occupied.insert(*c)) {
                    cell = octree.parent(at);
                }
            }
        }
        Ok(Scene {
            name: world.to_owned(),
            octree,
            pitch: leaf / pixels,
            triangles: sizes.iter().map(|(_, triangles, _)| *triangles as u64).sum(),
            finest_bytes: sizes.iter().map(|(.., bytes)| bytes).sum(),
            directions: nine_about(contents.up()),
            file,
            contents,
            of_leaf,
            occupied,
            _folder: folder,
        })
    }

    /// Leaves with something in them.
    pub fn leaves(&self) -> Vec<Cell> {
        self.of_leaf.keys().map(|&place| Cell { level: 0, place }).collect()
    }

    /// Occupied cells of a level.
    pub fn cells(&self, level: u32) -> Vec<Cell> {
        self.occupied.iter().copied().filter(|c| c.level == level).collect()
    }

    /// The lattice of a direction.
    pub fn lattice(&self, direction: Direction) -> Lattice {
        Lattice { direction, origin: self.octree.origin(), pitch: self.pitch }
    }

    /// Horizontal extent, m²; z is up.
    pub fn area(&self) -> f64 {
        let side = self.octree.leaf_side();
        let columns: BTreeSet<[u64; 2]> = self.of_leaf.keys().map(|p| [p[0], p[1]]).collect();
        columns.len() as f64 * side * side
    }

    /// Reads everything that lies in or beside a cell.
    ///
    /// # Errors
    /// A content that cannot be read.
    pub fn holding(&self, cell: Cell) -> Result<Holding, Fault> {
        let mut leaves: Vec<Cell> = vec![cell];
        while leaves.iter().any(|c| c.level > 0) {
            leaves = leaves.iter().flat_map(|&c| self.octree.children(c)).collect();
        }
        let indices: BTreeSet<usize> =
            leaves.iter().filter_map(|c| self.of_leaf.get(&c.place)).flatten().copied().collect();
        let load = |&index: &usize| self.contents.load(index).map_err(|e| Fault::new(&self.name, e));
        let surfaces = indices.iter().collect::<Vec<_>>().into_par_iter().map(load).collect::<Result<_, _>>()?;
        Ok(Holding { surfaces })
    }

    /// Levels of detail of what stands in each leaf, finest first, and its height in metres: level k of all the tileset's
    /// leaves whose middle lies there, those with fewer levels by their coarsest.
    ///
    /// # Errors
    /// A tileset that cannot be opened.
    pub fn geometry_by_leaf(&self) -> Result<BTreeMap<[u64; 3], Standing>, Fault> {
        let world = foresight_index::world::open(&self.file).map_err(|e| Fault::new(&self.name, e))?;
        let tree = &world.tree;
        let mut things: BTreeMap<[u64; 3], Vec<Vec<RepId>>> = BTreeMap::new();
        let mut heights: BTreeMap<[u64; 3], f64> = BTreeMap::new();
        for node in (0..tree.nodes() as u32).map(NodeId).filter(|&node| tree.is_leaf(node)) {
            // Levels of a thing lie inside each other.
            let alone = |n: &NodeId| tree.children(*n).count() <= 1;
            let mut levels: Vec<RepId> = tree.ancestors(node).take_while(alone).flat_map(|n| tree.own(n)).collect();
            levels.sort_by(|&a, &b| tree.error(a).total_cmp(&tree.error(b)).then(a.cmp(&b)));
            let bounds = tree.bounds(node);
            let middle = bounds.centre();
            let place = self.octree.leaves(&Aabb { min: middle, max: middle }).map(|[first, _]| first);
            things.entry(place).or_default().push(levels);
            let height = heights.entry(place).or_default();
            *height = height.max(bounds.max.z);
        }
        let level = |things: &[Vec<RepId>], k: usize| {
            let mut level = Geometry { size: Size { wire: 0, decoded: 0 }, error: 0.0 };
            for thing in things {
                if let Some(&rep) = thing.get(k).or(thing.last()) {
                    level.size.wire += tree.wire_bytes(rep) as u32;
                    level.size.decoded += tree.decoded_bytes(rep) as u32;
                    level.error = level.error.max(tree.error(rep) as f32);
                }
            }
            level
        };
        let all = things.into_iter().map(|(place, things)| {
            let most = things.iter().map(Vec::len).max().unwrap_or_default();
            let levels = (0..most).map(|k| level(&things, k)).collect();
            (place, (levels, heights.get(&place).copied().unwrap_or_default()))
        });
        Ok(all.collect())
    }

    /// Makes all orthoviews; `keep` takes a cell's.
    ///
    /// # Errors
    /// A content that cannot be read, or what `keep` refuses.
    pub fn orthoviews(
        &self,
        directions: &[Direction],
        keep: impl FnMut(Cell, &[(Direction, &Orthoview)]) -> Result<(), Fault>,
    ) -> Result<Made, Fault> {
        let mut shop = Shop { scene: self, cache: BTreeMap::new(), keep };
        build(&self.octree, directions, self.pitch, &mut shop)
    }
}

/// All places of three ranges, ends included.
fn places(x: [u64; 2], y: [u64; 2], z: [u64; 2]) -> impl Iterator<Item = [u64; 3]> {
    let range = |[first, last]: [u64; 2]| first..=last;
    range(z).flat_map(move |z| range(y).flat_map(move |y| range(x).map(move |x| [x, y, z])))
}

/// Holds the contents of one leaf at a time.
struct Shop<'a, K> {
    scene: &'a Scene,
    cache: BTreeMap<usize, Surfaces>,
    keep: K,
}

impl<K: FnMut(Cell, &[(Direction, &Orthoview)]) -> Result<(), Fault>> Workshop for Shop<'_, K> {
    type Error = Fault;

    fn is_occupied(&self, cell: Cell) -> bool {
        self.scene.occupied.contains(&cell)
    }

    fn with_content(&mut self, cell: Cell, draw: &mut dyn FnMut(&LeafContent<'_>)) -> Result<(), Fault> {
        let indices = &self.scene.of_leaf[&cell.place];
        self.cache.retain(|index, _| indices.contains(index));
        let missing: Vec<usize> = indices.iter().copied().filter(|i| !self.cache.contains_key(i)).collect();
        let scene = self.scene;
        let loaded: Vec<_> = missing
            .par_iter()
            .map(|&index| Ok((index, scene.contents.load(index).map_err(|e| Fault::new(&scene.name, e))?)))
            .collect::<Result<_, Fault>>()?;
        self.cache.extend(loaded);
        let meshes = self.cache.values().map(|s| (&s.triangles[..], &s.materials as &(dyn Surface + Sync))).collect();
        draw(&LeafContent { meshes });
        Ok(())
    }

    fn keep(&mut self, cell: Cell, images: &[(Direction, &Orthoview)]) -> Result<(), Fault> {
        (self.keep)(cell, images)
    }
}
