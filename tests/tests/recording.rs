//! A path made into a recording, and replayed from it; announcements, heads and failing requests from the command line.

use std::path::Path;
use std::time::Duration;

use foresight_tests::program;
use serde_json::Value;

const LIMIT: Duration = Duration::from_secs(300);
const JUMPS: &str = "teleport:speed=20,duration=12,every=4,distance=300";

fn sim(folder: &Path, arguments: &[&str]) -> String {
    let ended = program::sim(folder, arguments, LIMIT);
    assert_eq!(ended.code, Some(0), "{arguments:?}\n{}", ended.stderr);
    ended.stdout
}

/// The figures of the policies, without those that time this machine.
fn figures(folder: &Path, arguments: &[&str]) -> (Value, Vec<Value>) {
    let common = ["replay", "--json", "--no-bound", "--link", "constant:4Mbit,40ms", "--place", "centre,height=30"];
    let out = sim(folder, &[&common[..], arguments].concat());
    let mut document: Value = serde_json::from_str(&out).expect("standard output is one JSON document");
    let policies = document["policies"].as_array_mut().expect("a list of policies");
    for policy in &mut *policies {
        let policy = policy.as_object_mut().expect("a policy is an object");
        policy.remove("decision_ns");
        policy.remove("name");
    }
    let policies = core::mem::take(policies);
    (document["inputs"].take(), policies)
}

#[test]
fn a_recorded_path_replays_as_the_path() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = sim(folder.path(), &["generate", "path", "--path", JUMPS, "--fov", "50", "--out", "jumps.jsonl"]);
    assert!(out.contains("jumps.jsonl: ") && out.contains("2 jumps within"), "{out}");
    assert!(!folder.path().join("jumps.jsonl.partial").exists());
    let told = sim(folder.path(), &["inspect", "jumps.jsonl"]);
    assert!(told.contains("2 jumps within") && told.contains("field of view of 50.00°"), "{told}");
    let policy = ["--policy", "foresight"];
    let made = figures(folder.path(), &[&policy[..], &["--path", JUMPS]].concat());
    let recorded = figures(folder.path(), &[&policy[..], &["--path", "jumps.jsonl"]].concat());
    assert_eq!(made.1, recorded.1);
    assert_eq!(made.0["path_hash"], recorded.0["path_hash"]);

    let refused = |arguments: &[&str], expected: &str| {
        let ended = program::sim(folder.path(), arguments, LIMIT);
        assert!(ended.code == Some(2) && ended.stderr.contains(expected), "{arguments:?}: {}", ended.stderr);
    };
    refused(&["generate", "path", "--path", JUMPS, "--place", "geo", "--out", "x"], "--place and --loop");
    refused(&["generate", "path", "--path", JUMPS, "--from", "99", "--out", "x"], "--from 99");
    refused(&["generate", "path", "--path", "teleport:every=x", "--out", "x"], "distance=METRES");
    refused(&["generate", "path", "--head", "none.csv", "--out", "x"], "none.csv");
    assert!(!folder.path().join("x").exists());
}

#[test]
fn announcements_heads_and_losses() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    sim(folder.path(), &["generate", "path", "--path", "turn:speed=0,duration=4", "--out", "head.jsonl"]);
    let policies = ["--policy", "foresight:predictor=true-path,foresight:predictor=known-path,foresight"];
    let path = ["--path", JUMPS, "--head", "head.jsonl,scale=2"];
    let all = [&policies[..], &path].concat();
    let (inputs, told) = figures(folder.path(), &[&all[..], &["--announce", "1000"]].concat());
    assert_eq!((&inputs["announce_s"], &inputs["head"]), (&1000.0.into(), &"head.jsonl,scale=2".into()));
    let (inputs, silent) = figures(folder.path(), &all);
    assert!(inputs.get("announce_s").is_none());
    assert_eq!(told[0], told[1]);
    assert_ne!(silent[0], silent[1]);
    assert_eq!((&told[0], &told[2]), (&silent[0], &silent[2]));

    let lossy = [&all[..], &["--link", "constant:4Mbit,40ms,loss=0.2"]].concat();
    let out = sim(folder.path(), &[&["replay", "--json", "--no-bound"][..], &lossy].concat());
    let document: Value = serde_json::from_str(&out).expect("standard output is one JSON document");
    for policy in document["policies"].as_array().expect("a list of policies") {
        assert!(policy["failures"].as_f64().expect("a number") > 0.0, "{policy}");
    }
    assert!(document["warnings"].to_string().contains("20 % of the requests fail"), "{}", document["warnings"]);
}
