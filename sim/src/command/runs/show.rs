//! `runs show`.

use super::text::{printable, share, spread, table};
use super::{SCHEMA_VERSION, StoreArgs, time_text};
use clap::Args;
use foresight_index::runs::{FIGURES, PolicyResult, StoredRun};
use serde_json::{Map, Value, json};
use std::io::Write;

/// Longest line of a description, characters.
const LINE: usize = 2000;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim runs show 3\n  foresight-sim runs show 3 --json | jq .document.warnings"
)]
pub(super) struct ShowArgs {
    /// Number of the run
    #[arg(value_name = "RUN")]
    run: i64,
    #[command(flatten)]
    store: StoreArgs,
    /// Print one JSON document, with the one that the run itself printed as its field `document`
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &ShowArgs) -> anyhow::Result<()> {
    let mut store = args.store.open()?;
    let stored = store.run(args.run)?;
    let document = store.document(args.run)?;
    let mut out = std::io::stdout().lock();
    if args.json {
        let document: Value = serde_json::from_str(&document)?;
        let all = json!({
            "schema_version": SCHEMA_VERSION, "store": store.name(), "run": run_json(&stored), "document": document
        });
        writeln!(out, "{all}")?;
        return Ok(());
    }
    for (name, value) in description(&stored) {
        writeln!(out, "{name:<10}{}", printable(&value, LINE))?;
    }
    let heading = ["policy", "deficit", "mean Q", "p05 Q", "s<0.9", "s to 0.9", "≤16 px", "MB", "wasted", "evictions"];
    let rows: Vec<Vec<String>> = stored.run.results.iter().map(row).collect();
    writeln!(out, "\n{}", table(&heading, &rows, 1))?;
    Ok(())
}

fn description(stored: &StoredRun) -> Vec<(&'static str, String)> {
    let run = &stored.run;
    let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |v| format!("{v:.3}"));
    let memory = run.peak_memory_bytes.map_or_else(String::new, |bytes| format!(", {} MB at most", bytes / 1_000_000));
    let mut lines = vec![
        ("run", stored.id.to_string()),
        ("begun", format!("{}, took {:.2} s{memory}", time_text(run.started_at_ms), run.wall_s)),
        ("program", format!("{} (build {})", run.program_version, run.build)),
        ("command", format!("foresight-sim {}", run.arguments.iter().map(|a| quoted(a)).collect::<Vec<_>>().join(" "))),
    ];
    lines.extend(run.folder.clone().map(|folder| ("in", folder)));
    lines.extend(run.suite_case.clone().map(|case| ("case", case)));
    for (name, input) in [("world", &run.world), ("path", &run.path), ("link", &run.link)] {
        lines.push((name, format!("{}  {}", input.name, printable(&input.hash, 12))));
    }
    let pressure = &run.pressure;
    let bound = match run.bound_quality {
        Some(_) => format!("mean Q {}: {}", share(run.bound_quality), run.bound_method),
        None => "none".to_owned(),
    };
    lines.extend([
        ("settings", run.settings.clone()),
        ("pressure", format!("λ {}  ρ {}  μ {}", number(pressure.lambda), number(pressure.rho), number(pressure.mu))),
        ("bound", bound),
        ("inputs", run.inputs_hash.clone()),
        ("results", run.result_hash.clone()),
    ]);
    lines
}

/// An argument as a shell takes it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./:,+%@".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

fn row(result: &PolicyResult) -> Vec<String> {
    let value = |name: &str| result.figure(name).and_then(|figure| figure.value);
    let decimals =
        |name: &str, scale: f64, n: usize| value(name).map_or_else(|| "–".to_owned(), |v| format!("{:.n$}", v * scale));
    vec![
        result.policy.clone(),
        result.figure("mean_deficit").map(spread).unwrap_or_default(),
        share(value("mean_quality")),
        share(value("p05_quality")),
        decimals("seconds_below_0_9", 1.0, 1),
        decimals("seconds_to_0_9", 1.0, 1),
        share(value("share_within_16px")),
        decimals("bytes_fetched", 1e-6, 1),
        decimals("bytes_wasted", 1e-6, 1),
        decimals("evictions", 1.0, 1),
    ]
}

/// A run as JSON.
pub(super) fn run_json(stored: &StoredRun) -> Value {
    let run = &stored.run;
    let pressure = &run.pressure;
    json!({
        "id": stored.id,
        "started_at": time_text(run.started_at_ms),
        "started_at_ms": run.started_at_ms,
        "program_version": run.program_version,
        "build": run.build,
        "case": run.suite_case,
        "folder": run.folder,
        "arguments": run.arguments,
        "world": { "name": run.world.name, "hash": run.world.hash },
        "path": { "name": run.path.name, "hash": run.path.hash },
        "link": { "name": run.link.name, "hash": run.link.hash },
        "settings": serde_json::from_str::<Value>(&run.settings).unwrap_or_default(),
        "seed": run.seed,
        "inputs_hash": run.inputs_hash,
        "result_hash": run.result_hash,
        "wall_s": run.wall_s,
        "peak_memory_bytes": run.peak_memory_bytes,
        "nonempty_share": run.nonempty_share,
        "pressure": {
            "lambda": pressure.lambda, "rho": pressure.rho, "mu": pressure.mu, "largest_need_bytes": pressure.largest_need_bytes
        },
        "upper_bound": { "mean_quality": run.bound_quality, "method": run.bound_method },
        "results": run.results.iter().map(result_json).collect::<Vec<_>>(),
    })
}

fn result_json(result: &PolicyResult) -> Value {
    let mut fields = Map::new();
    fields.insert("policy".to_owned(), json!(result.policy));
    for (name, figure) in FIGURES.into_iter().zip(&result.figures) {
        fields.insert(name.to_owned(), json!({ "value": figure.value, "lower": figure.lower, "upper": figure.upper }));
    }
    fields.insert("decisions".to_owned(), json!(result.decisions));
    let [p50, p99, max] = result.decision_ns;
    fields.insert("decision_ns".to_owned(), json!({ "p50": p50, "p99": p99, "max": max }));
    Value::Object(fields)
}
