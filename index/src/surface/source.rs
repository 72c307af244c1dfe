//! From what a command line names to a source of surfaces.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::{GltfFile, ObjFile, PlyFile, SurfaceSource, Up};
use crate::import::tiles3d::surface::FinestContents;
use crate::import::tiles3d::{ContentError, Tiles3dError};
use crate::specification::Progress;

/// How much of a file is looked at to recognise it.
const HEAD: u64 = 1 << 16;

const EXPECTED: &str = "GLB, glTF, OBJ, PLY, a 3D Tiles tileset.json, CityJSON or CityJSONSeq, a generated world's document, or a folder with \
    one of them";

/// What makes a folder a world.
const INSIDE: [&str; 4] = ["tileset.json", "city.json", "terrain.json", "asteroids.json"];

/// What lines of an OBJ file begin with.
const OBJ: [&str; 14] = ["v", "vt", "vn", "vp", "f", "fo", "g", "o", "s", "l", "p", "mtllib", "usemtl", "maplib"];

/// Why there are no surfaces to be had.
#[derive(Debug, thiserror::Error)]
pub enum SurfaceError {
    /// It cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// What was to be read.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// It is none of the kinds known.
    #[error("{}: {found}; expected {EXPECTED}", file.display())]
    Unrecognised {
        /// What was looked at.
        file: PathBuf,
        /// What it looks like.
        found: String,
    },
    /// It is of a kind that this build was made without.
    #[error("{}: this build reads no surfaces of {kind}", file.display())]
    NotBuilt {
        /// What was looked at.
        file: PathBuf,
        /// Its kind.
        kind: &'static str,
    },
    /// A tileset is at fault.
    #[error(transparent)]
    Tiles3d(#[from] Tiles3dError),
    /// A city model is at fault.
    #[cfg(feature = "cityjson")]
    #[error(transparent)]
    CityJson(#[from] crate::import::cityjson::CityJsonError),
    /// A generated world is at fault.
    #[cfg(feature = "generated")]
    #[error(transparent)]
    Generated(#[from] crate::generate::document::GenerateError),
    /// There is not one triangle.
    #[error("{}: no triangles{why}; expected a mesh", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
        /// What was left out, if that is why.
        why: String,
    },
    /// What a file holds is at fault.
    #[error(transparent)]
    Content(#[from] ContentError),
}

/// Opens the surfaces that `input` names: a file or folder, recognised by its content, or the parameters of a generated
/// world (`city:blocks=20`, as worlds are named). Behind the name of an OBJ or PLY file `,up=y` says which of its axes
/// points up, which is z otherwise; glTF's is y. Worlds come out with z up.
///
/// # Errors
/// What cannot be read, is not recognised or holds no triangles.
pub fn open(input: &str, progress: &Progress) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    progress(0, 1);
    let source = opened(input);
    progress(1, 1);
    source
}

/// Whether `input` names a GLB, glTF, OBJ or PLY file: a mesh, and nothing else that is known.
pub fn is_mesh(input: &str) -> bool {
    let (path, _) = with_up(input);
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    path.is_file() && read.is_ok() && matches!(recognise(&head), Content::Gltf | Content::Ply | Content::Obj)
}

fn opened(input: &str) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    if !Path::new(input).exists()
        && let Some((given, parts)) = input.split_once(':')
        && let Some(kind) = ["city", "terrain", "asteroids"].into_iter().find(|kind| *kind == given)
    {
        return generated(kind, Given::Parts(parts));
    }
    let (path, up) = with_up(input);
    let io = |source| SurfaceError::Io { file: path.to_owned(), source };
    let file = if path.is_dir() {
        let found = INSIDE.iter().map(|name| path.join(name)).find(|file| file.is_file());
        found.ok_or_else(|| SurfaceError::Unrecognised {
            file: path.to_owned(),
            found: format!("a folder with none of {}", INSIDE.join(", ")),
        })?
    } else {
        path.to_owned()
    };
    let mut head = Vec::new();
    File::open(&file).map_err(io)?.take(HEAD).read_to_end(&mut head).map_err(io)?;
    match recognise(&head) {
        Content::Gltf => Ok(Box::new(GltfFile::open(&file)?)),
        Content::Ply => Ok(Box::new(PlyFile::open(&file, up)?)),
        Content::Obj => Ok(Box::new(ObjFile::open(&file, up)?)),
        Content::Tileset => Ok(Box::new(FinestContents::open(&file)?)),
        Content::CityJson => city_model(&file),
        Content::Generated(kind) => generated(kind, Given::File(&file)),
        Content::Other(found) => Err(SurfaceError::Unrecognised { file, found }),
    }
}

/// The path in front of `,up=…`.
fn with_up(input: &str) -> (&Path, Up) {
    let suffixes = [(",up=x", Up::X), (",up=y", Up::Y), (",up=z", Up::Z)];
    let found = suffixes.into_iter().find_map(|(suffix, up)| Some((input.strip_suffix(suffix)?, up)));
    match found.filter(|_| !Path::new(input).exists()) {
        Some((path, up)) => (Path::new(path), up),
        None => (Path::new(input), Up::default()),
    }
}

enum Content {
    Gltf,
    Ply,
    Obj,
    Tileset,
    CityJson,
    Generated(&'static str),
    Other(String),
}

fn recognise(head: &[u8]) -> Content {
    let head = head.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(head).trim_ascii_start();
    if head.starts_with(b"glTF") {
        return Content::Gltf;
    }
    if head.starts_with(b"ply\n") || head.starts_with(b"ply\r") {
        return Content::Ply;
    }
    if head.starts_with(b"\x1F\x8B") {
        // gzip, as tilesets are often stored.
        return Content::Tileset;
    }
    if head.is_empty() {
        return Content::Other("nothing in it".to_owned());
    }
    let has = |part: &str| head.windows(part.len()).any(|window| window == part.as_bytes());
    if head[0] == b'{' {
        let kinds =
            [("foresight-city", "city"), ("foresight-terrain", "terrain"), ("foresight-asteroids", "asteroids")];
        return match kinds.into_iter().find(|(format, _)| has(format)) {
            Some((_, kind)) => Content::Generated(kind),
            None if has("\"CityJSON") || has("\"CityObjects\"") => Content::CityJson,
            None if has("\"geometricError\"") => Content::Tileset,
            None if has("\"asset\"")
                && ["\"meshes\"", "\"accessors\"", "\"bufferViews\"", "\"buffers\"", "\"nodes\"", "\"scenes\""]
                    .into_iter()
                    .any(has) =>
            {
                Content::Gltf
            }
            None => Content::Tileset,
        };
    }
    let lines = head.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
    let first = lines.clone().find(|line| !line.is_empty() && !line.starts_with(b"#"));
    let is_obj = |line: &[u8]| {
        let word = line.split(u8::is_ascii_whitespace).next().unwrap_or_default();
        OBJ.iter().any(|known| known.as_bytes() == word)
    };
    if first.is_some_and(is_obj) {
        return Content::Obj;
    }
    let start = String::from_utf8_lossy(&head[..head.len().min(24)]);
    Content::Other(format!("it begins with {:?}", start.trim_end_matches(char::REPLACEMENT_CHARACTER)))
}

#[cfg(feature = "cityjson")]
fn city_model(file: &Path) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    Ok(Box::new(crate::import::cityjson::CityModelSurfaces::open(file)?))
}

#[cfg(not(feature = "cityjson"))]
fn city_model(file: &Path) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    Err(SurfaceError::NotBuilt { file: file.to_owned(), kind: "CityJSON" })
}

/// The parameters of a generated world.
#[cfg_attr(not(feature = "generated"), expect(dead_code, reason = "nothing reads them"))]
#[derive(Clone, Copy)]
enum Given<'a> {
    Parts(&'a str),
    File(&'a Path),
}

#[cfg(feature = "generated")]
fn generated(kind: &'static str, given: Given<'_>) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    match kind {
        #[cfg(feature = "textures")]
        "city" => Ok(Box::new(crate::generate::city::CitySurfaces::new(&params(given)?)?)),
        #[cfg(feature = "terrain")]
        "terrain" => Ok(Box::new(crate::generate::terrain::TerrainSurfaces::new(&params(given)?)?)),
        #[cfg(feature = "asteroids")]
        "asteroids" => Ok(Box::new(crate::generate::asteroids::AsteroidSurfaces::new(&params(given)?)?)),
        _ => Err(SurfaceError::NotBuilt { file: PathBuf::from(kind), kind: "generated worlds of this kind" }),
    }
}

#[cfg(feature = "generated")]
#[cfg_attr(
    not(any(feature = "textures", feature = "terrain", feature = "asteroids")),
    expect(dead_code, reason = "no generator is built")
)]
fn params<P: crate::generate::document::Params>(given: Given<'_>) -> Result<P, SurfaceError> {
    use crate::generate::document::{GenerateError, from_parts, parse};
    match given {
        Given::Parts(parts) => Ok(from_parts(parts)?),
        Given::File(file) => {
            let bytes = std::fs::read(file).map_err(|source| SurfaceError::Io { file: file.to_owned(), source })?;
            Ok(parse(&bytes).map_err(|source| GenerateError::File { file: file.to_owned(), source })?)
        }
    }
}

#[cfg(not(feature = "generated"))]
fn generated(kind: &'static str, _: Given<'_>) -> Result<Box<dyn SurfaceSource>, SurfaceError> {
    Err(SurfaceError::NotBuilt { file: PathBuf::from(kind), kind: "generated worlds" })
}
