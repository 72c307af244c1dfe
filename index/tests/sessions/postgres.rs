//! The store in a PostgreSQL database.

use crate::{observed, server};
use foresight_index::sessions::{Location, SessionStore, SessionStoreError};
use sqlx::{ConnectOptions as _, Executor as _};
use std::time::Duration;

#[test]
fn a_server_keeps_estimates_is_locked_and_goes_away() {
    if std::env::var_os("FORESIGHT_FULL").is_none_or(|value| value != "1") {
        println!("skipped: needs tests/run --full");
        return;
    }
    let server = server::Server::start();
    let location: Location = server.url().parse().expect("a location");
    let patience = Duration::from_secs(2);
    // Several servers of the product share a database.
    std::thread::scope(|scope| {
        for client in ["a", "b", "c", "a"] {
            let location = &location;
            scope.spawn(move || {
                let mut store = SessionStore::open(location, Duration::from_secs(20)).expect("opens");
                for _ in 0..5 {
                    store.observe(&[observed(client, 1e5, 0)]).expect("written");
                }
            });
        }
    });
    let mut store = SessionStore::open(&location, patience).expect("opens");
    let weight = |store: &mut SessionStore, client: &str| {
        store.estimate(client).expect("readable").map(|estimate| estimate.weight_s)
    };
    // Nothing is lost where two write of the same client.
    assert_eq!(weight(&mut store, "a"), Some(300.0));
    assert_eq!(weight(&mut store, "b"), Some(150.0));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options: sqlx::postgres::PgConnectOptions = server.url().parse().expect("a URL");
        let mut holder = options.connect().await.expect("a connection");
        holder.execute("BEGIN; LOCK TABLE link_estimates IN ACCESS EXCLUSIVE MODE").await.expect("the lock");
        let refused = std::thread::scope(|scope| scope.spawn(|| store.observe(&[observed("a", 1e5, 0)])).join());
        let refused = refused.expect("no panic");
        assert!(matches!(refused, Err(SessionStoreError::Locked { .. })), "{refused:?}");
        holder.execute("ROLLBACK").await.expect("the lock is given back");
    });
    store.observe(&[observed("b", 1e5, 0)]).expect("it is free again");
    drop(server);
    let gone = store.observe(&[observed("a", 1e5, 0)]);
    assert!(matches!(gone, Err(SessionStoreError::Database { .. } | SessionStoreError::NoAnswer { .. })), "{gone:?}");
    let absent = SessionStore::open(&location, patience);
    assert!(absent.is_err());
}
