//! A grid of heights and where it lies.

use std::collections::VecDeque;

use glam::{DMat2, DVec2, DVec3};

use crate::geodesy::{Geodetic, Projection};
use crate::ground::Surface;

/// Most samples of a grid.
pub const MAX_SAMPLES: u64 = 1 << 27;
/// Heights further than this from 0 are taken as missing, metres: more than any on a body in the solar system.
const HIGHEST: f32 = 1.0e5;

/// Where the samples of a grid lie: sample (i, j) at `origin + i·column + j·row`.
#[derive(Debug)]
pub struct Frame {
    /// Place of the first sample: metres, or degrees of longitude and latitude where there is a projection.
    pub origin: DVec2,
    /// From column to column.
    pub column: DVec2,
    /// From row to row.
    pub row: DVec2,
    /// From degrees to the metres of world space; `None` where the grid is in metres.
    pub projection: Option<Projection>,
}

/// Why a grid is no height field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum HeightFieldError {
    /// Too small or too large.
    #[error("{columns} × {rows} samples; expected at least 2 × 2 and at most {MAX_SAMPLES} in all")]
    Size {
        /// Samples in a row.
        columns: u32,
        /// Rows.
        rows: u32,
    },
    /// Another number of heights than samples.
    #[error("{found} heights; expected {expected}")]
    Count {
        /// Heights given.
        found: usize,
        /// Columns times rows.
        expected: usize,
    },
    /// No sample has a height.
    #[error("not one of the samples has a height; expected at least one")]
    NoHeight,
    /// The steps of the frame do not span a plane, or are not finite.
    #[error("steps of {column} and {row} from {origin}; expected finite ones along two directions")]
    Frame {
        /// As given.
        origin: DVec2,
        /// As given.
        column: DVec2,
        /// As given.
        row: DVec2,
    },
    /// A sample that the projection does not reach.
    #[error(
        "the sample at longitude {longitude}°, latitude {latitude}°: {fault}; expected a grid within one UTM zone and its surroundings"
    )]
    Projection {
        /// Degrees east.
        longitude: f64,
        /// Degrees north.
        latitude: f64,
        /// What the projection says.
        fault: String,
    },
}

/// A grid of heights, metres, linear on two triangles per cell.
#[derive(Debug)]
pub struct HeightField {
    columns: u32,
    rows: u32,
    heights: Vec<f32>,
    /// One flag a sample; empty where every sample has a height.
    missing: Vec<bool>,
    frame: Frame,
    /// From a step in native coordinates to steps along columns and rows.
    cells_from_native: DMat2,
}

impl HeightField {
    /// `heights` row by row; those that are not finite or beyond 100 km are missing, and stand at the nearest height
    /// that is there, counted in steps along rows and columns.
    pub fn new(columns: u32, rows: u32, mut heights: Vec<f32>, frame: Frame) -> Result<HeightField, HeightFieldError> {
        let samples = u64::from(columns) * u64::from(rows);
        if columns < 2 || rows < 2 || samples > MAX_SAMPLES {
            return Err(HeightFieldError::Size { columns, rows });
        }
        if heights.len() as u64 != samples {
            return Err(HeightFieldError::Count { found: heights.len(), expected: samples as usize });
        }
        let native_from_cells = DMat2::from_cols(frame.column, frame.row);
        let cells_from_native = native_from_cells.inverse();
        if !(frame.origin.is_finite() && native_from_cells.is_finite() && cells_from_native.is_finite()) {
            let Frame { origin, column, row, .. } = frame;
            return Err(HeightFieldError::Frame { origin, column, row });
        }
        let missing = fill(columns as usize, &mut heights)?;
        let field = HeightField { columns, rows, heights, missing, frame, cells_from_native };
        // The extremes of a projection over a region lie on its edge.
        for (i, j) in field.edge([0, 0, columns - 1, rows - 1]) {
            field.project(i, j)?;
        }
        Ok(field)
    }

    /// Samples in a row.
    pub fn columns(&self) -> u32 {
        self.columns
    }

    /// Rows.
    pub fn rows(&self) -> u32 {
        self.rows
    }

    /// Samples that had no height.
    pub fn missing(&self) -> usize {
        self.missing.iter().filter(|missing| **missing).count()
    }

    /// Where the samples lie.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The height of a sample of the grid, metres.
    pub fn at(&self, column: u32, row: u32) -> f32 {
        self.heights[row as usize * self.columns as usize + column as usize]
    }

    /// True if the sample had a height.
    pub(crate) fn is_there(&self, column: u32, row: u32) -> bool {
        let at = row as usize * self.columns as usize + column as usize;
        self.missing.get(at).is_none_or(|missing| !missing)
    }

    /// The place of a sample in world space, its height 0.
    fn project(&self, column: u32, row: u32) -> Result<DVec2, HeightFieldError> {
        let Frame { origin, column: by_column, row: by_row, projection } = &self.frame;
        let native = *origin + f64::from(column) * *by_column + f64::from(row) * *by_row;
        let Some(projection) = projection else { return Ok(native) };
        let fault = |fault: String| HeightFieldError::Projection { longitude: native.x, latitude: native.y, fault };
        if native.x.abs() > 540.0 || native.y.abs() > 90.0 {
            return Err(fault("outside the globe".to_owned()));
        }
        let longitude = (native.x + 180.0).rem_euclid(360.0) - 180.0;
        let at = projection
            .forward(Geodetic::from_degrees(native.y, longitude, 0.0))
            .map_err(|error| fault(error.to_string()))?;
        if at.is_finite() { Ok(at.truncate()) } else { Err(fault("projected beyond every number".to_owned())) }
    }

    /// Samples on the edge of the columns and rows from..=to.
    fn edge(&self, [x0, y0, x1, y1]: [u32; 4]) -> impl Iterator<Item = (u32, u32)> {
        let across = (x0..=x1).flat_map(move |x| [(x, y0), (x, y1)]);
        across.chain((y0..=y1).flat_map(move |y| [(x0, y), (x1, y)]))
    }

    /// Least and greatest corner of the columns and rows from..=to on the plane of world space.
    pub(crate) fn footprint(&self, [x0, y0, x1, y1]: [u32; 4]) -> Result<(DVec2, DVec2), HeightFieldError> {
        let (mut min, mut max) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let mut include = |at: DVec2| (min, max) = (min.min(at), max.max(at));
        if self.frame.projection.is_none() {
            for (x, y) in [(x0, y0), (x1, y0), (x0, y1), (x1, y1)] {
                include(self.project(x, y)?);
            }
        } else {
            for (x, y) in self.edge([x0, y0, x1, y1]) {
                include(self.project(x, y)?);
            }
        }
        Ok((min, max))
    }

    /// The height at a place between samples, counted in columns and rows and clamped to the grid.
    pub(crate) fn between(&self, at: DVec2) -> f64 {
        let last = DVec2::new(f64::from(self.columns - 1), f64::from(self.rows - 1));
        let at = at.clamp(DVec2::ZERO, last);
        let cell = at.floor().min(last - 1.0);
        let (x, y) = (cell.x as u32, cell.y as u32);
        let corner = |dx: u32, dy: u32| f64::from(self.at(x + dx, y + dy));
        on_cell([corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)], at - cell)
    }
}

/// The height at `at` ∈ [0, 1]² of a cell with the corners (0,0), (1,0), (0,1) and (1,1): linear on the two triangles
/// that meet on the diagonal x = y.
pub(crate) fn on_cell([h00, h10, h01, h11]: [f64; 4], at: DVec2) -> f64 {
    if at.x >= at.y {
        h00 + at.x * (h10 - h00) + at.y * (h11 - h10)
    } else {
        h00 + at.y * (h01 - h00) + at.x * (h11 - h01)
    }
}

impl Surface for HeightField {
    /// Beyond the grid: the height of its nearest edge.
    fn height(&self, at: DVec2) -> f64 {
        let native = match &self.frame.projection {
            None => at,
            Some(projection) => match projection.inverse(DVec3::new(at.x, at.y, 0.0)) {
                Ok(place) => {
                    let mut native = DVec2::new(place.longitude.to_degrees(), place.latitude.to_degrees());
                    // Grids may count longitudes from 0 to 360.
                    let turns = ((self.frame.origin.x - native.x) / 360.0).round();
                    native.x += 360.0 * turns;
                    native
                }
                Err(_) => self.frame.origin,
            },
        };
        let at = self.cells_from_native * (native - self.frame.origin);
        self.between(if at.is_finite() { at } else { DVec2::ZERO })
    }
}

/// Gives every sample without a height that of the nearest one; returns which they were, or nothing if there are none.
fn fill(columns: usize, heights: &mut [f32]) -> Result<Vec<bool>, HeightFieldError> {
    let is_missing = |height: &f32| height.is_nan() || height.abs() > HIGHEST;
    let absent = heights.iter().filter(|height| is_missing(height)).count();
    if absent == 0 {
        return Ok(Vec::new());
    }
    if absent == heights.len() {
        return Err(HeightFieldError::NoHeight);
    }
    let missing: Vec<bool> = heights.iter().map(is_missing).collect();
    let mut waiting: VecDeque<usize> = (0..heights.len()).filter(|&at| !missing[at]).collect();
    let mut filled: Vec<bool> = missing.iter().map(|missing| !missing).collect();
    while let Some(at) = waiting.pop_front() {
        let column = at % columns;
        let left = (column > 0).then(|| at - 1);
        let right = (column + 1 < columns).then_some(at + 1);
        let neighbours = [left, right, at.checked_sub(columns), Some(at + columns).filter(|&at| at < heights.len())];
        for next in neighbours.into_iter().flatten() {
            if !std::mem::replace(&mut filled[next], true) {
                heights[next] = heights[at];
                waiting.push_back(next);
            }
        }
    }
    Ok(missing)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn metres() -> Frame {
        Frame {
            origin: DVec2::new(100.0, 200.0),
            column: DVec2::new(10.0, 0.0),
            row: DVec2::new(0.0, -5.0),
            projection: None,
        }
    }

    #[test]
    fn heights_between_samples() {
        let field = HeightField::new(2, 2, vec![0.0, 1.0, 2.0, 7.0], metres()).unwrap();
        let height = |x: f64, y: f64| field.height(DVec2::new(x, y));
        assert_eq!(height(100.0, 200.0), 0.0);
        assert_eq!(height(110.0, 200.0), 1.0);
        assert_eq!(height(100.0, 195.0), 2.0);
        assert_eq!(height(105.0, 197.5), 3.5);
        assert_eq!(height(107.5, 198.75), 0.75 + 0.25 * 6.0);
        assert_eq!(height(1e9, -1e9), 7.0);
    }

    #[test]
    fn the_nearest_height_stands_in_for_a_missing_one() {
        let heights = vec![5.0, f32::NAN, f32::INFINITY, -32768.0e9, 8.0, f32::NAN];
        let field = HeightField::new(3, 2, heights, metres()).unwrap();
        assert_eq!((field.missing(), field.at(0, 1), field.at(2, 1)), (4, 5.0, 8.0));
        assert!(field.is_there(1, 1) && !field.is_there(2, 0));
        assert_eq!(HeightField::new(2, 2, vec![f32::NAN; 4], metres()).unwrap_err(), HeightFieldError::NoHeight);
    }

    #[test]
    fn a_grid_in_degrees_is_found_again() {
        let frame = Frame {
            origin: DVec2::new(8.0, 47.5),
            column: DVec2::new(0.01, 0.0),
            row: DVec2::new(0.0, -0.01),
            projection: Some(Projection::from_epsg(32632).unwrap()),
        };
        let heights = (0..121).map(|at| at as f32).collect();
        let field = HeightField::new(11, 11, heights, frame).unwrap();
        for (x, y) in [(0, 0), (3, 7), (10, 10)] {
            let at = field.project(x, y).unwrap();
            assert!((field.height(at) - f64::from(field.at(x, y))).abs() < 1e-4, "{x} {y}");
        }
    }

    #[test]
    fn refuses_what_spans_nothing() {
        let flat = Frame { row: DVec2::new(20.0, 0.0), ..metres() };
        assert!(matches!(HeightField::new(2, 2, vec![0.0; 4], flat), Err(HeightFieldError::Frame { .. })));
        assert!(matches!(HeightField::new(1, 2, vec![0.0; 2], metres()), Err(HeightFieldError::Size { .. })));
        assert!(matches!(HeightField::new(u32::MAX, 2, vec![0.0; 2], metres()), Err(HeightFieldError::Size { .. })));
        assert!(matches!(HeightField::new(2, 2, vec![0.0; 3], metres()), Err(HeightFieldError::Count { .. })));
    }
}
