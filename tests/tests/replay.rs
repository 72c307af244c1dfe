//! The comparison as a user first meets it: no arguments, and the JSON document.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Duration;

use foresight_tests::program;
use serde_json::Value;

const LIMIT: Duration = Duration::from_secs(300);

/// Fields of the document.
const DOCUMENT: [&str; 8] =
    ["schema_version", "inputs", "pressure", "nonempty_share", "upper_bound", "shadow_prices", "policies", "warnings"];

/// Fields of a policy's figures.
const POLICY: [&str; 15] = [
    "name",
    "mean_quality",
    "mean_deficit",
    "mean_deficit_by_start",
    "p05_quality",
    "seconds_below_0_9",
    "seconds_to_0_9",
    "share_within_16px",
    "bytes_fetched",
    "bytes_wasted",
    "bytes_cancelled",
    "failures",
    "evictions",
    "decisions",
    "decision_ns",
];

/// Fields without which a comparison cannot be repeated.
const INPUTS: [&str; 11] = [
    "world",
    "world_hash",
    "path",
    "path_hash",
    "link",
    "link_hash",
    "place",
    "memory_bytes",
    "alpha",
    "worst_case",
    "seed",
];

/// `replay --json` with further arguments.
fn document(arguments: &[&str]) -> Value {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut all = vec!["replay", "--json"];
    all.extend_from_slice(arguments);
    let ended = program::sim(folder.path(), &all, LIMIT);
    assert_eq!(ended.code, Some(0), "{all:?}\n{}", ended.stderr);
    serde_json::from_str(&ended.stdout).expect("standard output is one JSON document")
}

/// The first ten seconds of the built-in replay, without the figures that time this machine.
fn ten_seconds(arguments: &[&str]) -> String {
    let mut all = vec!["--duration", "10"];
    all.extend_from_slice(arguments);
    let mut document = document(&all);
    for policy in document["policies"].as_array_mut().expect("a list of policies") {
        policy.as_object_mut().expect("an object").remove("decision_ns").expect("decision_ns is there");
    }
    document.to_string()
}

fn fields(value: &Value) -> BTreeSet<&str> {
    value.as_object().expect("an object").keys().map(String::as_str).collect()
}

fn policies(document: &Value) -> &[Value] {
    document["policies"].as_array().expect("a list of policies")
}

/// The number, which must be one and finite.
fn number(value: &Value) -> f64 {
    let number = value.as_f64().unwrap_or_else(|| panic!("expected a number: {value}"));
    assert!(number.is_finite());
    number
}

/// Files of a name anywhere under a folder.
fn find(folder: &Path, name: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).expect("a folder can be listed") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(find(&path, name));
        } else if path.file_name().is_some_and(|file| file == name) {
            found.push(path);
        }
    }
    found
}

#[test]
fn without_arguments_it_compares_and_reports() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let ended = program::sim(folder.path(), &[], LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let document = document(&["--duration", "2"]);
    assert!(!policies(&document).is_empty());
    for policy in policies(&document) {
        let name = policy["name"].as_str().expect("a name");
        assert!(ended.stdout.contains(name), "the table does not name '{name}':\n{}", ended.stdout);
    }
    let reports = find(folder.path(), "report.html");
    assert_eq!(reports.len(), 1, "expected one report.html: {reports:?}");
    let report = std::fs::read_to_string(&reports[0]).expect("the report can be read");
    for loads in ["src=\"http", "href=\"http", "src=\"//", "@import", "url(http", "<script src", "<link "] {
        assert!(!report.contains(loads), "the report loads something: {loads}");
    }
    for not_a_number in ["NaN", "Infinity"] {
        assert!(!report.contains(not_a_number), "the report contains {not_a_number}");
    }
}

#[test]
fn the_document_has_the_fields_of_its_schema() {
    let document = document(&["--duration", "10", "--starts", "1"]);
    assert_eq!(fields(&document), BTreeSet::from(DOCUMENT));
    assert_eq!(document["schema_version"], 1);
    assert_eq!(fields(&document["pressure"]), BTreeSet::from(["lambda", "rho", "mu", "largest_need_bytes"]));
    assert_eq!(fields(&document["upper_bound"]), BTreeSet::from(["mean_quality", "method", "by_frame", "over_time"]));
    assert_eq!(document["shadow_prices"]["per_mbit_s"].as_array().map(Vec::len), Some(10));
    assert_eq!(document["shadow_prices"]["per_mib"].as_array().map(Vec::len), Some(10));
    let missing: Vec<_> = INPUTS.iter().filter(|field| document["inputs"].get(**field).is_none()).collect();
    assert!(missing.is_empty(), "inputs lack {missing:?}");
    for policy in policies(&document) {
        let mut expected = BTreeSet::from(POLICY);
        // Only what proves something can say what it may have missed.
        expected.extend(policy.get("regret").map(|_| "regret"));
        // Only one of them follows an α of its own.
        expected.extend((policy["name"] == "foresight").then_some("alpha"));
        assert_eq!(fields(policy), expected);
        assert_eq!(fields(&policy["decision_ns"]), BTreeSet::from(["p50", "p99", "max"]));
    }
    let names: BTreeSet<_> = policies(&document).iter().map(|policy| policy["name"].to_string()).collect();
    assert_eq!(names.len(), policies(&document).len(), "two policies of one name");
}

#[test]
fn figures_are_consistent_and_below_the_bound() {
    let document = document(&["--duration", "10"]);
    let share = number(&document["nonempty_share"]);
    assert!(share > 0.0 && share <= 1.0, "the built-in flight sees its world: {share}");
    let bound = number(&document["upper_bound"]["mean_quality"]);
    assert!((0.0..=1.0).contains(&bound));
    for field in ["lambda", "rho", "mu"] {
        assert!(number(&document["pressure"][field]) > 0.0, "{field}");
    }
    for policy in policies(&document) {
        let mean = number(&policy["mean_quality"]);
        assert!((0.0..=bound + 1e-12).contains(&mean), "a quality above the bound of {bound}: {policy}");
        assert!((mean + number(&policy["mean_deficit"]) - 1.0).abs() < 1e-9, "quality and deficit sum to 1: {policy}");
        for share in ["p05_quality", "share_within_16px"] {
            assert!((0.0..=1.0).contains(&number(&policy[share])), "{share}: {policy}");
        }
        let below = number(&policy["seconds_below_0_9"]);
        assert!((0.0..=10.0 + 1e-9).contains(&below), "{policy}");
        if !policy["seconds_to_0_9"].is_null() {
            assert!((0.0..=10.0 + 1e-9).contains(&number(&policy["seconds_to_0_9"])), "{policy}");
        }
        let fetched = number(&policy["bytes_fetched"]);
        for part in ["bytes_wasted", "bytes_cancelled"] {
            assert!((0.0..=fetched).contains(&number(&policy[part])), "{part}: {policy}");
        }
        assert!(number(&policy["evictions"]) >= 0.0 && number(&policy["decisions"]) >= 0.0, "{policy}");
        let time = &policy["decision_ns"];
        assert!(number(&time["p50"]) <= number(&time["p99"]) && number(&time["p99"]) <= number(&time["max"]), "{time}");
    }
}

#[test]
fn two_runs_agree_to_the_byte() {
    assert_eq!(ten_seconds(&[]), ten_seconds(&[]));
}

#[test]
fn the_number_of_threads_changes_nothing() {
    assert_eq!(ten_seconds(&["--threads", "1"]), ten_seconds(&["--threads", "2"]));
}

#[test]
fn several_starts_give_intervals_around_their_means() {
    let document = document(&["--duration", "5", "--starts", "3", "--seed", "7"]);
    for policy in policies(&document) {
        let interval = &policy["interval"]["mean_quality"];
        let mean = number(&policy["mean_quality"]);
        assert!(number(&interval["lower"]) <= mean && mean <= number(&interval["upper"]), "{policy}");
    }
}
