//! Real sizes of cells, and catalogues of worlds of any extent drawn from them.

use std::collections::BTreeMap;

use foresight_index::format::orthoview::{Encoding, encode, planes};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::direction::nine;
use foresight_index::orthoview::{Direction, Orthoview};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, Representation};
use foresight_traces::random::SplitMix64;
use glam::DVec3;
use rayon::prelude::*;

use super::Fault;
use super::scene::Scene;

/// Directions of an orthoview.
const DIRECTIONS: usize = 9;
/// Decoded bytes a pixel: colour with a byte to spare, depth and links, normal.
pub const DECODED_PER_PIXEL: u32 = 8;

/// What a file takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// On the wire, bytes.
    pub wire: u32,
    /// In memory, bytes.
    pub decoded: u32,
}

/// A cell's orthoviews, in the order of [`nine`]; `None` where nothing is to be seen.
pub type Images = [Option<Size>; DIRECTIONS];

/// A level of detail of a leaf's geometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// What it takes.
    pub size: Size,
    /// Its error, metres.
    pub error: f32,
}

/// What a leaf takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Leaf {
    /// Its orthoviews.
    pub images: Images,
    /// Its geometry, finest first.
    pub geometry: Vec<Geometry>,
    /// Height of what stands there, metres.
    pub height: f64,
}

/// Sizes measured on a build.
#[derive(Clone, Debug, PartialEq)]
pub struct Sizes {
    /// Side of a leaf, metres.
    pub leaf_side: f64,
    /// Side of a leaf's pixel, metres.
    pub pitch: f64,
    /// Triangles of the finest geometry per square metre.
    pub triangle_density: f64,
    /// One for each leaf.
    pub leaves: Vec<Leaf>,
    /// Cells of each level above.
    pub above: Vec<Vec<Images>>,
}

impl Sizes {
    /// Builds all orthoviews of a scene whose leaves lie in one layer, and takes the files' sizes; the geometry's are those
    /// of its contents, each in the leaf of its middle.
    ///
    /// # Errors
    /// A content that cannot be read, an image that cannot be encoded, leaves above each other.
    pub fn measured(scene: &Scene) -> Result<Sizes, Fault> {
        if scene.octree.splits()[2] != 0 {
            return Err(Fault::new(&scene.name, "leaves above each other; expected leaves as high as the world"));
        }
        let directions = nine();
        let mut images: BTreeMap<u32, BTreeMap<[u64; 3], Images>> = BTreeMap::new();
        scene.orthoviews(&directions, |cell, views: &[(Direction, &Orthoview)]| {
            let coded: Vec<(Direction, Option<Size>)> = views
                .par_iter()
                .map(|(direction, view)| {
                    let links = links(view, &scene.lattice(*direction), &Thresholds::default());
                    let file = encode(view, &links, *direction, Encoding::default());
                    let file = file.map_err(|e| Fault::new(&scene.name, e))?;
                    let pixels = planes(view, &links).map_or(0, |p| p.rect.area());
                    let size = |f: Vec<u8>| Size { wire: f.len() as u32, decoded: DECODED_PER_PIXEL * pixels as u32 };
                    Ok((*direction, file.map(size)))
                })
                .collect::<Result<_, Fault>>()?;
            let mut of_cell: Images = [None; DIRECTIONS];
            for (place, direction) in directions.iter().enumerate() {
                of_cell[place] = coded.iter().find(|(d, _)| d == direction).and_then(|(_, size)| *size);
            }
            images.entry(cell.level).or_default().insert(cell.place, of_cell);
            Ok(())
        })?;
        let mut leaves = Vec::new();
        let mut geometry = scene.geometry_by_leaf()?;
        for (place, images) in images.remove(&0).unwrap_or_default() {
            let (geometry, height) = geometry.remove(&place).unwrap_or_default();
            leaves.push(Leaf { images, geometry, height });
        }
        let above = images.into_values().map(|cells| cells.into_values().collect()).collect();
        let triangle_density = scene.triangles as f64 / scene.area();
        Ok(Sizes { leaf_side: scene.octree.leaf_side(), pitch: scene.pitch, triangle_density, leaves, above })
    }

    /// Bytes of the finest geometry per square metre.
    pub fn geometry_density(&self) -> f64 {
        let finest = |l: &Leaf| l.geometry.first().map_or(0.0, |g| f64::from(g.size.wire));
        let bytes: f64 = self.leaves.iter().map(finest).sum();
        bytes / (self.leaves.len().max(1) as f64 * self.leaf_side * self.leaf_side)
    }

    /// Mean bytes of an image of a level, all directions that show something; `None` for a level that was not built.
    pub fn mean_image(&self, level: usize) -> Option<f64> {
        let of = |images: &Images| images.iter().flatten().map(|s| f64::from(s.wire)).collect::<Vec<_>>();
        let bytes: Vec<f64> = match level {
            0 => self.leaves.iter().flat_map(|l| of(&l.images)).collect(),
            _ => self.above.get(level - 1)?.iter().flat_map(of).collect(),
        };
        (!bytes.is_empty()).then(|| bytes.iter().sum::<f64>() / bytes.len() as f64)
    }

    /// The catalogue of a square world of `side` metres, around the origin, z up: each cell takes the sizes of a cell of its
    /// level, by lot; levels above those measured take those of the highest.
    ///
    /// # Errors
    /// A world beyond what a tree holds.
    pub fn catalogue(&self, side: f64, seed: u64, with: With) -> Result<LodTree, LodTreeError> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
        let count = (side / self.leaf_side).ceil().clamp(1.0, 4096.0) as u32;
        let mut world = Drawn {
            sizes: self,
            builder: LodTreeBuilder::default(),
            random: SplitMix64::new(seed),
            count,
            low: -0.5 * f64::from(count) * self.leaf_side,
            with,
        };
        world.cell(count.next_power_of_two().trailing_zeros(), [0, 0])?;
        world.builder.finish()
    }
}

/// What a catalogue has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum With {
    /// Orthoviews of every cell, geometry in the leaves.
    Orthoviews,
    /// Geometry in the leaves only.
    GeometryOnly,
}

struct Drawn<'a> {
    sizes: &'a Sizes,
    builder: LodTreeBuilder,
    random: SplitMix64,
    count: u32,
    low: f64,
    with: With,
}

impl Drawn<'_> {
    fn pick<'s, T>(&mut self, of: &'s [T]) -> Option<&'s T> {
        let at = (self.random.uniform() * of.len() as f64) as usize;
        of.get(at.min(of.len().saturating_sub(1)))
    }

    /// At most 12 calls deep.
    fn cell(&mut self, level: u32, place: [u32; 2]) -> Result<(), LodTreeError> {
        let sizes = self.sizes;
        self.builder.open()?;
        if level == 0 {
            let Some(leaf) = self.pick(&sizes.leaves) else { return self.builder.close(None, 1.0) };
            self.images(&leaf.images, 0)?;
            // Geometry that is coarser than the orthoviews beside it is never worth its bytes.
            let coarsest = if self.with == With::Orthoviews { sizes.pitch } else { f64::INFINITY };
            for (place, level) in leaf.geometry.iter().enumerate() {
                if place > 0 && f64::from(level.error) >= coarsest {
                    continue;
                }
                self.builder.add(Representation {
                    wire_bytes: level.size.wire.max(1),
                    decoded_bytes: level.size.decoded.max(1),
                    error: level.error,
                    prerequisite: None,
                    direction: None,
                })?;
            }
            let corner = |at: u32| self.low + f64::from(at) * sizes.leaf_side;
            let min = DVec3::new(corner(place[0]), corner(place[1]), 0.0);
            let max = DVec3::new(corner(place[0] + 1), corner(place[1] + 1), leaf.height.max(1.0));
            return self.builder.close(Some(Aabb { min, max }), 1.0);
        }
        let measured = &sizes.above[(level as usize).min(sizes.above.len()).saturating_sub(1)..];
        if let Some(images) = measured.first().and_then(|cells| self.pick(cells)) {
            self.images(images, level)?;
        }
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let child = [2 * place[0] + x, 2 * place[1] + y];
            if child.iter().all(|&at| at << (level - 1) < self.count) {
                self.cell(level - 1, child)?;
            }
        }
        self.builder.close(None, 1.0)
    }

    fn images(&mut self, images: &Images, level: u32) -> Result<(), LodTreeError> {
        if self.with == With::GeometryOnly {
            return Ok(());
        }
        #[expect(clippy::cast_possible_truncation, reason = "a length in metres")]
        let error = (self.sizes.pitch * f64::from(1u32 << level.min(31))) as f32;
        for (direction, size) in nine().into_iter().zip(images) {
            if let Some(size) = size {
                self.builder.add(Representation {
                    wire_bytes: size.wire,
                    decoded_bytes: size.decoded,
                    error,
                    prerequisite: None,
                    direction: Some(direction.code()),
                })?;
            }
        }
        Ok(())
    }
}
