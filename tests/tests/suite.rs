//! The benchmark suite as a user runs it.

use std::time::Duration;

use foresight_tests::program;
use serde_json::Value;

const LIMIT: Duration = Duration::from_secs(120);

/// A JSON document without the figures that time this machine.
fn without_timings(mut document: Value) -> Value {
    for policy in document["policies"].as_array_mut().into_iter().flatten() {
        if let Some(policy) = policy.as_object_mut() {
            policy.remove("decision_ns");
        }
    }
    document
}

#[test]
fn a_case_runs_is_reported_and_each_replay_repeats_from_its_command() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let arguments = [
        "suite",
        "--case",
        "turn",
        "--policy",
        "foresight,lookahead",
        "--starts",
        "2",
        "--at-most",
        "4",
        "--json",
        "--report",
        "out",
    ];
    let ended = program::sim(folder.path(), &arguments, LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let document: Value = serde_json::from_str(&ended.stdout).expect("one JSON document");
    assert_eq!(document["schema_version"], 1);
    let case = &document["cases"][0];
    assert_eq!((&case["name"], &case["due"]), (&Value::from("turn"), &Value::from("open")));
    assert!(document["wall_s"].as_f64().is_some_and(|s| s > 0.0));
    let standing = &document["standings"][0];
    assert_eq!(standing["rival"], "lookahead");
    let counts: u64 = ["ahead", "level", "behind"].iter().map(|key| standing[*key].as_u64().expect("a count")).sum();
    assert_eq!(counts, 1);

    // The relative deficit is the geometric mean over the replays and starts, by hand.
    let replays = case["replays"].as_array().expect("replays");
    let deficits = |replay: &Value, policy: usize| -> Vec<f64> {
        let starts = replay["comparison"]["policies"][policy]["mean_deficit_by_start"].as_array().expect("starts");
        starts.iter().map(|d| d.as_f64().expect("a deficit")).collect()
    };
    let mut product = 1.0;
    let mut count = 0;
    for replay in replays {
        for (own, rival) in deficits(replay, 0).iter().zip(deficits(replay, 1)) {
            product *= own.max(1e-3) / rival.max(1e-3);
            count += 1;
        }
    }
    assert_eq!(count, 2 * replays.len());
    let relative = standing["relative_deficit"].as_f64().expect("a figure");
    let power: f64 = std::iter::repeat_n(relative, count).product();
    assert!((product / power - 1.0).abs() < 1e-9, "{relative} {product}");

    let page = std::fs::read_to_string(folder.path().join("out/suite.html")).expect("a page");
    assert!(page.contains("case-turn") && page.contains(case["why"].as_str().expect("text")));
    let written = std::fs::read(folder.path().join("out/suite.json")).expect("a document");
    assert_eq!(serde_json::from_slice::<Value>(&written).expect("JSON"), document);

    for replay in replays {
        let command: Vec<&str> =
            replay["command"].as_array().expect("words").iter().filter_map(Value::as_str).collect();
        let again = program::sim(folder.path(), &[&command[..], &["--json"]].concat(), LIMIT);
        assert_eq!(again.code, Some(0), "{}", again.stderr);
        let again: Value = serde_json::from_str(&again.stdout).expect("one JSON document");
        assert_eq!(without_timings(again), without_timings(replay["comparison"].clone()), "{command:?}");
    }
}

#[test]
fn every_case_is_listed_with_its_commands() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let ended = program::sim(folder.path(), &["suite", "--list"], LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    for name in [
        "walk",
        "drive",
        "helicopter",
        "formation-flight",
        "glider-dem",
        "hike",
        "head-ride",
        "turn",
        "teleport",
        "known-path",
        "memory",
        "latency",
        "moving-link",
        "null",
        "low-detail",
        "starved-small",
        "asteroids",
    ] {
        assert!(ended.stdout.lines().any(|line| line.starts_with(&format!("{name}: "))), "{name}\n{}", ended.stdout);
    }
}

#[test]
fn without_recorded_data_its_cases_are_skipped_and_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let wrong = program::sim(folder.path(), &["suite", "--case", "walk", "--data", "nowhere"], LIMIT);
    assert_eq!(wrong.code, Some(2));
    assert!(wrong.stderr.contains("nowhere") && wrong.stderr.contains("expected"), "{}", wrong.stderr);
    let unknown = program::sim(folder.path(), &["suite", "--case", "nothing"], LIMIT);
    assert_eq!(unknown.code, Some(2));
    assert!(unknown.stderr.contains("`nothing`") && unknown.stderr.contains("turn"), "{}", unknown.stderr);
}

/// Every case for a few seconds of path, with two policies: all inputs load, and something is in view.
#[test]
fn every_case_runs() {
    let Some(data) = foresight_tests::data() else { return };
    if let Err(reason) = foresight_tests::full() {
        println!("{reason}");
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let data = data.canonicalize().expect("the folder exists");
    let data = data.to_str().expect("a readable path");
    let arguments =
        ["suite", "--data", data, "--policy", "foresight,lookahead", "--starts", "1", "--at-most", "3", "--json"];
    let ended = program::sim(folder.path(), &arguments, Duration::from_secs(540));
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let document: Value = serde_json::from_str(&ended.stdout).expect("one JSON document");
    assert_eq!(document["skipped"].as_array().map(Vec::len), Some(0));
    for case in document["cases"].as_array().expect("cases") {
        for replay in case["replays"].as_array().expect("replays") {
            let share = replay["comparison"]["nonempty_share"].as_f64().expect("a share");
            assert!(share > 0.0, "{}: nothing in view: {}", case["name"], replay["command"]);
        }
    }
}

#[test]
fn the_alpha_sweep_sets_adapted_and_solved_against_the_best_fixed_one() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let arguments = ["suite", "--alpha-sweep", "--case", "starved-small", "--starts", "1", "--at-most", "10"];
    let ended = program::sim(folder.path(), &[&arguments[..], &["--json"]].concat(), LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let document: Value = serde_json::from_str(&ended.stdout).expect("one JSON document");
    assert_eq!((&document["schema_version"], &document["alphas"][10]), (&Value::from(1), &Value::from(1.0)));
    let row = &document["rows"][0];
    let deficits: Vec<f64> =
        row["deficits"].as_array().expect("deficits").iter().map(|d| d.as_f64().expect("a deficit")).collect();
    let least = deficits.iter().copied().fold(f64::INFINITY, f64::min);
    assert_eq!(deficits.len(), 11);
    for contender in ["adapted", "solved"] {
        let (deficit, regret) = (row[contender]["deficit"].as_f64(), row[contender]["regret"].as_f64());
        assert!((deficit.expect("a deficit") - least - regret.expect("a regret")).abs() < 1e-12, "{contender}");
    }
    assert!(row["solved"]["constraint"][0].is_string());
    let text = program::sim(folder.path(), &arguments, LIMIT);
    assert!(text.stdout.contains("adapted: regret ÷ spread ≤ 0.2 in"), "{}", text.stdout);
}
