//! A database of link estimates that is locked or full while clients fly.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use foresight_tests::sidecar::case::Case;
use foresight_tests::sidecar::process::Server;
use sqlx::{ConnectOptions as _, Connection as _, Executor as _};

use crate::is_sound;

const CASE: &str = "--world city:blocks=20 --path steady:speed=10,duration=5 --link constant:4Mbit,40ms --memory 32MiB";

/// A flight at whose end the server has something to write; nothing of it is to be noticed.
fn fly(case: &Case, folder: &Path, server: &Server, client: &str) {
    let live = case.fly(folder, server, "events.jsonl", &["--client", client]);
    is_sound(&live);
    assert_eq!((live.flown.count("failed"), live.figure("reconnections")), (0, 0.0));
    assert!(live.flown.count("completed") > 0);
}

/// Waits until readiness says this of the database, or nothing is said of it.
fn says(server: &Server, word: Option<&str>) {
    let mut said = String::new();
    for _ in 0..400 {
        let (status, body) = server.get("/health/ready");
        assert_eq!(status, 200, "it serves without the database too");
        if word.map_or(!body.contains("degraded"), |word| body.contains("degraded") && body.contains(word)) {
            return;
        }
        said = body;
        std::thread::sleep(Duration::from_millis(100));
    }
    panic!("{said:?}; expected {word:?}\n{}", server.log());
}

#[test]
fn a_locked_database_is_named_and_harms_no_session() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let case = Case::open(CASE, None);
    let options = ["--world", case.world(), "--link", case.link(), "--database", "sqlite:sessions.sqlite"];
    let server = Server::start(folder, &options);
    fly(&case, folder, &server, "desk");
    says(&server, None);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let file = folder.join("sessions.sqlite");
    let mut other = runtime.block_on(async {
        let mut other = sqlx::sqlite::SqliteConnectOptions::new().filename(&file).connect().await.expect("a database");
        other.execute("BEGIN EXCLUSIVE").await.expect("the lock");
        other
    });
    fly(&case, folder, &server, "phone");
    says(&server, Some("locked"));
    runtime.block_on(async {
        other.execute("ROLLBACK").await.expect("the lock is given back");
        other.close().await.expect("closed");
    });
    says(&server, None);
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(log.contains("link estimates are not kept") && log.contains("the database is back"), "{log}");
}

/// A file system of 256 KiB, gone when dropped.
struct Small(PathBuf);

impl Small {
    /// `None` where this process may mount nothing.
    fn mount(at: PathBuf) -> Option<Small> {
        std::fs::create_dir(&at).expect("a folder");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=256k", "none"]).arg(&at).output();
        mounted.is_ok_and(|mounted| mounted.status.success()).then_some(Small(at))
    }

    fn fill(&self) {
        // Ends with the error that is wanted.
        let _ = std::fs::write(self.0.join("filler"), vec![0; 1 << 20]);
    }

    fn empty(&self) {
        std::fs::remove_file(self.0.join("filler")).expect("the filler is there");
    }
}

impl Drop for Small {
    fn drop(&mut self) {
        // Who cannot unmount it leaves it to the system.
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).status();
    }
}

#[test]
fn a_full_database_is_named_and_harms_no_session() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let Some(small) = Small::mount(folder.join("small")) else {
        println!("skipped: mounting a small file system needs the superuser");
        return;
    };
    let case = Case::open(CASE, None);
    let options = ["--world", case.world(), "--link", case.link(), "--database", "sqlite:small/sessions.sqlite"];
    let server = Server::start(folder, &options);
    says(&server, None);
    small.fill();
    fly(&case, folder, &server, "desk");
    says(&server, Some("full"));
    small.empty();
    says(&server, None);
    let (code, log) = server.stop();
    assert_eq!(code, Some(0), "{log}");
    assert!(log.contains("link estimates are not kept") && log.contains("the database is back"), "{log}");
}
