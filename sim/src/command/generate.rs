//! `generate`: worlds of any size, and recordings of paths.

use super::inputs::{self, PathArgs};
use anyhow::Context;
use clap::{Args, Subcommand};
use foresight_index::generate::{city, mosaic};
use foresight_sim::path::recording::Writer;
use std::ffi::OsString;
use std::io::{BufWriter, IsTerminal, Write};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  foresight-sim generate mosaic --from mars/ --grid 16 --out mars16\n  \
                        foresight-sim generate city --blocks 40 --seed 7 --out city40\n  \
                        foresight-sim generate path --path teleport:every=5 --out jumps.jsonl")]
pub(crate) struct GenerateArgs {
    #[command(subcommand)]
    what: What,
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
    /// Streets, blocks and buildings from a seed.
    City {
        /// Blocks along each side, 100 m apart
        #[arg(long, default_value_t = 20, value_name = "N")]
        blocks: u32,
        /// Names the city among those of its size
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Directory to write; must not exist or be empty
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
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

pub(crate) fn run(args: GenerateArgs) -> anyhow::Result<()> {
    match args.what {
        What::Mosaic { from, grid, out } => {
            let shows_progress = std::io::stderr().is_terminal();
            let made = mosaic::mosaic(&from, grid, &out, &mut |done, all| {
                if shows_progress {
                    eprint!("\rcopied {:.1} of {:.1} MB", done as f64 / 1e6, all as f64 / 1e6);
                }
            })?;
            if shows_progress {
                eprint!("\r\x1b[K");
            }
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
        What::City { blocks, seed, out } => {
            let params = city::CityParams { blocks_x: blocks, blocks_y: blocks, seed, ..city::CityParams::default() };
            let world = city::city(&params)?;
            city::write(&params, &out)?;
            writeln!(
                std::io::stdout(),
                "{}: {} representations in {} nodes",
                out.display(),
                world.tree.representations(),
                world.tree.nodes()
            )?;
        }
        What::Path(args) => record(&args)?,
    }
    Ok(())
}

fn record(args: &PathToRecord) -> anyhow::Result<()> {
    let path = inputs::open_path(args.path.as_deref(), &args.path_args)?;
    let samples = inputs::samples(&path, &args.path_args)?;
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
