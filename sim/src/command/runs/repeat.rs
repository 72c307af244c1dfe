//! `runs repeat`: makes a run again from its stored command line.

use super::super::replay;
use super::record::{result_hash, without_times};
use super::text::printable;
use super::{SCHEMA_VERSION, StoreArgs};
use anyhow::{Context, bail};
use clap::Args;
use serde_json::{Value, json};
use std::io::Write;

/// Differences that are named; the others are counted.
const NAMED: usize = 20;

#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  foresight-sim runs repeat 3\n  foresight-sim runs repeat 3 --json\n\n\
                  The command is run in the folder in which it was given. What times this machine is not compared.\n\
                  Exit code 2 if the results are not the same.")]
pub(super) struct RepeatArgs {
    /// Number of the run
    #[arg(value_name = "RUN")]
    run: i64,
    #[command(flatten)]
    store: StoreArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &RepeatArgs) -> anyhow::Result<()> {
    let mut store = args.store.open()?;
    let stored = store.run(args.run)?;
    let recorded: Value = serde_json::from_str(&store.document(args.run)?)?;
    drop(store);
    let run = &stored.run;
    let replay =
        super::super::replay_args(&run.arguments).with_context(|| format!("the command of run {}", stored.id))?;
    if let Some(folder) = &run.folder {
        std::env::set_current_dir(folder)
            .with_context(|| format!("run {} was made in {folder}; expected that folder", stored.id))?;
    }
    let comparison = replay::execute(&replay, &|_, _| {})?;
    let repeated_hash = result_hash(&serde_json::to_value(&comparison)?);
    let reproduced = repeated_hash == run.result_hash;
    let mut differing = Vec::new();
    if !reproduced {
        // Both through the same reader, which may round.
        let repeated: Value = serde_json::from_str(&serde_json::to_string(&comparison)?)?;
        differences("", &without_times(recorded), &without_times(repeated), &mut differing);
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        let differing = differing
            .iter()
            .map(|(field, recorded, repeated)| json!({ "field": field, "recorded": recorded, "repeated": repeated }));
        let document = json!({
            "schema_version": SCHEMA_VERSION, "run": stored.id, "reproduced": reproduced,
            "result_hash": { "recorded": run.result_hash, "repeated": repeated_hash },
            "program_version": { "recorded": run.program_version, "repeated": env!("CARGO_PKG_VERSION") },
            "differences": differing.collect::<Vec<_>>(),
        });
        writeln!(out, "{document}")?;
    } else if reproduced {
        writeln!(out, "run {} is reproduced: results {repeated_hash}", stored.id)?;
    } else {
        for (field, recorded, repeated) in differing.iter().take(NAMED) {
            let [recorded, repeated] = [recorded, repeated].map(|value| printable(&value.to_string(), 200));
            writeln!(out, "{field}: {recorded} recorded, {repeated} now")?;
        }
        if differing.len() > NAMED {
            writeln!(out, "… and {} more", differing.len() - NAMED)?;
        }
    }
    if !reproduced {
        bail!(
            "run {} of version {} is not reproduced by version {}: {} fields differ; expected none",
            stored.id,
            run.program_version,
            env!("CARGO_PKG_VERSION"),
            differing.len()
        );
    }
    Ok(())
}

/// Fields of two documents that differ, by their place, in the documents' order.
fn differences(place: &str, recorded: &Value, repeated: &Value, found: &mut Vec<(String, Value, Value)>) {
    let absent = Value::Null;
    match (recorded, repeated) {
        (Value::Object(a), Value::Object(b)) => {
            let only_repeated = b.keys().filter(|name| !a.contains_key(*name));
            for name in a.keys().chain(only_repeated) {
                let place = if place.is_empty() { name.clone() } else { format!("{place}.{name}") };
                differences(&place, a.get(name).unwrap_or(&absent), b.get(name).unwrap_or(&absent), found);
            }
        }
        (Value::Array(a), Value::Array(b)) => {
            for index in 0..a.len().max(b.len()) {
                let place = format!("{place}[{index}]");
                differences(&place, a.get(index).unwrap_or(&absent), b.get(index).unwrap_or(&absent), found);
            }
        }
        (a, b) if a == b => {}
        (a, b) => found.push((place.to_owned(), a.clone(), b.clone())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named_by_their_place() {
        let recorded = json!({ "inputs": { "seed": 1 }, "policies": [{ "name": "a", "mean_quality": 0.5 }] });
        let repeated =
            json!({ "inputs": { "seed": 1, "new": true }, "policies": [{ "name": "a", "mean_quality": null }, 7] });
        let mut found = Vec::new();
        differences("", &recorded, &repeated, &mut found);
        let places: Vec<_> = found.iter().map(|(place, ..)| place.as_str()).collect();
        assert_eq!(places, ["inputs.new", "policies[0].mean_quality", "policies[1]"]);
    }
}
