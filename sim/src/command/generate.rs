//! `generate`: worlds of any size, and recordings of paths.

use anyhow::Context;
use clap::{Args, Subcommand};
use foresight_index::generate::asteroids::{self, AsteroidParams};
use foresight_index::generate::city::{self, CityParams};
use foresight_index::generate::document::{self, Params};
use foresight_index::generate::mosaic;
use foresight_index::generate::terrain::{self, TerrainParams};
use foresight_index::generate::tileset::Written;
use foresight_traces::arguments::{self, PathArgs};
use foresight_traces::path::recording::Writer;
use std::ffi::OsString;
use std::io::{BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  foresight-sim generate mosaic --from mars/ --grid 16 --out mars16\n  \
                        foresight-sim generate city --blocks 40 --seed 7 --out city40\n  \
                        foresight-sim generate terrain --size 20km --resolution 10m --out alps\n  \
                        foresight-sim generate asteroids --catalogue-only --out belt\n  \
                        foresight-sim generate path --path teleport:every=5 --out jumps.jsonl\n\n\
                        The same worlds without a folder: --world city:blocks=40,seed=7, --world city:blocks=40,orthoviews=256 (with the sizes of orthoviews instead of coarse geometry), --world terrain:size=20km, --world asteroids:, \
                        --world mosaic:mars/,grid=16")]
pub(crate) struct GenerateArgs {
    #[command(subcommand)]
    what: What,
}

/// Where a generated world goes.
#[derive(Debug, Args)]
struct Out {
    /// Directory to write; must not exist or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Write the parameters only: the world is made from them whenever it is opened, up to 16,777,216 representations
    #[arg(long)]
    catalogue_only: bool,
}

#[derive(Debug, Subcommand)]
enum What {
    /// A real 3D Tiles tileset instanced K × K under a quadtree of coarser, synthetic tiles.
    Mosaic {
        /// The tileset: tileset.json, or the directory with it
        #[arg(long, value_name = "TILESET")]
        from: PathBuf,
        /// Instances along each side
        #[arg(long, value_name = "K")]
        grid: u32,
        /// Directory to write; must not exist or be empty
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Streets, blocks and buildings from a seed. Without --catalogue-only a 3D Tiles tileset of at most 200,000 tiles (about
    /// 60 × 60 blocks) with façades, windows, trees and textures; with it, sizes are modelled.
    City {
        /// Blocks along each side, 100 m apart
        #[arg(long, default_value_t = 20, value_name = "N")]
        blocks: u32,
        /// Names the city among those of its size
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Pixels along a cell's orthoviews in the catalogue, 16 to 4096; 0 for coarse geometry instead
        #[arg(long, default_value_t = 0, value_name = "N", requires = "catalogue_only")]
        orthoviews: u32,
        #[command(flatten)]
        out: Out,
    },
    /// Fractal terrain from a seed: a quadtree of tiles of 64 × 64 cells. Without --catalogue-only a 3D Tiles tileset of at
    /// most 40,000 tiles of about 150 kB, its errors measured, without imagery; with it, errors and sizes are modelled, imagery included.
    Terrain {
        /// Side of the square, such as 40km
        #[arg(long, default_value = "40km", value_name = "LENGTH", value_parser = length)]
        size: f64,
        /// Between samples of the finest tiles, such as 10m
        #[arg(long, default_value = "10m", value_name = "LENGTH", value_parser = length)]
        resolution: f64,
        /// Names the terrain among those of its size
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// From the lowest to the highest place that there could be
        #[arg(long, default_value = "2km", value_name = "LENGTH", value_parser = length)]
        relief: f64,
        /// Texels along a side of a tile's imagery in the catalogue; 0 for none
        #[arg(long, default_value_t = 512, value_name = "N")]
        texels: u32,
        #[command(flatten)]
        out: Out,
    },
    /// Models floating in space, under an octree. Without --catalogue-only a 3D Tiles tileset of at most 200,000 tiles whose
    /// models share the files of 16 shapes.
    Asteroids {
        /// Models
        #[arg(long, default_value_t = 29_264, value_name = "N")]
        count: u32,
        /// Names the field among those of its size
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Triangles of a model's finest level
        #[arg(long, default_value_t = 97_000, value_name = "N")]
        triangles: u32,
        /// Mean distance between neighbours
        #[arg(long, default_value = "1km", value_name = "LENGTH", value_parser = length)]
        spacing: f64,
        /// Mean radius of the largest models; the smallest have a tenth of it
        #[arg(long, default_value = "200m", value_name = "LENGTH", value_parser = length)]
        radius: f64,
        #[command(flatten)]
        out: Out,
    },
    /// Any path as a recording of our own, placed by no world.
    Path(Box<PathToRecord>),
}

#[derive(Debug, Args)]
struct PathToRecord {
    /// A recording, or steady, turn, teleport with their options; the built-in flight if not given
    #[arg(long, value_name = "PATH")]
    path: Option<String>,
    #[command(flatten)]
    path_args: PathArgs,
    /// File to write, JSON lines; replaced if it exists
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

fn length(text: &str) -> Result<f64, String> {
    document::length(text).ok_or_else(|| format!("`{text}`; expected a length such as 40km or 250m"))
}

pub(crate) fn run(args: GenerateArgs) -> anyhow::Result<()> {
    match args.what {
        What::Mosaic { from, grid, out } => {
            let mut line = ProgressLine::new();
            let made = mosaic::mosaic(&from, grid, &out, &mut |done, all| {
                line.show(&format!("copied {:.1} of {:.1} MB", done as f64 / 1e6, all as f64 / 1e6));
            })?;
            drop(line);
            writeln!(
                std::io::stdout(),
                "{}: {} instances {:.1} m × {:.1} m apart under {} synthetic tiles, {} representations; one copy of {} files, {:.1} MB",
                out.display(),
                made.instances,
                made.pitch[0],
                made.pitch[1],
                made.coarse_tiles,
                made.representations,
                made.files,
                made.bytes as f64 / 1e6
            )?;
        }
        What::City { blocks, seed, orthoviews, out } => {
            let params = CityParams { blocks_x: blocks, blocks_y: blocks, seed, orthoviews, ..CityParams::default() };
            if out.catalogue_only {
                catalogue(&params, &out.out)?;
            } else {
                let mut line = ProgressLine::new();
                geometry(&out.out, city::geometry::write(&params, &out.out, &mut |done, all| line.files(done, all)))?;
            }
        }
        What::Terrain { size, resolution, seed, relief, texels, out } => {
            let params = TerrainParams { size, resolution, seed, relief, texels };
            if out.catalogue_only {
                catalogue(&params, &out.out)?;
            } else {
                let mut line = ProgressLine::new();
                geometry(&out.out, terrain::write(&params, &out.out, &mut |done, all| line.files(done, all)))?;
            }
        }
        What::Asteroids { count, seed, triangles, spacing, radius, out } => {
            let params = AsteroidParams { count, seed, triangles, spacing, radius };
            if out.catalogue_only {
                catalogue(&params, &out.out)?;
            } else {
                let mut line = ProgressLine::new();
                geometry(&out.out, asteroids::write(&params, &out.out, &mut |done, all| line.files(done, all)))?;
            }
        }
        What::Path(args) => record(&args)?,
    }
    Ok(())
}

fn record(args: &PathToRecord) -> anyhow::Result<()> {
    let path = arguments::open_path(args.path.as_deref(), &args.path_args)?;
    let samples = arguments::samples(&path, &args.path_args)?;
    // Beside it first: a recording is there whole or not at all.
    let mut beside = OsString::from(&args.out);
    beside.push(".partial");
    let beside = PathBuf::from(beside);
    let name = beside.display().to_string();
    let file = std::fs::File::create(&beside).with_context(|| name.clone())?;
    let mut writer = Writer::new(&name, BufWriter::new(file), path.frame(), path.up())?;
    for sample in &samples {
        writer.push(sample)?;
    }
    writer.finish()?;
    std::fs::rename(&beside, &args.out).with_context(|| args.out.display().to_string())?;
    let mut out = std::io::stdout();
    let duration = samples.last().map_or(0.0, |last| last.t);
    writeln!(out, "{}: {} poses over {duration:.2} s", args.out.display(), samples.len())?;
    for note in path.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}

/// Makes the world once, so that what is written can be opened, and writes its parameters.
fn catalogue<P: Params>(params: &P, out: &Path) -> anyhow::Result<()> {
    let world = params.build()?;
    document::write(params, out)?;
    let (representations, nodes) = (world.tree.representations(), world.tree.nodes());
    writeln!(std::io::stdout(), "{}: {representations} representations in {nodes} nodes", out.display())?;
    Ok(())
}

fn geometry<E: Into<anyhow::Error>>(out: &Path, written: Result<Written, E>) -> anyhow::Result<()> {
    let Written { tiles, files, bytes } = written.map_err(Into::into)?;
    writeln!(std::io::stdout(), "{}: {tiles} tiles, {files} files, {:.1} MB", out.display(), bytes as f64 / 1e6)?;
    Ok(())
}

/// A line on a terminal's standard error that is written over, and taken away at the end.
struct ProgressLine {
    is_terminal: bool,
}

impl ProgressLine {
    fn new() -> ProgressLine {
        ProgressLine { is_terminal: std::io::stderr().is_terminal() }
    }

    fn show(&mut self, text: &str) {
        if self.is_terminal {
            eprint!("\r\x1b[K{text}");
        }
    }

    fn files(&mut self, done: u64, all: u64) {
        self.show(&format!("wrote {done} of {all} files"));
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        self.show("");
    }
}
