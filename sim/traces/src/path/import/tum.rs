//! TUM lines: `t x y z qx qy qz qw`, seconds and metres; `#` begins a comment, further columns are ignored.

use crate::path::axes::{Axis, CameraAxes, Convention, QuatOrder};
use crate::path::parse::Options;
use crate::path::{CameraPath, PathError};
use crate::text_lines::TextLines;

use super::recording::Recording;

/// Reads TUM lines. `bytes` are those of the lines, for the header in their comments.
pub(super) fn read(name: &str, bytes: &[u8], lines: TextLines<'_>, options: &Options) -> Result<CameraPath, PathError> {
    let mut recording = Recording::new(name);
    recording.claimed = claimed_order(bytes);
    let mut longer = 0usize;
    for (number, line) in lines {
        let mut numbers = [0.0; 8];
        let mut fields = line.split_ascii_whitespace();
        for (i, slot) in numbers.iter_mut().enumerate() {
            let parsed = fields.next().map(str::parse::<f64>);
            *slot = match parsed {
                Some(Ok(value)) => value,
                _ if recording.poses.is_empty() => {
                    let found = line.chars().take(40).collect();
                    return Err(PathError::Unsupported { name: recording.name.to_owned(), line: number, found });
                }
                Some(Err(_)) => {
                    let message = format!("column {} is no number; expected `t x y z qx qy qz qw`", i + 1);
                    return Err(recording.line_error(number, message));
                }
                None => {
                    let message = format!("{i} columns; expected the 8 of `t x y z qx qy qz qw`");
                    return Err(recording.line_error(number, message));
                }
            };
        }
        longer += usize::from(fields.next().is_some());
        let [seconds, rest @ ..] = numbers;
        recording.push(number, seconds, rest)?;
    }
    if recording.is_untouched() {
        let message = "is empty; expected poses over time".to_owned();
        return Err(PathError::Whole { name: name.to_owned(), message });
    }
    let axes = CameraAxes { forward: Axis::Z, up: Axis::MINUS_Y };
    let note = (longer > 0).then(|| format!("{longer} lines with more than 8 columns: the others ignored"));
    recording.finish(Convention { order: QuatOrder::Xyzw, axes, up: Axis::Z }, Vec::from_iter(note), options)
}

/// The order that the comments before the first line of data name.
fn claimed_order(bytes: &[u8]) -> Option<QuatOrder> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let comments = bytes.split(|&b| b == b'\n').map(<[u8]>::trim_ascii).take_while(|line| line.first() == Some(&b'#'));
    comments.take(100).find_map(|line| {
        let words: Vec<String> =
            String::from_utf8_lossy(line).split_ascii_whitespace().map(str::to_ascii_lowercase).collect();
        let named = |names: [&str; 4]| words.windows(4).any(|four| four == names);
        match () {
            () if named(["qx", "qy", "qz", "qw"]) => Some(QuatOrder::Xyzw),
            () if named(["qw", "qx", "qy", "qz"]) => Some(QuatOrder::Wxyz),
            () => None,
        }
    })
}
