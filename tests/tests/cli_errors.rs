//! Inputs that must be refused: exit code 2, one message that names the culprit and what was expected, nothing
//! written, no panic.

use std::path::Path;
use std::time::Duration;

use foresight_tests::{input, program};

/// Words of which a message has at least one, because it says what was expected.
const EXPECTATION: [&str; 10] = [
    "expected",
    "must",
    "between",
    "at least",
    "at most",
    "one of",
    "possible values",
    "needs",
    "no such file",
    "No such file",
];

/// Runs `replay` with the arguments and a report asked for; all of `named` must stand in the message.
fn refused(folder: &Path, arguments: &[&str], named: &[&str]) {
    let before = listing(folder);
    let mut all = vec!["replay"];
    all.extend_from_slice(arguments);
    all.extend_from_slice(&["--report", "out"]);
    let ended = program::sim(folder, &all, Duration::from_secs(60));
    let message = &ended.stderr;
    let context = format!("{all:?}\nexit code {:?}\n{message}", ended.code);
    assert_eq!(ended.code, Some(2), "{context}");
    assert!(ended.stdout.is_empty(), "refused, yet printed: {}\n{context}", ended.stdout);
    assert!(!message.contains("panicked at"), "{context}");
    assert!(!message.trim().is_empty(), "no message\n{context}");
    assert!(message.matches("error:").count() <= 1, "more than one message\n{context}");
    let text = message.trim_end();
    let ending = &text[text.char_indices().rev().nth(30).map_or(0, |(at, _)| at)..];
    assert_eq!(text.matches(ending).count(), 1, "said more than once\n{context}");
    for name in named {
        assert!(message.contains(name), "the message does not name '{name}'\n{context}");
    }
    assert!(
        EXPECTATION.iter().any(|word| message.contains(word)),
        "the message does not say what was expected\n{context}"
    );
    assert_eq!(listing(folder), before, "something was written\n{context}");
}

fn listing(folder: &Path) -> Vec<std::ffi::OsString> {
    let entries = std::fs::read_dir(folder).expect("the folder can be listed");
    let mut names: Vec<_> = entries.map(|entry| entry.expect("an entry").file_name()).collect();
    names.sort();
    names
}

/// A folder with a good world and path, in which a test puts one thing wrong.
fn good() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a temporary folder");
    input::write_world(folder.path());
    folder
}

/// Writes a file under its name, and replays with it in place of the good world, path or link.
fn refused_file(option: &str, name: &str, bytes: impl AsRef<[u8]>, named: &[&str]) {
    let folder = good();
    input::write(folder.path(), name, bytes);
    refused_in(folder.path(), option, name, named);
}

fn refused_in(folder: &Path, option: &str, value: &str, named: &[&str]) {
    let mut arguments = Vec::new();
    for (other, good) in [("--world", "tileset.json"), ("--path", "path.txt"), ("--link", input::LINK)] {
        arguments.extend_from_slice(&[other, if other == option { value } else { good }]);
    }
    refused(folder, &arguments, named);
}

#[test]
fn alpha_outside_its_range() {
    let folder = good();
    for alpha in ["2", "-0.1", "nan", "inf", "much"] {
        refused(folder.path(), &[&format!("--alpha={alpha}")], &["alpha", alpha]);
    }
}

#[test]
fn memory_too_small() {
    let folder = good();
    refused(folder.path(), &["--memory", "0"], &["memory", "0"]);
    refused(folder.path(), &["--memory", "-1"], &["memory"]);
    refused(folder.path(), &["--memory=12parsec"], &["memory", "12parsec"]);
    refused(folder.path(), &["--memory", "1KiB"], &["memory"]);
}

#[test]
fn unknown_policy() {
    let folder = good();
    refused(folder.path(), &["--policy", "nonesuch"], &["nonesuch"]);
    refused(folder.path(), &["--policy", ""], &["policy"]);
}

#[test]
fn unknown_option() {
    refused(good().path(), &["--nonesuch", "1"], &["--nonesuch"]);
}

#[test]
fn a_file_that_is_not_there() {
    for option in ["--world", "--path", "--link"] {
        refused_in(good().path(), option, "absent.file", &["absent.file"]);
    }
}

#[test]
fn an_empty_file() {
    for option in ["--world", "--path", "--link"] {
        refused_file(option, "empty.file", "", &["empty.file"]);
    }
}

#[test]
fn a_file_of_noise() {
    let noise: Vec<u8> = (0..4096u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for option in ["--world", "--path", "--link"] {
        refused_file(option, "noise.file", &noise, &["noise.file"]);
    }
}

#[test]
fn a_link_that_delivers_nothing() {
    refused_file("--link", "dead.txt", "0 0\n1 0\n2 0\n", &["dead.txt"]);
    refused_in(good().path(), "--link", "constant:0Mbit,40ms", &["0Mbit"]);
}

#[test]
fn a_path_of_one_pose() {
    refused_file("--path", "one.txt", "0 0 0 0 0 0 0 1\n", &["one.txt"]);
}

#[test]
fn a_quaternion_of_length_zero() {
    refused_file("--path", "zero.txt", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0\n", &["zero.txt", "2"]);
}

#[test]
fn a_path_with_a_number_that_is_not_finite() {
    refused_file("--path", "nan.txt", "0 0 0 0 0 0 0 1\n1 nan 0 0 0 0 0 1\n", &["nan.txt"]);
    refused_file("--path", "inf.txt", "0 0 0 0 0 0 0 1\n1 1e999 0 0 0 0 0 1\n", &["inf.txt"]);
}

#[test]
fn a_tileset_that_includes_itself() {
    refused_file("--world", "self.json", input::tileset("self.json", ["west.glb", "east.glb"]), &["self.json"]);
}

#[test]
fn tilesets_that_include_each_other() {
    let folder = good();
    input::write(folder.path(), "ping.json", input::tileset("root.glb", ["pong.json", "east.glb"]));
    input::write(folder.path(), "pong.json", input::tileset("root.glb", ["ping.json", "east.glb"]));
    refused_in(folder.path(), "--world", "ping.json", &[".json"]);
}

#[test]
fn infinity_in_a_transform() {
    let tileset = input::tileset("root.glb", ["west.glb", "east.glb"]);
    let transform = r#""root": { "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 1e999,0,0,1],"#;
    let infinite = tileset.replacen(r#""root": {"#, transform, 1);
    assert_ne!(infinite, tileset);
    refused_file("--world", "infinite.json", infinite, &["infinite.json"]);
}

#[test]
fn a_city_model_with_a_fault() {
    let folder = good();
    input::write(folder.path(), "model.city.json", r#"{"type": "CityJSON", "version": "9"}"#);
    refused_in(folder.path(), "--world", "model.city.json", &["model.city.json", "$.version", "\"9\""]);
}

#[test]
fn a_truncated_subtree() {
    let folder = good();
    let implicit = r#"{
  "asset": { "version": "1.1" },
  "geometricError": 40,
  "root": {
    "boundingVolume": { "box": [0, 0, 0, 50, 0, 0, 0, 50, 0, 0, 0, 10] },
    "geometricError": 10,
    "refine": "REPLACE",
    "content": { "uri": "{level}_{x}_{y}.glb" },
    "implicitTiling": {
      "subdivisionScheme": "QUADTREE",
      "subtreeLevels": 2,
      "availableLevels": 2,
      "subtrees": { "uri": "{level}_{x}_{y}.subtree" }
    }
  }
}
"#;
    input::write(folder.path(), "implicit.json", implicit);
    let mut subtree = b"subt".to_vec();
    subtree.extend_from_slice(&1u32.to_le_bytes());
    subtree.extend_from_slice(&200u64.to_le_bytes());
    subtree.extend_from_slice(&0u64.to_le_bytes());
    subtree.extend_from_slice(b"{\"tileAvailability\":");
    input::write(folder.path(), "0_0_0.subtree", &subtree);
    refused_in(folder.path(), "--world", "implicit.json", &["0_0_0.subtree"]);
}
