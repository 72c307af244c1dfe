//! `suite`: the named benchmark cases.

use super::alpha_sweep;
use super::replay::{self, ReplayArgs};
use super::runs::Recorder;
use anyhow::{Context, bail};
use clap::{Args, Parser};
use foresight_sim::outcome::regime;
use foresight_sim::report;
use foresight_sim::stopwatch::Stopwatch;
use foresight_sim::suite::{CASES, Case, CaseOutcome, ReplayOutcome, SCHEMA_VERSION, Skipped, SuiteOutcome, standings};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

/// Starts of a replay that does not say how many.
const STARTS: u32 = 5;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim suite --list\n  foresight-sim suite --data recordings --report suite\n  \
                        foresight-sim suite --case turn,teleport --policy foresight,3d-tiles-renderer --starts 10\n  foresight-sim suite --alpha-sweep --starts 1 --at-most 60\n\n\
                        Cases over recorded worlds, paths and links take them from --data, else from the folder that \
                        FORESIGHT_DATA names, else from ../shared/data; without it they are skipped and named."
)]
pub(crate) struct SuiteArgs {
    /// Cases to run, separated by commas; all if not given
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    case: Vec<String>,
    /// Policies instead of each case's own
    #[arg(long, value_name = "NAMES")]
    policy: Option<String>,
    /// Seeded offsets in the link, for each replay; 5 if neither this nor the case says
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1000))]
    starts: Option<u32>,
    /// Replay at most this many seconds of each path
    #[arg(long, value_name = "SECONDS")]
    at_most: Option<f64>,
    /// Pixels of error that the rivals aim at; best adds each at its best of 1, 2, 4 … 64 px in hindsight
    #[arg(long, value_name = "PX|best")]
    error_target: Option<String>,
    /// Folder of recorded worlds, paths and links
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Replay each case with foresight only, at α = 0, 0.1, … 1, adapted, and solved for what the best of these leaves the
    /// worst case; prints what each loses against the best fixed α in hindsight
    #[arg(long, conflicts_with_all = ["policy", "error_target", "report", "store"])]
    alpha_sweep: bool,
    /// Name the cases, with why each is there, and run nothing
    #[arg(long)]
    list: bool,
    /// Write suite.html and suite.json into this directory
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Record every replay in this store, a SQLite file or a postgres:// URL; without a value in the user's own, which
    /// `runs` reads
    #[arg(long, value_name = "FILE|URL", num_args = 0..=1, default_missing_value = "")]
    store: Option<String>,
    /// Print one JSON document
    #[arg(long)]
    pub(super) json: bool,
    /// Threads; as many as there are processors if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: Option<u32>,
}

/// Policies of a replay that does not say which: all, and 3d-tiles-renderer once more over HTTP/1.1, which suits it better.
const POLICIES: &str = "all,3d-tiles-renderer:parallel=6";

/// A replay's options on their own.
#[derive(Debug, Parser)]
#[command(name = "replay")]
pub(crate) struct Line {
    #[command(flatten)]
    pub(crate) replay: ReplayArgs,
}

pub(crate) fn run(args: &SuiteArgs) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let cases = chosen(&args.case)?;
    let (data, is_given) = data_folder(args.data.as_deref());
    if args.list {
        for case in cases {
            writeln!(out, "{}: {} {}", case.name, case.why, case.shows)?;
            for command in case.commands(&data) {
                writeln!(out, "  foresight-sim {}", command.join(" "))?;
            }
        }
        return Ok(());
    }
    if is_given && !data.is_dir() {
        bail!("{}: no such folder; expected one with scenes, paths and network in it", data.display());
    }
    replay::use_threads(args.threads)?;
    if args.alpha_sweep {
        return alpha_sweep::run(args, &cases, &data, &mut out);
    }
    let watch = Stopwatch::start();
    let mut recorder = args.store.as_deref().map(Recorder::open).transpose()?;
    let shows_progress = std::io::stderr().is_terminal();
    let (mut outcomes, mut skipped) = (Vec::new(), Vec::new());
    for case in cases {
        if case.needs_data() && !data.is_dir() {
            let reason =
                format!("needs recorded data, and {} is not there; name their folder with --data", data.display());
            skipped.push(Skipped { name: case.name, reason });
            continue;
        }
        let mut replays = Vec::new();
        for command in case.commands(&data) {
            let command = completed(command, args);
            let line = Line::try_parse_from(&command).with_context(|| format!("case {}", case.name))?;
            let replay_watch = Stopwatch::start();
            let comparison = replay::execute(&line.replay, &|done, all| {
                if shows_progress {
                    eprint!("\r\x1b[K{}: {done} of {all} replays", case.name);
                }
            });
            let comparison = comparison.with_context(|| format!("case {}: {}", case.name, command.join(" ")))?;
            if let Some(recorder) = &mut recorder {
                recorder.record(&comparison, &line.replay, replay_watch, Some((case.name, &command)))?;
            }
            replays.push(ReplayOutcome { command, regime: regime(comparison.pressure.rho), comparison });
        }
        if shows_progress {
            eprint!("\r\x1b[K");
        }
        outcomes.push(CaseOutcome::new(case, replays));
    }
    let outcome = SuiteOutcome {
        schema_version: SCHEMA_VERSION,
        standings: standings(&outcomes),
        cases: outcomes,
        skipped,
        wall_s: watch.nanos() as f64 * 1e-9,
        peak_memory_bytes: peak_memory_bytes(),
    };
    if args.json {
        serde_json::to_writer(&mut out, &outcome)?;
        writeln!(out)?;
    } else {
        write!(out, "{}", report::suite_text(&outcome, replay::terminal_width()))?;
    }
    if let Some(dir) = &args.report {
        let page = report::write_suite(&outcome, dir)?;
        if !args.json {
            writeln!(out, "report: {}", page.display())?;
        }
    }
    Ok(())
}

fn chosen(names: &[String]) -> anyhow::Result<Vec<&'static Case>> {
    if names.is_empty() {
        return Ok(CASES.iter().collect());
    }
    let find = |name: &String| {
        let known = || CASES.iter().map(|c| c.name).collect::<Vec<_>>().join(", ");
        CASES.iter().find(|c| c.name == name).with_context(|| format!("unknown case `{name}`; expected of {}", known()))
    };
    names.iter().map(find).collect()
}

/// Where recorded data are, and whether somebody said so.
pub(crate) fn data_folder(given: Option<&Path>) -> (PathBuf, bool) {
    let named = std::env::var_os("FORESIGHT_DATA").filter(|v| !v.is_empty()).map(PathBuf::from);
    match given.map(Path::to_owned).or(named) {
        Some(folder) => (folder, true),
        None => (PathBuf::from("../shared/data"), false),
    }
}

/// A command with an option set; as it is without a value.
pub(super) fn set(command: &mut Vec<String>, option: &str, value: Option<String>) {
    let Some(value) = value else { return };
    match command.iter().position(|word| word == option).and_then(|at| command.get_mut(at + 1)) {
        Some(given) => *given = value,
        None => command.extend([option.to_owned(), value]),
    }
}

/// A case's command with what the suite's options and defaults add.
pub(super) fn completed(mut command: Vec<String>, args: &SuiteArgs) -> Vec<String> {
    let mut set = |option: &str, value: Option<String>| set(&mut command, option, value);
    set("--policy", args.policy.clone());
    set("--starts", args.starts.map(|n| n.to_string()));
    set("--error-target", args.error_target.clone());
    set("--at-most", args.at_most.map(|s| s.to_string()));
    for (option, value) in [("--policy", POLICIES.to_owned()), ("--starts", STARTS.to_string())] {
        if !command.iter().any(|word| word == option) {
            command.extend([option.to_owned(), value]);
        }
    }
    command.push("--limits".to_owned());
    command
}

/// Most memory that this process has held, bytes, as Linux tells it.
pub(crate) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}
