//! `runs export`: results as a table for other programs.

use super::{FilterArgs, StoreArgs, time_text};
use anyhow::{Context, bail};
use clap::{Args, ValueEnum};
use foresight_index::runs::{FIGURES, PolicyResult, Run, StoredRun};
use foresight_sim::report;
use std::io::Write;
use std::path::PathBuf;

#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  foresight-sim runs export --format csv --out runs.csv\n  \
                  foresight-sim runs export --format parquet --out runs.parquet --case walk --since 30d")]
pub(super) struct ExportArgs {
    /// Parquet needs a build with the feature `parquet`
    #[arg(long, value_enum)]
    format: Format,
    /// The file; one of that name is replaced
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    filter: FilterArgs,
    #[command(flatten)]
    store: StoreArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    Csv,
    Parquet,
}

/// A column of the table.
pub(super) enum Column {
    Text(Vec<Option<String>>),
    Integer(Vec<Option<i64>>),
    Real(Vec<Option<f64>>),
}

pub(super) fn run(args: &ExportArgs) -> anyhow::Result<()> {
    if args.format == Format::Parquet && cfg!(not(feature = "parquet")) {
        bail!(
            "--format parquet: this build has no Parquet; expected csv, or `cargo run --release --features parquet -- runs export …`"
        );
    }
    let runs = args.filter.runs(&mut args.store.open()?)?;
    let rows: Vec<(&StoredRun, &PolicyResult)> = runs
        .iter()
        .flat_map(|stored| stored.run.results.iter().map(move |result| (stored, result)))
        .filter(|(_, result)| args.filter.takes(result))
        .collect();
    let columns = columns(&rows);
    let bytes = match args.format {
        Format::Csv => csv(&columns, rows.len())?,
        #[cfg(feature = "parquet")]
        Format::Parquet => super::parquet::file(&columns)?,
        #[cfg(not(feature = "parquet"))]
        Format::Parquet => Vec::new(),
    };
    report::replace(&args.out, &bytes).context("exporting")?;
    writeln!(std::io::stdout().lock(), "{}: {} rows of {} runs", args.out.display(), rows.len(), runs.len())?;
    Ok(())
}

fn columns(rows: &[(&StoredRun, &PolicyResult)]) -> Vec<(String, Column)> {
    let text = |name: &str, of: fn(&Run) -> Option<String>| {
        (name.to_owned(), Column::Text(rows.iter().map(|(stored, _)| of(&stored.run)).collect()))
    };
    let integer = |name: &str, of: fn(&StoredRun) -> Option<i64>| {
        (name.to_owned(), Column::Integer(rows.iter().map(|(stored, _)| of(stored)).collect()))
    };
    let real = |name: &str, of: fn(&Run) -> Option<f64>| {
        (name.to_owned(), Column::Real(rows.iter().map(|(stored, _)| of(&stored.run)).collect()))
    };
    let mut columns = vec![
        integer("run", |stored| Some(stored.id)),
        text("started_at", |run| Some(time_text(run.started_at_ms))),
        integer("started_at_ms", |stored| Some(stored.run.started_at_ms)),
        text("program_version", |run| Some(run.program_version.clone())),
        text("build", |run| Some(run.build.clone())),
        text("case", |run| run.suite_case.clone()),
        text("arguments", |run| serde_json::to_string(&run.arguments).ok()),
        text("world", |run| Some(run.world.name.clone())),
        text("world_hash", |run| Some(run.world.hash.clone())),
        text("path", |run| Some(run.path.name.clone())),
        text("path_hash", |run| Some(run.path.hash.clone())),
        text("link", |run| Some(run.link.name.clone())),
        text("link_hash", |run| Some(run.link.hash.clone())),
        text("settings", |run| Some(run.settings.clone())),
        // Up to 2^64, which no integer column holds.
        text("seed", |run| Some(run.seed.to_string())),
        text("inputs_hash", |run| Some(run.inputs_hash.clone())),
        text("result_hash", |run| Some(run.result_hash.clone())),
        real("wall_s", |run| Some(run.wall_s)),
        integer("peak_memory_bytes", |stored| stored.run.peak_memory_bytes.and_then(|bytes| bytes.try_into().ok())),
        real("nonempty_share", |run| run.nonempty_share),
        real("lambda", |run| run.pressure.lambda),
        real("rho", |run| run.pressure.rho),
        real("mu", |run| run.pressure.mu),
        real("bound_quality", |run| run.bound_quality),
        ("policy".to_owned(), Column::Text(rows.iter().map(|(_, result)| Some(result.policy.clone())).collect())),
    ];
    for (place, name) in FIGURES.into_iter().enumerate() {
        let end = |end: &str, of: fn(&foresight_index::runs::Figure) -> Option<f64>| {
            (format!("{name}{end}"), Column::Real(rows.iter().map(|(_, result)| of(&result.figures[place])).collect()))
        };
        columns.extend([end("", |f| f.value), end("_lower", |f| f.lower), end("_upper", |f| f.upper)]);
    }
    columns.push(("decisions".to_owned(), Column::Real(rows.iter().map(|(_, result)| result.decisions).collect())));
    for (place, end) in ["p50", "p99", "max"].into_iter().enumerate() {
        let nanos = rows.iter().map(|(_, result)| result.decision_ns[place].try_into().ok()).collect();
        columns.push((format!("decision_ns_{end}"), Column::Integer(nanos)));
    }
    columns
}

/// With a heading; what is not known is an empty field.
fn csv(columns: &[(String, Column)], rows: usize) -> anyhow::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(columns.iter().map(|(name, _)| name))?;
    for row in 0..rows {
        let field = |column: &Column| match column {
            Column::Text(values) => values[row].clone().unwrap_or_default(),
            Column::Integer(values) => values[row].map(|v| v.to_string()).unwrap_or_default(),
            Column::Real(values) => values[row].map(|v| v.to_string()).unwrap_or_default(),
        };
        writer.write_record(columns.iter().map(|(_, column)| field(column)))?;
    }
    Ok(writer.into_inner().map_err(|error| error.into_error())?)
}
