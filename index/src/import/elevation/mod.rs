//! Elevation grids: numpy archives and GeoTIFFs, as terrain.
//!
//! A grid in degrees is projected to the UTM zone of its middle, sample by sample: it becomes a curvilinear grid, and no
//! height is changed. A projected grid stays in its system. Heights are taken as metres over whatever datum they have.

mod geotiff;
mod npy;
mod npz;

use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use glam::DVec2;

pub use geotiff::parse as parse_geotiff;
pub use npz::parse as parse_npz;

use crate::geodesy::{GeodesyError, Geodetic, Projection, utm_zone_epsg};
use crate::terrain::{self, Frame, HeightField, HeightFieldError, TerrainError};
use crate::world::{Georeference, Note, Severity, World};

/// A fault in an elevation grid's file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {fault}")]
pub struct GridError {
    /// Member of the archive, or tag.
    pub place: String,
    /// What is there, and what was expected.
    pub fault: String,
}

impl GridError {
    fn new(place: impl Into<String>, fault: impl Into<String>) -> GridError {
        GridError { place: place.into(), fault: fault.into() }
    }
}

/// What a grid's coordinates are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coordinates {
    /// Degrees of longitude and latitude on WGS 84.
    Degrees,
    /// Metres in a projected system by its EPSG code.
    Projected(u32),
    /// Metres in a system that is not named.
    Metres,
}

/// A grid as its file gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Samples in a row.
    pub columns: u32,
    /// Rows.
    pub rows: u32,
    /// Row by row, metres; NaN where there is none.
    pub heights: Vec<f32>,
    /// Place of the first sample.
    pub origin: DVec2,
    /// From column to column.
    pub column: DVec2,
    /// From row to row.
    pub row: DVec2,
    /// What these are.
    pub coordinates: Coordinates,
    /// What was found on the way: its place and text.
    pub notes: Vec<(Severity, String, String)>,
}

/// Why an elevation grid cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum ElevationError {
    /// It cannot be read.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// It is at fault.
    #[error("{}: {source}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The fault.
        source: GridError,
    },
    /// Its coordinates cannot be projected.
    #[error("{}: {source}", file.display())]
    Projection {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: GeodesyError,
    },
    /// No terrain can be made of it.
    #[error("{}: {source}", file.display())]
    Terrain {
        /// The file.
        file: PathBuf,
        /// Why not.
        source: TerrainError,
    },
}

/// The formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A zip archive of numpy arrays.
    Npz,
    /// A TIFF with geographic tags.
    GeoTiff,
}

/// Tells an elevation grid by the first bytes of its file.
pub fn format(head: &[u8]) -> Option<Format> {
    if head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06") {
        Some(Format::Npz)
    } else if [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| head.starts_with(*magic)) {
        Some(Format::GeoTiff)
    } else {
        None
    }
}

/// Opens the elevation grid in a file.
pub fn open(file: &Path, format: Format) -> Result<World, ElevationError> {
    let io = |source| ElevationError::Io { file: file.to_owned(), source };
    let mut reader = std::io::BufReader::new(std::fs::File::open(file).map_err(io)?);
    let grid = read(&mut reader, format).map_err(|source| ElevationError::File { file: file.to_owned(), source })?;
    world(file, grid)
}

fn read(reader: &mut (impl Read + Seek), format: Format) -> Result<Grid, GridError> {
    match format {
        Format::Npz => npz::read(reader),
        Format::GeoTiff => geotiff::read(reader),
    }
}

fn world(file: &Path, grid: Grid) -> Result<World, ElevationError> {
    let of = |source| ElevationError::Terrain { file: file.to_owned(), source };
    let no_projection = |source| ElevationError::Projection { file: file.to_owned(), source };
    let text =
        |part: Option<&std::ffi::OsStr>| part.map_or_else(String::new, |part| part.to_string_lossy().into_owned());
    let (name, file_name) = (text(file.file_stem()), text(file.file_name()));
    let Grid { columns, rows, heights, origin, column, row, coordinates, notes } = grid;
    let (projection, georeference) = match coordinates {
        Coordinates::Degrees => {
            let middle = origin + 0.5 * (f64::from(columns) * column + f64::from(rows) * row);
            let longitude = (middle.x + 180.0).rem_euclid(360.0) - 180.0;
            if !(middle.y.abs() <= 84.0 && longitude.is_finite()) {
                let fault = "no UTM zone there".to_owned();
                let source = HeightFieldError::Projection { longitude: middle.x, latitude: middle.y, fault };
                return Err(of(source.into()));
            }
            let code = utm_zone_epsg(&Geodetic::from_degrees(middle.y, longitude, 0.0));
            (Some(Projection::from_epsg(code).map_err(no_projection)?), Some(Georeference::Epsg(code)))
        }
        Coordinates::Projected(code) => {
            // Checked, so that what follows may rely on it.
            let code = Projection::from_epsg(code).map_err(no_projection)?.code();
            (None, Some(Georeference::Epsg(code)))
        }
        Coordinates::Metres => (None, None),
    };
    let frame = Frame { origin, column, row, projection };
    let field = HeightField::new(columns, rows, heights, frame).map_err(|error| of(error.into()))?;
    let mut world = terrain::terrain(name, &file_name, field, georeference).map_err(of)?;
    let notes =
        notes.into_iter().map(|(severity, place, text)| Note { severity, file: file_name.clone(), place, text });
    world.notes.splice(0..0, notes);
    Ok(world)
}

#[cfg(test)]
mod tests;
