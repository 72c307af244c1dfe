//! What geometry of leaves takes and how far off it is: levels of detail by number, packings side by side, the
//! simplifier's own account of its error against the measured one, and triangles a second.

use std::sync::Arc;

use foresight_index::format::glb_compressed::Packing;
use foresight_index::geometry::{GeometryLevel, GeometrySettings, levels};
use foresight_index::octree::Cell;
use foresight_index::orthoview::texture::Materials;
use foresight_index::surface::Surfaces;
use foresight_index::surface::spool::{Spool, SpoolSettings};
use foresight_sim::stopwatch::Stopwatch;
use serde_json::json;

use super::table::Table;
use super::{Fault, Findings};

/// Sums over the leaves' levels of one number.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    leaves: u64,
    triangles: u64,
    bytes: u64,
    decoded: u64,
    error: f64,
    largest: f64,
}

impl Sum {
    fn add(&mut self, level: &GeometryLevel) {
        self.leaves += 1;
        self.triangles += level.triangles;
        self.bytes += level.glb.len() as u64;
        self.decoded += level.decoded_bytes;
        self.error += f64::from(level.error);
        self.largest = self.largest.max(f64::from(level.error));
    }
}

/// Measures the world's leaves of side `side`, metres; at most `most` of them, evenly spread.
///
/// # Errors
/// A world that cannot be read, or geometry that cannot be made of it.
pub fn measure(world: &str, side: f64, most: usize) -> Result<Findings, Fault> {
    let fault = |e: &dyn std::fmt::Display| Fault::new(world, e);
    let source = foresight_index::surface::open(world, &(Arc::new(|_, _| {}) as _)).map_err(|e| fault(&e))?;
    let folder = tempfile::tempdir().map_err(|e| fault(&e))?;
    let settings = SpoolSettings { leaf_side: side, ..SpoolSettings::default() };
    let spool = Spool::fill(&*source, &folder.path().join("spool"), &settings, &|_, _| {}).map_err(|e| fault(&e))?;
    let places: Vec<[u64; 3]> = spool.leaves().collect();
    let stride = places.len().div_ceil(most.max(1)).max(1);
    let mut by_level: Vec<Sum> = Vec::new();
    let packings = [Packing::Floats, Packing::Quantised, Packing::Compressed];
    let mut packed = [(Sum::default(), Sum::default()); 3];
    let mut ratios: Vec<f64> = Vec::new();
    let mut widest = 0.0_f64;
    let (mut nanos, mut triangles) = (0_u64, 0_u64);
    let plain = Materials::default();
    for &place in places.iter().step_by(stride) {
        let Surfaces { triangles: content, materials, .. } = spool.leaf(place).map_err(|e| fault(&e))?;
        let make = |materials: &Materials, settings: &GeometrySettings| {
            levels(&[(&content, materials)], spool.octree(), Cell { level: 0, place }, settings).map_err(|e| fault(&e))
        };
        let clock = Stopwatch::start();
        let made = make(&materials, &GeometrySettings::default())?;
        nanos += clock.nanos();
        triangles += made.first().map_or(0, |level| level.triangles);
        by_level.resize(by_level.len().max(made.len()), Sum::default());
        for (sum, level) in by_level.iter_mut().zip(&made) {
            sum.add(level);
            let measured = level.measured;
            if level.claimed > 0.0 {
                ratios.push(measured.upper / level.claimed);
                widest = widest.max(measured.upper / measured.lower.max(1e-12));
            }
        }
        for (packing, (textured, bare)) in packings.into_iter().zip(&mut packed) {
            let settings = GeometrySettings { packing, coarsest: 0.0, ..GeometrySettings::default() };
            make(&materials, &settings)?.iter().for_each(|level| textured.add(level));
            make(&plain, &settings)?.iter().for_each(|level| bare.add(level));
        }
    }
    let seconds = nanos as f64 * 1e-9;
    let each = |bytes: u64, of: u64| if of > 0 { json!(bytes as f64 / of as f64) } else { json!(null) };

    let columns =
        ["level", "leaves", "triangles", "bytes", "bytes/triangle", "decoded bytes", "mean error m", "largest error m"];
    let mut sizes = Table::new(format!("{world}: levels of leaves of {side} m, the finest first"), &columns);
    for (number, sum) in by_level.iter().enumerate() {
        sizes.row([
            json!(number),
            json!(sum.leaves),
            json!(sum.triangles),
            json!(sum.bytes),
            each(sum.bytes, sum.triangles),
            json!(sum.decoded),
            json!(sum.error / sum.leaves.max(1) as f64),
            json!(sum.largest),
        ]);
    }
    let columns =
        ["packing", "bytes", "bytes/triangle", "bytes untextured", "bytes/triangle untextured", "decoded bytes"];
    let mut kinds = Table::new("the finest level by packing", &columns);
    for (packing, (textured, bare)) in packings.into_iter().zip(packed) {
        kinds.row([
            json!(format!("{packing:?}")),
            json!(textured.bytes),
            each(textured.bytes, textured.triangles),
            json!(bare.bytes),
            each(bare.bytes, bare.triangles),
            json!(textured.decoded),
        ]);
    }
    let mut findings = Findings { tables: vec![sizes, kinds], ..Findings::default() };
    ratios.sort_by(f64::total_cmp);
    if !ratios.is_empty() {
        let at = |share: f64| ratios[((ratios.len() - 1) as f64 * share).round() as usize];
        let columns = ["levels", "least", "5 %", "median", "95 %", "most", "measured above claimed", "widest bracket"];
        let mut claims = Table::new("the measured error as a multiple of what the simplifier claims", &columns);
        let above = ratios.iter().filter(|r| **r > 1.0).count() as f64 / ratios.len() as f64;
        let quantiles = [0.0, 0.05, 0.5, 0.95, 1.0].map(|share| json!(at(share)));
        claims.row(std::iter::once(json!(ratios.len())).chain(quantiles).chain([json!(above), json!(widest)]));
        findings.tables.push(claims);
    }
    let rate = triangles as f64 / seconds.max(1e-9);
    findings
        .remarks
        .push(format!("{triangles} triangles in {seconds:.2} s on one core: {rate:.0} a second, all levels"));
    Ok(findings)
}
