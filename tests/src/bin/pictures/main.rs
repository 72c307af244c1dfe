//! Measures what the viewer draws, beside the papers' figures and the scheduler's predictions.

mod cost;
mod directions;
mod flights;
mod offset;
mod quality;
mod rank;
mod shapes;
mod streamed;
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
    after_help = "Examples:\n  pictures quality --out out\n  pictures streamed --small\n  pictures directions --worlds built --out out\n  pictures shapes --small --out out\n  pictures cost --worlds built\n  pictures offset --worlds built"
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
        /// Only flights whose names hold this
        #[arg(long, value_name = "TEXT")]
        only: Option<String>,
    },
    /// Similarity over time on a starved and a matched link: foresight, lookahead and 3d-tiles-renderer where no content
    /// shows one direction only, added-benefit in its place elsewhere
    Streamed {
        /// Pictures a second; divides 60
        #[arg(long, default_value_t = 2, value_name = "N", value_parser = rate)]
        rate: u64,
        /// Only flights whose names hold this
        #[arg(long, value_name = "TEXT")]
        only: Option<String>,
    },
    /// Circular, warped, elliptical, and hybrid splats with and without sphericality, against triangles (HIBR Figure 8)
    Shapes {
        /// Only flights whose names hold this
        #[arg(long, value_name = "TEXT")]
        only: Option<String>,
    },
    /// Milliseconds per million splats; what compressed textures save and lose
    Cost {
        /// Only flights whose names hold this
        #[arg(long, value_name = "TEXT")]
        only: Option<String>,
    },
    /// Pixels that differ 6.4 million metres from the origin
    Offset {
        /// Only flights whose names hold this
        #[arg(long, value_name = "TEXT")]
        only: Option<String>,
    },
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

/// Flights by world: the path, where it goes, and whether it calibrates.
const FLIGHTS: [(&str, &str, &str, bool); 8] = [
    ("city", "steady:speed=6,duration=24", "--place centre,height=25,yaw=30", true),
    ("city", "turn:speed=8,duration=24", "--place centre,height=60", false),
    ("terrain", "steady:speed=15,duration=24", "--place centre,height=60,yaw=45", false),
    ("terrain", "turn:speed=20,duration=24", "--place centre,height=120", true),
    ("asteroids", "steady:speed=5,duration=24", "--place centre,height=10,yaw=20", true),
    ("asteroids", "turn:speed=5,duration=24", "--place centre,height=30", false),
    ("mars", "steady:speed=4,duration=24", "--place centre,height=6,yaw=60", false),
    ("mars", "turn:speed=4,duration=24", "--place centre,height=15", true),
];

/// Columns and rows of the pictures.
fn size(small: bool) -> [u32; 2] {
    if small { [160, 120] } else { [640, 480] }
}

/// The flights through stored worlds, with whether they calibrate.
fn stored_scenes(folder: &Path, small: bool, only: Option<&str>) -> Result<Vec<(Scene, bool)>, Fault> {
    let mut scenes = Vec::new();
    for recipe in worlds::recipes(small) {
        for (world, path, words, calibrates) in FLIGHTS {
            let kind = path.split(':').next().unwrap_or_default();
            let name = format!("{}, {kind}", recipe.name);
            let is_its = recipe.name == world || (small && recipe.name.starts_with(world) && calibrates);
            if !is_its || only.is_some_and(|only| !name.contains(only)) {
                continue;
            }
            let world = recipe.build(folder)?;
            let words = if small { format!("{words} --duration 4") } else { words.to_owned() };
            let scene = Scene::open(name, &world.display().to_string(), path, &words, size(small))?;
            scenes.push((scene, calibrates));
        }
    }
    Ok(scenes)
}

/// One flight through each stored world.
fn first_scenes(folder: &Path, small: bool, only: Option<&str>) -> Result<Vec<Scene>, Fault> {
    let mut scenes: Vec<Scene> = stored_scenes(folder, small, only)?.into_iter().map(|(scene, _)| scene).collect();
    scenes.dedup_by(|a, b| a.name.split(',').next() == b.name.split(',').next());
    Ok(scenes)
}

/// Flights through worlds whose contents show every direction.
fn undirected_scenes(small: bool, only: Option<&str>) -> Result<Vec<Scene>, Fault> {
    let mut cases =
        vec![("generated city", if small { "city:blocks=2" } else { "city:blocks=6" }.to_owned(), FLIGHTS[0])];
    if let Some(data) = foresight_tests::data_folder().filter(|_| !small) {
        let tileset = data.join("scenes/mars_dingo_gap_3dtiles/tileset.json");
        cases.push(("Mars tileset", tileset.display().to_string(), FLIGHTS[6]));
    }
    cases.retain(|(name, ..)| only.is_none_or(|only| name.contains(only)));
    let open = |(name, world, (_, path, words, _)): (&str, String, (&str, &str, &str, bool))| {
        let words = if small { format!("{words} --duration 4") } else { words.to_owned() };
        Scene::open(name.to_owned(), &world, path, &words, size(small))
    };
    cases.into_iter().map(open).collect()
}

/// City and terrain with five and with nine directions.
fn directed_scenes(folder: &Path, small: bool) -> Result<Vec<(Scene, u32)>, Fault> {
    let mut scenes = Vec::new();
    for recipe in worlds::recipes(small) {
        let flight = FLIGHTS.iter().find(|flight| recipe.name.starts_with(flight.0) && flight.0 != "mars");
        let Some((_, path, words, _)) = flight else { continue };
        for directions in [5, 9] {
            let mut recipe = recipe.clone();
            recipe.directions = Some(directions);
            let world = recipe.build(&folder.join(format!("directions-{directions}")))?;
            let name = format!("{}, {directions} directions", recipe.name);
            let words = format!("{words} --duration {}", if small { 2 } else { 12 });
            let scene = Scene::open(name, &world.display().to_string(), path, &words, size(small))?;
            scenes.push((scene, directions));
        }
    }
    Ok(scenes)
}

fn measured(cli: &Cli, folder: &Path) -> Result<Findings, Fault> {
    match &cli.figure {
        Figure::Quality { rho, rate, policy, geometry, only } => {
            let scenes = stored_scenes(folder, cli.small, only.as_deref())?;
            let against = if *geometry { Against::Geometry } else { Against::Everything };
            quality::findings(&scenes, &quality::Plan { rho: *rho, rate: *rate, memory: MEMORY, against, policy })
        }
        Figure::Streamed { rate, only } => {
            let mut scenes = undirected_scenes(cli.small, only.as_deref())?;
            scenes.extend(
                stored_scenes(folder, cli.small, only.as_deref())?.into_iter().filter(|(_, c)| *c).map(|(s, _)| s),
            );
            streamed::findings(&scenes, *rate, MEMORY)
        }
        Figure::Shapes { only } => {
            shapes::findings(&first_scenes(folder, cli.small, only.as_deref())?, size(cli.small))
        }
        Figure::Cost { only } => cost::findings(&first_scenes(folder, cli.small, only.as_deref())?),
        Figure::Offset { only } => {
            offset::findings(&first_scenes(folder, cli.small, only.as_deref())?, size(cli.small))
        }
        Figure::Directions { rate } => directions::findings(&directed_scenes(folder, cli.small)?, *rate),
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
