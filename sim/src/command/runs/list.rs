//! `runs list`.

use super::show::run_json;
use super::text::{share, table};
use super::{FilterArgs, SCHEMA_VERSION, StoreArgs, time_text};
use clap::Args;
use foresight_index::runs::StoredRun;
use serde_json::json;
use std::io::Write;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim runs list\n  foresight-sim runs list --case walk --since 2025-11-22\n  \
                  foresight-sim runs list --policy 3d-tiles-renderer --json"
)]
pub(super) struct ListArgs {
    #[command(flatten)]
    filter: FilterArgs,
    #[command(flatten)]
    store: StoreArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ListArgs) -> anyhow::Result<()> {
    let mut store = args.store.open()?;
    let runs = args.filter.runs(&mut store)?;
    let mut out = std::io::stdout().lock();
    if args.json {
        let runs: Vec<_> = runs.iter().map(run_json).collect();
        writeln!(out, "{}", json!({ "schema_version": SCHEMA_VERSION, "store": store.name(), "runs": runs }))?;
        return Ok(());
    }
    let heading = ["run", "begun", "version", "case", "world", "path", "link", "policy", "deficit", "ρ"];
    let rows: Vec<Vec<String>> = runs.iter().map(|stored| row(stored, &args.filter)).collect();
    writeln!(out, "{}", table(&heading, &rows, heading.len() - 2))?;
    Ok(())
}

/// A run, and of its policies the first that was asked for.
fn row(stored: &StoredRun, filter: &FilterArgs) -> Vec<String> {
    let run = &stored.run;
    let result = run.results.iter().find(|result| filter.takes(result));
    let deficit = result.and_then(|result| result.figure("mean_deficit")).and_then(|figure| figure.value);
    vec![
        stored.id.to_string(),
        time_text(run.started_at_ms),
        run.program_version.clone(),
        run.suite_case.clone().unwrap_or_default(),
        run.world.name.clone(),
        run.path.name.clone(),
        run.link.name.clone(),
        result.map(|result| result.policy.clone()).unwrap_or_default(),
        share(deficit),
        run.pressure.rho.map_or_else(|| "–".to_owned(), |rho| format!("{rho:.2}")),
    ]
}
