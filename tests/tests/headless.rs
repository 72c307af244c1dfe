//! `foresight-viewer --headless`: pictures of a flight on a virtual clock, by the real program.

use foresight_tests::input;
use foresight_tests::program::{Ended, run};
use serde_json::Value;
use std::path::Path;
use std::time::Duration;
use tempfile::tempdir;

const LIMIT: Duration = Duration::from_secs(300);

/// A city that is made in memory, and a short flight over it.
const CITY: [&str; 9] = [
    "--world",
    "city:blocks=2",
    "--path",
    "steady:speed=10,duration=3",
    "--place",
    "centre,height=40",
    "--size",
    "96x72",
    "--json",
];

fn viewer(folder: &Path, frames: &str, arguments: &[&str]) -> Ended {
    let all = [&["--headless", "--frames", frames], arguments].concat();
    run("foresight-viewer", folder, &all, &[], LIMIT)
}

/// Whether there is something to draw with. If not, a line says so.
///
/// # Panics
/// If not, and the environment has `CI=true`.
fn draws(ended: &Ended) -> bool {
    if !ended.stderr.contains("no graphics adapter") {
        return true;
    }
    assert!(std::env::var_os("CI").is_none_or(|value| value != "true"), "{}", ended.stderr);
    println!("skipped: {}", ended.stderr.trim());
    false
}

fn rows(folder: &Path) -> Vec<Value> {
    let table = std::fs::read_to_string(folder.join("frames.jsonl")).expect("the table is there");
    table.lines().map(|line| serde_json::from_str(line).expect("a line is JSON")).collect()
}

fn number(row: &Value, key: &str) -> f64 {
    row[key].as_f64().unwrap_or_else(|| panic!("{key} in {row}"))
}

/// The files of a folder by name.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).expect("the folder is there").map(|entry| entry.expect("an entry").path());
    let mut files: Vec<_> = entries
        .map(|path| {
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            (name, std::fs::read(path).expect("a file"))
        })
        .collect();
    files.sort();
    files
}

#[test]
fn a_flight_is_drawn_and_the_same_again() {
    let scratch = tempdir().expect("a folder");
    let here = scratch.path();
    let link = ["--link", "constant:8Mbit,40ms"];
    let first = viewer(here, "first", &[&CITY[..], &link].concat());
    if !draws(&first) {
        return;
    }
    assert_eq!((first.code, first.stderr.as_str()), (Some(0), ""), "{}", first.stdout);
    let summary: Value = serde_json::from_str(&first.stdout).expect("one document");
    assert_eq!(
        (&summary["schema_version"], &summary["frames"], &summary["broken_count"]),
        (&1.into(), &6.into(), &0.into())
    );
    let table = rows(&here.join("first"));
    assert_eq!(table.len(), 6);
    // Nothing is there in the beginning, and then it comes.
    assert_eq!((number(&table[0], "quality"), number(&table[0], "holes")), (0.0, 1.0));
    assert!(number(&table[5], "ssim") > number(&table[0], "ssim") + 0.1, "{table:?}");
    assert!(number(&table[5], "quality") > 0.5 && number(&table[5], "triangles") > 0.0, "{table:?}");
    let names: Vec<String> = files(&here.join("first")).into_iter().map(|(name, _)| name).collect();
    let pictures = (0..6).map(|i| format!("frame_{i:05}.png"));
    assert_eq!(names, pictures.chain(["frames.jsonl".to_owned()]).collect::<Vec<_>>());

    let second = viewer(here, "second", &[&CITY[..], &link].concat());
    assert_eq!(second.stdout, first.stdout);
    assert!(files(&here.join("second")) == files(&here.join("first")), "the same flight gave other bytes");
}

/// What a client shows whose link and memory are no limit is what is shown with everything resident.
#[test]
fn an_ample_link_shows_what_everything_resident_shows() {
    let scratch = tempdir().expect("a folder");
    let here = scratch.path();
    let reference = viewer(here, "reference", &[&CITY[..], &["--reference"]].concat());
    if !draws(&reference) {
        return;
    }
    assert_eq!((reference.code, reference.stderr.as_str()), (Some(0), ""));
    assert!(
        rows(&here.join("reference")).iter().all(|row| number(row, "ssim") > 1.0 - 1e-9 && row["psnr_db"].is_null())
    );
    let ample = viewer(here, "ample", &[&CITY[..], &["--link", "constant:4000Mbit,1ms", "--memory", "4GiB"]].concat());
    assert_eq!(ample.code, Some(0), "{}", ample.stderr);
    let last = rows(&here.join("ample")).pop().expect("pictures");
    assert!(number(&last, "ssim") > 0.98 && number(&last, "quality") > 0.95, "{last}");
    let picture = |of: &str| image::open(here.join(of).join("frame_00005.png")).expect("a picture").to_rgb8();
    let (ample, reference) = (picture("ample"), picture("reference"));
    assert_eq!(ample.dimensions(), (96, 72));
    let colours: std::collections::BTreeSet<[u8; 3]> = reference.pixels().map(|pixel| pixel.0).collect();
    assert!(colours.len() > 20, "{} colours", colours.len());
}

/// A content that cannot be read is named, and the rest is drawn.
#[test]
fn a_truncated_content_is_named_and_the_rest_is_drawn() {
    let scratch = tempdir().expect("a folder");
    let here = scratch.path();
    input::write_world(here);
    input::write(here, "west.glb", &input::glb([-50.0, -50.0, -10.0], [0.0, 50.0, 10.0])[..100]);
    let arguments = [
        "--world",
        "tileset.json",
        "--path",
        "steady:speed=1,duration=1",
        "--place",
        "centre,height=30",
        "--size",
        "64x48",
        "--reference",
    ];
    let ended = viewer(here, "out", &arguments);
    if !draws(&ended) {
        return;
    }
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert!(ended.stderr.contains("west.glb"), "{}", ended.stderr);
    assert_eq!(rows(&here.join("out")).len(), 2);
}

#[test]
fn bad_inputs_are_named() {
    let scratch = tempdir().expect("a folder");
    let here = scratch.path();
    input::write(here, "file", "");
    let with = |other: &[&'static str]| [&CITY[..], other].concat();
    let cases: [(&str, Vec<&str>, &str); 9] = [
        ("out", vec!["--world", "nowhere"], "nowhere"),
        ("out", vec!["--world", "city:blocks=3,orthoviews=64", "--path", "steady"], "sizes only"),
        ("out", with(&["--rate", "7"]), "--rate 7; expected 60 or what divides it"),
        ("out", with(&["--memory", "10"]), "expected at least that"),
        ("out", with(&["--policy", "guess"]), "unknown policy `guess`"),
        ("out", with(&["--policy", "all"]), "expected one"),
        ("out", with(&["--link", "constant:fast"]), "--link"),
        ("out", with(&["--server", "http://127.0.0.1:1"]), "expected --world without --server"),
        ("file", with(&[]), "file"),
    ];
    for (frames, arguments, expected) in cases {
        let ended = viewer(here, frames, &arguments);
        if !draws(&ended) {
            continue;
        }
        assert_eq!(ended.code, Some(2), "{arguments:?}: {}{}", ended.stdout, ended.stderr);
        assert!(
            ended.stderr.starts_with("error: ") && ended.stderr.contains(expected),
            "{arguments:?}: {}",
            ended.stderr
        );
    }
    let ended = viewer(here, "out", &["--world", "city:blocks=2", "--size", "0x10"]);
    assert!(ended.code == Some(2) && ended.stderr.contains("expected COLUMNSxROWS"), "{}", ended.stderr);
}

/// What is far from environment maps: counted, close to what it looks like without them, and the same again.
#[test]
fn environment_maps_are_counted_and_the_same_again() {
    let scratch = tempdir().expect("a folder");
    let here = scratch.path();
    let arguments = [&CITY[..], &["--reference", "--environment", "2"]].concat();
    let first = viewer(here, "first", &arguments);
    if !draws(&first) {
        return;
    }
    assert_eq!((first.code, first.stderr.as_str()), (Some(0), ""), "{}", first.stdout);
    let table = rows(&here.join("first"));
    for row in &table {
        let maps = &row["environment"];
        assert!(number(maps, "maps_drawn") >= 4.0 && number(maps, "left_out") > 0.0, "{row}");
        assert!(number(maps, "points") > 0.0 && number(maps, "points") <= number(row, "points"), "{row}");
        // Facades finer than these pixels: maps have one sample a pixel, the picture four.
        assert!(number(row, "ssim") > 0.78 && number(row, "holes") < 0.005, "{row}");
    }
    let summary: Value = serde_json::from_str(&first.stdout).expect("one document");
    assert!(number(&summary, "maps_max") > 1e5 && summary["maps_refused"].is_null(), "{summary}");
    let second = viewer(here, "second", &arguments);
    assert_eq!(second.stdout, first.stdout);
    assert!(files(&here.join("second")) == files(&here.join("first")), "the same flight gave other bytes");
    let wrong = viewer(here, "wrong", &[&CITY[..], &["--environment", "0"]].concat());
    assert_eq!(wrong.code, Some(2));
    assert!(wrong.stderr.contains("`0`; expected auto, or metres from 0.001 to 1e9"), "{}", wrong.stderr);
}
