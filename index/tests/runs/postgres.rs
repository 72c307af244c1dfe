//! A store in a PostgreSQL database.

use crate::{any_run, server};
use foresight_index::runs::{Access, Filter, Location, RunStore, RunStoreError};
use proptest::strategy::{Strategy as _, ValueTree as _};
use proptest::test_runner::TestRunner;
use sqlx::{ConnectOptions as _, Executor as _};
use std::time::Duration;

fn execute(url: &str, sql: &'static str) {
    block(async { connection(url).await.execute(sql).await.expect(sql) });
}

async fn connection(url: &str) -> sqlx::postgres::PgConnection {
    let options: sqlx::postgres::PgConnectOptions = url.parse().expect("a URL");
    options.connect().await.expect("a connection")
}

fn block<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime").block_on(work)
}

#[test]
fn a_server_holds_what_a_file_holds() {
    if std::env::var_os("FORESIGHT_FULL").is_none_or(|value| value != "1") {
        println!("skipped: needs tests/run --full");
        return;
    }
    let server = server::Server::start();
    let location: Location = server.url().parse().expect("a location");
    let absent = RunStore::open(&location, Access::Read).expect_err("no store yet");
    assert!(matches!(absent, RunStoreError::Absent { .. }), "{absent}");

    // Four writers at once make the store and fill it.
    let mut runner = TestRunner::deterministic();
    let runs: Vec<_> = (0..40).map(|_| any_run::run().new_tree(&mut runner).expect("a run").current()).collect();
    std::thread::scope(|scope| {
        for part in runs.chunks(10) {
            let location = &location;
            scope.spawn(move || {
                let mut store = RunStore::open(location, Access::Write).expect("the store opens");
                for (run, document) in part {
                    store.add(run, document).expect("added");
                }
            });
        }
    });
    let mut store = RunStore::open(&location, Access::Read).expect("the store opens");
    let listed = store.list(&Filter::default()).expect("listed");
    assert_eq!(listed.iter().map(|run| run.id).collect::<Vec<_>>(), (1..=40).collect::<Vec<_>>());
    for (run, document) in &runs {
        let stored = listed.iter().find(|stored| stored.run == *run).expect("what went in comes out");
        assert_eq!(&store.document(stored.id).expect("its document"), document);
        let filter = Filter {
            suite_case: run.suite_case.clone(),
            since_ms: Some(run.started_at_ms),
            program_version: Some(run.program_version.clone()),
            id: Some(stored.id),
        };
        assert_eq!(store.list(&filter).expect("filtered"), std::slice::from_ref(stored));
    }
    assert!(matches!(store.run(41), Err(RunStoreError::NoSuchRun { id: 41, .. })));

    let mut impatient = RunStore::open_within(&location, Access::Write, Duration::from_millis(200)).expect("opens");
    let (run, document) = any_run::numbered(0);
    block(async {
        let mut holder = connection(server.url()).await;
        holder.execute("BEGIN; LOCK TABLE runs IN EXCLUSIVE MODE").await.expect("the lock");
        // On a thread without a runtime, as the store brings its own.
        let locked = std::thread::scope(|scope| scope.spawn(|| impatient.add(&run, &document)).join());
        let locked = locked.expect("no panic").expect_err("it is locked");
        assert!(matches!(locked, RunStoreError::Locked { .. }), "{locked}");
        holder.execute("ROLLBACK").await.expect("the lock is given back");
    });
    assert_eq!(impatient.add(&run, &document).expect("it is free again"), 41);

    execute(
        server.url(),
        "INSERT INTO run_store_migrations (version, description, success, checksum, execution_time)
         VALUES (7, 'from the future', true, ''::bytea, 0)",
    );
    for access in [Access::Read, Access::Write] {
        let newer = RunStore::open(&location, access).expect_err("refused");
        assert!(matches!(newer, RunStoreError::Newer { found: 7, known: 1, .. }), "{newer}");
    }
    execute(
        server.url(),
        "DELETE FROM run_store_migrations WHERE version = 7; UPDATE results SET decisions = 3 WHERE run_id = 41",
    );
    let damaged = store.list(&Filter::default()).expect_err("a changed result is noticed");
    assert!(matches!(damaged, RunStoreError::Damaged { .. }), "{damaged}");
}

#[test]
fn a_server_that_is_not_there_is_named() {
    let location: Location = "postgres://me:secret@127.0.0.1:1/runs".parse().expect("a location");
    let message = RunStore::open(&location, Access::Read).expect_err("nobody listens").to_string();
    assert!(message.contains("postgres://me@127.0.0.1:1/runs") && !message.contains("secret"), "{message}");
}
