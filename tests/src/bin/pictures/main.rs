//! Measures what the viewer draws, beside the papers' figures and the scheduler's predictions.

mod controller;
mod cost;
mod culled;
mod directions;
mod environment;
mod fading;
mod flights;
mod offset;
mod quality;
mod rank;
mod resident;
mod shapes;
mod streamed;
mod street;
mod tree;
mod worlds;

use clap::{Parser, Subcommand};
use flights::Scene;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::headless::Against;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Measures what the viewer draws
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  pictures quality --out out\n  pictures streamed --small\n  pictures resident --sun --out out\n  pictures directions --worlds built --out out\n  pictures shapes --small --out out\n  pictures cost --worlds built\n  pictures offset --worlds built\n  pictures environment --small"
)]
struct Cli {
    #[command(subcommand)]
    figure: Figure,
    /// Print one JSON document
    #[arg(long, global = true)]
    json: bool,
    /// Write plots (SVG) and pictures (PNG) into this folder
    #[arg(long, global = true, value_name = "DIR")]
    out: Option<PathBuf>,
    /// One small world and a short flight
    #[arg(long, global = true)]
    small: bool,
    /// Columns and rows of the pictures; 640x480, or 160x120 with --small, if not given
    #[arg(long, global = true, value_name = "WxH", value_parser = size)]
    size: Option<[u32; 2]>,
    /// Seconds of each flight at most; 24, or 4 with --small, if not given
    #[arg(long, global = true, value_name = "SECONDS", value_parser = clap::value_parser!(u32).range(1..=3600))]
    seconds: Option<u32>,
    /// Only flights whose names hold this
    #[arg(long, global = true, value_name = "TEXT")]
    only: Option<String>,
    /// Folder of the stored worlds; those that are not there are built by foresight-server, which lies beside this
    /// program. A folder for this run only if not given
    #[arg(long, global = true, value_name = "DIR")]
    worlds: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Figure {
    /// Rank correlation between the scheduler's Q and the measured similarity on starved links, by flight and by e₀
    Quality {
        /// How much more the flight needs than its link brings
        #[arg(long, default_value_t = 3.0, value_name = "TIMES")]
        rho: f64,
        /// Pictures a second; divides 60
        #[arg(long, default_value_t = 2, value_name = "N", value_parser = rate)]
        rate: u64,
        /// Who decides
        #[arg(long, default_value = "foresight", value_name = "POLICY")]
        policy: String,
        /// Compare with triangles, not with everything resident
        #[arg(long)]
        geometry: bool,
    },
    /// Similarity over time on a starved and a matched link: foresight, lookahead and 3d-tiles-renderer where no content
    /// shows one direction only, added-benefit in its place elsewhere
    Streamed {
        /// Pictures a second; divides 60
        #[arg(long, default_value_t = 2, value_name = "N", value_parser = rate)]
        rate: u64,
    },
    /// Points in memory, in view and after occlusion culling along paths (HIBR Figure 10), and what that culling gains
    Culled,
    /// What is far from environment maps: points, time a frame, what making them costs, likeness (DRVW 6)
    Environment,
    /// A target frame time held while a city is entered: p90 from 60 frames after, pictures of 160x120 if no size is given
    /// (NVE 4.5, 4.6)
    Controller,
    /// Popping: the largest change between successive frames of a slow walk, with and without fading (HIBR 5.3)
    Fading,
    /// Everything resident, three directions a cell, against the input's surfaces drawn as triangles
    Resident {
        /// Pictures a second; divides 60
        #[arg(long, default_value_t = 1, value_name = "N", value_parser = rate)]
        rate: u64,
        /// With the sun from the side, so that normals are seen; without, colours are as they are
        #[arg(long)]
        sun: bool,
    },
    /// Circular, warped, elliptical, and hybrid splats with and without sphericality, against triangles (HIBR Figure 8)
    Shapes,
    /// Milliseconds per million splats; what compressed textures save and lose, what compressing and uploading takes
    Cost,
    /// Pixels that differ 6.4 million metres from the origin
    Offset,
    /// 2, 3 and 5 directions drawn of 5 and of 9 (HIBR Figure 5)
    Directions {
        /// Pictures a second; divides 60
        #[arg(long, default_value_t = 1, value_name = "N", value_parser = rate)]
        rate: u64,
    },
}

fn rate(text: &str) -> Result<u64, String> {
    let rate = text.parse().ok().filter(|&rate: &u64| rate > 0 && 60u64.is_multiple_of(rate));
    rate.ok_or_else(|| format!("`{text}`; expected 60 or what divides it"))
}

/// Memory of the clients, bytes.
const MEMORY: u64 = 256 << 20;

/// Flights by world: the path, the built-in one if empty, where it goes, and whether it calibrates.
const FLIGHTS: [(&str, &str, &str, bool); 8] = [
    ("city", "steady:speed=6,duration=24", "--place centre,height=8", true),
    ("city", "", "--place centre,height=60", false),
    ("terrain", "steady:speed=15,duration=24", "--place centre,height=60,yaw=45", false),
    ("terrain", "turn:speed=20,duration=24", "--place centre,height=120", true),
    ("asteroids", "steady:speed=5,duration=24", "--place centre,height=10,yaw=20", true),
    ("asteroids", "turn:speed=5,duration=24", "--place centre,height=30", false),
    ("mars", "steady:speed=4,duration=24", "--place centre,height=6,yaw=60", false),
    ("mars", "turn:speed=4,duration=24", "--place centre,height=15", true),
];

/// What a path is called in tables.
fn kind(path: &str) -> &str {
    path.split(':').next().filter(|kind| !kind.is_empty()).unwrap_or("flight")
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (16..=8192).contains(n));
    match text.split_once('x').map(|(w, h)| (side(w), side(h))) {
        Some((Some(w), Some(h))) => Ok([w, h]),
        _ => Err(format!("`{text}`; expected COLUMNSxROWS, each from 16 to 8192")),
    }
}

impl Cli {
    /// A flight through `world`.
    fn scene(&self, name: String, world: &str, (path, words): (&str, &str)) -> Result<Scene, Fault> {
        let seconds = self.seconds.unwrap_or(if self.small { 4 } else { 24 });
        let mut scene = Scene::open(name, world, path, &format!("{words} --at-most {seconds}"), self.size())?;
        // Its colours are photographs.
        scene.is_lit = !scene.name.to_lowercase().contains("mars");
        Ok(scene)
    }

    fn size(&self) -> [u32; 2] {
        self.size.unwrap_or(if self.small { [160, 120] } else { [640, 480] })
    }

    fn wants(&self, name: &str) -> bool {
        self.only.as_deref().is_none_or(|only| name.contains(only))
    }
}

/// The flights through stored worlds, with whether they calibrate.
fn stored_scenes(cli: &Cli, folder: &Path) -> Result<Vec<(Scene, bool)>, Fault> {
    let mut scenes = Vec::new();
    for recipe in worlds::recipes(cli.small) {
        for (world, path, words, calibrates) in FLIGHTS {
            let name = format!("{}, {}", recipe.name, kind(path));
            let is_its = recipe.name == world || (cli.small && recipe.name.starts_with(world) && calibrates);
            if is_its && cli.wants(&name) {
                let world = recipe.build(folder)?;
                scenes.push((cli.scene(name, &world.display().to_string(), (path, words))?, calibrates));
            }
        }
    }
    Ok(scenes)
}

/// One flight through each stored world.
fn first_scenes(cli: &Cli, folder: &Path) -> Result<Vec<Scene>, Fault> {
    let mut scenes: Vec<Scene> = stored_scenes(cli, folder)?.into_iter().map(|(scene, _)| scene).collect();
    scenes.dedup_by(|a, b| a.name.split(',').next() == b.name.split(',').next());
    Ok(scenes)
}

/// Flights through worlds whose contents show every direction.
fn undirected_scenes(cli: &Cli) -> Result<Vec<Scene>, Fault> {
    let mut cases =
        vec![("generated city", if cli.small { "city:blocks=2" } else { "city:blocks=6" }.to_owned(), FLIGHTS[1])];
    if let Some(data) = foresight_tests::data_folder().filter(|_| !cli.small) {
        let tileset = data.join("scenes/mars_dingo_gap_3dtiles/tileset.json");
        cases.push(("Mars tileset", tileset.display().to_string(), FLIGHTS[6]));
    }
    let wanted = cases.into_iter().filter(|(name, ..)| cli.wants(name));
    wanted.map(|(name, world, (_, path, words, _))| cli.scene(name.to_owned(), &world, (path, words))).collect()
}

/// City and terrain with five and with nine directions.
fn directed_scenes(cli: &Cli, folder: &Path) -> Result<Vec<(Scene, u32)>, Fault> {
    let mut scenes = Vec::new();
    for recipe in worlds::recipes(cli.small) {
        let flight = FLIGHTS.iter().find(|flight| recipe.name.starts_with(flight.0));
        let Some((_, path, words, _)) = flight.filter(|_| cli.wants(recipe.name)) else { continue };
        for directions in [5, 9] {
            let recipe = worlds::Recipe { directions: Some(directions), ..recipe.clone() };
            let world = recipe.build(&folder.join(format!("directions-{directions}")))?;
            let name = format!("{}, {directions} directions", recipe.name);
            scenes.push((cli.scene(name, &world.display().to_string(), (path, words))?, directions));
        }
    }
    Ok(scenes)
}

fn measured(cli: &Cli, folder: &Path) -> Result<Findings, Fault> {
    match &cli.figure {
        Figure::Quality { rho, rate, policy, geometry } => {
            let mut scenes = stored_scenes(cli, folder)?;
            scenes.extend(undirected_scenes(cli)?.into_iter().map(|scene| (scene, false)));
            let against = if *geometry { Against::Geometry } else { Against::Everything };
            quality::findings(&scenes, &quality::Plan { rho: *rho, rate: *rate, memory: MEMORY, against, policy })
        }
        Figure::Streamed { rate } => {
            let mut scenes = undirected_scenes(cli)?;
            scenes.extend(stored_scenes(cli, folder)?.into_iter().filter(|(_, c)| *c).map(|(s, _)| s));
            streamed::findings(&scenes, *rate, MEMORY)
        }
        Figure::Culled => culled::findings(&culled::flights(folder, cli.small)?),
        Figure::Environment => {
            let flights = environment::flights(folder, cli.small, cli.only.as_deref(), cli.size())?;
            environment::findings(&flights, cli.small)
        }
        Figure::Controller => {
            let size = cli.size.unwrap_or([160, 120]);
            controller::findings(&street::open(folder, cli.small)?, cli.small, size)
        }
        Figure::Fading => fading::findings(&street::open(folder, cli.small)?, cli.small),
        Figure::Resident { rate, sun } => {
            let scenes = resident::scenes(folder, cli.small, cli.only.as_deref(), cli.size())?;
            resident::findings(&scenes, *rate, *sun)
        }
        Figure::Shapes => shapes::findings(&first_scenes(cli, folder)?, cli.size()),
        Figure::Cost => cost::findings(&first_scenes(cli, folder)?),
        Figure::Offset => offset::findings(&first_scenes(cli, folder)?, cli.size()),
        Figure::Directions { rate } => directions::findings(&directed_scenes(cli, folder)?, *rate),
    }
}

fn run(cli: &Cli) -> Result<(), Fault> {
    let scratch = tempfile::tempdir().map_err(|error| Fault::new("a folder for worlds", error))?;
    let findings = measured(cli, cli.worlds.as_deref().unwrap_or(scratch.path()))?;
    if let Some(folder) = &cli.out {
        findings.write(folder)?;
    }
    if cli.json {
        println!("{}", serde_json::json!({ "schema_version": 1, "findings": findings }));
    } else {
        findings.tables.iter().for_each(|table| println!("{}\n", table.text()));
        findings.remarks.iter().for_each(|remark| println!("{remark}"));
    }
    Ok(())
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("{fault}");
            ExitCode::from(2)
        }
    }
}
