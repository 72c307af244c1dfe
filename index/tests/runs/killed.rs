//! Writers that are killed in the middle of it, and two at once. The writer is this test's own executable, started
//! again with the store's file in an environment variable.

use crate::any_run;
use foresight_index::runs::{Access, Filter, Location, RunStore};
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const STORE: &str = "FORESIGHT_TEST_STORE";
const RUNS: &str = "FORESIGHT_TEST_RUNS";
const KILLS: u64 = 40;

/// The writer: adds numbered runs and acknowledges each on standard output. Does nothing unless it was started as one.
#[test]
fn writer() {
    let (Some(file), Ok(runs)) = (std::env::var_os(STORE), std::env::var(RUNS)) else { return };
    let runs: u64 = runs.parse().expect("a number of runs");
    let mut store = RunStore::open(&Location::File(PathBuf::from(file)), Access::Write).expect("the store opens");
    for number in 0..runs {
        let (run, document) = any_run::numbered(number);
        let id = store.add(&run, &document).expect("the run is added");
        println!("\nadded {id}");
    }
}

fn start_writer(file: &Path, runs: u64) -> Child {
    Command::new(std::env::current_exe().expect("this test knows its own path"))
        .args(["--exact", "killed::writer", "--nocapture", "--test-threads=1"])
        .env(STORE, file)
        .env(RUNS, runs.to_string())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the writer starts")
}

/// Numbers of the runs that were acknowledged.
fn acknowledged(output: impl std::io::Read) -> Vec<i64> {
    let lines = BufReader::new(output).lines().map_while(Result::ok);
    lines.filter_map(|line| line.strip_prefix("added ").and_then(|id| id.parse().ok())).collect()
}

/// Every run has all of its results and its document, and the numbers have no gap. Gives their count.
fn whole(file: &Path) -> usize {
    // Opening runs SQLite's integrity check, reading compares checksums.
    let mut store = RunStore::open(&Location::File(file.to_owned()), Access::Read).expect("the store opens");
    let runs = store.list(&Filter::default()).expect("every run is whole");
    for (place, stored) in runs.iter().enumerate() {
        assert_eq!(stored.id, place as i64 + 1);
        let (run, document) = any_run::numbered(stored.run.seed);
        assert_eq!(stored.run, run);
        if place + 3 > runs.len() {
            assert_eq!(store.document(stored.id).expect("its document"), document);
        }
    }
    runs.len()
}

#[test]
fn a_killed_writer_leaves_a_whole_store() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("runs.sqlite");
    let mut random = 1_u64;
    let (mut known, mut interrupted) = (0, 0);
    for kill in 0..KILLS {
        // A linear congruential generator (Knuth's MMIX) chooses the moment.
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let mut writer = start_writer(&file, u64::MAX);
        std::thread::sleep(Duration::from_micros((random >> 33) % 60_000));
        writer.kill().expect("killed");
        let ids = acknowledged(writer.stdout.take().expect("standard output is piped"));
        let mut errors = String::new();
        writer.stderr.take().expect("standard error is piped").read_to_string(&mut errors).expect("text");
        assert!(!errors.contains("panicked"), "kill {kill}: {errors}");
        writer.wait().expect("it has ended");
        if folder.path().join("runs.sqlite-journal").exists() {
            interrupted += 1;
        }
        if !file.exists() {
            assert!(ids.is_empty(), "acknowledged without a store");
            continue;
        }
        let runs = whole(&file);
        let last = ids.last().map_or(known, |id| *id as usize);
        assert!(runs == last || runs == last + 1, "kill {kill}: {last} acknowledged, {runs} there");
        known = runs;
    }
    println!("{KILLS} kills, {interrupted} within a transaction, {known} runs");
    assert!(known > 0, "no kill came late enough for a run");
}

#[test]
fn two_writers_at_once_lose_nothing() {
    const EACH: u64 = 40;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("runs.sqlite");
    // Both find no store, and both make one.
    let writers = [start_writer(&file, EACH), start_writer(&file, EACH)];
    let mut ids = Vec::new();
    for writer in writers {
        let output = writer.wait_with_output().expect("it ends");
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        ids.extend(acknowledged(output.stdout.as_slice()));
    }
    ids.sort_unstable();
    assert_eq!(ids, (1..=2 * EACH as i64).collect::<Vec<_>>());
    assert_eq!(whole(&file), ids.len());
    assert_eq!(std::fs::read_dir(folder.path()).expect("listed").count(), 1, "something was left beside the store");
}
