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

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_index::surface::open;

    #[test]
    fn a_mesh_with_its_traps() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.obj");
        // A wall that stands on z: a floor in a file whose y points up.
        let floor =
            "v 0 0 0\nv 8 0 0\nv 0 0 8\nv 8 0 8\nv nan 0 0\nf 1 3 2\nf 2 3 4\nf 1 2 5\nf 1 1 2\nusemtl absent\n";
        std::fs::write(&file, floor).expect("written");
        let described = |input: &str| {
            let progress: foresight_index::specification::Progress = std::sync::Arc::new(|_, _| {});
            let mut out = Vec::new();
            describe(&mut out, input, &*open(input, &progress).expect("a mesh")).expect("described");
            String::from_utf8(out).expect("UTF-8")
        };
        let plain = file.to_str().expect("UTF-8");
        let text = described(plain);
        for part in [
            "2 triangles in 1 pieces, 64.00 m²",
            "extent 8.00 × 0.00 × 8.00 m",
            "perhaps y points up; then add ,up=y",
            "repaired: 1 triangles with a corner that is no number",
            "repaired: 1 triangles without area",
            "missing: the material \"absent\", which no library has",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let turned = described(&format!("{plain},up=y"));
        // Seen from both sides, half of it looks each way.
        assert!(turned.contains("50 % look up, 50 % down") && !turned.contains("mind"), "{turned}");
    }
}
