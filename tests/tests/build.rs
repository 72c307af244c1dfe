//! `foresight-server build` as a user meets it: worlds that are used, killed builds that go on, targets that cannot be
//! written.

use std::collections::BTreeSet;
use std::fs::File;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use foresight_index::stored;
use foresight_scheduler::lod_tree::RepId;
use foresight_tests::sidecar::process::Server;
use foresight_tests::{full, input, program};
use serde_json::Value;

const LIMIT: Duration = Duration::from_secs(600);

/// A small city with textures, as a tileset in `city/` of the folder.
fn generate(folder: &Path, blocks: &str) {
    let ended = program::sim(folder, &["generate", "city", "--blocks", blocks, "--out", "city"], LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
}

const QUICK: [&str; 7] = ["--input", "city/tileset.json", "--leaf", "16", "--directions", "3", "--no-geometry"];

fn arguments<'a>(out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    let pixels: &[&str] = if more.contains(&"--pixels") { &[] } else { &["--pixels", "16"] };
    [&["build"], &QUICK[..], &["--out", out, "--json", "--quiet"], pixels, more].concat()
}

fn build(folder: &Path, out: &str, more: &[&str]) -> Value {
    let ended = program::run("foresight-server", folder, &arguments(out, more), &[], LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    serde_json::from_str(&ended.stdout).expect("one JSON document")
}

/// The message of a build that must fail.
fn refused(folder: &Path, arguments: &[&str]) -> String {
    let ended = program::run("foresight-server", folder, arguments, &[], LIMIT);
    assert_eq!(ended.code, Some(2), "{}", ended.stderr);
    assert_eq!(ended.stdout, "");
    ended.stderr
}

/// Every file of a world but the lock and the document, relative to its folder.
fn files(world: &Path) -> BTreeSet<String> {
    fn visit(folder: &Path, name: &str, found: &mut BTreeSet<String>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let entry = entry.expect("an entry");
            let name = format!("{name}/{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                visit(&entry.path(), &name, found);
            } else {
                found.insert(name);
            }
        }
    }
    let mut found = BTreeSet::new();
    visit(world, "", &mut found);
    found.retain(|name| name != "/world.toml" && name != "/build.lock");
    found
}

#[test]
fn a_killed_build_goes_on_and_ends_the_same() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    // What was made before a kill stays, so that the moments together reach beyond a whole build.
    let (blocks, kills, reach) = if full().is_ok() { ("6", 10, 3.0) } else { ("2", 3, 1.5) };
    generate(folder, blocks);
    #[expect(clippy::disallowed_methods, reason = "when to kill, as a share of what an undisturbed build takes")]
    let begun = Instant::now();
    let whole = build(folder, "whole", &[]);
    let takes = begun.elapsed();
    let mut state = 20_240_607u64;
    for kill in 0..kills {
        // From a tenth to nine tenths of it, so that some hit the first pass and some the end.
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let share = reach / f64::from(kills) * (0.1 + 0.8 * (state >> 40) as f64 / (1u64 << 24) as f64);
        let mut child = Command::new(program::built("foresight-server"))
            .args(arguments("killed", &[]))
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        std::thread::sleep(takes.mul_f64(share));
        child.kill().expect("a child can be killed");
        child.wait().expect("a child can be waited for");
        let document = folder.join("killed/world.toml");
        if document.exists() {
            // Whoever reads sees nothing or a whole world.
            stored::open(&folder.join("killed")).expect("what is published is whole");
        }
        println!("kill {kill} after {:.2} of an undisturbed build", share);
    }
    let resumed = build(folder, "killed", &[]);
    assert_eq!(resumed["identity"], whole["identity"]);
    assert_eq!(resumed["content"], whole["content"]);
    assert_eq!(files(&folder.join("killed")), files(&folder.join("whole")));
    println!("{} of {} leaves had been made", resumed["leaves_restored"], resumed["content"]["leaves"]);
}

#[test]
fn a_world_is_inspected_replayed_served_and_rebuilt() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    generate(folder, "2");
    let first = build(folder, "world", &[]);
    assert!(first["content"]["orthoviews"].as_u64() > Some(100), "{first:#}");
    assert!(first["left_out"].as_array().is_some_and(|list| list.iter().any(|entry| entry["what"] == "empty leaves")));

    let ended = program::sim(folder, &["inspect", "world"], LIMIT);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    assert!(ended.stdout.contains("stored world") && ended.stdout.contains("empty leaves"), "{}", ended.stdout);

    // Every file that a representation names is there, with the bytes that it says.
    let world = stored::open(&folder.join("world")).expect("a world");
    for rep in (0..world.tree.representations() as u32).map(RepId) {
        let bytes = std::fs::read(folder.join("world").join(&*world.uri(rep))).expect("a file");
        assert_eq!(bytes.len() as u64, world.tree.wire_bytes(rep));
        foresight_index::format::orthoview::decode(&bytes).expect("an orthoview");
    }
    let server = Server::start(folder, &["--world", "world"]);
    let (status, body) = server.get("/worlds");
    assert!(status == 200 && body.contains("\"files\"") && body.contains("stored world"), "{status} {body}");
    server.kill();

    // Built again without a change it is the same; changed, the version before stays until the next.
    let again = build(folder, "world", &[]);
    assert_eq!((&again["identity"], &again["previous"]), (&first["identity"], &Value::Null));
    let named = |identity: &Value| format!("/catalogue.{}.sqlite", &identity.as_str().expect("text")[..16]);
    let second = build(folder, "world", &["--pixels", "8"]);
    assert_eq!(second["previous"], first["identity"]);
    assert!(files(&folder.join("world")).contains(&named(&first["identity"])));
    let third = build(folder, "world", &["--pixels", "12"]);
    assert_eq!(third["previous"], second["identity"]);
    assert!(!files(&folder.join("world")).contains(&named(&first["identity"])));
    assert!(files(&folder.join("world")).contains(&named(&second["identity"])));
    stored::open(&folder.join("world")).expect("a whole world");
}

#[test]
fn what_cannot_be_built_leaves_what_is_published() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    input::write_world(folder);
    let given = |more: &[&'static str]| {
        [&["build", "--input", "tileset.json", "--out", "world", "--leaf", "20", "--quiet"], more].concat()
    };
    let built = program::run("foresight-server", folder, &given(&[]), &[], LIMIT);
    assert_eq!(built.code, Some(0), "{}", built.stderr);
    let document = folder.join("world/world.toml");
    let published = std::fs::read_to_string(&document).expect("a document");
    let changed = given(&["--directions", "2"]);

    // Another build at work.
    let lock = File::options().write(true).open(folder.join("world/build.lock")).expect("a lock");
    lock.lock().expect("free");
    assert!(refused(folder, &changed).contains("another build is at work"));
    drop(lock);

    // No room: files of more than 512 bytes cannot be written.
    let script = format!(
        "trap '' XFSZ; ulimit -f 1; exec {} {}",
        program::built("foresight-server").display(),
        changed.join(" ")
    );
    let full = Command::new("sh").args(["-c", &script]).current_dir(folder).output().expect("a shell");
    assert_eq!(full.status.code(), Some(2));
    let message = String::from_utf8_lossy(&full.stderr).into_owned();
    assert!(message.starts_with("error: ") && message.contains("world/"), "{message}");
    assert_eq!(std::fs::read_to_string(&document).expect("a document"), published);
    stored::open(&folder.join("world")).expect("what was published is whole");

    // Other faults, each with its message.
    for (arguments, part) in [
        (vec!["build", "--input", "tileset.json", "--out", "/proc/nowhere"], "/proc/nowhere"),
        (vec!["build", "--input", "tileset.json", "--out", "."], "holds something else"),
        (vec!["build", "--input", "absent.glb", "--out", "other"], "absent.glb"),
        (vec!["build", "--input", "path.txt", "--out", "other"], "path.txt"),
        (given(&["--pixels", "100000"]), "expected 8 to 4096"),
        (given(&["--directions", "27"]), "expected `auto`"),
    ] {
        let arguments: Vec<&str> = arguments.into_iter().collect();
        let message = refused(folder, &arguments);
        assert!(message.contains(part), "{arguments:?}: {message}");
    }

    // A newer schema is refused by name and left alone.
    let newer = published.replace("schema_version = 1", "schema_version = 2");
    std::fs::write(&document, &newer).expect("a document");
    let message = refused(folder, &changed);
    assert!(message.contains("schema_version is 2; expected 1") && message.contains("newer"), "{message}");
    assert_eq!(std::fs::read_to_string(&document).expect("a document"), newer);
    let inspected = program::sim(folder, &["inspect", "world"], LIMIT);
    assert!(inspected.code == Some(2) && inspected.stderr.contains("schema_version is 2"), "{}", inspected.stderr);
}
