//! What share of the geometry the orthoviews take.

use std::collections::BTreeMap;

use foresight_index::format::orthoview::{ColourCodec, Encoding, encode};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::{Direction, Orthoview};
use rayon::prelude::*;
use serde_json::json;

use super::scene::Scene;
use super::table::Table;
use super::{Fault, Findings};

/// Bytes of a scene's orthoviews.
#[derive(Clone, Debug, Default)]
pub struct Stored {
    /// As they are kept by default.
    pub bytes: u64,
    /// Without normals.
    pub without_normals: u64,
    /// Colours as JPEG 50, as \[DRVW\] keeps them, and no normals.
    pub drvw: u64,
    /// Images and bytes, by level.
    pub levels: BTreeMap<u32, (u64, u64)>,
}

/// Makes and encodes all orthoviews.
///
/// # Errors
/// A content that cannot be read, an image that cannot be encoded.
pub fn stored(scene: &Scene) -> Result<Stored, Fault> {
    let mut stored = Stored::default();
    scene.orthoviews(&scene.directions, |cell, images: &[(Direction, &Orthoview)]| {
        let sizes: Vec<[u64; 3]> = images
            .par_iter()
            .map(|(direction, view)| {
                let links = links(view, &scene.lattice(*direction), &Thresholds::default());
                let size = |encoding| {
                    let file = encode(view, &links, *direction, encoding).map_err(|e| Fault::new(&scene.name, e))?;
                    Ok(file.map_or(0, |f| f.len() as u64))
                };
                let whole = Encoding::default();
                let drvw = Encoding { colour: ColourCodec::Jpeg(50), normals: false };
                Ok([size(whole)?, size(Encoding { normals: false, ..whole })?, size(drvw)?])
            })
            .collect::<Result<_, Fault>>()?;
        for [whole, without, drvw] in sizes {
            stored.bytes += whole;
            stored.without_normals += without;
            stored.drvw += drvw;
            let level = stored.levels.entry(cell.level).or_default();
            level.0 += 1;
            level.1 += whole;
        }
        Ok(())
    })?;
    Ok(stored)
}

/// The table, beside the papers'.
///
/// # Errors
/// As [`stored`].
pub fn findings(scenes: &[Scene]) -> Result<Findings, Fault> {
    let mut table = Table::new(
        "Orthoviews as a share of the geometry",
        &[
            "world",
            "km²",
            "triangles, M",
            "geometry, MB",
            "orthoviews, MB",
            "share, %",
            "without normals, %",
            "JPEG 50, no normals, %",
        ],
    );
    for scene in scenes {
        let stored = stored(scene)?;
        let share = |bytes: u64| 100.0 * bytes as f64 / scene.finest_bytes.max(1) as f64;
        table.row([
            json!(format!(
                "{}, {} px of {:.3} m",
                scene.name,
                (scene.octree.leaf_side() / scene.pitch).round(),
                scene.pitch
            )),
            json!(scene.area() / 1e6),
            json!(scene.triangles as f64 / 1e6),
            json!(scene.finest_bytes as f64 / 1e6),
            json!(stored.bytes as f64 / 1e6),
            json!(share(stored.bytes)),
            json!(share(stored.without_normals)),
            json!(share(stored.drvw)),
        ]);
    }
    let papers: [(&str, f64, Option<f64>, f64, f64); 4] = [
        ("[HIBR] landscape", 10_000.0, Some(25e3), 944e3, 412e3),
        ("[HIBR] models in space", f64::NAN, Some(2839.0), 79.5e3, 1.9e3),
        ("[DRVW] scene 1", 163.84, Some(614.4), 294e3, 1.5e3),
        ("[DRVW] scene 2", 2621.44, Some(9800.0), 1e6, 22e3),
    ];
    for (name, area, triangles, geometry, orthoviews) in papers {
        table.row([
            json!(name),
            json!(area.is_finite().then_some(area)),
            json!(triangles),
            json!(geometry),
            json!(orthoviews),
            json!(100.0 * orthoviews / geometry),
            json!(null),
            json!(null),
        ]);
    }
    Ok(Findings { tables: vec![table], ..Findings::default() })
}
