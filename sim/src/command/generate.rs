//! `generate`: worlds of any size.

use clap::{Args, Subcommand};
use foresight_index::generate::{city, mosaic};
use std::io::{IsTerminal, Write};
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  foresight-sim generate mosaic --from mars/ --grid 16 --out mars16\n  \
                        foresight-sim generate city --blocks 40 --seed 7 --out city40")]
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
    }
    Ok(())
}
