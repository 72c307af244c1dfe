//! `runs`: the store of past runs.

mod diff;
mod export;
mod list;
#[cfg(feature = "parquet")]
mod parquet;
mod record;
mod repeat;
mod show;
mod text;

use anyhow::Context;
use clap::{Args, Subcommand};
use foresight_index::runs::{Access, Filter, Location, PolicyResult, RunStore, StoredRun};
use foresight_sim::stopwatch;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

pub(crate) use record::Recorder;

/// Version of the JSON documents of these commands.
const SCHEMA_VERSION: u32 = 1;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim replay --store --starts 10\n  foresight-sim runs list --since 7d\n  foresight-sim runs show 3\n  \
    foresight-sim runs diff 3 5\n  foresight-sim runs diff --versions 0.1.0 0.2.0\n  foresight-sim runs repeat 3\n  \
    foresight-sim runs export --format csv --out runs.csv --store postgres://me@host/runs\n\n\
    The store is the file or PostgreSQL database that --store names, else $XDG_DATA_HOME/foresight/runs.sqlite,\n\
    XDG_DATA_HOME being ~/.local/share if it is not set."
)]
pub(crate) struct RunsArgs {
    #[command(subcommand)]
    command: RunsCommand,
}

#[derive(Debug, Subcommand)]
enum RunsCommand {
    /// Lists runs.
    List(list::ListArgs),
    /// Shows a run: what was replayed, how, and what came of it.
    Show(show::ShowArgs),
    /// Compares two runs, or two versions of the program on all inputs that both have replayed.
    Diff(diff::DiffArgs),
    /// Writes the results of runs into a file, a row for each policy of each run.
    Export(export::ExportArgs),
    /// Makes a run again, and says whether its results are the same.
    Repeat(repeat::RepeatArgs),
}

pub(crate) fn run(args: &RunsArgs) -> anyhow::Result<()> {
    match &args.command {
        RunsCommand::List(args) => list::run(args),
        RunsCommand::Show(args) => show::run(args),
        RunsCommand::Diff(args) => diff::run(args),
        RunsCommand::Export(args) => export::run(args),
        RunsCommand::Repeat(args) => repeat::run(args),
    }
}

/// Which store.
#[derive(Debug, Args)]
struct StoreArgs {
    /// A file or postgres:// URL; $XDG_DATA_HOME/foresight/runs.sqlite if not given
    #[arg(long, value_name = "FILE|URL")]
    store: Option<String>,
}

impl StoreArgs {
    /// Opens it for reading.
    fn open(&self) -> anyhow::Result<RunStore> {
        Ok(RunStore::open(&location(self.store.as_deref().unwrap_or_default())?, Access::Read)?)
    }
}

/// Which runs; those that meet every condition given.
#[derive(Debug, Args)]
struct FilterArgs {
    /// Runs of this case of the suite
    #[arg(long, value_name = "NAME")]
    case: Option<String>,
    /// Runs of this policy, whatever its options, or of exactly this policy with its options
    #[arg(long, value_name = "NAME")]
    policy: Option<String>,
    /// Runs begun since: an age such as 36h or 7d, a date, or a date and time in UTC such as 2025-11-22T14:00:00Z
    #[arg(long, value_name = "TIME", value_parser = since)]
    since: Option<i64>,
}

impl FilterArgs {
    fn runs(&self, store: &mut RunStore) -> anyhow::Result<Vec<StoredRun>> {
        let filter = Filter { suite_case: self.case.clone(), since_ms: self.since, ..Filter::default() };
        let mut runs = store.list(&filter)?;
        runs.retain(|stored| stored.run.results.iter().any(|result| self.takes(result)) || self.policy.is_none());
        Ok(runs)
    }

    fn takes(&self, result: &PolicyResult) -> bool {
        self.policy.as_ref().is_none_or(|name| result.policy == *name || base_name(&result.policy) == name)
    }
}

/// A policy's name without its options.
fn base_name(policy: &str) -> &str {
    policy.split([':', ' ']).next().unwrap_or_default()
}

/// Milliseconds since 1970-01-01 UTC of an age, a date or a date and time.
fn since(text: &str) -> Result<i64, String> {
    let expected =
        || format!("`{text}`; expected an age such as 36h or 7d, a date such as 2025-11-22, or 2025-11-22T14:00:00Z");
    if let Ok(age) = humantime::parse_duration(text) {
        let age = i64::try_from(age.as_millis()).map_err(|_| expected())?;
        return Ok(stopwatch::unix_ms().saturating_sub(age));
    }
    let time =
        humantime::parse_rfc3339_weak(text).or_else(|_| humantime::parse_rfc3339_weak(&format!("{text} 00:00:00")));
    let since_1970 = time.ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok()).ok_or_else(expected)?;
    i64::try_from(since_1970.as_millis()).map_err(|_| expected())
}

/// A time in UTC as 2025-11-22T14:00:00Z; outside the years 1970 to 9999 as milliseconds since 1970.
fn time_text(unix_ms: i64) -> String {
    match u64::try_from(unix_ms) {
        Ok(ms) if ms < 253_402_300_800_000 => {
            let time: SystemTime = UNIX_EPOCH + Duration::from_millis(ms);
            humantime::format_rfc3339_seconds(time).to_string()
        }
        _ => format!("{unix_ms} ms"),
    }
}

/// The store named; that of the user if the name is empty.
fn location(named: &str) -> anyhow::Result<Location> {
    if !named.is_empty() {
        return Ok(named.parse()?);
    }
    let absolute = |name| std::env::var_os(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
    let data = absolute("XDG_DATA_HOME").or_else(|| absolute("HOME").map(|home| home.join(".local/share")));
    let data =
        data.context("no home for the store of runs: HOME and XDG_DATA_HOME are not set; expected --store FILE")?;
    Ok(Location::File(data.join("foresight").join("runs.sqlite")))
}

/// Makes the folder of the user's own store; that of a store named must be there.
fn make_folder(named: &str, location: &Location) -> anyhow::Result<()> {
    if let (true, Location::File(file)) = (named.is_empty(), location) {
        let folder = file.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).with_context(|| format!("making the folder {}", folder.display()))?;
    }
    Ok(())
}

/// What people call what a run replayed: its case, or its inputs.
fn subject(stored: &StoredRun) -> String {
    let run = &stored.run;
    match &run.suite_case {
        Some(case) => case.clone(),
        None => format!("{}, {}, {}", run.world.name, run.path.name, run.link.name),
    }
}
