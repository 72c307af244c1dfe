//! `runs diff`: two runs, or two versions of the program on the inputs that both have replayed.

use super::text::{printable, spread, table};
use super::{SCHEMA_VERSION, StoreArgs, subject};
use anyhow::bail;
use clap::Args;
use foresight_index::runs::{Figure, Filter, PolicyResult, RunStore, StoredRun};
use foresight_sim::outcome::relative_deficit;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::Write;

#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  foresight-sim runs diff 3 5\n  foresight-sim runs diff --versions 0.1.0 0.2.0\n  \
    foresight-sim runs diff --versions 0.2.0+4be1 0.2.0+77c0 --json\n\n\
    Of several runs of a version on the same inputs, the latest with the policy counts. Changes of the mean deficit:\n  \
    same     not one digit\n  within   the 95 % intervals meet\n  beyond   they do not\n  differs  without intervals to tell by"
)]
pub(super) struct DiffArgs {
    /// Numbers of two runs
    #[arg(value_name = "RUN", num_args = 2, required_unless_present = "versions", conflicts_with = "versions")]
    runs: Vec<i64>,
    /// Two versions of the program; VERSION+BUILD means the builds of a version whose hash begins so
    #[arg(long, num_args = 2, value_name = "VERSION")]
    versions: Vec<String>,
    #[command(flatten)]
    store: StoreArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// A policy's result and the run that it is from.
type Entry<'a> = (&'a StoredRun, &'a PolicyResult);

/// What a policy reached on the same inputs, before and after.
struct Row<'a> {
    subject: String,
    policy: &'a str,
    before: Entry<'a>,
    after: Entry<'a>,
}

/// What both sides have, and what must be known to judge it.
#[derive(Default)]
struct Difference<'a> {
    rows: Vec<Row<'a>>,
    notes: Vec<String>,
}

pub(super) fn run(args: &DiffArgs) -> anyhow::Result<()> {
    let mut store = args.store.open()?;
    let (names, before, after) = match (args.runs.as_slice(), args.versions.as_slice()) {
        ([a, b], _) => {
            let names = [format!("run {a}"), format!("run {b}")];
            (names, vec![store.run(*a)?], vec![store.run(*b)?])
        }
        (_, [a, b]) => ([a.clone(), b.clone()], of_version(&mut store, a)?, of_version(&mut store, b)?),
        _ => bail!("expected two runs, or --versions and two versions"),
    };
    let difference = match (before.as_slice(), after.as_slice()) {
        ([a], [b]) if args.versions.is_empty() => of_runs(a, b),
        _ => of_versions(&names, &before, &after),
    };
    let mut out = std::io::stdout().lock();
    if args.json {
        let rows: Vec<Value> = difference.rows.iter().map(row_json).collect();
        let document = json!({
            "schema_version": SCHEMA_VERSION, "store": store.name(), "before": names[0], "after": names[1],
            "rows": rows, "notes": difference.notes,
        });
        writeln!(out, "{document}")?;
        return Ok(());
    }
    let heading = ["case", "runs", "policy", "change", &names[0], &names[1], "ratio"];
    let rows: Vec<Vec<String>> = difference.rows.iter().map(cells).collect();
    writeln!(out, "{}", table(&heading, &rows, 4))?;
    for line in summary(&difference.rows).into_iter().chain(difference.notes) {
        writeln!(out, "{}", printable(&line, 2000))?;
    }
    Ok(())
}

/// All runs of a version, or of those of its builds whose hash begins as given after a `+`.
fn of_version(store: &mut RunStore, given: &str) -> anyhow::Result<Vec<StoredRun>> {
    let (version, build) = given.split_once('+').unwrap_or((given, ""));
    let mut runs = store.list(&Filter { program_version: Some(version.to_owned()), ..Filter::default() })?;
    runs.retain(|stored| stored.run.build.starts_with(build));
    if runs.is_empty() {
        let mut known: Vec<String> =
            store.list(&Filter::default())?.into_iter().map(|s| s.run.program_version).collect();
        known.sort();
        known.dedup();
        bail!("no run of version {given} in {}; expected one of: {}", store.name(), known.join(", "));
    }
    Ok(runs)
}

fn of_runs<'a>(before: &'a StoredRun, after: &'a StoredRun) -> Difference<'a> {
    let mut difference = Difference::default();
    let entries = |stored: &'a StoredRun| stored.run.results.iter().map(|result| (stored, result)).collect::<Vec<_>>();
    let subject = subject(before);
    pair(&mut difference, &subject, [&before.id.to_string(), &after.id.to_string()], &entries(before), &entries(after));
    if before.run.inputs_hash != after.run.inputs_hash {
        difference.notes.push("the runs did not replay the same thing:".to_owned());
        difference.notes.extend(differing_inputs(before, after));
    }
    difference
}

/// The inputs and settings in which two runs differ.
fn differing_inputs(before: &StoredRun, after: &StoredRun) -> Vec<String> {
    let mut lines = Vec::new();
    let (a, b) = (&before.run, &after.run);
    for (name, a, b) in [("world", &a.world, &b.world), ("path", &a.path, &b.path), ("link", &a.link, &b.link)] {
        if a.hash != b.hash {
            let [a, b] = [a, b].map(|input| format!("{} ({})", input.name, printable(&input.hash, 12)));
            lines.push(format!("  {name}: {a}, {b}"));
        }
    }
    let settings = |run: &str| serde_json::from_str::<BTreeMap<String, Value>>(run).unwrap_or_default();
    let (a, b) = (settings(&a.settings), settings(&b.settings));
    let names: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    for name in names {
        let [a, b] = [&a, &b].map(|side| side.get(name).map_or_else(|| "not set".to_owned(), Value::to_string));
        if a != b {
            lines.push(format!("  {name}: {a}, {b}"));
        }
    }
    lines
}

/// Of each policy on each inputs the latest result, by the inputs' hash.
fn latest(runs: &[StoredRun]) -> BTreeMap<&str, Vec<Entry<'_>>> {
    let mut latest: BTreeMap<&str, Vec<Entry<'_>>> = BTreeMap::new();
    for stored in runs {
        let entries = latest.entry(&stored.run.inputs_hash).or_default();
        for result in &stored.run.results {
            match entries.iter_mut().find(|(_, earlier)| earlier.policy == result.policy) {
                Some(entry) => *entry = (stored, result),
                None => entries.push((stored, result)),
            }
        }
    }
    latest
}

fn of_versions<'a>(names: &[String; 2], before: &'a [StoredRun], after: &'a [StoredRun]) -> Difference<'a> {
    let mut difference = Difference::default();
    let (a, b) = (latest(before), latest(after));
    let newest = |entries: &[Entry<'_>]| entries.iter().map(|(stored, _)| stored.id).max().unwrap_or_default();
    let mut shared: Vec<&str> = a.keys().copied().filter(|inputs| b.contains_key(inputs)).collect();
    shared.sort_by_key(|inputs| newest(&b[inputs]));
    for inputs in shared {
        let subject = a[inputs].first().map(|(stored, _)| subject(stored)).unwrap_or_default();
        pair(&mut difference, &subject, [&names[0], &names[1]], &a[inputs], &b[inputs]);
    }
    for (name, own, other) in [(&names[0], &a, &b), (&names[1], &b, &a)] {
        let alone = own.iter().filter(|(inputs, _)| !other.contains_key(*inputs));
        let mut newest: Vec<&StoredRun> = alone
            .filter_map(|(_, entries)| entries.iter().map(|(stored, _)| *stored).max_by_key(|stored| stored.id))
            .collect();
        newest.sort_by_key(|stored| stored.id);
        let note = |stored: &StoredRun| {
            format!("only {name} replayed {} with these settings: run {}", subject(stored), stored.id)
        };
        difference.notes.extend(newest.into_iter().map(note));
    }
    difference
}

/// Puts the policies of two sides beside each other.
fn pair<'a>(
    difference: &mut Difference<'a>,
    subject: &str,
    names: [&str; 2],
    before: &[Entry<'a>],
    after: &[Entry<'a>],
) {
    for &entry in before {
        let same = |other: &&Entry<'a>| other.1.policy == entry.1.policy;
        match after.iter().find(same) {
            Some(&after) => {
                let policy = entry.1.policy.as_str();
                difference.rows.push(Row { subject: subject.to_owned(), policy, before: entry, after });
            }
            None => difference.notes.push(format!("{subject}: {} is in {} only", entry.1.policy, names[0])),
        }
    }
    for entry in after.iter().filter(|entry| before.iter().all(|other| other.1.policy != entry.1.policy)) {
        difference.notes.push(format!("{subject}: {} is in {} only", entry.1.policy, names[1]));
    }
}

fn deficit(entry: Entry<'_>) -> Figure {
    entry.1.figure("mean_deficit").copied().unwrap_or_default()
}

/// How a figure changed; see the command's help.
fn change(before: &Figure, after: &Figure) -> &'static str {
    match (before.lower, before.upper, after.lower, after.upper) {
        _ if before == after => "same",
        (Some(low), Some(high), Some(after_low), Some(after_high)) => {
            if high < after_low || after_high < low {
                "beyond"
            } else {
                "within"
            }
        }
        _ => "differs",
    }
}

fn ratio(row: &Row<'_>) -> Option<f64> {
    Some(relative_deficit(deficit(row.after).value?, deficit(row.before).value?))
}

fn cells(row: &Row<'_>) -> Vec<String> {
    let (before, after) = (deficit(row.before), deficit(row.after));
    vec![
        row.subject.clone(),
        format!("{}, {}", row.before.0.id, row.after.0.id),
        row.policy.to_owned(),
        change(&before, &after).to_owned(),
        spread(&before),
        spread(&after),
        ratio(row).map_or_else(|| "–".to_owned(), |ratio| format!("{ratio:.3}")),
    ]
}

/// The geometric mean of the ratios of each policy that has several.
fn summary(rows: &[Row<'_>]) -> Vec<String> {
    let mut ratios: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for row in rows {
        ratios.entry(row.policy).or_default().extend(ratio(row));
    }
    let several = ratios.into_iter().filter(|(_, ratios)| ratios.len() > 1);
    several
        .map(|(policy, ratios)| {
            let log = ratios.iter().map(|ratio| libm::log(*ratio)).sum::<f64>() / ratios.len() as f64;
            format!("{policy}: geometric mean of the ratio {:.3} over {} cases", libm::exp(log), ratios.len())
        })
        .collect()
}

fn row_json(row: &Row<'_>) -> Value {
    let side = |entry: Entry<'_>| {
        let figure = deficit(entry);
        json!({
            "run": entry.0.id, "build": entry.0.run.build, "mean_deficit": figure.value, "lower": figure.lower, "upper": figure.upper
        })
    };
    json!({
        "case": row.subject,
        "inputs_hash": [&row.before.0.run.inputs_hash, &row.after.0.run.inputs_hash],
        "policy": row.policy,
        "before": side(row.before),
        "after": side(row.after),
        "ratio": ratio(row),
        "change": change(&deficit(row.before), &deficit(row.after)),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_index::runs::Run;

    fn stored(id: i64, inputs: &str, deficits: &[(&str, f64, Option<f64>)]) -> StoredRun {
        let result = |&(policy, value, half): &(&str, f64, Option<f64>)| {
            let mut result = PolicyResult { policy: policy.to_owned(), ..PolicyResult::default() };
            result.figures[1] = Figure {
                value: Some(value),
                lower: half.map(|half| value - half),
                upper: half.map(|half| value + half),
            };
            result
        };
        let results = deficits.iter().map(result).collect();
        StoredRun { id, run: Run { inputs_hash: inputs.to_owned(), results, ..Run::default() } }
    }

    #[test]
    fn versions_meet_on_the_inputs_and_policies_that_both_have() {
        let before = [
            stored(1, "x", &[("a", 0.2, Some(0.01)), ("b", 0.4, None)]),
            stored(2, "y", &[("a", 0.1, None)]),
            stored(3, "x", &[("a", 0.4, Some(0.01))]),
        ];
        let after = [
            stored(4, "x", &[("a", 0.2, Some(0.01)), ("b", 0.4, None), ("c", 0.1, None)]),
            stored(5, "z", &[("a", 0.3, None)]),
        ];
        let difference = of_versions(&["1".to_owned(), "2".to_owned()], &before, &after);
        let rows: Vec<_> = difference.rows.iter().map(|row| (row.policy, row.before.0.id, row.after.0.id)).collect();
        assert_eq!(rows, [("a", 3, 4), ("b", 1, 4)], "of `a` the later run, of `b` the only one");
        assert_eq!(ratio(&difference.rows[0]), Some(0.5));
        let changes: Vec<_> =
            difference.rows.iter().map(|row| change(&deficit(row.before), &deficit(row.after))).collect();
        assert_eq!(changes, ["beyond", "same"]);
        let notes = difference.notes.join("\n");
        assert!(notes.contains("c is in 2 only") && notes.contains("run 2") && notes.contains("run 5"), "{notes}");
    }

    #[test]
    fn a_change_is_judged_by_the_intervals() {
        let figure = |value, half: Option<f64>| Figure {
            value: Some(value),
            lower: half.map(|half| value - half),
            upper: half.map(|half| value + half),
        };
        assert_eq!(change(&figure(0.5, Some(0.1)), &figure(0.6, Some(0.1))), "within");
        assert_eq!(change(&figure(0.5, Some(0.1)), &figure(0.8, Some(0.1))), "beyond");
        assert_eq!(change(&figure(0.8, Some(0.1)), &figure(0.5, Some(0.1))), "beyond");
        assert_eq!(change(&figure(0.5, None), &figure(0.5_f64.next_up(), None)), "differs");
        assert_eq!(change(&Figure::default(), &figure(0.5, None)), "differs");
        assert_eq!(change(&Figure::default(), &Figure::default()), "same");
    }
}
