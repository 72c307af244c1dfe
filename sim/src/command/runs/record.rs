//! Recording a run: what a comparison becomes in the store.

use super::super::replay::ReplayArgs;
use super::super::suite::peak_memory_bytes;
use super::{location, make_folder};
use anyhow::Context;
use foresight_index::runs::{Access, Figure, Input, Location, PolicyResult, Pressure, Run, RunStore, RunStoreError};
use foresight_sim::outcome::{Comparison, Inputs, Interval, Intervals, PolicyOutcome};
use foresight_sim::stopwatch::{self, Stopwatch};
use serde_json::{Value, json};
use std::ffi::OsString;
use std::io::Read;

/// Records runs into a store.
pub(crate) struct Recorder {
    named: String,
    location: Location,
    // Opened for the first run, so that a replay that fails leaves no empty store.
    store: Option<RunStore>,
    build: String,
}

impl Recorder {
    /// For the store named, or the user's own if the name is empty. Refuses one that cannot be used, before the work is
    /// done that is to be recorded.
    pub(crate) fn open(named: &str) -> anyhow::Result<Recorder> {
        let location = location(named)?;
        match RunStore::open(&location, Access::Read) {
            Ok(_) | Err(RunStoreError::Absent { .. } | RunStoreError::Older { .. }) => {}
            Err(error) => return Err(error.into()),
        }
        if let (false, Location::File(file)) = (named.is_empty(), &location) {
            let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
            if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
                return Err(RunStoreError::Folder { file: file.clone(), folder: folder.to_owned() }.into());
            }
        }
        Ok(Recorder { named: named.to_owned(), location, store: None, build: build()? })
    }

    /// Records a comparison that began when the watch was started, and says where. `line` is the case of a suite and the
    /// command that repeats it, where that is not the program's own command line.
    pub(crate) fn record(
        &mut self,
        comparison: &Comparison,
        args: &ReplayArgs,
        watch: Stopwatch,
        line: Option<(&str, &[String])>,
    ) -> anyhow::Result<String> {
        let wall = watch.nanos();
        let arguments = match line {
            Some((_, command)) => command.to_vec(),
            None => repeatable(std::env::args_os().skip(1))?,
        };
        let settings = settings(&comparison.inputs, args.other_settings());
        let document = serde_json::to_value(comparison)?;
        let mut run = run_of(comparison, &settings);
        run.started_at_ms = stopwatch::unix_ms() - i64::try_from(wall / 1_000_000).unwrap_or(i64::MAX);
        run.program_version = env!("CARGO_PKG_VERSION").to_owned();
        run.build.clone_from(&self.build);
        run.suite_case = line.map(|(case, _)| case.to_owned());
        run.folder = std::env::current_dir().ok().and_then(|folder| folder.into_os_string().into_string().ok());
        run.arguments = arguments;
        run.result_hash = result_hash(&document);
        run.wall_s = wall as f64 * 1e-9;
        run.peak_memory_bytes = peak_memory_bytes();
        if self.store.is_none() {
            make_folder(&self.named, &self.location)?;
        }
        let store = match &mut self.store {
            Some(store) => store,
            none => none.insert(RunStore::open(&self.location, Access::Write)?),
        };
        let id = store.add(&run, &serde_json::to_string(comparison)?)?;
        Ok(format!("run {id} in {}", store.name()))
    }
}

/// BLAKE3 of the executable, the first 16 digits.
fn build() -> anyhow::Result<String> {
    let hash = || {
        let mut hasher = blake3::Hasher::new();
        let mut file = std::fs::File::open(std::env::current_exe()?)?;
        let mut buffer = vec![0; 1 << 16];
        loop {
            match file.read(&mut buffer)? {
                0 => return Ok::<_, std::io::Error>(hasher.finalize()),
                n => hasher.update(&buffer[..n]),
            };
        }
    };
    Ok(hash().context("reading this program's executable")?.to_hex()[..16].to_owned())
}

/// The command line without the options that say where results go.
fn repeatable(words: impl Iterator<Item = OsString>) -> anyhow::Result<Vec<String>> {
    let mut words = words
        .map(|word| {
            word.into_string()
                .map_err(|word| anyhow::anyhow!("`{}` cannot be recorded; expected UTF-8", word.display()))
        })
        .collect::<Result<Vec<_>, _>>()?
        .into_iter()
        .peekable();
    let mut kept = Vec::new();
    while let Some(word) = words.next() {
        match word.split('=').next().unwrap_or_default() {
            "--json" => {}
            // With their value, which --store may lack.
            "--store" | "--report" if !word.contains('=') => {
                words.next_if(|value| word == "--report" || !value.starts_with('-'));
            }
            "--store" | "--report" => {}
            _ => kept.push(word),
        }
    }
    Ok(kept)
}

/// What the results depend on beside world, path and link. Policies are not among them: each is judged by itself.
///
/// Two versions of the program share the inputs of a run if this is equal. So a setting that comes later is left out
/// where it has the value that all runs before it had.
fn settings(inputs: &Inputs, other: Value) -> Value {
    let mut settings = json!({
        "duration_s": inputs.duration_s,
        "memory_bytes": inputs.memory_bytes,
        "alpha": inputs.alpha,
        "worst_case": inputs.worst_case,
        "refinement": inputs.refinement,
        "warm": inputs.warm,
        "seed": inputs.seed,
        "starts_s": inputs.starts_s,
        "viewport": inputs.viewport,
        "fov_y_deg": inputs.fov_y_deg,
    });
    if let (Value::Object(all), Value::Object(other)) = (&mut settings, other) {
        all.extend(other);
    }
    settings
}

/// The run of a comparison, without what the comparison does not know.
fn run_of(comparison: &Comparison, settings: &Value) -> Run {
    let inputs = &comparison.inputs;
    let input = |name: &str, hash: &str| Input { name: name.to_owned(), hash: hash.to_owned() };
    let hashed = json!({
        "world": inputs.world_hash, "path": inputs.path_hash, "link": inputs.link_hash, "settings": settings
    });
    Run {
        world: input(&inputs.world, &inputs.world_hash),
        path: input(&inputs.path, &inputs.path_hash),
        link: input(&inputs.link, &inputs.link_hash),
        settings: canonical(settings).to_string(),
        seed: inputs.seed,
        inputs_hash: hash(&hashed),
        nonempty_share: finite(comparison.nonempty_share),
        pressure: Pressure {
            lambda: finite(comparison.pressure.lambda),
            rho: finite(comparison.pressure.rho),
            mu: finite(comparison.pressure.mu),
            largest_need_bytes: comparison.pressure.largest_need_bytes,
        },
        bound_quality: comparison.upper_bound.mean_quality.and_then(finite),
        bound_method: comparison.upper_bound.method.clone(),
        results: comparison.policies.iter().map(result).collect(),
        ..Run::default()
    }
}

fn result(policy: &PolicyOutcome) -> PolicyResult {
    let interval = policy.interval.unwrap_or_default();
    let figure = |value: Option<f64>, of: fn(&Intervals) -> Option<Interval>| Figure {
        value: value.and_then(finite),
        lower: of(&interval).and_then(|interval| finite(interval.lower)),
        upper: of(&interval).and_then(|interval| finite(interval.upper)),
    };
    PolicyResult {
        policy: policy.name.clone(),
        figures: [
            figure(policy.mean_quality, |i| i.mean_quality),
            figure(policy.mean_deficit, |i| i.mean_deficit),
            figure(policy.p05_quality, |i| i.p05_quality),
            figure(Some(policy.seconds_below_0_9), |i| i.seconds_below_0_9),
            figure(policy.seconds_to_0_9, |i| i.seconds_to_0_9),
            figure(policy.share_within_16px, |i| i.share_within_16px),
            figure(Some(policy.bytes_fetched), |i| i.bytes_fetched),
            figure(Some(policy.bytes_wasted), |i| i.bytes_wasted),
            figure(Some(policy.bytes_cancelled), |i| i.bytes_cancelled),
            figure(Some(policy.evictions), |i| i.evictions),
        ],
        decisions: finite(policy.decisions),
        decision_ns: [policy.decision_ns.p50, policy.decision_ns.p99, policy.decision_ns.max],
    }
}

/// As in the document, where what is not finite is `null`.
fn finite(value: f64) -> Option<f64> {
    Some(value).filter(|v| v.is_finite())
}

/// The document of a comparison without what times this machine.
pub(super) fn without_times(mut document: Value) -> Value {
    for policy in document["policies"].as_array_mut().into_iter().flatten() {
        if let Some(policy) = policy.as_object_mut() {
            policy.remove("decision_ns");
        }
    }
    document
}

/// BLAKE3 of a document without what times this machine.
pub(super) fn result_hash(document: &Value) -> String {
    hash(&without_times(document.clone()))
}

fn hash(value: &Value) -> String {
    blake3::hash(canonical(value).to_string().as_bytes()).to_hex().to_string()
}

/// The same value with the fields of its objects sorted, whatever order the JSON library keeps.
fn canonical(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let mut names: Vec<&String> = fields.keys().collect();
            names.sort();
            names.into_iter().map(|name| (name.clone(), canonical(&fields[name]))).collect()
        }
        Value::Array(items) => items.iter().map(canonical).collect(),
        other => other.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_results_go_is_no_part_of_what_is_repeated() {
        let kept = |line: &str| repeatable(line.split(' ').map(OsString::from)).unwrap().join(" ");
        assert_eq!(kept("replay --store --json --seed 3"), "replay --seed 3");
        assert_eq!(kept("replay --store a.sqlite --seed 3"), "replay --seed 3");
        assert_eq!(kept("replay --seed 3 --store"), "replay --seed 3");
        assert_eq!(kept("replay --store=a --report=out --seed 3"), "replay --seed 3");
        assert_eq!(kept("replay --report out --world w --store"), "replay --world w");
    }

    #[test]
    fn results_hash_without_times_and_without_order() {
        let document = |nanos: u64, q: f64| json!({ "policies": [{ "name": "a", "mean_quality": q, "decision_ns": { "p50": nanos } }], "warnings": [] });
        assert_eq!(result_hash(&document(1, 0.5)), result_hash(&document(2, 0.5)));
        assert_ne!(result_hash(&document(1, 0.5)), result_hash(&document(1, 0.5_f64.next_up())));
        assert_eq!(hash(&json!({ "a": 1, "b": [2] })), hash(&json!({ "b": [2], "a": 1 })));
    }
}
