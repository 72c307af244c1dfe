//! `replay`: compares policies.

use super::runs::Recorder;
use super::session;
use anyhow::{Context, bail};
use clap::Args;
use foresight_index::world::World;
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::policy::specification::{PolicySpec, Trust};
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_sim::compare::{Memory, Plan, compare, starts};
use foresight_sim::outcome::{Comparison, Inputs};
use foresight_sim::report;
use foresight_sim::stopwatch::Stopwatch;
use foresight_traces::arguments::{self, PathArgs, Placed};
use foresight_traces::client::ClientSettings;
use foresight_traces::link::LinkTrace;
use foresight_traces::path::CameraPath;
use std::io::{IsTerminal, Write};
use std::path::PathBuf;

/// Error targets tried for the best in hindsight, pixels.
const HINDSIGHT_TARGETS_PX: [f64; 7] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// Memory without `--memory`: what puts the built-in flight under some pressure, and otherwise what viewers use.
const BUILT_IN_MEMORY: u64 = 16 << 20;
const MEMORY: u64 = 256 << 20;
/// Starts without `--starts` on the built-in link: one offset into it says little.
const BUILT_IN_STARTS: u32 = 4;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim replay --json\n  foresight-sim replay --world mosaic16 --path walk.txt --link lte.down --memory mu:0.25 --starts 10\n  \
    foresight-sim replay --policy foresight,foresight:alpha=1:predictor=true-path,clairvoyant\n  foresight-sim replay --error-target best --link constant:5Mbit,40ms\n  \
    foresight-sim replay --session flight.jsonl --world tiles/ --link constant:5Mbit,40ms\n\n\
    A policy takes options after colons:\n  foresight, added-benefit, clairvoyant: alpha (0 to 1, adapted, or solved with at-least=Q), watch (on: W/Σw is measured), predictor (constant-velocity, constant-turn, kalman, mixture, known-path,\n    \
    true-path), discards (planned, lru), arrival (on, off), cover (on, off), horizon, reuse, hysteresis, attenuation, samples,\n    \
    opening, falloff, choice (certified, sampled), tolerance, evaluations, grouping, slack, turn-rate and speed (declared, rad/s and m/s), request-cost,\n    \
     worst (union, minimum), neighbourhood (free, walk, orbit, path), clearance\n  the rivals: target (pixels, where it has one), parallel\n  \
     foresight-adapted and foresight-solved, not in all, are foresight:alpha=adapted and foresight:alpha=solved"
)]
pub(crate) struct ReplayArgs {
    /// A world directory, tileset.json, elevation grid (.npz, GeoTIFF), or a generated world by its parameters:
    /// city:blocks=40,seed=7, terrain:size=40km,resolution=10m, asteroids:count=29264, mosaic:TILESET,grid=16; the built-in
    /// city if not given
    #[arg(long, value_name = "WORLD")]
    pub(super) world: Option<String>,
    /// A TUM or EyeNavGS recording or one of our own, or steady, turn (with :speed=5,duration=60), teleport (with
    /// every=10,distance=200,seed=1 besides); the built-in flight if not given
    #[arg(long, value_name = "PATH")]
    pub(super) path: Option<String>,
    /// A Mahimahi trace (with the .delay beside it), `seconds Mbit/s` lines, a SABRE list, a G-NetTrack log, or
    /// constant:5Mbit,40ms; each with ,scale= ,start= ,rtt= or ,delay=FILE, and ,loss=P for requests that fail
    #[arg(long, value_name = "LINK")]
    pub(super) link: Option<String>,
    /// Policies separated by commas, or all
    #[arg(long, default_value = "all", value_name = "NAMES")]
    policy: String,
    /// Memory budget: bytes, 256MiB, 1GB, or mu:0.5 for half of the largest need; 256MiB if not given, and 16MiB for
    /// the built-in world
    #[arg(long, value_name = "SIZE", value_parser = memory, allow_hyphen_values = true)]
    memory: Option<Memory>,
    /// Trust in the prediction: adapted follows how well it predicts, from 0.7 on; a number from 0 to 1 stays; and
    /// solved:at-least=Q is as high as leaves the worst case a mean quality of Q, 0.6 if not given
    #[arg(long, default_value = "adapted", value_name = "ALPHA", allow_hyphen_values = true)]
    alpha: Trust,
    /// Pixels of error that the rivals aim at, instead of what each ships with; best adds each at its best of 1, 2, 4 …
    /// 64 px in hindsight
    #[arg(long, value_name = "PX|best")]
    error_target: Option<String>,
    /// When children count: partial (drawn beside their parent) or atomic (all or none)
    #[arg(long, default_value = "partial", value_name = "KIND", value_parser = refinement)]
    refinement: Refinement,
    #[command(flatten)]
    pub(super) path_args: PathArgs,
    /// Recordings of live sessions instead of a comparison: are their decisions made again, and what was seen? With
    /// --link, what the simulator makes of the same views, or of --path, over that link. Memory, refinement and policy are
    /// those of the recording
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with_all = ["policy", "memory", "alpha", "error_target", "refinement",
        "warm", "starts", "announce", "no_bound", "limits", "report", "store"])]
    pub(super) session: Vec<PathBuf>,
    /// Start with what the first view needs resident
    #[arg(long)]
    warm: bool,
    /// Repeat over this many seeded offsets in the link, and give 95 % intervals; 1 if not given, and 4 for the built-in
    /// link
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    starts: Option<u32>,
    /// Seed of the offsets, and of which requests fail
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Decoded bytes per second that each of two workers decodes
    #[arg(long, default_value_t = 200e6, value_name = "BYTES/S")]
    pub(super) decode_rate: f64,
    /// Decoded bytes uploaded per 1/60 s
    #[arg(long, default_value_t = 8 << 20, value_name = "BYTES")]
    pub(super) upload_budget: u64,
    /// Opening angle of the cuts by which frames are judged; smaller is more accurate and slower
    #[arg(long, default_value_t = 0.15, value_name = "THETA")]
    pub(super) opening: f64,
    /// The client announces its path this many seconds ahead, renewed once a second; for predictor=known-path
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    announce: Option<f64>,
    /// Leave the upper bound out
    #[arg(long)]
    no_bound: bool,
    /// Replay clairvoyant once more with what the bound lets cost nothing (latency, failures, decoding), and say what keeps
    /// foresight from the bound
    #[arg(long)]
    pub(super) limits: bool,
    /// Write report.html and comparison.json into this directory
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Record the run in this store, a SQLite file or a postgres:// URL; without a value in the user's own, which `runs`
    /// reads
    #[arg(long, value_name = "FILE|URL", num_args = 0..=1, default_missing_value = "")]
    store: Option<String>,
    /// Print one JSON document
    #[arg(long)]
    pub(super) json: bool,
    /// Threads; as many as there are processors if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
}

impl ReplayArgs {
    /// What `foresight-sim` alone replays.
    pub(crate) fn built_in() -> ReplayArgs {
        ReplayArgs {
            world: None,
            path: None,
            link: None,
            policy: "all".to_owned(),
            memory: None,
            alpha: Trust::adapted(),
            error_target: None,
            refinement: Refinement::Partial,
            path_args: PathArgs::default(),
            session: Vec::new(),
            warm: false,
            starts: None,
            seed: 1,
            decode_rate: 200e6,
            upload_budget: 8 << 20,
            opening: 0.15,
            announce: None,
            no_bound: false,
            limits: false,
            report: Some(PathBuf::from("report")),
            store: None,
            json: false,
            threads: None,
        }
    }

    /// Refuses numbers out of range.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        if !(self.opening >= 0.0 && self.opening <= 2.0) {
            bail!("--opening {}; expected an angle from 0 to 2", self.opening);
        }
        if !(self.decode_rate >= 1.0 && self.decode_rate.is_finite() && self.upload_budget > 0) {
            bail!(
                "--decode-rate {} and --upload-budget {}; expected at least 1 byte each",
                self.decode_rate,
                self.upload_budget
            );
        }
        Ok(())
    }

    /// What the client can do, apart from announcing its path.
    pub(super) fn client(&self) -> ClientSettings {
        ClientSettings {
            decode_rate: self.decode_rate,
            upload_bytes_per_tick: self.upload_budget,
            ..ClientSettings::default()
        }
    }

    /// What the results depend on beside the inputs that the comparison names.
    #[cfg(feature = "runs")]
    pub(crate) fn other_settings(&self) -> serde_json::Value {
        serde_json::json!({
            "alpha_rule": self.alpha.word(),
            "error_target": self.error_target,
            "decode_rate": self.decode_rate,
            "upload_budget": self.upload_budget,
            "opening": self.opening,
        })
    }
}

fn memory(text: &str) -> Result<Memory, String> {
    let expected = || format!("`{text}`; expected bytes such as 268435456, 256MiB, 1GB, or mu:0.5");
    if let Some(mu) = text.strip_prefix("mu:") {
        let mu = mu.parse::<f64>().ok().filter(|mu| *mu > 0.0 && *mu <= 1e6).ok_or_else(expected)?;
        return Ok(Memory::OfLargestNeed(mu));
    }
    Ok(Memory::Bytes(arguments::bytes(text).map_err(|_| expected())?))
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| *seconds > 0.0 && *seconds <= 86_400.0);
    seconds.ok_or_else(|| format!("`{text}`; expected seconds, more than 0 and at most 86400"))
}

fn refinement(text: &str) -> Result<Refinement, String> {
    match text {
        "partial" => Ok(Refinement::Partial),
        "atomic" => Ok(Refinement::Atomic),
        _ => Err(format!("`{text}`; expected partial or atomic")),
    }
}

/// Runs everything that follows on this many threads.
pub(crate) fn use_threads(threads: Option<u32>) -> anyhow::Result<()> {
    if let Some(threads) = threads {
        rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global().context("starting threads")?;
    }
    Ok(())
}

pub(crate) fn run(args: ReplayArgs) -> anyhow::Result<()> {
    use_threads(args.threads)?;
    if !args.session.is_empty() {
        return session::run(&args);
    }
    let watch = Stopwatch::start();
    let recorder = args.store.as_deref().map(Recorder::open).transpose()?;
    let shows_progress = std::io::stderr().is_terminal() && !args.json;
    let comparison = execute(&args, &|done, all| {
        if shows_progress {
            eprint!("\r{done} of {all} replays");
        }
    })?;
    if shows_progress {
        eprint!("\r\x1b[K");
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer(&mut out, &comparison)?;
        writeln!(out)?;
    } else {
        let width = terminal_width();
        writeln!(out, "{}", report::table(&comparison, width))?;
    }
    if let Some(dir) = &args.report {
        let words: Vec<_> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
        let command = words.join(" ");
        let file = report::write_with_command(&comparison, dir, &command)?;
        if !args.json {
            writeln!(out, "report: {}", file.display())?;
        }
    }
    if let Some(mut recorder) = recorder {
        let place = recorder.record(&comparison, &args, watch, None)?;
        if !args.json {
            writeln!(out, "{place}")?;
        }
    }
    Ok(())
}

/// World, path and link of a replay.
pub(crate) struct Opened {
    pub(crate) link: LinkTrace,
    pub(crate) path: CameraPath,
    pub(crate) world_name: String,
    pub(crate) world: World,
    pub(crate) placed: Placed,
}

/// Opens what the arguments name and puts the path into the world.
pub(crate) fn open(args: &ReplayArgs) -> anyhow::Result<Opened> {
    // Links and paths are small: what is wrong with them is said before a world is loaded.
    let link = arguments::open_link(args.link.as_deref())?.with_loss_seed(args.seed);
    let path = arguments::open_path(args.path.as_deref(), &args.path_args)?;
    let (world_name, world) = arguments::open_world(args.world.as_deref())?;
    let as_is = args.world.is_none() && args.path.is_none();
    let placed = arguments::place(&path, &world, as_is, &args.path_args)?;
    Ok(Opened { link, path, world_name, world, placed })
}

/// Makes the comparison that the arguments ask for. `progress` is told how many replays of how many are done.
pub(crate) fn execute(args: &ReplayArgs, progress: &(dyn Fn(usize, usize) + Sync)) -> anyhow::Result<Comparison> {
    args.check()?;
    let (target, hindsight) = match args.error_target.as_deref() {
        None => (None, Vec::new()),
        Some("best") => (None, HINDSIGHT_TARGETS_PX.to_vec()),
        Some(px) => {
            let target = px.parse::<f64>().ok().filter(|t| *t >= 0.01 && *t <= 1e4);
            let target =
                target.with_context(|| format!("--error-target {px}; expected pixels from 0.01 to 10000, or best"))?;
            (Some(target), Vec::new())
        }
    };
    let mut policies = PolicySpec::parse_list(&args.policy, args.alpha, target)?;
    let Opened { link, path, world_name, world, placed } = open(args)?;
    policies.iter_mut().for_each(|policy| policy.settings.reach.up = world.up);
    let is_all = args.policy.split(',').any(|name| name.trim() == "all");
    let mut blind = Vec::new();
    if is_all && world.tree.has_directions() {
        blind.extend(policies.iter().filter(|p| !p.tells_directions()).map(|p| p.label.clone()));
        policies.retain(PolicySpec::tells_directions);
    }

    let count = args.starts.unwrap_or(if args.link.is_none() { BUILT_IN_STARTS } else { 1 });
    let base = SchedulerSettings::with_budget(0);
    let plan = Plan {
        tree: &world.tree,
        up: world.up,
        flight: &placed.flight,
        link: &link,
        starts: starts(&link, count as usize, args.seed),
        policies,
        hindsight_targets: hindsight,
        memory: args.memory.unwrap_or(Memory::Bytes(if args.world.is_none() { BUILT_IN_MEMORY } else { MEMORY })),
        scheduler: SchedulerSettings { refinement: args.refinement, ..base },
        client: ClientSettings { announce_s: args.announce.unwrap_or(0.0), ..args.client() },
        judging: CutSettings { opening: args.opening, ..CutSettings::default() },
        warm: args.warm,
        without_bound: args.no_bound,
        limits: args.limits && !args.no_bound,
    };
    let view = placed.flight.views[0];
    let inputs = Inputs {
        world: world_name,
        world_hash: world.hash().to_hex().to_string(),
        path: args.path.clone().unwrap_or_else(|| path.name().to_owned()),
        link: args.link.clone().unwrap_or_else(|| link.name().to_owned()),
        place: placed.place,
        alpha: args.alpha.alpha,
        worst_case: worst_cases(&plan.policies),
        refinement: format!("{:?}", args.refinement).to_lowercase(),
        announce_s: args.announce,
        head: args.path_args.head().map(str::to_owned),
        seed: args.seed,
        viewport: view.viewport,
        fov_y_deg: view.fov_y.to_degrees(),
        ..Inputs::default()
    };
    let mut comparison = compare(&plan, inputs, progress)?;
    if link.loss() > 0.0 {
        let failures = comparison.policies.iter().map(|p| format!("{} {:.1}", p.name, p.failures));
        let failures = failures.collect::<Vec<_>>().join(", ");
        comparison.warnings.push(format!("{} % of the requests fail; failures: {failures}", link.loss() * 100.0));
    }
    if !blind.is_empty() {
        let blind = blind.join(", ");
        comparison
            .warnings
            .push(format!("left out, because they take an orthoview for the whole of its node: {blind}"));
    }
    comparison.warnings.extend(arguments::world_notes(&world, 5));
    comparison.warnings.extend(placed.notes.iter().map(|n| format!("path: {n}")));
    comparison.warnings.extend(link.notes().iter().map(|n| format!("link: {n}")));
    Ok(comparison)
}

/// The readings of the worst case; each policy with its own where they differ.
fn worst_cases(policies: &[PolicySpec]) -> String {
    let used: Vec<_> = policies.iter().filter_map(|p| Some((p.label.as_str(), p.worst_case()?))).collect();
    match used.first() {
        None => "none".to_owned(),
        Some((_, first)) if used.iter().all(|(_, reading)| reading == first) => first.clone(),
        Some(_) => used.iter().map(|(label, reading)| format!("{label}: {reading}")).collect::<Vec<_>>().join("; "),
    }
}

/// Columns of the terminal, by COLUMNS; 120 where nothing says.
pub(crate) fn terminal_width() -> usize {
    std::env::var("COLUMNS").ok().and_then(|c| c.parse().ok()).filter(|c| (40..=1000).contains(c)).unwrap_or(120)
}
