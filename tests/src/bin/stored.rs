//! Prints what a stored world has to show, beside the papers' figures.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use foresight_index::orthoview::Direction;
use foresight_tests::stored::headline::Plan as Headline;
use foresight_tests::stored::scene::Scene;
use foresight_tests::stored::sizes::Sizes;
use foresight_tests::stored::{Fault, Findings, codec, connectivity, correct, headline, levels, linear, storage};

/// Measures orthoviews: whether they are right, what they cost, how building grows, and what a moving viewer needs
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  stored correct\n  stored correct --world TILESET --leaf 16 --pixels 256 --report out\n  \
                        stored codecs --world city:blocks=4\n  stored linear --blocks 2,4,8,16 --city pitch=40m,street=8m --leaf 40 --pixels 32 --count --report out\n  stored storage\n  \
                        stored levels --world TILESET --leaf 32\n  \
                        stored headline --json"
)]
struct Cli {
    #[command(subcommand)]
    figure: Figure,
    /// Print one JSON document
    #[arg(long, global = true)]
    json: bool,
    /// Write plots (SVG) and pictures (PNG) into this folder
    #[arg(long, global = true, value_name = "DIR")]
    report: Option<PathBuf>,
}

/// A world and how it is cut.
#[derive(Clone, Debug, Args)]
struct World {
    /// A tileset.json, or city:blocks=N,…, which is made for it
    #[arg(long, default_value = "city:blocks=4", value_name = "WORLD")]
    world: String,
    /// Side of a leaf, metres
    #[arg(long, default_value_t = 100.0, value_name = "METRES")]
    leaf: f64,
    /// Pixels along a leaf's side
    #[arg(long, default_value_t = 256.0, value_name = "PIXELS")]
    pixels: f64,
}

impl World {
    fn open(&self) -> Result<Scene, Fault> {
        Scene::open(&self.world, self.leaf, self.pixels)
    }
}

#[derive(Debug, Subcommand)]
enum Figure {
    /// Leaves against ray-cast ground truth, parents against drawing them directly and against supersampling (HIBR Figure
    /// 6), connectivity on made cases
    Correct {
        #[command(flatten)]
        world: World,
        /// Leaves that rays are cast into, by lot
        #[arg(long, default_value_t = 6, value_name = "N")]
        leaves: usize,
        /// Cells of each level above, by lot
        #[arg(long, default_value_t = 2, value_name = "N")]
        parents: usize,
        /// Highest level that is supersampled: memory grows by 4 with each
        #[arg(long, default_value_t = 2, value_name = "LEVEL")]
        level_max: u32,
        /// Number of directions, of the nine
        #[arg(long, default_value_t = 9, value_name = "N")]
        directions: usize,
        /// For what is drawn by lot
        #[arg(long, default_value_t = 1, value_name = "N")]
        seed: u64,
    },
    /// Bytes against fidelity of colours, normals, depths and links, by codec
    Codecs {
        #[command(flatten)]
        world: World,
        /// Cells of each level at most
        #[arg(long, default_value_t = 8, value_name = "N")]
        cells: usize,
    },
    /// Bytes, instructions, time and memory of building against leaf cells (HIBR Figure 9)
    Linear {
        /// Blocks along the city's side
        #[arg(long, value_delimiter = ',', default_value = "2,4,8,16", value_name = "N,…")]
        blocks: Vec<u32>,
        /// Further parameters of the city
        #[arg(long, default_value = "", value_name = "KEY=VALUE,…")]
        city: String,
        /// Side of a leaf, metres
        #[arg(long, default_value_t = 100.0, value_name = "METRES")]
        leaf: f64,
        /// Pixels along a leaf's side
        #[arg(long, default_value_t = 128.0, value_name = "PIXELS")]
        pixels: f64,
        /// Count instructions too: under valgrind, some 20 times as long
        #[arg(long)]
        count: bool,
        /// Build this world only, and print its figures
        #[arg(long, hide = true, value_name = "WORLD")]
        one: Option<String>,
        /// With --one: open the world, but do not build
        #[arg(long, hide = true)]
        unbuilt: bool,
    },
    /// Orthoviews as a share of the geometry, beside HIBR and DRVW
    Storage {
        /// WORLD,LEAF METRES,PIXELS; may be repeated
        #[arg(long = "case", value_name = "CASE", default_values_t = ["city:blocks=8;200;512".to_owned(), "city:blocks=8;100;128".to_owned()])]
        cases: Vec<String>,
    },
    /// Levels of detail of leaves: bytes and measured errors, packings, the simplifier's claims, triangles a second
    Levels {
        /// A mesh, tileset or city model, or the parameters of a generated world
        #[arg(long, default_value = "city:blocks=4", value_name = "WORLD")]
        world: String,
        /// Side of a leaf, metres
        #[arg(long, default_value_t = 64.0, value_name = "METRES")]
        leaf: f64,
        /// Leaves that are looked at, at most
        #[arg(long, default_value_t = 64, value_name = "N")]
        leaves: usize,
    },
    /// Cells and bandwidth as the world grows, DRVW Table 1 and Figure 6, time to a first view
    Headline {
        #[command(flatten)]
        world: World,
        /// Areas, km²
        #[arg(long, value_delimiter = ',', default_value = "1,2,4,8,16,32,64,128,256,512,1024", value_name = "KM²,…")]
        areas: Vec<f64>,
        /// Trips for each area
        #[arg(long, default_value_t = 24, value_name = "N")]
        trips: usize,
        /// Their seconds
        #[arg(long, default_value_t = 24.0, value_name = "SECONDS")]
        seconds: f64,
        /// Runs for each speed of the table
        #[arg(long, default_value_t = 3, value_name = "N")]
        runs: usize,
        /// Their seconds
        #[arg(long, default_value_t = 400.0, value_name = "SECONDS")]
        run_seconds: f64,
        /// The slower link of the bursts, Mbit/s
        #[arg(long, default_value_t = 50.0, value_name = "MBIT")]
        broadband: f64,
        /// Of catalogues and trips
        #[arg(long, default_value_t = 1, value_name = "N")]
        seed: u64,
    },
}

fn measured(figure: Figure) -> Result<Findings, Fault> {
    match figure {
        Figure::Correct { world, leaves, parents, level_max, directions, seed } => {
            let scene = world.open()?;
            let directions: Vec<Direction> = scene.directions.into_iter().take(directions).collect();
            let mut findings =
                correct::findings(&scene, &correct::Plan { leaves, parents, level_max, directions, seed })?;
            findings.join(connectivity::findings()?);
            Ok(findings)
        }
        Figure::Codecs { world, cells } => {
            let scene = world.open()?;
            let samples = codec::samples(&scene, cells)?;
            codec::findings(&scene.name, &samples)
        }
        Figure::Linear { blocks, city, leaf, pixels, count, .. } => {
            let program = std::env::current_exe().map_err(|e| Fault::new("this program", e))?;
            linear::findings(&linear::Plan { blocks, city: &city, leaf: (leaf, pixels), program: &program, count })
        }
        Figure::Storage { cases } => {
            let scenes: Vec<Scene> = cases
                .iter()
                .map(|case| {
                    let fault = || Fault::new(case, "expected WORLD;LEAF METRES;PIXELS");
                    let (rest, pixels) = case.rsplit_once(';').ok_or_else(fault)?;
                    let (world, leaf) = rest.rsplit_once(';').ok_or_else(fault)?;
                    let [leaf, pixels] = [leaf, pixels].map(|v| v.parse().map_err(|_| fault()));
                    Scene::open(world, leaf?, pixels?)
                })
                .collect::<Result<_, Fault>>()?;
            storage::findings(&scenes)
        }
        Figure::Levels { world, leaf, leaves } => levels::measure(&world, leaf, leaves),
        Figure::Headline { world, areas, trips, seconds, runs, run_seconds, broadband, seed } => {
            let sizes = Sizes::measured(&world.open()?)?;
            headline::findings(&sizes, &Headline { areas, trips, seconds, table: (run_seconds, runs), broadband, seed })
        }
    }
}

/// A single world's figures, for `linear`, which starts this program anew for each.
fn one(world: &str, leaf: f64, pixels: f64, unbuilt: bool) -> Result<(), Fault> {
    let scene = Scene::open(world, leaf, pixels)?;
    let built = if unbuilt { linear::Built::default() } else { linear::built(&scene)? };
    println!("{}", serde_json::to_string(&built).map_err(|e| Fault::new(world, e))?);
    Ok(())
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let outcome = match &cli.figure {
        Figure::Linear { one: Some(world), leaf, pixels, unbuilt, .. } => one(world, *leaf, *pixels, *unbuilt),
        _ => measured(cli.figure).and_then(|findings| {
            if let Some(folder) = &cli.report {
                findings.write(folder)?;
            }
            if cli.json {
                println!("{}", serde_json::json!({ "schema_version": 1, "findings": findings }));
            } else {
                findings.tables.iter().for_each(|table| println!("{}\n", table.text()));
                findings.remarks.iter().for_each(|remark| println!("{remark}"));
            }
            Ok(())
        }),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(fault) => {
            eprintln!("{fault}");
            ExitCode::from(2)
        }
    }
}
