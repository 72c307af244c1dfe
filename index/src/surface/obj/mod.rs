//! Wavefront OBJ files with their material libraries, z up unless said otherwise, seen from both sides.
//!
//! Opening reads the file once: positions (27 bytes each) and texture coordinates (8 bytes) stay in memory, faces stay in
//! the file and are read a piece at a time.

mod mtl;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};

use super::inputs::{beside, identity};
use super::lines::Lines;
use super::polygon::Polygons;
use super::{PIECE_TRIANGLES, Piece, SurfaceError, SurfaceSource, Up};
use crate::import::tiles3d::ContentError;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;
use crate::world::Georeference;
use mtl::Look;

/// Most corners of a face.
const MAX_CORNERS: usize = 1 << 14;
/// Most things said about one file.
const MAX_SAID: usize = 64;

/// An OBJ file.
pub struct ObjFile {
    file: PathBuf,
    up: Up,
    positions: Vec<[f64; 3]>,
    /// As many as positions, or none.
    colours: Vec<[u8; 3]>,
    coordinates: Vec<[f32; 2]>,
    looks: Vec<Look>,
    /// The first look of each name.
    known: BTreeMap<String, usize>,
    /// Files of the libraries.
    libraries: Vec<PathBuf>,
    parts: Vec<Part>,
    name: String,
    /// Said by the first piece.
    left_out: Vec<String>,
}

/// Faces that follow each other.
#[derive(Clone, Copy, Debug)]
struct Part {
    offset: u64,
    /// Lines before it.
    line: u64,
    end: u64,
    positions: usize,
    coordinates: usize,
    /// Index of the look; past the last for none.
    look: usize,
}

/// A corner of a face: position and texture coordinates by number from 0.
type Corner = (Option<usize>, Option<usize>);

/// A number of a corner: from 1 on, or from the last one backwards.
fn number(text: &str, so_far: usize) -> Result<Option<usize>, ()> {
    let given: i64 = text.parse().map_err(|_| ())?;
    Ok(match given {
        1.. => usize::try_from(given - 1).ok(),
        0 => None,
        _ => usize::try_from(given.unsigned_abs()).ok().and_then(|back| so_far.checked_sub(back)),
    })
}

fn corner(text: &str, positions: usize, coordinates: usize) -> Result<Corner, ()> {
    let mut parts = text.split('/');
    let position = number(parts.next().unwrap_or_default(), positions)?;
    let coordinate = match parts.next() {
        None | Some("") => None,
        Some(text) => number(text, coordinates)?,
    };
    Ok((position, coordinate))
}

/// The finite or not finite numbers of a line, as many as there are up to N.
fn numbers<const N: usize>(rest: &str) -> Result<([f64; N], usize), ()> {
    let mut out = [0.0; N];
    let mut count = 0;
    for (into, text) in out.iter_mut().zip(rest.split_ascii_whitespace()) {
        *into = text.parse().map_err(|_| ())?;
        count += 1;
    }
    Ok((out, count))
}

fn clipped(text: &str) -> String {
    text.chars().take(60).collect()
}

impl ObjFile {
    /// Opens an OBJ file.
    ///
    /// # Errors
    /// Lines that are none of OBJ's, no faces at all.
    pub fn open(path: &Path, up: Up) -> Result<ObjFile, SurfaceError> {
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let mut made = ObjFile {
            file: path.to_owned(),
            up,
            positions: Vec::new(),
            colours: Vec::new(),
            coordinates: Vec::new(),
            looks: Vec::new(),
            known: BTreeMap::new(),
            libraries: Vec::new(),
            parts: Vec::new(),
            name,
            left_out: Vec::new(),
        };
        made.scan()?;
        if made.parts.is_empty() {
            let why = made.left_out.first().map_or_else(String::new, |first| format!(" (left out: {first})"));
            return Err(SurfaceError::Empty { file: path.to_owned(), why });
        }
        Ok(made)
    }

    fn say(&mut self, text: String) {
        if self.left_out.len() < MAX_SAID {
            self.left_out.push(text);
        }
    }

    /// Reads everything but the faces, and where these are.
    fn scan(&mut self) -> Result<(), ContentError> {
        let mut lines = Lines::open(&self.file, 0, 0)?;
        let mut libraries = Vec::new();
        let mut names: BTreeMap<String, usize> = BTreeMap::new();
        // The material of each part by name, until the libraries are read.
        let mut used: Vec<Option<usize>> = Vec::new();
        let (mut material, mut triangles, mut other) = (None, 0, 0_u64);
        let mut is_open = false;
        loop {
            let (offset, before) = (lines.offset, lines.number);
            let Some(line) = lines.next()? else { break };
            let line = line.trim_start();
            let (keyword, rest) = line.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((line, ""));
            match keyword {
                "v" => {
                    let Ok((values, count @ 3..)) = numbers::<7>(rest) else {
                        let found = format!("{:?}; expected v with three numbers", clipped(line));
                        return Err(lines.fault(found));
                    };
                    self.position(values, count);
                }
                "vt" => {
                    let Ok((values, 1..)) = numbers::<2>(rest) else {
                        let found = format!("{:?}; expected vt with one to three numbers", clipped(line));
                        return Err(lines.fault(found));
                    };
                    self.coordinates.push(values.map(|value| value as f32));
                }
                "f" | "fo" => {
                    let corners = rest.split_ascii_whitespace().count();
                    if !(3..=MAX_CORNERS).contains(&corners) {
                        let found = format!("{:?}; expected f with 3 to {MAX_CORNERS} corners", clipped(line));
                        return Err(lines.fault(found));
                    }
                    if !is_open || triangles + corners - 2 > PIECE_TRIANGLES {
                        let (positions, coordinates) = (self.positions.len(), self.coordinates.len());
                        self.parts.push(Part { offset, line: before, end: offset, positions, coordinates, look: 0 });
                        used.push(material);
                        (is_open, triangles) = (true, 0);
                    }
                    triangles += corners - 2;
                    if let Some(part) = self.parts.last_mut() {
                        part.end = lines.offset;
                    }
                }
                "usemtl" => {
                    let next = names.len();
                    material = Some(*names.entry(rest.trim().to_owned()).or_insert(next));
                }
                "mtllib" => libraries.push(rest.trim().to_owned()),
                "p" | "l" | "curv" | "curv2" | "surf" => other += 1,
                "vn" | "vp" | "g" | "o" | "s" | "" => {}
                _ if keyword.starts_with('#') => {}
                // Free-form geometry, display attributes and what programs add.
                _ if keyword.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_') => {}
                _ => {
                    let found = format!("{:?}; expected a line of an OBJ file", clipped(line));
                    return Err(lines.fault(found));
                }
            }
        }
        if other > 0 {
            self.say(format!("{other} points, lines or curved surfaces"));
        }
        self.libraries(&libraries);
        self.known = self.looks.iter().enumerate().rev().map(|(at, look)| (look.name.clone(), at)).collect();
        // Past the last there is the white one of a name without a look.
        let white = self.looks.len();
        let mut look_of = vec![white; names.len()];
        let mut missing = Vec::new();
        for (name, &at) in &names {
            match self.known.get(name) {
                Some(&look) => look_of[at] = look,
                None => missing.push(format!("the material {:?}, which no library has: white", clipped(name))),
            }
        }
        for (part, used) in self.parts.iter_mut().zip(used) {
            part.look = used.map_or(white, |used| look_of[used]);
        }
        missing.into_iter().for_each(|text| self.say(text));
        Ok(())
    }

    /// Adds x y z \[w\] or x y z r g b.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
    fn position(&mut self, values: [f64; 7], count: usize) {
        let [x, y, z, ..] = values;
        self.positions.push(self.up.to_z([x, y, z]));
        if count >= 6 {
            let from = count - 3;
            let colour = [values[from], values[from + 1], values[from + 2]];
            self.colours.resize(self.positions.len() - 1, [255; 3]);
            self.colours.push(colour.map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8));
        } else if !self.colours.is_empty() {
            self.colours.push([255; 3]);
        }
    }

    fn libraries(&mut self, lines: &[String]) {
        for line in lines {
            // One name with blanks in it, or several.
            let whole = beside(&self.file, line).filter(|file| file.is_file());
            let names = if whole.is_some() { vec![line.as_str()] } else { line.split_ascii_whitespace().collect() };
            for name in names {
                let file = beside(&self.file, name);
                match file.filter(|file| file.is_file()) {
                    Some(file) => match mtl::read(&file) {
                        Ok(looks) => {
                            self.looks.extend(looks);
                            self.libraries.push(file);
                        }
                        Err(error) => self.say(format!("a material library: {error}")),
                    },
                    None => self.say(format!("the material library {:?}, which is not there", clipped(name))),
                }
            }
        }
    }

    /// Adds the triangles of the faces of a part; each names the look of its material.
    fn faces(&self, part: &Part, out: &mut Vec<Triangle>) -> Result<(), ContentError> {
        let Part { offset, line, end, mut positions, mut coordinates, mut look } = *part;
        let mut lines = Lines::open(&self.file, offset, line)?;
        let mut polygons = Polygons::default();
        let (mut corners, mut places): (Vec<Corner>, Vec<DVec3>) = (Vec::new(), Vec::new());
        let white = self.looks.len();
        while lines.offset < end {
            let Some(line) = lines.next()? else { break };
            let line = line.trim_start();
            let (keyword, rest) = line.split_once(|c: char| c.is_ascii_whitespace()).unwrap_or((line, ""));
            match keyword {
                "v" => positions += 1,
                "vt" => coordinates += 1,
                "usemtl" => look = self.known.get(rest.trim()).copied().unwrap_or(white),
                "f" | "fo" => {
                    corners.clear();
                    for text in rest.split_ascii_whitespace() {
                        let Ok(corner) = corner(text, positions, coordinates) else {
                            let found = format!("{:?}; expected corners such as 1, 1/2 or 1/2/3", clipped(line));
                            return Err(lines.fault(found));
                        };
                        corners.push(corner);
                    }
                    places.clear();
                    let place = |&(at, _): &Corner| at.and_then(|at| self.positions.get(at));
                    places.extend(corners.iter().map(|c| place(c).map_or(DVec3::NAN, |at| DVec3::from_array(*at))));
                    let uv = |at: usize| {
                        let given = corners[at].1.and_then(|at| self.coordinates.get(at));
                        // Images begin at their upper end.
                        given.map_or(DVec2::ZERO, |&[u, v]| DVec2::new(f64::from(u), 1.0 - f64::from(v)))
                    };
                    let tint = |at: usize| corners[at].0.and_then(|at| self.colours.get(at)).map_or([255; 3], |c| *c);
                    polygons.cut(&places, |triangle| {
                        out.push(Triangle {
                            corners: triangle.map(|at| places[at]),
                            uv: triangle.map(uv),
                            tint: triangle.map(tint),
                            material: look as u32,
                            two_sided: true,
                        });
                    });
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl SurfaceSource for ObjFile {
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
        self.faces(&self.parts[piece], &mut triangles)?;
        Ok(triangles)
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let mut out = Piece { triangles: self.triangles(piece)?, ..Piece::default() };
        if piece == 0 {
            out.left_out.clone_from(&self.left_out);
        }
        let mut own: BTreeMap<u32, u32> = BTreeMap::new();
        for triangle in &mut out.triangles {
            triangle.material = *own.entry(triangle.material).or_insert_with_key(|&look| {
                let look = self.looks.get(look as usize);
                let image = look.and_then(|look| look.image.as_deref());
                let texture = image.map(|name| {
                    let bytes = beside(&self.file, name).and_then(|file| std::fs::read(file).ok());
                    if bytes.is_none() {
                        out.left_out.push(format!("the image {:?}, which is not there: base colour", clipped(name)));
                    }
                    out.images.push(bytes.map(Arc::from));
                    out.images.len() - 1
                });
                let base = look.map_or([1.0; 3], |look| look.base);
                let cutoff = if texture.is_some() { 0.5 } else { 0.0 };
                out.materials.push(Material { base, texture, cutoff });
                out.materials.len() as u32 - 1
            });
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
        let images = self.looks.iter().filter_map(|look| beside(&self.file, look.image.as_deref()?));
        let mut images: Vec<PathBuf> = images.filter(|file| file.is_file()).collect();
        images.sort();
        images.dedup();
        let files = std::iter::once(&self.file).chain(&self.libraries).chain(&images).map(PathBuf::as_path);
        identity("foresight-surfaces-obj-1", &[self.up.code()], files)
    }
}
