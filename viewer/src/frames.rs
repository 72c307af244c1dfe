//! `foresight-viewer --headless`.

use crate::arguments::headless::{AgainstWord, LightWord};
use crate::arguments::{Cli, LINK};
use crate::no_draw::print;
use anyhow::{Context, bail};
use foresight_index::world::WorldKind;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_traces::arguments;
use foresight_traces::client::ClientSettings;
use foresight_viewer::clock::Clock;
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::gpu::{GpuSettings, Light, RenderSettings};
use foresight_viewer::headless::{self, Against, Headless, Summary};
use foresight_viewer::offscreen::Offscreen;
use foresight_viewer::scene::source::Source;
use std::io::IsTerminal;

/// Pictures a second where nothing is said: software takes a second for one.
const RATE: u64 = 2;

/// Notes on an imported world that are printed.
const NOTES: usize = 5;

/// Most bytes of environment maps with everything resident.
const REFERENCE_MAPS: u64 = 2 << 30;

/// The default of α.
const ALPHA: f64 = 0.7;

pub(crate) fn run(cli: &Cli) -> anyhow::Result<bool> {
    let args = &cli.headless_args;
    let frames = args.frames.as_deref().context("--headless needs --frames DIR")?;
    if cli.server().is_some() {
        bail!("--headless runs on a virtual clock, which no server follows; expected --world without --server");
    }
    let name = cli.world_name().context("--headless needs --world WORLD")?;
    let ticks_per_picture = cli.ticks(RATE)?;
    let link = match cli.link()? {
        Some(link) => link,
        None => arguments::open_link(Some(LINK))?,
    };
    let mut policies = PolicySpec::parse_list(cli.policy.as_deref().unwrap_or("foresight"), ALPHA, None)?;
    let (Some(mut policy), None) = (policies.pop(), policies.pop()) else {
        bail!("--policy {}; expected one", cli.policy.as_deref().unwrap_or_default());
    };
    if let Some(threads) = cli.threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global().context("starting threads")?;
    }
    let (world, source) = Source::open(name).context("--world")?;
    if let Some(why) = source.refusal() {
        bail!("--world {name}: {why}");
    }
    if world.kind != WorldKind::Built {
        arguments::world_notes(&world, NOTES).iter().for_each(|note| eprintln!("{note}"));
    }
    policy.settings.reach.up = world.up;
    let mut flight = cli.path(Some(&world))?;
    flight.views.iter_mut().for_each(|view| view.viewport = args.size);
    let light = match args.light {
        LightWord::Unlit => Light::Unlit,
        LightWord::Sun => Offscreen::sun(&world),
    };
    let background = cli.sky(&world, &source).background(world.up);
    let settings = RenderSettings { light, background, ..Offscreen::settings(&world, &source) };
    let mut offscreen = Offscreen::new(&world, &source, &GpuSettings::default(), settings)?;
    offscreen.set_compression(cli.compression());
    // With everything resident there is no budget but the machine's.
    let maps_memory = if args.reference { REFERENCE_MAPS } else { cli.memory };
    let flown = Headless {
        world: &world,
        flight: &flight,
        link: &link,
        policy: &policy,
        scheduler: cli.scheduler(),
        client: ClientSettings { announce_s: cli.announce, ..ClientSettings::default() },
        everything: args.reference,
        against: match args.against {
            AgainstWord::Everything => Against::Everything,
            AgainstWord::Geometry => Against::Geometry,
        },
        choose: ChooseSettings::default(),
        environment: cli.environment(&world).map(|environment| (environment, maps_memory)),
        ticks_per_picture,
    };
    let (clock, shows) = (Clock::start(), std::io::stderr().is_terminal());
    let summary = headless::run(&flown, &mut offscreen, frames, &mut |done, all, _| {
        if shows {
            let left = clock.now_ns() as f64 / 1e9 / done as f64 * (all - done) as f64;
            eprint!("\r{done} of {all} pictures, {left:.0} s left\x1b[K");
        }
    });
    if shows {
        eprint!("\r\x1b[K");
    }
    let summary = summary?;
    for fault in &summary.broken {
        eprintln!("not shown: {fault}");
    }
    if summary.broken_count > summary.broken.len() {
        eprintln!("… and {} more that are not shown", summary.broken_count - summary.broken.len());
    }
    if let Some(refused) = &summary.maps_refused {
        eprintln!("{refused}");
    }
    print(cli.json, &summary, |summary| text(summary, frames))?;
    Ok(summary.memory_budget.is_none_or(|budget| summary.memory_max <= budget))
}

fn text(s: &Summary, frames: &std::path::Path) -> String {
    let number = |value: Option<f64>| value.map_or("none".to_owned(), |value| format!("{value:.4}"));
    let streamed = match (&s.policy, &s.link, s.memory_budget) {
        (Some(policy), Some(link), Some(budget)) => format!(
            "policy {policy} over {link}: {:.2} MB received, {:.2} of {:.2} MB of memory at most",
            s.bytes_received as f64 / 1e6,
            s.memory_max as f64 / 1e6,
            budget as f64 / 1e6
        ),
        _ => "everything resident".to_owned(),
    };
    let worst = match (s.worst_frame, s.worst_ssim) {
        (Some(frame), Some(ssim)) => format!(", least {ssim:.4} at picture {frame}"),
        _ => String::new(),
    };
    format!(
        "{} pictures of {}×{} pixels of {} in {}, {} s, drawn by {}\n  {streamed}\n  mean quality {}, mean SSIM {}{worst}\n",
        s.frames,
        s.size[0],
        s.size[1],
        s.world,
        frames.display(),
        s.duration_s,
        s.adapter,
        number(s.mean_quality),
        number(s.mean_ssim),
    )
}
