//! EyeNavGS tables: a header, two rows a frame, of which those of view 0 are taken; milliseconds, y up.

use crate::path::axes::{Axis, CameraAxes, Convention, QuatOrder};
use crate::path::parse::Options;
use crate::path::{CameraPath, PathError};
use crate::text_lines::TextLines;

use super::recording::Recording;

/// Tangents of a field of view whose two sides differ by more than this share are called asymmetric.
const ASYMMETRIC: f64 = 0.05;

/// Where the columns of an EyeNavGS table are.
struct EyeNavColumns {
    view: usize,
    /// Left, right, down and up edge of the field of view, radians.
    fov: Option<[usize; 4]>,
    milliseconds: usize,
    /// Position and quaternion.
    pose: [usize; 7],
}

impl EyeNavColumns {
    /// `None` if this is no header of such a table; an error names the column that it lacks.
    fn find(header: &str) -> Option<Result<EyeNavColumns, &'static str>> {
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        let column = |name: &'static str| names.iter().position(|n| n.eq_ignore_ascii_case(name)).ok_or(name);
        let view = column("ViewIndex").ok()?;
        let pose = ["PositionX", "PositionY", "PositionZ", "QuaternionX", "QuaternionY", "QuaternionZ", "QuaternionW"];
        let find = || {
            let mut columns = [0; 7];
            for (slot, name) in columns.iter_mut().zip(pose) {
                *slot = column(name)?;
            }
            let mut fov = [0; 4];
            let has_fov = fov.iter_mut().zip(["FOV1", "FOV2", "FOV3", "FOV4"]).all(|(slot, name)| {
                column(name).is_ok_and(|index| {
                    *slot = index;
                    true
                })
            });
            let milliseconds = column("timestep").or_else(|_| column("Timestamp"))?;
            Ok(EyeNavColumns { view, fov: has_fov.then_some(fov), milliseconds, pose: columns })
        };
        Some(find())
    }
}

/// Reads a table.
pub(super) fn read(name: &str, mut lines: TextLines<'_>, options: &Options) -> Result<CameraPath, PathError> {
    let mut recording = Recording::new(name);
    let Some((header_line, header)) = lines.next() else {
        return Err(recording.line_error(1, "no header; expected one with ViewIndex, PositionX, …".to_owned()));
    };
    let columns = match EyeNavColumns::find(&header) {
        Some(Ok(columns)) => columns,
        missing => {
            let missing = missing.and_then(Result::err).unwrap_or("ViewIndex");
            return Err(recording.line_error(header_line, format!("a header without {missing}; expected that column")));
        }
    };
    let (mut fov, mut other_views) = (None, 0usize);
    for (number, line) in lines {
        let fields: Vec<&str> = line.split(',').map(str::trim).collect();
        let value = |column: usize| {
            let field = fields.get(column).ok_or_else(|| {
                recording.line_error(number, format!("{} columns; expected a column {}", fields.len(), column + 1))
            })?;
            field
                .parse::<f64>()
                .map_err(|_| recording.line_error(number, format!("column {} is no number; expected one", column + 1)))
        };
        if value(columns.view)? != 0.0 {
            other_views += 1;
            continue;
        }
        let seconds = value(columns.milliseconds)? * 1e-3;
        let mut numbers = [0.0; 7];
        for (slot, &column) in numbers.iter_mut().zip(&columns.pose) {
            *slot = value(column)?;
        }
        if fov.is_none() {
            fov = columns.fov.map(|columns| columns.map(|column| value(column).unwrap_or(f64::NAN)));
        }
        recording.push(number, seconds, numbers)?;
    }
    let mut notes = vec![
        "mind: positions are in units of the scene, metres times an initial scale that the file does not state"
            .to_owned(),
    ];
    if other_views > 0 {
        notes.push(format!("{other_views} rows of another eye left out: ViewIndex 0 is taken"));
    }
    notes.extend(fov.and_then(fov_note));
    let axes = CameraAxes { forward: Axis::MINUS_Z, up: Axis::Y };
    recording.finish(Convention { order: QuatOrder::Xyzw, axes, up: Axis::Y }, notes, options)
}

/// Is this the header of such a table?
pub(super) fn is_header(line: &str) -> bool {
    EyeNavColumns::find(line).is_some()
}

/// A note on a field of view that is not symmetric.
fn fov_note(edges: [f64; 4]) -> Option<String> {
    let [left, right, down, up] = edges.map(libm::tan);
    let is_off = |a: f64, b: f64| (a + b).abs() > ASYMMETRIC * (b - a).abs();
    (is_off(left, right) || is_off(down, up)).then(|| {
        let [left, right, down, up] = edges.map(f64::to_degrees);
        format!(
            "mind: the recorded field of view is asymmetric ({left:.0}° to {right:.0}° across, {down:.0}° to {up:.0}° \
             upwards); the replay's is symmetric"
        )
    })
}
