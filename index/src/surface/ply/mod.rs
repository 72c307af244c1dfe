//! PLY files, text or binary: vertices with colours and texture coordinates, faces, triangle strips. z up unless said otherwise,
//! seen from both sides.
//!
//! Opening reads the file once: vertices stay in memory (12 bytes of each position, 24 if they are doubles; 3 of a colour, 8
//! of texture coordinates), faces stay in the file and are read a piece at a time.

mod body;
mod header;

#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::sync::Arc;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};

use super::inputs::{beside, identity, unreadable};
use super::lines::Lines;
use super::polygon::Polygons;
use super::{PIECE_TRIANGLES, Piece, SurfaceError, SurfaceSource, Up};
use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::world::Georeference;
use body::Body;
use header::{Element, Header, Kind};

/// Most corners of a face.
const MAX_CORNERS: usize = 1 << 14;

/// A PLY file.
pub struct PlyFile {
    file: PathBuf,
    up: Up,
    header: Header,
    vertices: Vertices,
    parts: Vec<Part>,
    name: String,
    /// Said by the first piece.
    left_out: Vec<String>,
}

/// What is known of the vertices; each list as long as the positions, or empty.
#[derive(Default)]
struct Vertices {
    narrow: Vec<[f32; 3]>,
    wide: Vec<[f64; 3]>,
    colours: Vec<[u8; 3]>,
    coordinates: Vec<[f32; 2]>,
}

impl Vertices {
    fn position(&self, at: f64) -> DVec3 {
        let at = index(at);
        match (self.narrow.get(at), self.wide.get(at)) {
            (Some(narrow), _) => DVec3::from_array(narrow.map(f64::from)),
            (_, Some(wide)) => DVec3::from_array(*wide),
            _ => DVec3::NAN,
        }
    }
}

/// What a number names; nothing if it is no index.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a whole number in range")]
fn index(at: f64) -> usize {
    if at >= 0.0 && at < u32::MAX as f64 { at as usize } else { usize::MAX }
}

/// Faces or strips that follow each other.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Which element.
    element: usize,
    place: (u64, u64),
    count: u64,
}

/// The properties of an element of faces.
struct Faces {
    corners: usize,
    /// Texture coordinates, two a corner.
    uv: Option<usize>,
    /// Number of the image.
    image: Option<usize>,
    colour: Option<[usize; 3]>,
    is_strip: bool,
}

fn faces(element: &Element) -> Option<Faces> {
    let is_list = |at: &usize| element.properties[*at].count.is_some();
    let is_strip = element.name == "tristrips";
    if !is_strip && element.name != "face" {
        return None;
    }
    Some(Faces {
        corners: element.find(&["vertex_indices", "vertex_index"]).filter(is_list)?,
        uv: element.find(&["texcoord"]).filter(is_list),
        image: element.find(&["texnumber"]).filter(|at| !is_list(at)),
        colour: colour(element),
        is_strip,
    })
}

fn colour(element: &Element) -> Option<[usize; 3]> {
    let one = |name: &'static str, short: &'static str, diffuse: &'static str| {
        element.find(&[name, short, diffuse]).filter(|&at| element.properties[at].count.is_none())
    };
    Some([one("red", "r", "diffuse_red")?, one("green", "g", "diffuse_green")?, one("blue", "b", "diffuse_blue")?])
}

/// A colour as a byte: floats are shares of 1, 16-bit numbers of 65535.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
fn byte(value: f64, kind: Kind) -> u8 {
    let share = match kind {
        Kind::F32 | Kind::F64 => value,
        Kind::U16 | Kind::I16 => value / 65535.0,
        _ => value / 255.0,
    };
    (share.clamp(0.0, 1.0) * 255.0).round() as u8
}

impl PlyFile {
    /// Opens a PLY file.
    ///
    /// # Errors
    /// A header that is none, a body that is not what the header says, no faces.
    pub fn open(path: &Path, up: Up) -> Result<PlyFile, SurfaceError> {
        let mut lines = Lines::open(path, 0, 0)?;
        let length = std::fs::metadata(path).map_err(|error| unreadable(path, &error))?.len();
        let header = header::read(&mut lines, length)?;
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let (vertices, parts) = (Vertices::default(), Vec::new());
        let file = path.to_owned();
        let mut made = PlyFile { file, up, header, vertices, parts, name, left_out: Vec::new() };
        made.scan()?;
        if made.parts.is_empty() {
            let why = made.left_out.first().map_or_else(String::new, |first| format!(" (left out: {first})"));
            return Err(SurfaceError::Empty { file: path.to_owned(), why });
        }
        Ok(made)
    }

    /// Reads the vertices, and where faces are.
    fn scan(&mut self) -> Result<(), ContentError> {
        let mut body = Body::open(&self.file, self.header.format, self.header.body)?;
        let mut has_vertices = false;
        for (number, element) in self.header.elements.iter().enumerate() {
            if element.name == "vertex" && !has_vertices {
                has_vertices = true;
                read_vertices(&mut body, element, self.up, &mut self.vertices)?;
                continue;
            }
            let Some(faces) = faces(element) else {
                if element.count > 0 {
                    self.left_out.push(format!("{} of {}, which are no surfaces", element.count, element.name));
                }
                for _ in 0..element.count {
                    body.element(element, |_, _, _| {})?;
                }
                continue;
            };
            let (mut triangles, mut is_open) = (0, false);
            for _ in 0..element.count {
                let place = body.place();
                let mut corners = 0;
                body.element(element, |property, _, _| corners += usize::from(property == faces.corners))?;
                if !faces.is_strip && corners > MAX_CORNERS {
                    return Err(body.fault(format!("a face of {corners} corners; expected at most {MAX_CORNERS}")));
                }
                let own = corners.saturating_sub(2);
                if !is_open || triangles + own > PIECE_TRIANGLES {
                    self.parts.push(Part { element: number, place, count: 0 });
                    (is_open, triangles) = (true, 0);
                }
                triangles += own;
                if let Some(part) = self.parts.last_mut() {
                    part.count += 1;
                }
            }
        }
        Ok(())
    }

    /// Adds the triangles of a part; the material is the number of the image, 0 without one.
    fn surfaces(&self, part: &Part, out: &mut Vec<Triangle>) -> Result<(), ContentError> {
        let element = &self.header.elements[part.element];
        let Some(faces) = faces(element) else { return Ok(()) };
        let mut body = Body::open(&self.file, self.header.format, part.place)?;
        let mut polygons = Polygons::default();
        let (mut corners, mut uv, mut places) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..part.count {
            corners.clear();
            uv.clear();
            let (mut image, mut colour) = (0.0, [255_u8; 3]);
            body.element(element, |property, _, value| {
                if property == faces.corners {
                    corners.push(value);
                } else if Some(property) == faces.uv {
                    uv.push(value);
                } else if Some(property) == faces.image {
                    image = value;
                } else if let Some(channel) = faces.colour.and_then(|c| c.iter().position(|&at| at == property)) {
                    colour[channel] = byte(value, element.properties[property].kind);
                }
            })?;
            let material = index(image).min(self.header.images.len().saturating_sub(1)) as u32;
            places.clear();
            places.extend(corners.iter().map(|&at| self.vertices.position(at)));
            let tint = |at: usize| {
                let own = self.vertices.colours.get(index(corners[at]));
                if faces.colour.is_some() { colour } else { own.copied().unwrap_or([255; 3]) }
            };
            let coordinates = |at: usize| {
                let given = match uv.get(2 * at..2 * at + 2) {
                    Some(pair) => Some(DVec2::new(pair[0], pair[1])),
                    None => {
                        self.vertices.coordinates.get(index(corners[at])).map(|c| DVec2::from_array(c.map(f64::from)))
                    }
                };
                // Images begin at their upper end.
                given.map_or(DVec2::ZERO, |uv| DVec2::new(uv.x, 1.0 - uv.y))
            };
            let mut add = |triangle: [usize; 3]| {
                out.push(Triangle {
                    corners: triangle.map(|at| places[at]),
                    uv: triangle.map(coordinates),
                    tint: triangle.map(tint),
                    material,
                    two_sided: true,
                });
            };
            if faces.is_strip {
                // −1 ends a strip.
                let mut first = 0;
                for (at, &corner) in corners.iter().enumerate() {
                    if corner < 0.0 {
                        first = at + 1;
                    } else if at >= first + 2 {
                        let turned = (at - first) % 2;
                        add([at - 2, at - 1 + turned, at - turned]);
                    }
                }
            } else {
                polygons.cut(&places, add);
            }
        }
        Ok(())
    }
}

fn read_vertices(body: &mut Body, element: &Element, up: Up, out: &mut Vertices) -> Result<(), ContentError> {
    let single = |names: &[&str]| element.find(names).filter(|&at| element.properties[at].count.is_none());
    let [Some(x), Some(y), Some(z)] = [single(&["x"]), single(&["y"]), single(&["z"])] else {
        return Err(body.fault("an element vertex without x, y and z; expected them"));
    };
    let colour = colour(element);
    let u = single(&["s", "u", "texture_u"]).zip(single(&["t", "v", "texture_v"]));
    let is_narrow = [x, y, z].iter().all(|&at| element.properties[at].kind != Kind::F64)
        && [x, y, z].iter().all(|&at| !matches!(element.properties[at].kind, Kind::I32 | Kind::U32));
    for _ in 0..element.count {
        let (mut at, mut tint, mut uv) = ([0.0; 3], [255; 3], [0.0; 2]);
        body.element(element, |property, _, value| {
            if let Some(axis) = [x, y, z].iter().position(|&own| own == property) {
                at[axis] = value;
            } else if let Some(channel) = colour.and_then(|c| c.iter().position(|&own| own == property)) {
                tint[channel] = byte(value, element.properties[property].kind);
            } else if let Some((u, v)) = u {
                if property == u {
                    uv[0] = value as f32;
                } else if property == v {
                    uv[1] = value as f32;
                }
            }
        })?;
        let at = up.to_z(at);
        if is_narrow {
            out.narrow.push(at.map(|value| value as f32));
        } else {
            out.wide.push(at);
        }
        if colour.is_some() {
            out.colours.push(tint);
        }
        if u.is_some() {
            out.coordinates.push(uv);
        }
    }
    Ok(())
}

impl SurfaceSource for PlyFile {
    fn pieces(&self) -> usize {
        self.parts.len()
    }

    fn declared(&self, _: usize) -> Option<Aabb> {
        None
    }

    fn name(&self, _: usize) -> &str {
        &self.name
    }

    fn triangles(&self, piece: usize) -> Result<Vec<Triangle>, ContentError> {
        let mut triangles = Vec::new();
        self.surfaces(&self.parts[piece], &mut triangles)?;
        Ok(triangles)
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let mut out = Piece { triangles: self.triangles(piece)?, ..Piece::default() };
        if piece == 0 {
            out.left_out.clone_from(&self.left_out);
        }
        let mut shown: Vec<u32> = out.triangles.iter().map(|triangle| triangle.material).collect();
        shown.sort_unstable();
        shown.dedup();
        for &number in &shown {
            let image = self.header.images.get(number as usize).map(|name| {
                let bytes = beside(&self.file, name).and_then(|file| std::fs::read(file).ok());
                if bytes.is_none() {
                    out.left_out.push(format!("the image {name:?}, which is not there: base colour"));
                }
                out.images.push(bytes.map(Arc::from));
                out.images.len() - 1
            });
            out.materials.push(Material { texture: image, ..Material::default() });
        }
        for triangle in &mut out.triangles {
            triangle.material = shown.binary_search(&triangle.material).unwrap_or(0) as u32;
        }
        Ok(out)
    }

    fn up(&self) -> DVec3 {
        DVec3::Z
    }

    fn georeference(&self) -> Option<Georeference> {
        None
    }

    fn identity(&self) -> Result<[u8; 32], ContentError> {
        let images: Vec<PathBuf> = self.header.images.iter().filter_map(|name| beside(&self.file, name)).collect();
        let images = images.iter().filter(|file| file.is_file());
        let files = std::iter::once(&self.file).chain(images).map(PathBuf::as_path);
        identity("foresight-surfaces-ply-1", &[self.up.code()], files)
    }
}
