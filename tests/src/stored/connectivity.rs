//! Connectivity on made cases, drawn like any cell: a wall, foliage, a sphere, a step.

use foresight_index::octree::Octree;
use foresight_index::orthoview::connectivity::{Links, Thresholds, links};
use foresight_index::orthoview::direction::nine;
use foresight_index::orthoview::raster::{Drawn, Plain, Surface, Triangle, leaf};
use foresight_index::orthoview::{Lattice, Orthoview};
use foresight_scheduler::lod_tree::Aabb;
use foresight_traces::random::SplitMix64;
use glam::DVec3;
use serde_json::json;

use super::table::Table;
use super::{Fault, Findings, picture};

/// Side of the cell that the cases stand in, metres.
const SIDE: f64 = 16.0;
/// Its pixels along a side.
const PIXELS: f64 = 128.0;

/// A case with the shares of its pixels that are to be connected.
pub struct Case {
    /// Its name.
    pub name: &'static str,
    /// Least and largest.
    pub expected: [f64; 2],
    /// Whether borders between heights are to be parted.
    triangles: Vec<Triangle>,
}

/// The four.
pub fn cases() -> Vec<Case> {
    vec![
        // Seen at 60° from its normal.
        Case { name: "wall", expected: [0.95, 1.0], triangles: wall() },
        Case { name: "foliage", expected: [0.0, 0.35], triangles: foliage() },
        Case { name: "sphere", expected: [0.6, 0.98], triangles: sphere() },
        Case { name: "step", expected: [0.95, 1.0], triangles: step() },
    ]
}

fn triangle(corners: [DVec3; 3]) -> Triangle {
    Triangle { corners, two_sided: true, ..Triangle::default() }
}

fn quad(at: DVec3, right: DVec3, up: DVec3) -> [Triangle; 2] {
    [triangle([at, at + right, at + right + up]), triangle([at, at + right + up, at + up])]
}

fn wall() -> Vec<Triangle> {
    let rise = DVec3::new(0.45 * SIDE, 0.0, 0.45 * SIDE * 3f64.sqrt());
    quad(DVec3::new(0.2 * SIDE, 0.1 * SIDE, 0.1 * SIDE), DVec3::Y * (0.8 * SIDE), rise).to_vec()
}

/// Leaves of 0.3 m, anywhere and turned anyhow.
fn foliage() -> Vec<Triangle> {
    let mut random = SplitMix64::new(6);
    let mut within = |low: f64, high: f64| low + (high - low) * random.uniform();
    (0..4000)
        .map(|_| {
            let mut point = |low: f64, high: f64| DVec3::new(within(low, high), within(low, high), within(low, high));
            let at = point(0.15 * SIDE, 0.85 * SIDE);
            triangle([at + point(-0.3, 0.3), at + point(-0.3, 0.3), at + point(-0.3, 0.3)])
        })
        .collect()
}

fn sphere() -> Vec<Triangle> {
    let (rings, parts) = (96, 192);
    let at = |ring: usize, part: usize| {
        let (theta, phi) = (
            core::f64::consts::PI * ring as f64 / rings as f64,
            core::f64::consts::TAU * (part % parts) as f64 / parts as f64,
        );
        let (sine, cosine) = (libm::sin(theta), libm::cos(theta));
        DVec3::splat(0.5 * SIDE) + 0.45 * SIDE * DVec3::new(sine * libm::cos(phi), sine * libm::sin(phi), cosine)
    };
    (0..rings)
        .flat_map(|ring| (0..parts).map(move |part| (ring, part)))
        .flat_map(|(ring, part)| {
            let [a, b, c, d] = [at(ring, part), at(ring + 1, part), at(ring + 1, part + 1), at(ring, part + 1)];
            [triangle([a, b, c]), triangle([a, c, d])]
        })
        .collect()
}

/// A floor 3 m up beside one 11 m up.
fn step() -> Vec<Triangle> {
    let half = |x: f64, z: f64| quad(DVec3::new(x, 0.0, z), DVec3::X * (0.5 * SIDE), DVec3::Y * SIDE);
    [half(0.0, 3.0), half(0.5 * SIDE, 11.0)].concat()
}

/// The image of a case from above, with its links.
///
/// # Errors
/// A case that shows nothing.
pub fn drawn(case: &Case) -> Result<(Orthoview, Vec<Links>), Fault> {
    let bounds = Aabb { min: DVec3::ZERO, max: DVec3::splat(SIDE) };
    let octree = Octree::over(bounds, SIDE).map_err(|e| Fault::new(case.name, e))?;
    let lattice = Lattice { direction: nine()[0], origin: octree.origin(), pitch: SIDE / PIXELS };
    let white = Plain([0.8; 3]);
    let meshes = [(&case.triangles[..], &white as &dyn Surface)];
    let view = leaf(&octree, octree.root(), &lattice, meshes, &mut Drawn::default());
    let view = view.ok_or_else(|| Fault::new(case.name, "nothing to be seen"))?;
    let links = links(&view, &lattice, &Thresholds::default());
    Ok((view, links))
}

/// Share of a case's pixels that are connected.
pub fn share(view: &Orthoview, links: &[Links]) -> f64 {
    let shown = view.pixels.iter().filter(|p| p.is_some()).count();
    links.iter().filter(|l| l.is_connected()).count() as f64 / shown.max(1) as f64
}

/// Links between pixels whose depths are more than `apart` metres apart.
pub fn bridges(view: &Orthoview, links: &[Links], apart: f32) -> usize {
    const FORWARD: [(i64, i64); 4] = [(1, 0), (0, 1), (-1, 1), (1, 1)];
    let mut count = 0;
    for (index, link) in links.iter().enumerate() {
        for (joined, (x, y)) in link.forward().into_iter().zip(FORWARD) {
            let there = view.get(view.rect.at(index) + glam::I64Vec2::new(x, y));
            count += usize::from(joined && (there.depth - view.pixels[index].depth).abs() > apart);
        }
    }
    count
}

/// The table and the pictures.
///
/// # Errors
/// As [`drawn`].
pub fn findings() -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    let title = format!("Connectivity of made cases, from above, {PIXELS} pixels over {SIDE} m");
    let mut table =
        Table::new(title, &["case", "pixels", "connected, %", "expected, %", "links across 2 m", "as expected"]);
    for case in cases() {
        let (view, links) = drawn(&case)?;
        let (share, bridges) = (share(&view, &links), bridges(&view, &links, 2.0));
        let [least, most] = case.expected;
        table.row([
            json!(case.name),
            json!(view.pixels.iter().filter(|p| p.is_some()).count()),
            json!(100.0 * share),
            json!(format!("{:.0} to {:.0}", 100.0 * least, 100.0 * most)),
            json!(bridges),
            json!(if (least..=most).contains(&share) && bridges == 0 { "yes" } else { "no" }),
        ]);
        findings.pictures.push((format!("connectivity-{}.png", case.name), picture::connected(&view, &links)));
    }
    findings.tables.push(table);
    Ok(findings)
}
