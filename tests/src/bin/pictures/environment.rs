//! What is far drawn from environment maps instead of from its own contents (\[DRVW\] §6): points, time, what making them
//! costs, and how alike the pictures are.

use crate::flights::Scene;
use crate::street::everything;
use crate::worlds;
use foresight_scheduler::view::View;
use foresight_sim::stopwatch::Stopwatch;
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::draw::environment::{Cell, EnvironmentSettings, missing};
use foresight_viewer::gpu::{Picture, Share};
use foresight_viewer::headless::png;
use foresight_viewer::measure::{Likeness, compare};
use serde_json::json;
use std::path::Path;

/// Sides of a cell from the viewpoint to what is far; that distance is the same for all of them.
const MULTIPLES: [f64; 3] = [4.0, 8.0, 16.0];

/// Drawn so often, the quickest counts: other work on the machine disturbs.
const REPEATS: usize = 3;

/// Frames a second over which what maps cost is spread.
const RATE: f64 = 60.0;

/// Time and memory for all that is missing, and for nothing.
const AMPLE: Share = Share { bytes: 2 << 30, frames: 1 << 20, waits: true };
const NONE: Share = Share { frames: 0, ..AMPLE };

/// Flights through the built city and terrain, with the views that are looked at.
pub(crate) fn flights(
    folder: &Path,
    small: bool,
    only: Option<&str>,
    size: [u32; 2],
) -> Result<Vec<(Scene, Vec<View>)>, Fault> {
    let count = if small { 2 } else { 6 };
    let mut flights = Vec::new();
    for recipe in worlds::recipes(small) {
        let height = if recipe.name.starts_with("terrain") { 80 } else { 15 };
        let is_wanted = only.is_none_or(|only| recipe.name.contains(only));
        if !is_wanted || !["city", "terrain"].iter().any(|name| recipe.name.starts_with(name)) {
            continue;
        }
        let world = recipe.build(folder)?.display().to_string();
        let words = format!("--place centre,height={height},yaw=30");
        let scene = Scene::open(recipe.name.to_owned(), &world, "turn:speed=8,duration=24", &words, size)?;
        let step = (scene.flight.views.len() / count).max(1);
        let views = scene.flight.views.iter().step_by(step).take(count).copied().collect();
        flights.push((scene, views));
    }
    Ok(flights)
}

/// Means over the views of a flight.
#[derive(Default)]
struct Sums {
    pictures: f64,
    /// Points of which tiles are in view and not hidden, thousands, and of these the maps'.
    points: f64,
    map_points: f64,
    ms: f64,
    ssim: f64,
    worst: Option<f64>,
    psnr_db: f64,
    holes: f64,
    to_geometry: f64,
    left_out: f64,
    bytes: u64,
    faces: u64,
    points_in: u64,
    making_ms: f64,
}

impl Sums {
    fn mean(&self, sum: f64) -> f64 {
        sum / self.pictures.max(1.0)
    }
}

fn likeness(name: &str, picture: &Picture, reference: &Picture) -> Result<Likeness, Fault> {
    let compared = compare(picture, reference).map_err(|error| Fault::new(name, error))?;
    Ok(compared.unwrap_or(Likeness { ssim: 1.0, psnr_db: f64::INFINITY, compared: 0.0, holes: 0.0 }))
}

/// Faces that are made a second along a flight, each vertex's when the viewpoint first has it in its cell.
fn faces_a_second(scene: &Scene, settings: &EnvironmentSettings) -> f64 {
    let (mut cell, mut made) = (None, 0);
    for view in &scene.flight.views {
        let next = Cell::follow(cell, view.position, settings.side);
        if let (Some(before), Some(now)) = (cell, next) {
            made += missing(now, &before.vertices().into_iter().collect(), view.position, settings.side).len();
        }
        cell = next;
    }
    6.0 * made as f64 / scene.flight.duration().secs()
}

/// Flies each path, everything resident.
pub(crate) fn findings(scenes: &[(Scene, Vec<View>)], small: bool) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    let mut drawn = Table::new(
        "",
        &[
            "flight",
            "far from, m",
            "side, m",
            "thousand points",
            "from maps, %",
            "contents left out",
            "ms a frame",
            "SSIM",
            "worst",
            "PSNR, dB",
            "holes",
            "SSIM to geometry",
        ],
    );
    let mut made = Table::new(
        "Making maps",
        &[
            "flight",
            "side, m",
            "faces made",
            "thousand points a face",
            "ms a face",
            "faces a second",
            "ms a frame",
            "MB",
        ],
    );
    for (scene, views) in scenes {
        let fault = |error: foresight_viewer::gpu::GpuError| Fault::new(&scene.name, error);
        let mut offscreen = scene.offscreen()?;
        drawn.title = format!("What is far from environment maps, everything resident, on {}", offscreen.adapter());
        let resident = everything(scene);
        let choose = ChooseSettings::default();
        let tree = &scene.world.tree;
        let distance = EnvironmentSettings::for_world(&tree.bounds(tree.root())).distance();
        let mut references = Vec::new();
        for view in views {
            references.push(offscreen.picture(view, &resident, &ChooseSettings::reference()).map_err(fault)?.0);
        }
        let mut direct: Vec<Picture> = Vec::new();
        let multiples = if small { &MULTIPLES[1..2] } else { &MULTIPLES[..] };
        for multiple in std::iter::once(None).chain(multiples.iter().map(|&multiple| Some(multiple))) {
            let settings = multiple.map(|multiple| EnvironmentSettings {
                multiple,
                ..EnvironmentSettings::with_side(distance / multiple)
            });
            offscreen.set_environment(settings);
            let mut sums = Sums::default();
            for (at, view) in views.iter().enumerate() {
                let start = Stopwatch::start();
                let (_, _, counts) = offscreen.picture_with_maps(view, &resident, &choose, AMPLE).map_err(fault)?;
                let first_ms = start.nanos() as f64 * 1e-6;
                sums.faces += counts.faces_made;
                sums.points_in += counts.points_in;
                sums.bytes = sums.bytes.max(counts.bytes);
                sums.left_out += counts.left_out as f64;
                // What is hidden is known once it was drawn.
                offscreen.picture_with_maps(view, &resident, &choose, NONE).map_err(fault)?;
                let mut ms = f64::INFINITY;
                let mut last = None;
                for _ in 0..REPEATS {
                    let start = Stopwatch::start();
                    last = Some(offscreen.picture_with_maps(view, &resident, &choose, NONE).map_err(fault)?);
                    ms = ms.min(start.nanos() as f64 * 1e-6);
                }
                let Some((picture, counts, _)) = last else { continue };
                let points = offscreen.renderer().occlusion().map_or(counts.points, |seen| seen.points_drawn);
                sums.making_ms += (first_ms - ms).max(0.0);
                sums.pictures += 1.0;
                sums.ms += ms;
                sums.points += points as f64 / 1e3;
                sums.map_points +=
                    if counts.points > 0 { counts.map_points as f64 / counts.points as f64 } else { 0.0 };
                sums.to_geometry += likeness(&scene.name, &picture, &references[at])?.ssim;
                if multiple.is_none() {
                    direct.push(picture);
                    continue;
                }
                let alike = likeness(&scene.name, &picture, &direct[at])?;
                sums.ssim += alike.ssim;
                sums.psnr_db += alike.psnr_db.min(100.0);
                sums.holes += alike.holes;
                if sums.worst.is_none_or(|worst| alike.ssim < worst) {
                    sums.worst = Some(alike.ssim);
                }
                if at == views.len() / 2 {
                    let name = scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-");
                    let encoded = |picture| png(picture).map_err(|error| Fault::new(&scene.name, error));
                    let file = format!("environment-{name}-{}", multiple.unwrap_or_default());
                    findings.pictures.push((format!("{file}.png"), encoded(&picture)?));
                    findings.pictures.push((format!("{file}-direct.png"), encoded(&direct[at])?));
                }
            }
            eprintln!("{}, {multiple:?}", scene.name);
            let compared = |value: f64| json!(multiple.map(|_| sums.mean(value)));
            drawn.row([
                json!(scene.name),
                json!(multiple.map(|_| distance)),
                json!(settings.map(|settings| settings.side)),
                json!(sums.mean(sums.points)),
                json!(100.0 * sums.mean(sums.map_points)),
                compared(sums.left_out),
                json!(sums.mean(sums.ms)),
                compared(sums.ssim),
                json!(sums.worst),
                compared(sums.psnr_db),
                compared(sums.holes),
                json!(sums.mean(sums.to_geometry)),
            ]);
            let Some(settings) = settings else { continue };
            let each = |value: f64| if sums.faces > 0 { value / sums.faces as f64 } else { 0.0 };
            let (ms, rate) = (each(sums.making_ms), faces_a_second(scene, &settings));
            made.row([
                json!(scene.name),
                json!(settings.side),
                json!(sums.faces),
                json!(each(sums.points_in as f64 / 1e3)),
                json!(ms),
                json!(rate),
                json!(ms * rate / RATE),
                json!(sums.bytes as f64 / 1e6),
            ]);
        }
    }
    findings.tables.extend([drawn, made]);
    findings.remarks.push(format!("Making them is spread over {RATE} frames a second in the last column but one."));
    Ok(findings)
}
