//! A tileset that names a content file that is not there still loads, and the result says what is missing.

use std::path::Path;
use std::time::Duration;

use foresight_tests::{input, program};

/// Warnings of a replay of the world in a folder.
fn warnings(folder: &Path) -> Vec<String> {
    let arguments = ["replay", "--world", "tileset.json", "--path", "path.txt", "--link", input::LINK, "--json"];
    let ended = program::sim(folder, &arguments, Duration::from_secs(120));
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let document: serde_json::Value = serde_json::from_str(&ended.stdout).expect("one JSON document");
    let warnings = document["warnings"].as_array().expect("a list of warnings");
    warnings.iter().map(|warning| warning.as_str().expect("a warning is text").to_owned()).collect()
}

#[test]
fn a_missing_content_file_is_a_warning() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    input::write_world(folder.path());
    std::fs::remove_file(folder.path().join("east.glb")).expect("the file was just written");
    let warnings = warnings(folder.path());
    assert!(warnings.iter().any(|warning| warning.contains("east.glb")), "no warning names east.glb: {warnings:?}");
}

#[test]
fn a_whole_tileset_has_no_such_warning() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    input::write_world(folder.path());
    let warnings = warnings(folder.path());
    assert!(!warnings.iter().any(|warning| warning.contains(".glb")), "content that is there: {warnings:?}");
}
