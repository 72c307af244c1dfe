//! A store in a file.

use crate::any_run;
use foresight_index::runs::{Access, Filter, Location, Run, RunStore, RunStoreError, SCHEMA_VERSION};
use proptest::prelude::*;
use sqlx::{ConnectOptions as _, Executor as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

fn at(file: &Path) -> Location {
    Location::File(file.to_owned())
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// A store with these many numbered runs.
fn filled(folder: &Path, runs: u64) -> PathBuf {
    let file = folder.join("runs.sqlite");
    let mut store = RunStore::open(&at(&file), Access::Write).expect("a new store");
    for number in 0..runs {
        let (run, document) = any_run::numbered(number);
        assert_eq!(store.add(&run, &document).expect("added"), number as i64 + 1);
    }
    file
}

/// Gives SQL to a database directly.
fn execute(file: &Path, sql: &'static str) {
    block(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).create_if_missing(true);
        options.connect().await.expect("a database").execute(sql).await.expect(sql);
    });
}

fn block<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime").block_on(work)
}

/// What opening for reading and for writing say; the file's bytes must stay as they are, and no other file appear.
fn refusals(file: &Path) -> [RunStoreError; 2] {
    let before = std::fs::read(file).ok();
    let refusals = [Access::Read, Access::Write].map(|access| RunStore::open(&at(file), access).expect_err("refused"));
    assert_eq!(std::fs::read(file).ok(), before, "a refused file was changed");
    for refusal in &refusals {
        let message = refusal.to_string();
        assert!(message.contains("expected") && message.contains("runs.sqlite"), "{message}");
    }
    refusals
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_goes_in_comes_out(runs in proptest::collection::vec(any_run::run(), 1..4)) {
        let folder = folder();
        let location = at(&folder.path().join("runs.sqlite"));
        let mut ids = Vec::new();
        for (run, document) in &runs {
            // A new connection each time: nothing may live in one only.
            ids.push(RunStore::open(&location, Access::Write).unwrap().add(run, document).unwrap());
        }
        let mut store = RunStore::open(&location, Access::Read).unwrap();
        let listed = store.list(&Filter::default()).unwrap();
        prop_assert_eq!(listed.iter().map(|run| run.id).collect::<Vec<_>>(), ids);
        for (stored, (run, document)) in listed.iter().zip(&runs) {
            prop_assert_eq!(&stored.run, run);
            prop_assert_eq!(&store.run(stored.id).unwrap(), stored);
            prop_assert_eq!(&store.document(stored.id).unwrap(), document);
            let filter = Filter {
                suite_case: run.suite_case.clone(),
                since_ms: Some(run.started_at_ms),
                program_version: Some(run.program_version.clone()),
                id: None,
            };
            prop_assert!(store.list(&filter).unwrap().contains(stored));
            if let Some(later) = run.started_at_ms.checked_add(1) {
                let filter = Filter { since_ms: Some(later), ..filter };
                prop_assert!(!store.list(&filter).unwrap().contains(stored));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_cut_file_is_refused(share in 0.0..1.0) {
        let folder = folder();
        let file = filled(folder.path(), 3);
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..(bytes.len() as f64 * share) as usize]).unwrap();
        for refusal in refusals(&file) {
            prop_assert!(matches!(refusal, RunStoreError::Damaged { .. } | RunStoreError::NotSqlite { .. }), "{}", refusal);
        }
    }

    /// Whatever bit changes: the runs are as recorded, or refused; and the file is not changed further.
    #[test]
    fn a_changed_bit_is_noticed_or_harmless(share in prop_oneof![0.0..1.0, 0.0..0.2], bit in 0_u32..8) {
        let folder = folder();
        let file = filled(folder.path(), 2);
        let intact = RunStore::open(&at(&file), Access::Read).unwrap().list(&Filter::default()).unwrap();
        let mut bytes = std::fs::read(&file).unwrap();
        let place = (bytes.len() as f64 * share) as usize;
        bytes[place] ^= 1 << bit;
        std::fs::write(&file, &bytes).unwrap();
        let read = RunStore::open(&at(&file), Access::Read).and_then(|mut store| {
            let runs = store.list(&Filter::default())?;
            Ok((runs, store.document(1)?, store.document(2)?))
        });
        match read {
            Ok((runs, first, second)) => {
                prop_assert_eq!(runs, intact);
                prop_assert_eq!(first, any_run::numbered(0).1);
                prop_assert_eq!(second, any_run::numbered(1).1);
            }
            // The database library's thread panicked.
            Err(RunStoreError::Database { source: sqlx::Error::WorkerCrashed, .. }) => prop_assert!(false, "a panic"),
            Err(_) => {}
        }
        prop_assert!(std::fs::read(&file).unwrap() == bytes, "the file was changed");
    }
}

#[test]
fn what_is_no_store_is_refused_and_left_alone() {
    let folder = folder();
    let file = folder.path().join("runs.sqlite");
    for content in ["", "SQLite", "SQLite format 4\0 and more", "t x y z\n0 0 0 0\n"] {
        std::fs::write(&file, content).unwrap();
        for refusal in refusals(&file) {
            assert!(matches!(refusal, RunStoreError::NotSqlite { .. }), "{refusal}");
        }
    }
    std::fs::write(&file, [b"SQLite format 3\0".as_slice(), &[0x5a; 4000]].concat()).unwrap();
    for refusal in refusals(&file) {
        assert!(matches!(refusal, RunStoreError::Damaged { .. }), "{refusal}");
    }
    std::fs::remove_file(&file).unwrap();
    execute(&file, "CREATE TABLE moz_places (id INTEGER PRIMARY KEY, url TEXT)");
    for refusal in refusals(&file) {
        assert!(matches!(refusal, RunStoreError::NotARunStore { .. }), "{refusal}");
    }
    std::fs::remove_file(&file).unwrap();
    std::fs::create_dir(&file).unwrap();
    refusals(&file);
}

#[test]
fn an_absent_store_is_made_for_writing_only() {
    let folder = folder();
    let file = folder.path().join("runs.sqlite");
    let absent = RunStore::open(&at(&file), Access::Read).unwrap_err();
    assert!(matches!(absent, RunStoreError::Absent { .. }), "{absent}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    drop(RunStore::open(&at(&file), Access::Write).unwrap());
    assert!(RunStore::open(&at(&file), Access::Read).unwrap().list(&Filter::default()).unwrap().is_empty());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the store is one file");

    let nowhere = folder.path().join("missing").join("runs.sqlite");
    let refusal = RunStore::open(&at(&nowhere), Access::Write).unwrap_err();
    assert!(refusal.to_string().contains("missing"), "{refusal}");
    assert!(matches!(refusal, RunStoreError::Folder { .. }), "{refusal}");
}

/// Nobody, the superuser included, can make files there.
#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let refusal = RunStore::open(&at(Path::new("/proc/runs.sqlite")), Access::Write).unwrap_err();
    assert!(refusal.to_string().contains("/proc/runs.sqlite"), "{refusal}");
}

#[test]
fn a_newer_schema_is_refused_with_both_versions() {
    let folder = folder();
    let file = filled(folder.path(), 1);
    execute(
        &file,
        "INSERT INTO run_store_migrations (version, description, success, checksum, execution_time)
         VALUES (7, 'from the future', true, x'00', 0)",
    );
    for refusal in refusals(&file) {
        assert!(matches!(refusal, RunStoreError::Newer { found: 7, known: SCHEMA_VERSION, .. }), "{refusal}");
        assert!(refusal.to_string().contains("version 7") && refusal.to_string().contains("up to 1"), "{refusal}");
    }
}

#[test]
fn a_locked_store_says_so_and_is_usable_again() {
    let folder = folder();
    let file = filled(folder.path(), 1);
    let patience = Duration::from_millis(50);
    let location = at(&file);
    let mut store = RunStore::open_within(&location, Access::Write, patience).unwrap();
    block(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&file);
        let mut holder = options.connect().await.unwrap();
        holder.execute("BEGIN EXCLUSIVE").await.unwrap();
        // On a thread without a runtime, as the store brings its own.
        std::thread::scope(|scope| {
            let locked = scope.spawn(|| {
                let opening = RunStore::open_within(&location, Access::Read, patience).unwrap_err();
                let (run, document) = any_run::numbered(1);
                [opening, store.add(&run, &document).unwrap_err(), store.run(1).unwrap_err()]
            });
            for refusal in locked.join().unwrap() {
                assert!(matches!(refusal, RunStoreError::Locked { .. }), "{refusal}");
                assert!(refusal.to_string().contains("locked by another process for more than 0.05 s"), "{refusal}");
            }
        });
        holder.execute("ROLLBACK").await.unwrap();
    });
    let (run, document) = any_run::numbered(1);
    assert_eq!(store.add(&run, &document).unwrap(), 2);
}

#[test]
fn values_that_no_database_holds_are_refused_by_name() {
    let folder = folder();
    let mut store = RunStore::open(&at(&folder.path().join("runs.sqlite")), Access::Write).unwrap();
    let (good, document) = any_run::numbered(0);
    let mut refused = |change: fn(&mut Run), column: &str| {
        let mut run = good.clone();
        change(&mut run);
        let message = store.add(&run, &document).unwrap_err().to_string();
        assert!(message.starts_with(column) && message.contains("expected"), "{message}");
    };
    refused(|run| run.wall_s = f64::NAN, "wall_s");
    refused(|run| run.results[1].figures[1].upper = Some(f64::INFINITY), "mean_deficit");
    refused(|run| run.results[1].decisions = Some(f64::NEG_INFINITY), "decisions");
    refused(|run| run.peak_memory_bytes = Some(u64::MAX), "peak_memory_bytes");
    refused(|run| run.world.name = "a\0b".to_owned(), "world");
    refused(|run| run.results[0].policy = "\0".to_owned(), "policy");
    assert!(store.list(&Filter::default()).unwrap().is_empty());
}
