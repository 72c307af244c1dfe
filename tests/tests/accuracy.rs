//! Error against run time as a user measures it.

use std::time::Duration;

use foresight_tests::program;
use serde_json::Value;

const LIMIT: Duration = Duration::from_secs(300);

/// Removes what differs from run to run.
fn without_nanos(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            fields.retain(|name, _| {
                !matches!(name.as_str(), "ns_per_candidate" | "ns_per_decision" | "decision_ns" | "action_ns")
            });
            fields.values_mut().for_each(without_nanos);
        }
        Value::Array(items) => items.iter_mut().for_each(without_nanos),
        _ => {}
    }
}

fn document(stdout: &str) -> Value {
    let mut document = serde_json::from_str(stdout).expect("one JSON document");
    without_nanos(&mut document);
    document
}

#[test]
fn a_small_measurement_has_the_agreed_shape_repeats_and_is_reported() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let small = ["--world", "city:blocks=4", "--path", "steady:speed=5,duration=4", "--candidates", "240"];
    let sizes = ["--situations", "2", "--largest", "1e4", "--decisions", "10", "--instances", "2"];
    let words = [&["accuracy"], &small[..], &sizes[..], &["--json"]].concat();
    let with_report = [&words[..], &["--report", "out"]].concat();
    let ended = program::sim(folder.path(), &with_report, LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let raw: Value = serde_json::from_str(&ended.stdout).expect("one JSON document");
    assert_eq!(raw["schema_version"], 1);
    let error = [
        "case",
        "kind",
        "method",
        "setting",
        "certified",
        "evaluations",
        "ns_per_candidate",
        "max_relative_error",
        "p999_relative_error",
        "median_relative_error",
        "bound_violations",
    ];
    let choice = ["case", "method", "tolerance", "wrong_choices", "decisions", "max_regret", "ns_per_decision"];
    let scale = ["representations", "situation", "decision_ns", "action_ns", "nodes_opened"];
    for (part, fields) in [("integral", &error[..]), ("worst_case", &error), ("choice", &choice), ("scale", &scale)] {
        let rows = raw[part].as_array().expect(part);
        assert!(!rows.is_empty(), "{part}");
        for (row, field) in rows.iter().flat_map(|row| fields.iter().map(move |field| (row, field))) {
            assert!(row.get(field).is_some(), "{part} has no {field}: {row}");
        }
    }
    assert!(raw["upper_bound"].is_array());
    assert!(raw["worst_case"].as_array().is_some_and(|rows| rows.iter().any(|row| row["gap"].is_number())));
    for row in raw["integral"].as_array().into_iter().chain(raw["worst_case"].as_array()).flatten() {
        assert!(row["certified"] != true || row["bound_violations"] == 0, "{row}");
    }
    for row in raw["scale"].as_array().into_iter().flatten() {
        assert!(row["decision_ns"]["p50"].as_u64() <= row["decision_ns"]["p99"].as_u64(), "{row}");
    }

    let again = program::sim(folder.path(), &words, LIMIT);
    assert_eq!(document(&again.stdout), document(&ended.stdout));

    let page = std::fs::read_to_string(folder.path().join("out/accuracy.html")).expect("a page");
    for part in ["id=\"integral\"", "id=\"regret\"", "id=\"scale\"", "id=\"findings\"", "<svg"] {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("<script") && !page.contains("http://") && !page.contains("NaN"));
    let written = std::fs::read_to_string(folder.path().join("out/accuracy.json")).expect("a document");
    assert_eq!(serde_json::from_str::<Value>(&written).expect("JSON"), raw);
}

#[test]
fn what_cannot_be_measured_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (words, named) in [
        (&["--only", "speed"][..], &["speed", "integral", "scale"][..]),
        (&["--largest", "1e9"], &["1e9", "1e7"]),
        (&["--candidates", "0"], &["0", "--candidates"]),
        (&["--data", "nowhere"], &["nowhere", "expected"]),
        (&["--world", "missing.json", "--only", "choice"], &["missing.json"]),
        (&["--path", "steady:speed=fast", "--only", "choice"], &["speed=fast", "expected"]),
    ] {
        let ended = program::sim(folder.path(), &[&["accuracy"], words, &["--report", "out"]].concat(), LIMIT);
        assert_eq!(ended.code, Some(2), "{words:?}: {}", ended.stderr);
        assert!(ended.stdout.is_empty() && !ended.stderr.contains("panicked"), "{words:?}: {}", ended.stderr);
        for name in named {
            assert!(ended.stderr.contains(name), "{words:?} does not name {name}: {}", ended.stderr);
        }
        assert!(!folder.path().join("out").exists(), "{words:?} wrote a report");
    }
}
