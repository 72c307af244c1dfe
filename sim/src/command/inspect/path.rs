//! What a path contains.

use foresight_traces::path::{CameraPath, PathFacts};
use std::io::Write;

pub(super) fn describe(out: &mut impl Write, file: &str, path: &CameraPath) -> std::io::Result<()> {
    writeln!(out, "{file}: path")?;
    let facts = PathFacts::new(path);
    for line in facts.lines() {
        writeln!(out, "  {line}")?;
    }
    writeln!(out, "  extent {:.2} m, up {:.3}", facts.extent, path.up())?;
    for note in path.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}
