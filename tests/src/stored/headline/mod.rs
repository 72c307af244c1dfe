//! The papers' headline: what a moving viewer needs as the world grows, at which speed, in which bursts, and at the start.

pub mod demand;
pub mod required;

use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::Policy;
use foresight_scheduler::policy::lookahead::{Lookahead, LookaheadSettings};
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::replay::{Run, Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, TICKS_PER_SECOND};
use foresight_traces::link::LinkTrace;
use foresight_traces::random::SplitMix64;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use serde_json::json;
use std::collections::BTreeSet;

use self::demand::Demand;
use self::required::{Shown, required};
use super::plot::{Curve, Plot, Scale};
use super::sizes::{Sizes, With};
use super::table::Table;
use super::{Fault, Findings};

/// Screen of the viewer, pixels; \[HIBR\] §7.
const VIEWPORT: [u32; 2] = [640, 480];
/// Horizontal field of view, radians.
const FOV_X: f64 = core::f64::consts::FRAC_PI_3;
/// Height of the eye, metres.
const EYE: f64 = 2.0;
/// A pixel of an orthoview covers at most so many of the screen's.
const TARGET_PX: f64 = 1.0;
/// More memory than any world takes.
const UNLIMITED: u64 = 1 << 50;
/// Seconds at the start of a warm replay that are not counted.
const SETTLING: f64 = 2.0;

/// Speeds of \[DRVW\] Table 1, m/s, and its figures: nearby geometry and depth images, Mbit/s.
const DRVW: [(f64, f64, f64); 6] =
    [(2.0, 7.6, 0.9), (5.0, 19.5, 1.8), (10.0, 39.6, 3.0), (15.0, 59.5, 4.3), (20.0, 79.5, 5.5), (40.0, 159.5, 10.7)];
/// Bytes of \[DRVW\]'s second scene per square metre, and its polygons.
const DRVW_DENSITY: (f64, f64) = (1e12 / (51_200.0 * 51_200.0), 3.85);

/// Who fetches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Viewer {
    /// What is required now.
    Demand,
    /// \[HIBR\] §6.2.
    Lookahead,
}

impl Viewer {
    fn policy<'a>(self, tree: &'a LodTree, view: &View) -> Box<dyn Policy + 'a> {
        match self {
            Viewer::Demand => Box::new(Demand::new(TARGET_PX, view)),
            Viewer::Lookahead => {
                let settings = LookaheadSettings { error_target_px: TARGET_PX, ..LookaheadSettings::default() };
                Box::new(Lookahead::new(tree, settings))
            }
        }
    }
}

/// A straight way.
#[derive(Clone, Copy, Debug)]
pub struct Trip {
    /// Where it begins.
    pub from: DVec3,
    /// Counter-clockwise from +x, radians.
    pub heading: f64,
    /// Metres a second.
    pub speed: f64,
    /// How long.
    pub seconds: f64,
}

impl Trip {
    fn view(&self, at: f64) -> View {
        let along = DVec3::new(libm::cos(self.heading), libm::sin(self.heading), 0.0);
        let level = DQuat::from_mat3(&DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X));
        let [width, height] = VIEWPORT.map(f64::from);
        View {
            position: self.from + along * (self.speed * at),
            orientation: (DQuat::from_rotation_z(self.heading) * level).normalize(),
            fov_y: 2.0 * libm::atan(libm::tan(0.5 * FOV_X) * height / width),
            viewport: VIEWPORT,
        }
    }

    fn flight(&self) -> Flight {
        Flight::sample(self.seconds, |at| self.view(at))
    }
}

/// Metres of a pixel that is required at a metre's distance.
fn allowed() -> f64 {
    let still = Trip { from: DVec3::ZERO, heading: 0.0, speed: 0.0, seconds: 1.0 };
    TARGET_PX / still.view(0.0).pixels_per_radian()
}

/// Replays a trip. Started warm, what the first view requires is resident.
fn travel(tree: &LodTree, trip: &Trip, link: &LinkTrace, viewer: Viewer, warm: bool) -> Result<Run, Fault> {
    let flight = trip.flight();
    let first = flight.views[0];
    let preloaded: Vec<RepId> = match warm {
        true => required(tree, first.position, allowed()).into_iter().flat_map(|s| s.by).collect(),
        false => Vec::new(),
    };
    // Frames are not judged here.
    let cuts = vec![Cut::default(); flight.frames()];
    let stage = Stage {
        tree,
        flight: &flight,
        cuts: &cuts,
        link,
        link_start: Time::ZERO,
        client: ClientSettings::unlimited(),
        scheduler: SchedulerSettings::with_budget(UNLIMITED),
        preloaded: &preloaded,
    };
    replay(stage, viewer.policy(tree, &first)).map_err(|e| Fault::new("a replay", e))
}

fn link(mbit: f64, latency_ms: f64) -> Result<LinkTrace, Fault> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a rate within a link's range")]
    let rate = (mbit * 1e6) as u64;
    let name = format!("constant {mbit} Mbit/s");
    LinkTrace::constant(&name, rate, Time::from_secs(1e-3 * latency_ms)).map_err(|e| Fault::new("a link", e))
}

/// Trips that stay within a world of `side` metres, by lot.
fn trips(side: f64, speed: f64, seconds: f64, count: usize, seed: u64) -> Vec<Trip> {
    let mut random = SplitMix64::new(seed);
    let room = (0.5 * side - speed * seconds).max(0.1 * side);
    (0..count)
        .map(|_| {
            let mut within = || room * (2.0 * random.uniform() - 1.0);
            let from = DVec3::new(within(), within(), EYE);
            Trip { from, heading: core::f64::consts::TAU * random.uniform(), speed, seconds }
        })
        .collect()
}

/// Mbit/s of geometry and of orthoviews over the trip, without its first seconds.
fn rates(tree: &LodTree, run: &Run, trip: &Trip) -> [f64; 2] {
    let mut bytes = [0u64; 2];
    for done in run.completions.iter().filter(|c| c.at.secs() >= SETTLING) {
        bytes[usize::from(tree.direction(done.rep).is_some())] += tree.wire_bytes(done.rep);
    }
    bytes.map(|b| 8e-6 * b as f64 / (trip.seconds - SETTLING))
}

/// What of the required cells is missing while travelling: share of the seconds with any, largest share of cells.
fn missing(tree: &LodTree, run: &Run, trip: &Trip) -> [f64; 2] {
    let first = required(tree, trip.view(0.0).position, allowed());
    let mut there: BTreeSet<RepId> = first.into_iter().flat_map(|s| s.by).collect();
    let mut done = run.completions.iter().peekable();
    let (mut late, mut most) = (0.0, 0.0f64);
    let seconds = trip.seconds as u64;
    for second in 1..=seconds {
        let now = Time(second * 1_000_000_000);
        while let Some(next) = done.next_if(|c| c.at <= now) {
            there.insert(next.rep);
        }
        let needed = required(tree, trip.view(now.secs()).position, allowed());
        let lacking = needed.iter().filter(|s| !s.by.iter().all(|rep| there.contains(rep))).count();
        late += f64::from(u32::from(lacking > 0));
        most = most.max(lacking as f64 / needed.len().max(1) as f64);
    }
    [late / seconds.max(1) as f64, most]
}

/// What to measure.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Areas, km².
    pub areas: Vec<f64>,
    /// Trips for each area.
    pub trips: usize,
    /// Seconds of these, at 15 m/s.
    pub seconds: f64,
    /// Seconds of a run for the table of speeds, and runs.
    pub table: (f64, usize),
    /// Link of the bursts beside 1 Gbit/s, Mbit/s.
    pub broadband: f64,
    /// Of catalogues and trips.
    pub seed: u64,
}

/// All of it.
///
/// # Errors
/// A catalogue or replay that fails.
pub fn findings(sizes: &Sizes, plan: &Plan) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    findings.tables.push(basis(sizes));
    findings.join(growth(sizes, plan)?);
    let largest = plan.areas.iter().copied().fold(1.0, f64::max);
    let side = 1e3 * largest.sqrt();
    let tree = sizes.catalogue(side, plan.seed, With::Orthoviews).map_err(|e| Fault::new("a catalogue", e))?;
    findings.join(speeds(sizes, &tree, side, plan)?);
    findings.join(bursts(&tree, plan)?);
    findings.join(first_view(sizes, plan)?);
    Ok(findings)
}

fn basis(sizes: &Sizes) -> Table {
    let mut table = Table::new(
        format!(
            "Sizes measured: {} leaves of {} m, pixels of {:.3} m; screen {} × {}, 60° wide: geometry within {:.0} m",
            sizes.leaves.len(),
            sizes.leaf_side,
            sizes.pitch,
            VIEWPORT[0],
            VIEWPORT[1],
            sizes.pitch / allowed()
        ),
        &["of", "kB an image", "kB geometry/m²", "triangles/m²"],
    );
    for level in 0..=sizes.above.len() {
        let mean = sizes.mean_image(level).map(|b| b / 1e3);
        table.row([json!(format!("level {level}")), json!(mean), json!(null), json!(null)]);
    }
    let (bytes, triangles) = DRVW_DENSITY;
    let density = json!(sizes.geometry_density() / 1e3);
    table.row([json!("geometry"), json!(null), density, json!(sizes.triangle_density)]);
    table.row([json!("[DRVW] scene 2"), json!("100 to 300"), json!(bytes / 1e3), json!(triangles)]);
    table
}

/// Cells and bandwidth as the world grows.
fn growth(sizes: &Sizes, plan: &Plan) -> Result<Findings, Fault> {
    const SPEED: f64 = 15.0;
    let mut table = Table::new(
        format!("A viewer at {SPEED} m/s as the world grows ({} trips of {} s each)", plan.trips, plan.seconds),
        &[
            "km²",
            "leaves",
            "cells needed",
            "of these leaves with geometry",
            "more per doubling",
            "orthoviews of a view, MB",
            "orthoviews, Mbit/s",
            "geometry, Mbit/s",
            "orthoviews ahead, Mbit/s",
            "geometry ahead, Mbit/s",
        ],
    );
    let fast = link(1000.0, 1.0)?;
    let mut curves: [Vec<(f64, f64)>; 4] = Default::default();
    let mut last: Option<(f64, f64)> = None;
    for &area in &plan.areas {
        let side = 1e3 * area.sqrt();
        let tree = sizes.catalogue(side, plan.seed, With::Orthoviews).map_err(|e| Fault::new("a catalogue", e))?;
        let trips = trips(side, SPEED, plan.seconds, plan.trips, plan.seed ^ area.to_bits());
        let each: Vec<[f64; 7]> = trips
            .par_iter()
            .map(|trip| {
                let needed = required(&tree, trip.from, allowed());
                let is_image = |rep: &RepId| tree.direction(*rep).is_some();
                let near = needed.iter().filter(|s| s.by.iter().any(|rep| !is_image(rep))).count();
                let images = needed.iter().flat_map(|s| &s.by).filter(|rep| is_image(rep));
                let bytes: u64 = images.map(|&rep| tree.wire_bytes(rep)).sum();
                let demand = rates(&tree, &travel(&tree, trip, &fast, Viewer::Demand, true)?, trip);
                let ahead = rates(&tree, &travel(&tree, trip, &fast, Viewer::Lookahead, true)?, trip);
                let [cells, near] = [needed.len(), near].map(|n| n as f64);
                Ok([cells, near, bytes as f64 / 1e6, demand[1], demand[0], ahead[1], ahead[0]])
            })
            .collect::<Result<_, Fault>>()?;
        let mean = |of: usize| each.iter().map(|row| row[of]).sum::<f64>() / each.len().max(1) as f64;
        let cells = mean(0);
        let more = last.map(|(before, then)| (cells - then) / libm::log2(area / before));
        last = Some((area, cells));
        let leaves =
            (0..tree.nodes() as u32).filter(|&n| tree.is_leaf(foresight_scheduler::lod_tree::NodeId(n))).count();
        table.row([
            json!(area),
            json!(leaves),
            json!(cells),
            json!(mean(1)),
            json!(more),
            json!(mean(2)),
            json!(mean(3)),
            json!(mean(4)),
            json!(mean(5)),
            json!(mean(6)),
        ]);
        for (curve, value) in curves.iter_mut().zip([cells, mean(3), mean(4), mean(5)]) {
            curve.push((area, value));
        }
    }
    let curve =
        |name: &str, points: &[(f64, f64)]| Curve { name: name.to_owned(), points: points.to_vec(), dotted: true };
    let [cells, images, geometry, ahead] = &curves;
    let x = || ("area, km²".to_owned(), Scale::Logarithmic);
    let plots = vec![
        Plot {
            name: "growth-cells".to_owned(),
            title: "Cells that a view needs".to_owned(),
            x: x(),
            y: ("cells".to_owned(), Scale::Linear),
            curves: vec![curve("cells", cells)],
        },
        Plot {
            name: "growth-bandwidth".to_owned(),
            title: format!("Bandwidth at {SPEED} m/s"),
            x: x(),
            y: ("Mbit/s".to_owned(), Scale::Linear),
            curves: vec![
                curve("orthoviews", images),
                curve("geometry", geometry),
                curve("orthoviews, with prefetching", ahead),
            ],
        },
    ];
    Ok(Findings { tables: vec![table], plots, ..Findings::default() })
}

/// \[DRVW\] Table 1.
fn speeds(sizes: &Sizes, tree: &LodTree, side: f64, plan: &Plan) -> Result<Findings, Fault> {
    let (seconds, runs) = plan.table;
    let mut table = Table::new(
        format!(
            "Bandwidth by speed, {runs} runs of {seconds} s in {:.0} km², beside [DRVW] Table 1",
            side * side / 1e6
        ),
        &[
            "m/s",
            "geometry, Mbit/s",
            "orthoviews, Mbit/s",
            "ratio, %",
            "geometry ahead",
            "orthoviews ahead",
            "ratio ahead, %",
            "[DRVW] geometry",
            "[DRVW] images",
            "[DRVW] ratio, %",
            "geometry at [DRVW]'s density",
        ],
    );
    let fast = link(1000.0, 1.0)?;
    let denser = DRVW_DENSITY.0 / sizes.geometry_density();
    for (speed, geometry, images) in DRVW {
        let jobs: Vec<(Trip, Viewer)> = trips(side, speed, seconds, runs, plan.seed ^ speed.to_bits())
            .into_iter()
            .flat_map(|trip| [(trip, Viewer::Demand), (trip, Viewer::Lookahead)])
            .collect();
        let each: Vec<[f64; 2]> = jobs
            .par_iter()
            .map(|(trip, viewer)| Ok(rates(tree, &travel(tree, trip, &fast, *viewer, true)?, trip)))
            .collect::<Result<_, Fault>>()?;
        let mean = |viewer: usize, kind: usize| {
            each.iter().skip(viewer).step_by(2).map(|rates| rates[kind]).sum::<f64>() / runs.max(1) as f64
        };
        let ratio = |viewer: usize| 100.0 * mean(viewer, 1) / mean(viewer, 0);
        table.row([
            json!(speed),
            json!(mean(0, 0)),
            json!(mean(0, 1)),
            json!(ratio(0)),
            json!(mean(1, 0)),
            json!(mean(1, 1)),
            json!(ratio(1)),
            json!(geometry),
            json!(images),
            json!(100.0 * images / geometry),
            json!(mean(0, 0) * denser),
        ]);
    }
    Ok(Findings { tables: vec![table], ..Findings::default() })
}

/// \[DRVW\] Figure 6: a way through the middle, where cells of all levels end.
fn bursts(tree: &LodTree, plan: &Plan) -> Result<Findings, Fault> {
    const SPEED: f64 = 15.0;
    const SECONDS: f64 = 240.0;
    let trip =
        Trip { from: DVec3::new(-0.5 * SPEED * SECONDS, 37.0, EYE), heading: 0.1, speed: SPEED, seconds: SECONDS };
    let mut table = Table::new(
        format!("Downloads along {SECONDS} s at {SPEED} m/s through the world's middle, warm"),
        &[
            "link, Mbit/s",
            "fetching",
            "mean, Mbit/s",
            "99th percentile of a second",
            "largest second",
            "largest : mean",
            "seconds with something missing, %",
            "cells missing at most, %",
        ],
    );
    let mut plots = Vec::new();
    for (name, mbit, latency) in [("lan", 1000.0, 1.0), ("broadband", plan.broadband, 40.0)] {
        let link = link(mbit, latency)?;
        let mut curves = Vec::new();
        for (title, viewer) in [("without prefetching", Viewer::Demand), ("with prefetching", Viewer::Lookahead)] {
            let run = travel(tree, &trip, &link, viewer, true)?;
            let per_second = (TICKS_PER_SECOND / TICKS_PER_FRAME) as usize;
            let marks: Vec<u64> = run.received.iter().copied().step_by(per_second).collect();
            let mbits: Vec<f64> = marks.windows(2).map(|w| 8e-6 * (w[1] - w[0]) as f64).collect();
            let settled = &mbits[(SETTLING as usize).min(mbits.len())..];
            let mean = settled.iter().sum::<f64>() / settled.len().max(1) as f64;
            let mut sorted = settled.to_vec();
            sorted.sort_by(f64::total_cmp);
            let at = |share: f64| sorted.get((share * (sorted.len().max(1) - 1) as f64) as usize).copied();
            let most = at(1.0).unwrap_or_default();
            let [late, lacking] = missing(tree, &run, &trip);
            table.row([
                json!(mbit),
                json!(title),
                json!(mean),
                json!(at(0.99)),
                json!(most),
                json!(most / mean.max(1e-9)),
                json!(100.0 * late),
                json!(100.0 * lacking),
            ]);
            let points = mbits.iter().enumerate().map(|(second, v)| (second as f64, *v)).collect();
            curves.push(Curve { name: title.to_owned(), points, dotted: false });
        }
        plots.push(Plot {
            name: format!("bursts-{name}"),
            title: format!("Downloads at {SPEED} m/s over {mbit} Mbit/s ([DRVW] Figure 6)"),
            x: ("time, s".to_owned(), Scale::Linear),
            y: ("Mbit/s".to_owned(), Scale::Linear),
            curves,
        });
    }
    Ok(Findings { tables: vec![table], plots, ..Findings::default() })
}

/// \[NVE\] §4.8.3: time until everything in view has something, and until it has what it requires.
fn first_view(sizes: &Sizes, plan: &Plan) -> Result<Findings, Fault> {
    let mut table = Table::new(
        "A complete first view, from nothing (medians)",
        &["world", "link, Mbit/s", "something everywhere, s", "as required, s", "runs that got there"],
    );
    for (area, mbit, seconds) in [(1.0, 0.2, 900.0), (1.0, 5.0, 300.0), (1000.0, 0.2, 900.0), (1000.0, 5.0, 300.0)] {
        let side = 1e3 * libm::sqrt(area);
        let link = link(mbit, 40.0)?;
        for (title, with) in [("orthoviews", With::Orthoviews), ("geometry only", With::GeometryOnly)] {
            if with == With::GeometryOnly && area > 1.0 {
                continue;
            }
            let tree = sizes.catalogue(side, plan.seed, with).map_err(|e| Fault::new("a catalogue", e))?;
            let each: Vec<[Option<f64>; 2]> = trips(side, 0.0, seconds, 5, plan.seed)
                .par_iter()
                .map(|trip| started(&tree, trip, &link))
                .collect::<Result<_, Fault>>()?;
            let median = |of: usize| {
                let mut values: Vec<f64> = each.iter().map(|e| e[of].unwrap_or(f64::INFINITY)).collect();
                values.sort_by(f64::total_cmp);
                values.get(values.len() / 2).copied().filter(|v| v.is_finite())
            };
            table.row([
                json!(format!("{area} km², {title}")),
                json!(mbit),
                json!(median(0)),
                json!(median(1)),
                json!(format!("{} of {}", each.iter().filter(|e| e[1].is_some()).count(), each.len())),
            ]);
        }
    }
    for (title, first) in
        [("[NVE] 400 objects, meshes and relief textures", 8.0), ("[NVE] 400 objects, progressive meshes", 50.0)]
    {
        table.row([json!(title), json!(0.2), json!(first), json!(null), json!(null)]);
    }
    Ok(Findings { tables: vec![table], ..Findings::default() })
}

/// Seconds until everything in view has something, and what it requires.
fn started(tree: &LodTree, trip: &Trip, link: &LinkTrace) -> Result<[Option<f64>; 2], Fault> {
    let run = travel(tree, trip, link, Viewer::Lookahead, false)?;
    let view = trip.view(0.0);
    let frustum = Frustum::new(&view);
    let in_view = |s: &Shown| frustum.side(tree.centre(s.node) - view.position, tree.half(s.node)) != Side::Outside;
    let needed: Vec<Shown> = required(tree, view.position, allowed()).into_iter().filter(in_view).collect();
    let mut there: BTreeSet<RepId> = BTreeSet::new();
    let (mut something, mut all) = (None, None);
    for done in &run.completions {
        there.insert(done.rep);
        let has = |s: &Shown| tree.ancestors(s.node).flat_map(|n| tree.own(n)).any(|rep| there.contains(&rep));
        if something.is_none() && needed.iter().all(has) {
            something = Some(done.at.secs());
        }
        if needed.iter().all(|s| s.by.iter().all(|rep| there.contains(rep))) {
            all = Some(done.at.secs());
            break;
        }
    }
    Ok([something, all])
}
