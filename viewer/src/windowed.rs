//! `foresight-viewer` in a window.

use crate::arguments::Cli;
use crate::arguments::window::ControlsWord;
use crate::no_draw::{choose, print};
use anyhow::{Context, bail};
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_traces::arguments;
use foresight_viewer::clock::Clock;
use foresight_viewer::controls::rig::Mode;
use foresight_viewer::fetch::Http;
use foresight_viewer::scene::source::Source;
use foresight_viewer::window::{self, Decider, Outcome, WindowSettings};
use std::sync::Arc;

/// The default of α.
const ALPHA: f64 = 0.7;

/// What carries contents where no link is given: a disk.
const DISK: &str = "constant:4Gbit,1ms";

/// Whether memory stayed within its budget.
pub(crate) fn run(cli: &Cli) -> anyhow::Result<bool> {
    let args = &cli.window_args;
    let name = cli.world_name().context(
        "a window needs --world WORLD; with --server too: it tells where the contents that the server sends belong",
    )?;
    if cli.announce > 0.0 {
        bail!(
            "--announce {}: in a window nobody knows the path beforehand; expected --headless or --no-draw",
            cli.announce
        );
    }
    if cli.rate().is_some() {
        bail!("--rate is for --headless and --no-draw; a window draws as often as it can");
    }
    let (mut world, source) = Source::open(name).context("--world")?;
    if name.contains(':') && world.name.is_empty() {
        name.clone_into(&mut world.name);
    }
    let path = if cli.has_path() { Some(cli.path(Some(&world))?.views) } else { None };
    let decider = match cli.server() {
        Some(_) => remote(cli, world.tree.representations())?,
        None => local(cli, &world)?,
    };
    let (memory, environment) = (cli.memory, cli.environment(&world));
    let (compression, sky) = (cli.compression(), cli.sky(&world, &source));
    let outcome = window::run(WindowSettings {
        world: Arc::new(world),
        source: Arc::new(source),
        decider,
        memory,
        contents_memory: cli.contents_memory(),
        environment,
        path,
        closes: args.close,
        mode: match args.controls {
            ControlsWord::Fly => Mode::Fly,
            ControlsWord::Walk => Mode::Walk,
            ControlsWord::Orbit => Mode::Orbit,
        },
        fov_y: cli.path_args.fov_y()?,
        size: cli.path_args.viewport(),
        captures: args.captures.clone(),
        frame_s: args.frame_time.filter(|&ms| ms > 0.0).map(|ms| ms * 1e-3),
        compression,
        sky,
        clock: Clock::start(),
    })?;
    print(cli.json, &outcome, text)?;
    Ok(outcome.memory_max <= outcome.memory_budget)
}

fn local(cli: &Cli, world: &foresight_index::world::World) -> anyhow::Result<Decider> {
    let mut policies = PolicySpec::parse_list(cli.policy.as_deref().unwrap_or("foresight"), ALPHA, None)?;
    let (Some(mut policy), None) = (policies.pop(), policies.pop()) else {
        bail!("--policy {}; expected one", cli.policy.as_deref().unwrap_or_default());
    };
    policy.settings.reach.up = world.up;
    let link = match cli.link()? {
        Some(link) => link,
        None => arguments::open_link(Some(DISK))?,
    };
    Ok(Decider::Local { policy: Box::new(policy), link, scheduler: cli.scheduler() })
}

fn remote(cli: &Cli, representations: usize) -> anyhow::Result<Decider> {
    let mut plan = cli.plan()?;
    let http = Http::new(cli.http()).context("HTTP")?;
    let runtime = crate::runtime(cli.threads)?;
    let world = runtime.block_on(choose(&http, &plan.address.origin, &plan.world))?;
    if world.content != "files" {
        bail!(
            "{}: the contents of {} are made up, and cannot be drawn; expected a world of files",
            plan.address.origin,
            world.name
        );
    }
    plan.has_files = true;
    plan.world = world.name;
    Ok(Decider::Remote { plan: Box::new(plan), representations, http, runtime })
}

fn text(s: &Outcome) -> String {
    let files: Vec<_> = s.files.iter().map(|file| format!("\n  {}", file.display())).collect();
    format!(
        "{:.1} s in {}, policy {}, drawn by {}\n  {} frames, {:.1} ms from one to the next (median)\n  {} contents shown, {} broken; {:.2} MB received; \
         memory: {:.2} of {:.2} MB at most\n  the graphics device was lost {} times, the server was away {} times{}\n",
        s.seconds,
        s.world,
        s.policy,
        s.adapter,
        s.frames,
        s.frame_ms,
        s.shown,
        s.broken,
        s.bytes_received as f64 / 1e6,
        s.memory_max as f64 / 1e6,
        s.memory_budget as f64 / 1e6,
        s.devices_lost,
        s.server_away,
        files.concat()
    )
}
