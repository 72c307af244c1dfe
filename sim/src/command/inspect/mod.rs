//! `inspect`: what files contain, and the pressure to expect when they are replayed together.

mod link;
mod mesh;
mod path;
mod world;

use anyhow::bail;
use clap::Args;
use foresight_index::specification;
use foresight_index::surface::{self, SurfaceSource};
use foresight_index::world::{World, WorldError};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_sim::outcome::regime;
use foresight_sim::pressure::Needs;
use foresight_traces::arguments::{self, PathArgs};
use foresight_traces::link::LinkTrace;
use foresight_traces::path::{CameraPath, parse::is_path_like};
use std::io::Write;
use std::path::Path;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim inspect tiles/\n  foresight-sim inspect scan.obj,up=y\n  foresight-sim inspect mosaic16 walk.txt lte.down"
)]
pub(crate) struct InspectArgs {
    /// Worlds, meshes (GLB, glTF, OBJ, PLY), paths and links, told apart by their content; given a world and a path together, also the pressure
    #[arg(required = true, value_name = "FILE")]
    files: Vec<String>,
    #[command(flatten)]
    path_args: PathArgs,
}

enum Input {
    Mesh(Box<dyn SurfaceSource>),
    World(Box<World>),
    Path(CameraPath),
    Link(LinkTrace),
}

/// A mesh by its first bytes; else tries the other three kinds; if none fits, says why each does not. A table of positions and bitrates is a path and a link.
fn recognise(file: &str, args: &PathArgs) -> anyhow::Result<Vec<Input>> {
    if specification::is_specification(file) {
        return Ok(vec![Input::World(Box::new(arguments::world_named(file)?))]);
    }
    if surface::is_mesh(file) {
        let progress: specification::Progress = std::sync::Arc::new(|_, _| {});
        return Ok(vec![Input::Mesh(surface::open(file, &progress)?)]);
    }
    let generated = file.starts_with("constant:") || arguments::MADE_PATHS.iter().any(|made| file.starts_with(made));
    if !generated && !Path::new(file.split(',').next().unwrap_or(file)).exists() {
        bail!("{file}: no such file or directory; expected a world, a path or a link");
    }
    let path = Path::new(file);
    if (path.is_dir() || path.extension().is_some_and(|e| e == "json")) && !is_path_like(path) {
        return Ok(vec![Input::World(Box::new(foresight_index::world::open(path)?))]);
    }
    let as_path = arguments::open_vehicle(Some(file), args);
    let as_link = || foresight_traces::link::parse::from_specification(file);
    match as_path {
        Ok(path) => {
            let link = if Path::new(file).is_file() { as_link().ok() } else { None };
            Ok(std::iter::once(Input::Path(path)).chain(link.map(Input::Link)).collect())
        }
        Err(path_error) => match as_link() {
            Ok(link) => Ok(vec![Input::Link(link)]),
            Err(link_error) => match foresight_index::world::open(path) {
                Ok(world) => Ok(vec![Input::World(Box::new(world))]),
                Err(error @ (WorldError::Elevation(_) | WorldError::CityJson(_))) => Err(error.into()),
                Err(_) => bail!("{file} is neither a path ({path_error:#}) nor a link ({link_error})"),
            },
        },
    }
}

pub(crate) fn run(args: &InspectArgs) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let (mut worlds, mut paths, mut links) = (Vec::new(), Vec::new(), Vec::new());
    for file in &args.files {
        for input in recognise(file, &args.path_args)? {
            match input {
                Input::Mesh(source) => mesh::describe(&mut out, file, &*source)?,
                Input::World(world) => {
                    world::describe(&mut out, file, &world)?;
                    worlds.push(world);
                }
                Input::Path(path) => {
                    path::describe(&mut out, file, &path)?;
                    paths.push(arguments::carry_head(path, &args.path_args)?);
                }
                Input::Link(link) => {
                    link::describe(&mut out, file, &link)?;
                    links.push(link);
                }
            }
        }
    }
    for world in &worlds {
        for path in &paths {
            pressure(&mut out, world, path, &links, &args.path_args)?;
        }
    }
    Ok(())
}

fn megabytes(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

fn pressure(
    out: &mut impl Write,
    world: &World,
    path: &CameraPath,
    links: &[LinkTrace],
    args: &PathArgs,
) -> anyhow::Result<()> {
    let placed = arguments::place(path, world, false, args)?;
    let cuts = placed.flight.cuts(&world.tree, &CutSettings::default());
    let needs = Needs::new(&world.tree, &cuts);
    let seen = cuts.iter().filter(|c| c.total_weight > 0.0).count();
    let duration = placed.flight.duration();
    writeln!(out, "{} over {} ({}, {:.1} s)", path.name(), world.name, placed.place, duration.secs())?;
    for note in placed.notes.iter().skip(path.notes().len()) {
        writeln!(out, "  {note}")?;
    }
    writeln!(out, "  something is in view in {:.1} % of the frames", 100.0 * seen as f64 / cuts.len() as f64)?;
    writeln!(
        out,
        "  needs at 16 px: {:.2} MB on the wire in all; the largest view {:.2} MB decoded (μ = 1)",
        megabytes(needs.union_bytes),
        megabytes(needs.largest_bytes)
    )?;
    for link in links {
        let delivered = link.bytes_deliverable(Default::default(), duration) as f64;
        let rho = needs.union_bytes as f64 / delivered.max(1.0);
        let lambda = |mu: f64| {
            let budget = (mu * needs.largest_bytes as f64) as u64;
            needs.newly_needed_bytes(&world.tree, budget) as f64 / (duration.secs() * link.mean_rate())
        };
        let word = if rho < 0.1 { "policies cannot differ" } else { regime(rho) };
        writeln!(
            out,
            "  on {}: ρ = {rho:.3} ({word}); λ = {:.3}, {:.3}, {:.3} at μ = ¼, ½, 1",
            link.name(),
            lambda(0.25),
            lambda(0.5),
            lambda(1.0)
        )?;
    }
    Ok(())
}
