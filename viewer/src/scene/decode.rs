//! Bytes of a representation to what is drawn.

use super::content::{Content, Mesh, Part, SplatImage, Texels, Vertex};
use super::source::{Placing, Source};
use super::texture;
use foresight_index::format::orthoview::{self, DecodedPlanes, depth_error};
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::Direction;
use foresight_index::orthoview::image::Lattice;
use foresight_index::orthoview::raster::Triangle;
use foresight_index::surface::{Piece, read_glb};
use foresight_index::world::World;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use glam::DVec3;
use std::collections::HashMap;
use std::sync::Arc;

/// Texture coordinates beyond this are brought near 0, where 32 bits are fine enough, triangle by triangle.
const UV_FAR: f64 = 256.0;

/// A representation that cannot be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("representation {} ({uri}): {fault}", rep.0)]
pub struct DecodeError {
    /// Which.
    pub rep: RepId,
    /// Where it is fetched.
    pub uri: String,
    /// Where the fault is, what is there, and what was expected.
    pub fault: String,
}

/// What bytes hold.
#[derive(Clone, Debug)]
pub struct Decoded {
    /// What is drawn.
    pub content: Content,
    /// Whose it is, as it says itself.
    pub credit: Option<Arc<str>>,
    /// What of it is not drawn, in words.
    pub left_out: Vec<String>,
}

/// Decodes a representation of `world`, whose contents stand where `source` says.
///
/// # Errors
/// Bytes that are not what the representation is to be, are cut off or corrupt, and formats that are not drawn.
pub fn decode(world: &World, source: &Source, rep: RepId, bytes: &[u8]) -> Result<Decoded, DecodeError> {
    let fault = |fault: String| DecodeError { rep, uri: world.uri(rep).into_owned(), fault };
    if rep.index() >= world.tree.representations() {
        return Err(fault(format!("not there; expected one of {}", world.tree.representations())));
    }
    let inflated = match source.placing() {
        // What comes for it means nothing.
        Placing::Made(_) => None,
        _ => super::source::inflated(bytes).map_err(&fault)?,
    };
    let bytes = inflated.as_deref().unwrap_or(bytes);
    let piece = match source.placing() {
        Placing::Stored { octree, pixel } => match world.tree.direction(rep) {
            Some(code) => {
                let cell = cell_of(&world.uri(rep)).ok_or_else(|| {
                    fault("an address without a cell; expected orthoviews/LEVEL/X_Y_Z/DIRECTION.HASH.fsov".to_owned())
                })?;
                let image = splats(bytes, octree, *pixel, cell, code).map_err(&fault)?;
                let content = Content::Splats(image);
                return Ok(Decoded { content, credit: source.credit().map(Into::into), left_out: Vec::new() });
            }
            None => read_glb(bytes).map_err(|error| fault(error.to_string()))?,
        },
        Placing::Tiles(tiles) => tiles.read(rep, bytes).map_err(|error| fault(error.to_string()))?,
        Placing::Made(made) => made.piece(world, rep).map_err(&fault)?,
        Placing::Nowhere(why) => return Err(fault((*why).to_owned())),
    };
    let credit = piece.credit.as_deref().or(source.credit()).map(Into::into);
    let (content, left_out) = meshed(piece);
    if let (Content::Empty, Some(first)) = (&content, left_out.first()) {
        return Err(fault(format!("{first}; expected triangles")));
    }
    Ok(Decoded { content, credit, left_out })
}

/// The cell in the address of an orthoview of a stored world.
fn cell_of(uri: &str) -> Option<Cell> {
    let mut parts = uri.strip_prefix("orthoviews/")?.split('/');
    let level = parts.next()?.parse().ok()?;
    let mut place = parts.next()?.split('_').map(|number| number.parse::<u64>().ok());
    let place = [place.next()??, place.next()??, place.next()??];
    Some(Cell { level, place })
}

/// The box of the cell that an orthoview of a stored world shows: what hides a parent's share of it. `None` for what is no orthoview
/// of a stored world.
pub fn cell_bounds(world: &World, source: &Source, rep: RepId) -> Option<Aabb> {
    let Placing::Stored { octree, .. } = source.placing() else { return None };
    Some(octree.bounds(cell_of(&world.uri(rep))?))
}

/// An orthoview of a cell, whose depths and pixels must be those of the cell.
fn splats(bytes: &[u8], octree: &Octree, pitch: f64, cell: Cell, code: u8) -> Result<SplatImage, String> {
    let DecodedPlanes { direction, level, near, range, planes } =
        orthoview::decode_planes(bytes).map_err(|error| error.to_string())?;
    let expected = Direction::from_code(code).map_or_else(|| format!("direction {code}"), Direction::name);
    if direction.code() != code {
        return Err(format!("byte 8: an image along {}; expected one along {expected}", direction.name()));
    }
    if level != cell.level {
        return Err(format!("byte 7: an image of level {level}; expected {}", cell.level));
    }
    let lattice = Lattice { direction, origin: octree.origin(), pitch };
    let bounds = octree.bounds(cell);
    let (most, [first, last]) = lattice.footprint(&bounds, level);
    let rect = planes.rect;
    if rect.min.cmplt(most.min).any() || rect.max.cmpgt(most.max).any() {
        return Err(format!(
            "byte 12: pixels from {} to {}; expected them from {} to {}, where the cell is",
            rect.min, rect.max, most.min, most.max
        ));
    }
    let step = (1u64 << level.min(62)) as f64;
    let pixel = pitch * step;
    let slack = pixel + depth_error(last - first);
    if near < first - slack || near + range > last + slack {
        return Err(format!(
            "byte 36: depths from {near} to {} m; expected them from {first} to {last} m, where the cell is",
            near + range
        ));
    }
    let frame = lattice.frame();
    let middle = (rect.min.as_dvec2() + 0.5) * step;
    let [right, up] = direction.image_axes();
    Ok(SplatImage {
        direction,
        origin: frame.unproject(middle.extend(near)),
        right,
        up,
        towards_eye: direction.towards_eye(),
        pixel,
        range,
        size: [rect.width() as u32, rect.height() as u32],
        colours: planes.colours.as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect(),
        shapes: planes.depths.iter().zip(&planes.links).map(|(depth, links)| depth | u16::from(*links) << 10).collect(),
        normals: planes.normals,
        colours_kept: Texels::Plain,
        normals_kept: Texels::Plain,
        bounds,
    })
}

/// A corner to the bit, for finding it again.
#[derive(PartialEq, Eq, Hash)]
struct Key([u32; 8], [u8; 4]);

/// Triangles with shared corners, in runs by material. What is not finite is left out.
pub fn meshed(piece: Piece) -> (Content, Vec<String>) {
    let Piece { triangles, materials, images, normals, mut left_out, .. } = piece;
    let is_finite = |t: &Triangle| t.corners.iter().all(|c| c.is_finite()) && t.uv.iter().all(|uv| uv.is_finite());
    let mut order: Vec<usize> = (0..triangles.len()).filter(|&at| is_finite(&triangles[at])).collect();
    if order.len() < triangles.len() {
        left_out.push(format!("{} triangles that are not finite", triangles.len() - order.len()));
    }
    let corners = order.iter().flat_map(|&at| triangles[at].corners);
    let bounds = corners.fold(Aabb::EMPTY, |bounds, at| bounds.union(Aabb { min: at, max: at }));
    if bounds.is_empty() {
        return (Content::Empty, left_out);
    }
    // Whole metres, so that neighbours with equal corners have them equal in the world again where they are that coarse.
    let origin = bounds.centre().round();
    order.sort_by_key(|&at| (triangles[at].material, triangles[at].two_sided));
    let mut mesh = Mesh {
        origin,
        vertices: Vec::new(),
        indices: Vec::with_capacity(3 * order.len()),
        parts: Vec::new(),
        textures: Vec::new(),
        bounds,
    };
    let decoded = texture::decode_all(&images, &materials, &mut left_out);
    mesh.textures = decoded.textures;
    let mut known: HashMap<Key, u32> = HashMap::new();
    for run in order.chunk_by(|&a, &b| {
        (triangles[a].material, triangles[a].two_sided) == (triangles[b].material, triangles[b].two_sided)
    }) {
        let first = mesh.indices.len() as u32;
        let (number, two_sided) = (triangles[run[0]].material as usize, triangles[run[0]].two_sided);
        for &at in run {
            let triangle = &triangles[at];
            let shift = if triangle.uv.iter().any(|uv| uv.abs().max_element() > UV_FAR) {
                triangle.uv[0].floor()
            } else {
                glam::DVec2::ZERO
            };
            let own = normals.get(at).copied().unwrap_or_default();
            for (corner, normal) in own.into_iter().enumerate() {
                let [r, g, b] = triangle.tint[corner];
                let position = narrowed(triangle.corners[corner] - origin);
                let uv = triangle.uv[corner] - shift;
                #[expect(clippy::cast_possible_truncation, reason = "within a few repetitions of the texture")]
                let uv = [uv.x as f32, uv.y as f32];
                let vertex = Vertex { position, normal, uv, tint: [r, g, b, 255] };
                let ([a, b, c], [d, e, f], [g, h]) = (position, normal, uv);
                let key = Key([a, b, c, d, e, f, g, h].map(f32::to_bits), vertex.tint);
                let next = mesh.vertices.len() as u32;
                let index = *known.entry(key).or_insert(next);
                if index == next {
                    mesh.vertices.push(vertex);
                }
                mesh.indices.push(index);
            }
        }
        let material = materials.get(number).copied().unwrap_or_default();
        let texture = material.texture.and_then(|image| decoded.of_image.get(image).copied().flatten());
        let cutoff = if texture.is_some() { material.cutoff } else { 0.0 };
        mesh.parts.push(Part {
            indices: first..mesh.indices.len() as u32,
            base: material.base,
            texture,
            cutoff,
            two_sided,
        });
    }
    (Content::Mesh(mesh), left_out)
}

/// Metres from a mesh's own origin.
#[expect(clippy::cast_possible_truncation, reason = "relative to the middle of the mesh")]
fn narrowed(at: DVec3) -> [f32; 3] {
    at.to_array().map(|v| v as f32)
}

#[cfg(test)]
#[path = "decode_tests.rs"]
mod tests;
