//! The store of past runs as a user meets it: recorded, listed, shown, compared, exported and repeated; and a build
//! without it.

use std::path::Path;
use std::time::Duration;

use foresight_tests::{input, postgres, program};
use serde_json::Value;

const LIMIT: Duration = Duration::from_secs(120);
/// What a tiny replay takes.
const REPLAY: [&str; 9] = [
    "replay",
    "--world",
    "tileset.json",
    "--path",
    "path.txt",
    "--link",
    input::LINK,
    "--policy",
    "foresight,lookahead",
];

/// Ends well, and says this on standard output.
fn said(folder: &Path, arguments: &[&str]) -> String {
    // The user's own store is that of the test.
    let home = folder.join("home");
    let ended = program::run("foresight-sim", folder, arguments, &[("XDG_DATA_HOME", &home)], LIMIT);
    assert_eq!(ended.code, Some(0), "{arguments:?}\n{}", ended.stderr);
    ended.stdout
}

fn document(folder: &Path, arguments: &[&str]) -> Value {
    let mut all = arguments.to_vec();
    all.push("--json");
    let document: Value = serde_json::from_str(&said(folder, &all)).expect("one JSON document");
    assert_eq!(document["schema_version"], 1, "{arguments:?}");
    document
}

/// Exit code 2, one message with all of these words, and nothing on standard output.
fn refused(program: &str, folder: &Path, arguments: &[&str], named: &[&str]) {
    let ended = program::run(program, folder, arguments, &[("XDG_DATA_HOME", &folder.join("home"))], LIMIT);
    let context = format!("{arguments:?}\nexit code {:?}\n{}", ended.code, ended.stderr);
    assert_eq!(ended.code, Some(2), "{context}");
    assert!(ended.stdout.is_empty(), "refused, yet printed: {}\n{context}", ended.stdout);
    assert!(!ended.stderr.contains("panicked at"), "{context}");
    assert!(named.iter().all(|word| ended.stderr.contains(word)), "the message lacks one of {named:?}\n{context}");
}

fn with<'a>(arguments: &[&'a str], more: &[&'a str]) -> Vec<&'a str> {
    [arguments, more].concat()
}

/// Records two runs of different seeds and one of another memory budget.
fn record_three(folder: &Path, store: &[&str]) {
    for settings in [["--seed", "1"], ["--seed", "2"], ["--memory", "8MiB"]] {
        let line = with(&with(&REPLAY, &["--starts", "3"]), &settings);
        let text = said(folder, &with(&line, store));
        assert!(text.lines().last().is_some_and(|line| line.starts_with("run ")), "{text}");
    }
}

/// What `list`, `show`, `diff`, `export` and `repeat` answer, without what differs between stores and machines.
fn answers(folder: &Path, store: &[&str]) -> Vec<Value> {
    let mut answers = vec![
        document(folder, &with(&["runs", "list"], store)),
        document(folder, &with(&["runs", "list", "--policy", "lookahead", "--since", "1h"], store)),
        document(folder, &with(&["runs", "show", "3"], store)),
        document(folder, &with(&["runs", "diff", "1", "3"], store)),
        document(
            folder,
            &with(&["runs", "diff", "--versions", env!("CARGO_PKG_VERSION"), env!("CARGO_PKG_VERSION")], store),
        ),
        document(folder, &with(&["runs", "repeat", "2"], store)),
    ];
    for answer in &mut answers {
        forget(answer);
    }
    answers
}

/// Removes the store's name and whatever times a machine, at any depth.
fn forget(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            fields.retain(|name, _| {
                !["store", "started_at", "started_at_ms", "wall_s", "peak_memory_bytes", "decision_ns"]
                    .contains(&name.as_str())
            });
            fields.values_mut().for_each(forget);
        }
        Value::Array(items) => items.iter_mut().for_each(forget),
        _ => {}
    }
}

#[test]
fn runs_are_recorded_listed_shown_compared_exported_and_repeated() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    input::write_world(folder);
    record_three(folder, &["--store"]);

    let list = document(folder, &["runs", "list"]);
    let runs = list["runs"].as_array().expect("a list of runs");
    assert_eq!(runs.iter().map(|run| run["id"].as_i64()).collect::<Vec<_>>(), [Some(1), Some(2), Some(3)]);
    let arguments = with(&with(&REPLAY, &["--starts", "3"]), &["--seed", "1"]);
    assert_eq!(runs[0]["arguments"], Value::from(arguments), "where results go is no part of what is repeated");
    for run in runs {
        assert_eq!(run["results"].as_array().map(Vec::len), Some(2));
        assert!(run["wall_s"].as_f64().is_some_and(|wall| wall > 0.0));
        assert!(run["started_at_ms"].as_i64().is_some_and(|ms| ms > 1_700_000_000_000));
    }
    assert_ne!(runs[0]["inputs_hash"], runs[1]["inputs_hash"]);
    assert_eq!(document(folder, &["runs", "list", "--policy", "cesium"])["runs"], Value::Array(Vec::new()));
    assert_eq!(document(folder, &["runs", "list", "--since", "0s"])["runs"], Value::Array(Vec::new()));
    assert_eq!(said(folder, &["runs", "list"]).lines().count(), 2 + 3);

    let show = document(folder, &["runs", "show", "1"]);
    for (result, policy) in [0, 1].map(|i| (&show["run"]["results"][i], &show["document"]["policies"][i])) {
        assert_eq!(result["policy"], policy["name"]);
        assert_eq!(result["mean_deficit"]["value"], policy["mean_deficit"]);
        assert_eq!(result["mean_deficit"]["upper"], policy["interval"]["mean_deficit"]["upper"]);
        assert_eq!(result["seconds_to_0_9"]["value"], policy["seconds_to_0_9"]);
        assert_eq!(result["decision_ns"], policy["decision_ns"]);
    }
    assert!(said(folder, &["runs", "show", "1"]).contains("foresight-sim replay --world tileset.json"));

    let diff = document(folder, &["runs", "diff", "1", "3"]);
    assert_eq!(diff["rows"].as_array().map(Vec::len), Some(2));
    assert!(diff["notes"].to_string().contains("memory_bytes: 268435456, 8388608"), "{}", diff["notes"]);
    said(folder, &with(&arguments_of_run_one(), &["--store"]));
    for row in document(folder, &["runs", "diff", "1", "4"])["rows"].as_array().expect("rows") {
        assert_eq!((&row["change"], &row["ratio"]), (&Value::from("same"), &Value::from(1.0)), "{row}");
    }
    assert!(said(folder, &["runs", "repeat", "3"]).contains("run 3 is reproduced"));

    for (format, start) in [("csv", b"run,".as_slice()), ("parquet", b"PAR1")] {
        let file = format!("runs.{format}");
        said(folder, &["runs", "export", "--format", format, "--out", &file, "--policy", "foresight"]);
        let bytes = std::fs::read(folder.join(&file)).expect("the file is there");
        assert!(bytes.starts_with(start), "{format}");
        if format == "csv" {
            assert_eq!(bytes.iter().filter(|byte| **byte == b'\n').count(), 1 + 4);
        }
    }

    // A changed input is named by `repeat`, which then fails.
    input::write(folder, "path.txt", input::PATH.replace("4 10 0 0", "4 11 0 0"));
    let ended = program::run(
        "foresight-sim",
        folder,
        &["runs", "repeat", "1"],
        &[("XDG_DATA_HOME", &folder.join("home"))],
        LIMIT,
    );
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert!(ended.stdout.contains("inputs.path_hash"), "{}", ended.stdout);
    assert!(ended.stderr.contains("is not reproduced"), "{}", ended.stderr);
}

fn arguments_of_run_one() -> Vec<&'static str> {
    with(&with(&REPLAY, &["--starts", "3"]), &["--seed", "1"])
}

#[test]
fn what_cannot_be_used_is_refused_before_the_work() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    input::write_world(folder);
    let sim = "foresight-sim";
    refused(sim, folder, &["runs", "list"], &["no run store", "runs.sqlite", "expected"]);
    refused(sim, folder, &["runs", "show", "1", "--store", "absent.sqlite"], &["absent.sqlite"]);
    refused(sim, folder, &with(&REPLAY, &["--store", "tileset.json"]), &["tileset.json", "SQLite"]);
    refused(sim, folder, &with(&REPLAY, &["--store", "missing/runs.sqlite"]), &["missing", "does not exist"]);
    refused(sim, folder, &with(&REPLAY, &["--store", "mysql://localhost/runs"]), &["mysql", "expected"]);
    refused(sim, folder, &with(&REPLAY, &["--alpha", "2", "--store", "new.sqlite"]), &["alpha"]);
    refused(
        sim,
        folder,
        &with(&REPLAY, &["--world", "absent.json", "--store", "new.sqlite"]),
        &["cannot be used multiple"],
    );
    refused(sim, folder, &["replay", "--world", "absent.json", "--store", "new.sqlite"], &["absent.json"]);
    assert!(!folder.join("new.sqlite").exists(), "a replay that was refused made a store");
    said(folder, &with(&REPLAY, &["--store", "new.sqlite"]));
    refused(sim, folder, &["runs", "show", "7", "--store", "new.sqlite"], &["no run 7"]);
    refused(
        sim,
        folder,
        &["runs", "diff", "--versions", "0.0.0", "9", "--store", "new.sqlite"],
        &["0.0.0", "expected"],
    );
    refused(
        sim,
        folder,
        &["runs", "list", "--since", "yesterday", "--store", "new.sqlite"],
        &["yesterday", "expected"],
    );
    refused(
        sim,
        folder,
        &["runs", "export", "--format", "csv", "--out", "no/x.csv", "--store", "new.sqlite"],
        &["no/x.csv"],
    );
    let whole = std::fs::read(folder.join("new.sqlite")).expect("the store");
    input::write(folder, "cut.sqlite", &whole[..whole.len() / 2]);
    refused(sim, folder, &["runs", "list", "--store", "cut.sqlite"], &["cut.sqlite", "damaged"]);
    refused(sim, folder, &with(&REPLAY, &["--store", "cut.sqlite"]), &["cut.sqlite", "damaged"]);
    assert_eq!(std::fs::read(folder.join("cut.sqlite")).expect("still there"), whole[..whole.len() / 2]);
}

#[test]
fn a_build_without_the_store_says_how_to_get_it() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    input::write_world(folder.path());
    let default = "foresight-sim-default";
    refused(
        default,
        folder.path(),
        &["runs", "list", "--since", "7d"],
        &["cargo run --release --features runs -- runs list --since 7d"],
    );
    refused(default, folder.path(), &with(&REPLAY, &["--store"]), &["--store", "--features runs"]);
    let help = program::run(default, folder.path(), &["runs", "--help"], &[], LIMIT);
    assert!(help.code == Some(0) && help.stdout.contains("--features runs"), "{help:?}");
    let json = with(&REPLAY, &["--json"]);
    let results = ["foresight-sim", default].map(|program| {
        let ended = program::run(program, folder.path(), &json, &[], LIMIT);
        let mut document: Value = serde_json::from_str(&ended.stdout).expect("one JSON document");
        forget(&mut document);
        document
    });
    assert_eq!(results[0], results[1], "the store changes no result");
}

#[test]
fn a_server_answers_what_a_file_answers() {
    if let Err(reason) = foresight_tests::full() {
        println!("{reason}");
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    input::write_world(folder.path());
    let server = postgres::Server::start();
    let (file, url) = (["--store", "runs.sqlite"], ["--store", server.url()]);
    record_three(folder.path(), &file);
    record_three(folder.path(), &url);
    for (file, server) in answers(folder.path(), &file).iter().zip(answers(folder.path(), &url)) {
        assert_eq!(*file, server);
    }
}
