//! Everything resident, three directions a cell, against pure geometry: the surfaces of the input drawn as triangles at their
//! finest.

use crate::flights::Scene;
use crate::worlds;
use foresight_index::specification::Progress;
use foresight_index::surface;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_traces::flight::TICKS_PER_SECOND;
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::draw::list::{ALL_TILES, DrawList, Item};
use foresight_viewer::gpu::{Gpu, GpuSettings, Light, Picture, RenderSettings, Renderer};
use foresight_viewer::headless::png;
use foresight_viewer::measure::{Likeness, compare};
use foresight_viewer::offscreen::FORMAT;
use foresight_viewer::scene::content::Content;
use foresight_viewer::scene::decode::meshed;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// Mean similarity that is asked for.
const ASKED: f64 = 0.95;

/// Samples a pixel, of both.
const SAMPLES: u32 = 4;

/// Flights by world: the path and where it goes.
const FLIGHTS: [(&str, &str, &str); 7] = [
    ("city", "turn:speed=8,duration=12", "--place centre,height=60"),
    ("city", "steady:speed=6,duration=12", "--place centre,height=25,yaw=30"),
    ("terrain", "turn:speed=20,duration=12", "--place centre,height=120"),
    ("terrain", "steady:speed=15,duration=12", "--place centre,height=60,yaw=45"),
    ("asteroids", "turn:speed=5,duration=12", "--place centre,height=30"),
    ("mars", "turn:speed=4,duration=12", "--place centre,height=30"),
    ("mars", "steady:speed=8,duration=12", "--place centre,height=60,yaw=60"),
];

/// What is drawn of the resident world: three directions, nine, and the stored geometry alone.
fn drawn() -> [ChooseSettings; 3] {
    let nine = ChooseSettings { directions: 9, ..ChooseSettings::default() };
    [ChooseSettings::default(), nine, ChooseSettings::reference()]
}

/// Opens the flights, each with what its world was built from.
pub(crate) fn scenes(
    folder: &Path,
    small: bool,
    only: Option<&str>,
    size: [u32; 2],
) -> Result<Vec<(Scene, String)>, Fault> {
    let mut scenes = Vec::new();
    for recipe in worlds::recipes(small) {
        let own = FLIGHTS.iter().filter(|flight| recipe.name.starts_with(flight.0));
        for (_, path, words) in own.take(if small { 1 } else { usize::MAX }) {
            let name = format!("{}, {}", recipe.name, path.split(':').next().unwrap_or_default());
            if only.is_some_and(|only| !name.contains(only)) {
                continue;
            }
            let world = recipe.build(folder)?;
            let words = if small { format!("{words} --duration 3") } else { (*words).to_owned() };
            let scene = Scene::open(name, &world.display().to_string(), path, &words, size)?;
            scenes.push((scene, recipe.input.clone()));
        }
    }
    Ok(scenes)
}

/// The surfaces of an input, uploaded whole.
struct Surfaces {
    renderer: Renderer,
    list: DrawList,
}

impl Surfaces {
    fn open(input: &str, settings: RenderSettings) -> Result<Surfaces, Fault> {
        let silent: Progress = Arc::new(|_, _| {});
        let source = surface::open(input, &silent).map_err(|error| Fault::new(input, error))?;
        let gpu = Gpu::open(&GpuSettings::default()).map_err(|error| Fault::new("GPU", error))?;
        let mut renderer = Renderer::new(&gpu, settings, FORMAT);
        let mut list = DrawList::default();
        for piece in 0..source.pieces() {
            let read = source.read(piece).map_err(|error| Fault::new(input, error))?;
            let (content, _) = meshed(read);
            let rep = RepId(piece as u32);
            if !matches!(content, Content::Empty) {
                renderer.upload(rep, &content).map_err(|error| Fault::new(input, error))?;
                list.items.push(Item { rep, hidden: Vec::new(), behind: 0.0, tiles: ALL_TILES, false_colour: None });
            }
        }
        Ok(Surfaces { renderer, list })
    }

    fn picture(&mut self, view: &View) -> Result<Picture, Fault> {
        let drawn = self.renderer.picture(view, &self.list).map_err(|error| Fault::new("GPU", error))?;
        Ok(drawn.0)
    }
}

/// Likeness over a flight.
#[derive(Default)]
struct Sum {
    pictures: u32,
    ssim: f64,
    holes: f64,
    worst: Option<(f64, Picture, Picture)>,
}

impl Sum {
    fn add(&mut self, likeness: &Likeness, picture: Picture, reference: &Picture) {
        self.pictures += 1;
        self.ssim += likeness.ssim;
        self.holes += likeness.holes;
        if self.worst.as_ref().is_none_or(|(worst, ..)| likeness.ssim < *worst) {
            self.worst = Some((likeness.ssim, picture, reference.clone()));
        }
    }

    fn mean(&self) -> f64 {
        self.ssim / f64::from(self.pictures.max(1))
    }
}

/// Flies each scene, whose world was built from the input beside it.
pub(crate) fn findings(scenes: &[(Scene, String)], rate: u64, sun: bool) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    let columns = [
        "flight",
        "pictures",
        "SSIM, 3 directions",
        "of 9 directions'",
        "worst",
        "holes",
        "9 directions",
        "stored geometry",
    ];
    let mut table = Table::new("", &columns);
    let (mut mean, mut flights) = (0.0, 0.0);
    for (scene, input) in scenes {
        let mut offscreen = scene.offscreen()?;
        offscreen.render_settings().samples = SAMPLES;
        if sun {
            let up = scene.world.up;
            let towards = (up + 1.5 * up.any_orthonormal_vector()).normalize();
            offscreen.render_settings().light = Light::Sun { towards, ambient: 0.3 };
        }
        let mut surfaces = Surfaces::open(input, *offscreen.render_settings())?;
        let adapter = offscreen.adapter().to_owned();
        let light = if sun { "with the sun from the side" } else { "unlit" };
        table.title = format!(
            "Everything resident against the input's surfaces as triangles, {light}, {SAMPLES} samples a pixel, on {adapter}"
        );
        let all: BTreeSet<RepId> = (0..scene.world.tree.representations() as u32).map(RepId).collect();
        let mut sums: [Sum; 3] = Default::default();
        let step = (TICKS_PER_SECOND / rate.max(1)).max(1) as usize;
        for view in scene.flight.views.iter().step_by(step) {
            let reference = surfaces.picture(view)?;
            for (sum, settings) in sums.iter_mut().zip(drawn()) {
                let drawn = offscreen.picture(view, &all, &settings);
                let (picture, _) = drawn.map_err(|error| Fault::new(&scene.name, error))?;
                let likeness = compare(&picture, &reference).map_err(|error| Fault::new(&scene.name, error))?;
                // A view of nothing but sky says nothing.
                if let Some(likeness) = likeness {
                    sum.add(&likeness, picture, &reference);
                }
            }
        }
        if let Some((rep, why)) = offscreen.broken().iter().next() {
            return Err(Fault::new(&scene.name, format!("representation {} cannot be drawn: {why}", rep.0)));
        }
        eprintln!("{}", scene.name);
        let [three, nine, geometry] = &sums;
        mean += three.mean();
        flights += 1.0;
        table.row([
            json!(scene.name),
            json!(three.pictures),
            json!(three.mean()),
            json!(three.mean() / nine.mean()),
            json!(three.worst.as_ref().map(|worst| worst.0)),
            json!(three.holes / f64::from(three.pictures.max(1))),
            json!(nine.mean()),
            json!(geometry.mean()),
        ]);
        if let Some((_, picture, reference)) = &three.worst {
            let name = format!("resident-{}", scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
            let encoded = |picture| png(picture).map_err(|error| Fault::new(&scene.name, error));
            findings.pictures.push((format!("{name}.png"), encoded(picture)?));
            findings.pictures.push((format!("{name}-geometry.png"), encoded(reference)?));
        }
    }
    findings.tables.push(table);
    if flights > 0.0 {
        let mean = mean / flights;
        let verdict = if mean >= ASKED { "kept" } else { "not kept" };
        findings
            .remarks
            .push(format!("Mean similarity {mean:.4} over {flights} flights; asked for at least {ASKED}: {verdict}"));
    }
    Ok(findings)
}
