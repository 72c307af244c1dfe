//! `inspect`: what files contain, and the pressure to expect when they are replayed together.

use super::inputs::{self, PathArgs};
use anyhow::bail;
use clap::Args;
use foresight_index::world::{self, World};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_sim::link::{self, LinkStatistics, LinkTrace};
use foresight_sim::path::CameraPath;
use foresight_sim::pressure::Needs;
use std::io::{Read, Write};
use std::path::Path;

#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  foresight-sim inspect tiles/\n  foresight-sim inspect mosaic16 walk.txt lte.down")]
pub(crate) struct InspectArgs {
    /// Worlds, paths and links, told apart by their content; given a world and a path together, also the pressure
    #[arg(required = true, value_name = "FILE")]
    files: Vec<String>,
    #[command(flatten)]
    path_args: PathArgs,
}

enum Input {
    World(Box<World>),
    Path(CameraPath),
    Link(LinkTrace),
}

/// Tries the three kinds; if none fits, says why each does not. A recording of a camera and its link is both.
fn recognise(file: &str, args: &PathArgs) -> anyhow::Result<Vec<Input>> {
    let generated = file.starts_with("constant:") || inputs::MADE_PATHS.iter().any(|made| file.starts_with(made));
    if !generated && !Path::new(file.split(',').next().unwrap_or(file)).exists() {
        bail!("{file}: no such file or directory; expected a world, a path or a link");
    }
    let path = Path::new(file);
    if path.is_dir() || path.extension().is_some_and(|e| e == "json") && !begins_a_list(path) {
        return Ok(vec![Input::World(Box::new(world::open(path)?))]);
    }
    let as_path = inputs::open_vehicle(Some(file), args);
    let as_link = link::parse::from_specification(file);
    match (as_path, as_link) {
        (Ok(path), Ok(link)) => Ok(vec![Input::Path(path), Input::Link(link)]),
        (Ok(path), Err(_)) => Ok(vec![Input::Path(path)]),
        (Err(_), Ok(link)) => Ok(vec![Input::Link(link)]),
        (Err(path_error), Err(link_error)) => match world::open(path) {
            Ok(world) => Ok(vec![Input::World(Box::new(world))]),
            Err(_) => bail!("{file} is neither a path ({path_error:#}) nor a link ({link_error})"),
        },
    }
}

/// Whether the file's first bytes begin a JSON list: a SABRE trace rather than a tileset.
fn begins_a_list(file: &Path) -> bool {
    let mut first = [0; 64];
    let read = std::fs::File::open(file).and_then(|mut file| file.read(&mut first));
    read.is_ok_and(|count| link::sabre::is_sabre(&first[..count]))
}

pub(crate) fn run(args: &InspectArgs) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let (mut worlds, mut paths, mut links) = (Vec::new(), Vec::new(), Vec::new());
    for file in &args.files {
        for input in recognise(file, &args.path_args)? {
            match input {
                Input::World(world) => {
                    describe_world(&mut out, file, &world)?;
                    worlds.push(world);
                }
                Input::Path(path) => {
                    describe_path(&mut out, file, &path)?;
                    paths.push(inputs::carry_head(path, &args.path_args)?);
                }
                Input::Link(link) => {
                    describe_link(&mut out, file, &link)?;
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

fn describe_world(out: &mut impl Write, file: &str, world: &World) -> std::io::Result<()> {
    let summary = world.summary();
    let size = summary.bounds.max - summary.bounds.min;
    writeln!(out, "{file}: world, {}", world.kind)?;
    writeln!(
        out,
        "  {} representations on {} nodes, {} of them leaves; depth {}",
        summary.representations, summary.nodes, summary.leaves, summary.depth
    )?;
    writeln!(
        out,
        "  {:.2} MB on the wire, {:.2} MB decoded with mips; {:.1} MB of memory for the tree ({:.1} bytes a representation)",
        megabytes(summary.wire_bytes),
        megabytes(summary.decoded_bytes),
        megabytes(world.tree.heap_bytes() as u64),
        world.tree.heap_bytes() as f64 / summary.representations.max(1) as f64
    )?;
    writeln!(out, "  extent {:.2} × {:.2} × {:.2} m, up {:.3}", size.x, size.y, size.z, world.up)?;
    for note in &world.notes {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}

fn describe_path(out: &mut impl Write, file: &str, path: &CameraPath) -> std::io::Result<()> {
    let poses = path.poses();
    let mut length = 0.0;
    let (mut low, mut high) = (poses[0].position, poses[0].position);
    for pair in poses.windows(2) {
        length += pair[0].position.distance(pair[1].position);
        low = low.min(pair[1].position);
        high = high.max(pair[1].position);
    }
    let duration = path.duration();
    writeln!(out, "{file}: path")?;
    writeln!(
        out,
        "  {} poses over {duration:.2} s ({:.1} Hz); {length:.1} m long, {:.2} m/s on average",
        poses.len(),
        (poses.len() - 1) as f64 / duration,
        length / duration
    )?;
    writeln!(out, "  extent {:.2} m, up {:.3}", high - low, path.up())?;
    for note in path.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}

fn describe_link(out: &mut impl Write, file: &str, link: &LinkTrace) -> std::io::Result<()> {
    writeln!(out, "{file}: link")?;
    let (least, greatest) = link.rtt_range();
    writeln!(
        out,
        "  {:.3} Mbit/s on average over {:.2} s, then it repeats; round trip {}",
        link.mean_rate() * 8e-6,
        link.period().secs(),
        if least == greatest {
            format!("{:.1} ms", least.secs() * 1e3)
        } else {
            format!("{:.1} to {:.1} ms", least.secs() * 1e3, greatest.secs() * 1e3)
        }
    )?;
    let statistics = LinkStatistics::new(link);
    let [p05, p25, median, p75, p95] = statistics.percentiles.map(|rate| format!("{:.3}", rate * 8e-6));
    writeln!(out, "  by the second: median {median} Mbit/s; 5, 25, 75, 95 %: {p05}, {p25}, {p75}, {p95} Mbit/s")?;
    writeln!(
        out,
        "  {:.1} % of the seconds deliver less than 5 % of the mean, at most {:.0} s in a row; longest time without a byte {:.3} s",
        statistics.near_zero_share * 100.0,
        statistics.longest_near_zero.secs(),
        statistics.longest_outage.secs()
    )?;
    if link.loss() > 0.0 {
        writeln!(out, "  {:.2} % of the requests fail", link.loss() * 100.0)?;
    }
    for note in link.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}

fn pressure(
    out: &mut impl Write,
    world: &World,
    path: &CameraPath,
    links: &[LinkTrace],
    args: &PathArgs,
) -> anyhow::Result<()> {
    let placed = inputs::place(path, world, false, args)?;
    let cuts = placed.flight.cuts(&world.tree, &CutSettings::default());
    let needs = Needs::new(&world.tree, &cuts);
    let seen = cuts.iter().filter(|c| c.total_weight > 0.0).count();
    let duration = placed.flight.duration();
    writeln!(out, "{} over {} ({}, {:.1} s)", path.name(), world.name, placed.place, duration.secs())?;
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
        let word = match rho {
            r if r > 2.0 => "starved",
            r if r < 0.1 => "policies cannot differ",
            r if r < 0.5 => "ample",
            _ => "matched",
        };
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
