//! Geometry of a leaf of the octree: its content as levels of detail, each a GLB with its measured error.
//!
//! What lies in the leaf is cut out of the triangles, rounded to a lattice that neighbouring leaves share
//! ([`STEPS`] steps a side) and simplified for errors that double from level to level. Vertices in the faces of the leaf are
//! the same in all levels and in both leaves: no level of one leaf leaves a crack to any level of another. A level's
//! error is measured against the content itself, rounding included, and its textures are reduced to texels of that size.

mod clip;
pub mod distance;
mod frame;
mod lattice;
mod nearest;
mod normals;
mod parts;
mod simplify;
mod soup;

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use meshopt::{optimize_vertex_cache, optimize_vertex_fetch_remap};

use crate::format::glb_compressed::{self, Model, Packing, Part};
use crate::octree::{Cell, Octree};
use crate::orthoview::raster;
use crate::orthoview::texture::Materials;
use distance::{Bracket, Surface};
use lattice::{Lattice, LatticeMesh};
use nearest::Nearest;
use soup::{Group, Soup};

pub use lattice::STEPS;
pub use soup::TRIANGLES_MAX;

/// How geometry is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometrySettings {
    /// Error that the finest level may have, metres: what no view can resolve. 0 keeps all.
    pub finest: f64,
    /// Largest error that a level is made for, as a share of the leaf's side. Larger values make coarser levels.
    pub coarsest: f64,
    /// Share of the bytes of the next finer level that a level may have at most; what gains less is dropped.
    pub gain: f64,
    /// Bytes beneath which nothing coarser is made: a request costs as much.
    pub least_bytes: usize,
    /// Texels across a level's error. Larger values make textures sharper and files larger.
    pub texels: f64,
    /// Whether viewers light what they show: with a normal a vertex. Without, colours are shown as they are, as orthoviews
    /// show them.
    pub lit: bool,
    /// Quality of JPEG textures, 1 to 100.
    pub jpeg_quality: u8,
    /// How vertices and indices are stored.
    pub packing: Packing,
}

impl Default for GeometrySettings {
    fn default() -> GeometrySettings {
        GeometrySettings {
            finest: 0.0,
            coarsest: 1.0 / 16.0,
            gain: 0.7,
            least_bytes: 2048,
            texels: 1.0,
            lit: false,
            jpeg_quality: 85,
            packing: Packing::Compressed,
        }
    }
}

impl GeometrySettings {
    /// # Errors
    /// Values out of range.
    pub fn check(&self) -> Result<(), GeometryError> {
        let bad = |what| Err(GeometryError::Settings { what });
        match self {
            Self { finest, .. } if !(finest.is_finite() && *finest >= 0.0) => bad("finest must be 0 m or more"),
            Self { coarsest, .. } if !(*coarsest >= 0.0 && *coarsest <= 1.0) => bad("coarsest must be from 0 to 1"),
            Self { gain, .. } if !(*gain > 0.0 && *gain <= 1.0) => bad("gain must be above 0 and at most 1"),
            Self { texels, .. } if !(*texels >= 0.125 && *texels <= 64.0) => bad("texels must be from ⅛ to 64"),
            Self { jpeg_quality, .. } if !(1..=100).contains(jpeg_quality) => bad("jpeg_quality must be from 1 to 100"),
            _ => Ok(()),
        }
    }
}

/// Why there is no geometry.
#[derive(Debug, thiserror::Error)]
pub enum GeometryError {
    /// A setting out of range.
    #[error("geometry settings: {what}")]
    Settings {
        /// Which, and what was expected.
        what: &'static str,
    },
    /// More than memory should hold.
    #[error("more than {most} triangles in a leaf; expected fewer, or smaller leaves")]
    TooMany {
        /// What is allowed.
        most: usize,
    },
    /// A texture that cannot be written.
    #[error("a texture: {0}")]
    Image(#[from] image::ImageError),
    /// A mesh that cannot be written.
    #[error("mesh compression: {0}")]
    Compression(#[from] meshopt::Error),
}

/// A level of detail.
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryLevel {
    /// The file. It is y up: (x, y, z) of the world is (x, z, −y) in it.
    pub glb: Vec<u8>,
    /// Bound on how far any point of the level is from the content and any of the content from the level, metres (see
    /// [`distance`]); no less than the side of a texel where a texture is reduced.
    pub error: f32,
    /// What is known of that distance, metres; its upper end is in `error`.
    pub measured: Bracket,
    /// What the simplifier claims for it, metres.
    pub claimed: f64,
    /// Number of triangles.
    pub triangles: u64,
    /// Number of vertices.
    pub vertices: u64,
    /// Bytes once decoded and uploaded: vertices, indices, and textures with their mips.
    pub decoded_bytes: u64,
}

/// Levels of a cell's content, the finest first; none if the cell shows nothing. Errors rise and sizes fall from level to level.
/// `meshes` may reach beyond the cell: what is cut off belongs to its neighbours.
///
/// # Errors
/// Settings out of range, more triangles than [`TRIANGLES_MAX`], and what cannot be encoded.
pub fn levels(
    meshes: &[(&[raster::Triangle], &Materials)],
    octree: &Octree,
    cell: Cell,
    settings: &GeometrySettings,
) -> Result<Vec<GeometryLevel>, GeometryError> {
    settings.check()?;
    let soup = soup::gathered(meshes, octree, cell)?;
    let lattice = Lattice::of(octree, cell);
    let whole = LatticeMesh::welded(&soup, &lattice);
    let Some(workshop) = Workshop::over(&soup, &lattice, settings) else { return Ok(Vec::new()) };
    let side = f64::from(lattice.step) * f64::from(STEPS);
    let mut levels: Vec<GeometryLevel> = Vec::new();
    // Triangles and halvings of the last level that was kept.
    let mut last: Option<(usize, Vec<u32>)> = None;
    let mut current = whole;
    let mut claimed = 0.0;
    let doubling = (0..16).map(|k| side / 4096.0 * f64::from(1_u32 << k));
    let targets = doubling.filter(|&e| e > 2.0 * settings.finest && e <= settings.coarsest * side);
    for target in std::iter::once(settings.finest).chain(targets) {
        if target > 0.0 {
            let made = simplify::simplified(&current, &soup.groups, &lattice, target);
            claimed += made.claimed;
            current = made.mesh;
        }
        let shown = current.with_area();
        if shown.triangles.is_empty() {
            break;
        }
        let halvings = workshop.halvings(target);
        let gains = last.as_ref().is_none_or(|(triangles, before)| {
            (shown.triangles.len() as f64) < settings.gain * *triangles as f64 || halvings != *before
        });
        if !gains {
            continue;
        }
        let mut level = workshop.level(&shown, &halvings)?;
        let most = levels.last().map_or(f64::INFINITY, |finer| settings.gain * finer.glb.len() as f64);
        if level.glb.len() as f64 > most {
            continue;
        }
        let Some(measured) = workshop.measured(&shown, target) else { break };
        level.measured = measured;
        level.claimed = claimed;
        level.error = upwards(measured.upper.max(workshop.texel(&halvings)));
        // What is no worse and smaller takes the finer one's place.
        while levels.last().is_some_and(|finer| finer.error >= level.error) {
            levels.pop();
        }
        let bytes = level.glb.len();
        levels.push(level);
        last = Some((shown.triangles.len(), halvings));
        if bytes <= settings.least_bytes {
            break;
        }
    }
    Ok(levels)
}

/// The least 32-bit number that is no less.
#[expect(clippy::cast_possible_truncation, reason = "rounded up after")]
fn upwards(value: f64) -> f32 {
    let narrow = value as f32;
    if f64::from(narrow) < value { narrow.next_up() } else { narrow }
}

/// What all levels of a cell are made of.
struct Workshop<'a> {
    soup: &'a Soup<'a>,
    lattice: &'a Lattice,
    settings: &'a GeometrySettings,
    originals: Nearest,
    /// What leaving out each original costs at most, metres.
    wholes: Vec<f64>,
}

impl<'a> Workshop<'a> {
    /// `None` if there is nothing to see.
    fn over(soup: &'a Soup<'a>, lattice: &'a Lattice, settings: &'a GeometrySettings) -> Option<Workshop<'a>> {
        let seen: Vec<_> = soup
            .pieces
            .iter()
            .filter(|p| (p.corners[1] - p.corners[0]).cross(p.corners[2] - p.corners[0]) != DVec3::ZERO)
            .collect();
        if seen.is_empty() {
            return None;
        }
        let corners: Vec<_> = seen.iter().map(|p| p.corners.map(|at| lattice.nearest(at))).collect();
        let wholes = parts::parts(&corners, lattice).iter().map(|part| part.diameter).collect();
        let originals = Nearest::over(seen.iter().map(|p| p.corners).collect());
        Some(Workshop { soup, lattice, settings, originals, wholes })
    }

    /// How often each group's texture may be halved for an error.
    fn halvings(&self, error: f64) -> Vec<u32> {
        let halvings = |group: &Group<'_>| {
            let Some((_, frame)) = &group.texture else { return 0 };
            let fits = |k: &u32| group.texel * f64::from(1_u32 << k) * self.settings.texels <= error;
            (1..=frame.halvings_max()).take_while(fits).count() as u32
        };
        self.soup.groups.iter().map(halvings).collect()
    }

    /// Side of the largest texel of a reduced texture, metres.
    fn texel(&self, halvings: &[u32]) -> f64 {
        let reduced = self.soup.groups.iter().zip(halvings).filter(|(_, k)| **k > 0);
        reduced.map(|(group, &k)| group.texel * f64::from(1_u32 << k)).fold(0.0, f64::max)
    }

    /// `target` is the error that the level was made for, metres.
    fn measured(&self, mesh: &LatticeMesh, target: f64) -> Option<Bracket> {
        let level = Nearest::over(mesh.triangles.iter().map(|&t| mesh.corners(t, self.lattice)).collect());
        let originals = Surface { tree: &self.originals, wholes: Some(&self.wholes) };
        let absolute = (f64::from(self.lattice.step) / 8.0).max(0.02 * target);
        let Bracket { lower, upper } = distance::error(&Surface { tree: &level, wholes: None }, &originals, absolute)?;
        let model = Model {
            origin: self.lattice.origin,
            step: self.lattice.step,
            steps: STEPS,
            parts: &[],
            pictures: &[],
            packing: self.settings.packing,
        };
        let off = model.misplacement();
        Some(Bracket { lower: (lower - off).max(0.0), upper: upper + off })
    }

    /// A level without its error.
    fn level(&self, mesh: &LatticeMesh, halvings: &[u32]) -> Result<GeometryLevel, GeometryError> {
        let mut pictures = Vec::new();
        let mut texels = 0;
        let mut parts = Vec::new();
        let mut of_group: Vec<Vec<[u32; 3]>> = vec![Vec::new(); self.soup.groups.len()];
        for &triangle in &mesh.triangles {
            of_group[mesh.vertices[triangle[0] as usize].group as usize].push(triangle);
        }
        let groups = self.soup.groups.iter().zip(&of_group).zip(halvings).filter(|((_, t), _)| !t.is_empty());
        for ((group, triangles), &halvings) in groups {
            let mut part = self.part(&mesh.with(triangles.iter().copied()), group);
            if let Some((texture, frame)) = &group.texture {
                let has_holes = group.material.cutoff > 0.0;
                let picture = frame.picture(texture, halvings, has_holes, self.settings.jpeg_quality)?;
                texels += picture.size[0] as u64 * picture.size[1] as u64;
                part.picture = Some(pictures.len());
                part.repeat = frame.transform();
                pictures.push((picture.bytes, picture.is_png));
            }
            parts.push(part);
        }
        let (origin, step, packing) = (self.lattice.origin, self.lattice.step, self.settings.packing);
        let model = Model { origin, step, steps: STEPS, parts: &parts, pictures: &pictures, packing };
        Ok(GeometryLevel {
            glb: glb_compressed::encode(&model)?,
            error: 0.0,
            measured: Bracket { lower: 0.0, upper: 0.0 },
            claimed: 0.0,
            triangles: parts.iter().map(|p| p.triangles.len() as u64).sum(),
            vertices: parts.iter().map(|p| p.positions.len() as u64).sum(),
            decoded_bytes: glb_compressed::decoded_bytes(&model) + 16 * texels / 3,
        })
    }

    /// A group's triangles in the order that caches and the compressor like.
    fn part(&self, mesh: &LatticeMesh, group: &Group<'_>) -> Part {
        let shaded = self.settings.lit.then(|| normals::shaded(mesh, self.lattice));
        let mesh = shaded.as_ref().map_or(mesh, |(mesh, _)| mesh);
        let indices: Vec<u32> = mesh.triangles.as_flattened().to_vec();
        let indices = optimize_vertex_cache(&indices, mesh.vertices.len());
        let number = optimize_vertex_fetch_remap(&indices, mesh.vertices.len());
        let mut order = vec![0; mesh.vertices.len()];
        for (vertex, &place) in number.iter().enumerate() {
            order[place as usize] = vertex;
        }
        let vertices = || order.iter().map(|&vertex| &mesh.vertices[vertex]);
        let uv = if group.texture.is_some() { vertices().map(|v| v.uv).collect() } else { Vec::new() };
        let is_tinted = mesh.vertices.iter().any(|v| v.tint != [255; 3]);
        let tints = if is_tinted { vertices().map(|v| v.tint).collect() } else { Vec::new() };
        let normals = shaded.iter().flat_map(|(_, normals)| order.iter().map(|&vertex| normals[vertex])).collect();
        let renamed = |t: &[u32]| [t[0], t[1], t[2]].map(|vertex| number[vertex as usize]);
        Part {
            positions: vertices().map(|v| v.at).collect(),
            normals,
            uv,
            tints,
            triangles: indices.chunks_exact(3).map(renamed).collect(),
            base: group.material.base,
            cutoff: if group.texture.is_some() { group.material.cutoff } else { 0.0 },
            two_sided: group.two_sided,
            ..Part::default()
        }
    }
}

/// Box around what a cell shows, metres in the world; empty if it shows nothing.
///
/// # Errors
/// More triangles than [`TRIANGLES_MAX`].
pub fn bounds(
    meshes: &[(&[raster::Triangle], &Materials)],
    octree: &Octree,
    cell: Cell,
) -> Result<Aabb, GeometryError> {
    let origin = octree.bounds(cell).min;
    let soup = soup::gathered(meshes, octree, cell)?;
    let at = |corner: DVec3| Aabb { min: origin + corner, max: origin + corner };
    Ok(soup.corners().fold(Aabb::EMPTY, |bounds, corner| bounds.union(at(corner))))
}

#[cfg(test)]
mod tests;
