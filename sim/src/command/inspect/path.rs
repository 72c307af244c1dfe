//! What a path contains.

use foresight_sim::path::CameraPath;
use std::io::Write;

pub(super) fn describe(out: &mut impl Write, file: &str, path: &CameraPath) -> std::io::Result<()> {
    let poses = path.poses();
    let mut length = 0.0;
    let (mut low, mut high) = (poses[0].position, poses[0].position);
    for pair in poses.windows(2) {
        length += pair[0].position.distance(pair[1].position);
        low = low.min(pair[1].position);
        high = high.max(pair[1].position);
    }
    let duration = path.duration();
    writeln!(out, "{file}: path")?;
    writeln!(
        out,
        "  {} poses over {duration:.2} s ({:.1} Hz); {length:.1} m long, {:.2} m/s on average",
        poses.len(),
        (poses.len() - 1) as f64 / duration,
        length / duration
    )?;
    writeln!(out, "  extent {:.2} m, up {:.3}", high - low, path.up())?;
    for note in path.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}
