//! What a mesh contains, and what of it cannot be drawn.

use super::megabytes;
use foresight_index::surface::SurfaceSource;
use foresight_index::surface::spool::{Statistics, inspect};
use std::io::Write;

/// A world whose size is in millimetres by mistake is a thousand times as large as this.
const LARGE: f64 = 1e5;
/// One that is smaller than this may be in kilometres.
const SMALL: f64 = 0.5;

pub(super) fn describe(out: &mut impl Write, file: &str, source: &dyn SurfaceSource) -> anyhow::Result<()> {
    let found = inspect(source, &|_, _| {})?;
    let Statistics { triangles, bounds, area, repairs, image_bytes, .. } = found;
    let size = bounds.max - bounds.min;
    writeln!(out, "{file}: mesh")?;
    writeln!(
        out,
        "  {triangles} triangles in {} pieces, {area:.2} m²; {:.2} MB of images",
        source.pieces(),
        megabytes(image_bytes)
    )?;
    writeln!(out, "  extent {:.2} × {:.2} × {:.2} m, from {:.2}, up z", size.x, size.y, size.z, bounds.min)?;
    let facing = |least: f64, sign: f64| {
        let looks = found.orientations.iter().filter(|(normal, _)| sign * normal.z > least);
        100.0 * looks.map(|(_, area)| area).sum::<f64>() / area.max(f64::MIN_POSITIVE)
    };
    let (up, down) = (facing(0.5, 1.0), facing(0.5, -1.0));
    writeln!(out, "  of its area {up:.0} % look up, {down:.0} % down, {:.0} % sideways", 100.0 - up - down)?;
    let sideways = |axis: usize| {
        let looks = found.orientations.iter().filter(|(normal, _)| normal[axis].abs() > 0.9);
        looks.map(|(_, area)| area).sum::<f64>() / area.max(f64::MIN_POSITIVE)
    };
    if up < 10.0 && down < 10.0 && sideways(1) > 0.3 && sideways(0) < 0.1 {
        writeln!(
            out,
            "  mind: hardly anything looks up and much along y: perhaps y points up; then add ,up=y to its name"
        )?;
    }
    if size.max_element() > LARGE || size.max_element() < SMALL {
        writeln!(out, "  mind: coordinates are taken as metres")?;
    }
    for (count, what) in [
        (repairs.not_finite, "triangles with a corner that is no number or names no vertex: left out"),
        (repairs.degenerate, "triangles without area: left out"),
        (repairs.non_manifold_edges, "edges of more than two triangles: kept"),
    ] {
        if count > 0 {
            writeln!(out, "  repaired: {count} {what}")?;
        }
    }
    for text in &found.left_out {
        writeln!(out, "  missing: {text}")?;
    }
    Ok(())
}
