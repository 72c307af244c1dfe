//! The store in a file.

use crate::observed;
use foresight_index::sessions::{Location, SessionStore, SessionStoreError};
use sqlx::{ConnectOptions as _, Connection as _, Executor as _};
use std::path::Path;
use std::time::Duration;

const PATIENCE: Duration = Duration::from_millis(200);

fn open(file: &Path) -> Result<SessionStore, SessionStoreError> {
    SessionStore::open(&Location::File(file.to_owned()), PATIENCE)
}

/// Does something over a connection of its own.
fn beside<T>(file: &Path, work: impl AsyncFnOnce(&mut sqlx::sqlite::SqliteConnection) -> T) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file).create_if_missing(true);
        let mut connection = options.connect().await.expect("a database");
        let value = work(&mut connection).await;
        connection.close().await.expect("closed");
        value
    })
}

#[test]
fn what_is_learnt_is_known_after_a_restart() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sessions.sqlite");
    let mut store = open(&file).expect("a new store");
    assert_eq!(store.estimate("tablet").expect("readable"), None);
    let unsound = [observed("nan", f64::NAN, 0), observed("zero", 0.0, 0), observed("nul\0", 1e5, 0)];
    store.observe(&unsound).expect("left out");
    store
        .observe(&[observed("tablet", 1e5, 0), observed("desk", 9e5, 0), observed("tablet", 4e5, 0)])
        .expect("written");
    drop(store);
    let mut store = open(&file).expect("the same store");
    let tablet = store.estimate("tablet").expect("readable").expect("known");
    assert!((tablet.rate - 2e5).abs() < 1e-6 && tablet.weight_s == 60.0, "{tablet:?}");
    for unknown in ["nan", "zero", "nul\0", "tablet'--", ""] {
        assert_eq!(store.estimate(unknown).expect("readable"), None, "{unknown:?}");
    }
}

#[test]
fn a_locked_database_is_said_to_be_locked_and_then_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sessions.sqlite");
    let mut store = open(&file).expect("a new store");
    beside(&file, async |other| {
        other.execute("BEGIN EXCLUSIVE").await.expect("the lock");
        std::thread::scope(|scope| {
            // On a thread without a runtime, as the store brings its own.
            let refused = scope.spawn(|| store.observe(&[observed("a", 1e5, 0)])).join().expect("no panic");
            assert!(matches!(refused, Err(SessionStoreError::Locked { .. })), "{refused:?}");
        });
        other.execute("ROLLBACK").await.expect("the lock is given back");
    });
    store.observe(&[observed("a", 1e5, 0)]).expect("it is free again");
    assert!(store.estimate("a").expect("readable").is_some());
}

#[test]
fn a_file_that_is_removed_is_gone_and_not_written_into_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sessions.sqlite");
    let mut store = open(&file).expect("a new store");
    store.observe(&[observed("a", 1e5, 0)]).expect("written");
    std::fs::remove_file(&file).expect("removed");
    let refused = store.observe(&[observed("a", 1e5, 0)]);
    assert!(matches!(refused, Err(SessionStoreError::Gone { .. })), "{refused:?}");
    assert!(matches!(store.estimate("a"), Err(SessionStoreError::Gone { .. })));
    // Opened anew it is made anew.
    let mut store = open(&file).expect("a new store");
    assert_eq!(store.estimate("a").expect("readable"), None);
}

#[test]
fn a_full_database_is_said_to_be_full() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sessions.sqlite");
    drop(open(&file).expect("a new store"));
    let mut store = open(&file).expect("the store");
    store.pages_max(12).expect("a limit");
    let many: Vec<_> = (0..1000).map(|n| observed(&format!("{n:0>100}"), 1e5, n)).collect();
    let refused = store.observe(&many);
    assert!(matches!(refused, Err(SessionStoreError::Full { .. })), "{refused:?}");
    // All or none.
    assert_eq!(store.estimate(&format!("{:0>100}", 0)).expect("readable"), None);
}

#[test]
fn what_cannot_be_opened_or_is_no_store_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let absent = open(&folder.path().join("no/such/folder.sqlite")).expect_err("no folder");
    assert!(matches!(absent, SessionStoreError::ReadOnly { .. }), "{absent}");
    let system = open(Path::new("/proc/sessions.sqlite")).expect_err("nobody may");
    assert!(matches!(system, SessionStoreError::ReadOnly { .. }), "{system}");
    let garbage = folder.path().join("garbage.sqlite");
    std::fs::write(&garbage, [0xab; 5000]).expect("written");
    let damaged = open(&garbage).expect_err("no database");
    assert!(matches!(damaged, SessionStoreError::Damaged { .. }), "{damaged}");
    let newer = folder.path().join("newer.sqlite");
    drop(open(&newer).expect("a new store"));
    beside(&newer, async |other| {
        let sql = "INSERT INTO session_store_migrations (version, description, success, checksum, execution_time) \
                   VALUES (7, 'from the future', true, x'', 0)";
        other.execute(sql).await.expect("written");
    });
    let newer = open(&newer).expect_err("newer");
    assert!(matches!(newer, SessionStoreError::Newer { found: 7, .. }), "{newer}");
}

#[test]
fn a_read_only_database_is_read_and_not_written() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("sessions.sqlite");
    let mut store = open(&file).expect("a new store");
    store.observe(&[observed("a", 1e5, 0)]).expect("written");
    store.read_only().expect("a limit");
    assert!(store.estimate("a").expect("readable").is_some());
    let refused = store.observe(&[observed("a", 1e5, 0)]);
    assert!(matches!(refused, Err(SessionStoreError::ReadOnly { .. })), "{refused:?}");
}
