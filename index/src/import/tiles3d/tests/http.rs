//! Tilesets from a server on the loopback interface.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use foresight_scheduler::lod_tree::RepId;

use super::*;
use crate::specification;

/// What the server answers for a path: status, further headers, body.
type Answers = BTreeMap<String, (&'static str, String, Vec<u8>)>;

/// Serves `answers` for as long as the test runs; returns the origin and the paths that were asked for.
fn serve(answers: Answers) -> (String, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let origin = format!("http://{}", listener.local_addr().unwrap());
    let asked = Arc::new(Mutex::new(Vec::new()));
    let (answers, log) = (Arc::new(answers), asked.clone());
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let (mut stream, answers, log) = (stream.unwrap(), answers.clone(), log.clone());
            std::thread::spawn(move || {
                let mut reader = BufReader::new(stream.try_clone().unwrap());
                loop {
                    let mut request = String::new();
                    if reader.read_line(&mut request).unwrap_or(0) == 0 {
                        return;
                    }
                    let path = request.split(' ').nth(1).unwrap().to_owned();
                    let mut line = String::new();
                    while reader.read_line(&mut line).unwrap_or(0) > 2 {
                        line.clear();
                    }
                    log.lock().unwrap().push(path.clone());
                    let absent = ("404 Not Found", String::new(), Vec::new());
                    let (status, headers, body) = answers.get(&path).unwrap_or(&absent);
                    let head = format!("HTTP/1.1 {status}\r\ncontent-length: {}\r\n{headers}\r\n", body.len());
                    stream.write_all(head.as_bytes()).unwrap();
                    stream.write_all(body).unwrap();
                }
            });
        }
    });
    (origin, asked)
}

fn ok(body: impl Into<Vec<u8>>) -> (&'static str, String, Vec<u8>) {
    ("200 OK", String::new(), body.into())
}

fn named(url: &str) -> Result<World, String> {
    specification::open(url, &(Arc::new(|_, _| {}) as specification::Progress)).map_err(|error| error.to_string())
}

/// A root over two tiles, one with an address without an extension.
fn files() -> BTreeMap<String, Vec<u8>> {
    let tileset = r#"{"asset":{"version":"1.1"},"geometricError":40,"root":{"boundingVolume":{"box":[0,0,0,50,0,0,0,50,0,0,0,10]},
        "geometricError":10,"refine":"REPLACE","content":{"uri":"root.glb"},"children":[
        {"boundingVolume":{"box":[-25,0,0,25,0,0,0,50,0,0,0,10]},"geometricError":0,"content":{"uri":"a%20b.glb?v=1"}},
        {"boundingVolume":{"box":[25,0,0,25,0,0,0,50,0,0,0,10]},"geometricError":0,"content":{"uri":"east"}}]}}"#;
    let mut files = BTreeMap::from([("tileset.json".to_owned(), tileset.as_bytes().to_vec())]);
    for name in ["root.glb", "a b.glb", "east"] {
        files.insert(name.to_owned(), rectangle(None));
    }
    files
}

#[test]
fn the_same_world_as_from_the_folder() {
    let folder = tempfile::tempdir().unwrap();
    let mut answers = Answers::new();
    for (name, bytes) in files() {
        std::fs::write(folder.path().join(&name), &bytes).unwrap();
        answers.insert(format!("/w/{}", name.replace(' ', "%20")), ok(bytes));
    }
    let (origin, asked) = serve(answers);
    let (calls, counted) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let (calls_seen, bytes_seen) = (calls.clone(), counted.clone());
    let progress: specification::Progress = Arc::new(move |_, bytes| {
        calls_seen.fetch_add(1, Ordering::Relaxed);
        bytes_seen.fetch_max(bytes, Ordering::Relaxed);
    });
    let world = specification::open(&format!("{origin}/w/tileset.json"), &progress).unwrap();
    let written = crate::world::open(folder.path()).unwrap();
    assert_eq!((world.hash(), world.name.as_str()), (written.hash(), "w"));
    let bytes: u64 = files().values().map(|bytes| bytes.len() as u64).sum();
    assert_eq!((calls.load(Ordering::Relaxed), counted.load(Ordering::Relaxed)), (4, bytes));
    let note = world.notes.last().unwrap();
    assert!(note.text.contains(&format!("4 files of {bytes} bytes")), "{note}");
    let mut asked = asked.lock().unwrap().clone();
    asked.sort();
    assert_eq!(asked, ["/w/a%20b.glb", "/w/east", "/w/root.glb", "/w/tileset.json"], "each once");
    assert_eq!(named(&format!("{origin}/w/")).unwrap().hash(), written.hash());
}

#[test]
fn redirects_stay_at_their_origin() {
    let to = |place: &str| ("302 Found", format!("location: {place}\r\n"), Vec::new());
    let mut answers: Answers =
        files().into_iter().map(|(name, bytes)| (format!("/b/{}", name.replace(' ', "%20")), ok(bytes))).collect();
    answers.insert("/b/root.glb".to_owned(), to("http://198.51.100.7/root.glb"));
    answers.insert("/b/a%20b.glb".to_owned(), to("../c/there.glb"));
    answers.insert("/c/there.glb".to_owned(), ok(rectangle(None)));
    answers.insert("/b/east".to_owned(), to("/b/east"));
    answers.insert("/a/tileset.json".to_owned(), to("/b/tileset.json"));
    let (origin, asked) = serve(answers);
    let world = named(&format!("{origin}/b/tileset.json")).unwrap();
    assert_eq!(world.tree.representations(), 1, "{:?}", world.notes);
    let notes: String = world.notes.iter().map(|note| format!("{note}\n")).collect();
    assert!(notes.contains("redirected to \"http://198.51.100.7/root.glb\""), "{notes}");
    assert!(notes.contains("more than 5 redirects"), "{notes}");
    assert!(asked.lock().unwrap().iter().filter(|path| *path == "/b/east").count() >= 6);
}

#[test]
fn answers_that_are_no_files() {
    let mut answers: Answers = files().into_iter().map(|(name, bytes)| (format!("/{name}"), ok(bytes))).collect();
    let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    zipped.write_all(&rectangle(None)).unwrap();
    let zipped = zipped.finish().unwrap();
    let length = zipped.len() as u64;
    answers.insert("/root.glb".to_owned(), ("200 OK", "content-encoding: gzip\r\n".to_owned(), zipped));
    answers.insert("/a%20b.glb".to_owned(), ("200 OK", "content-encoding: br\r\n".to_owned(), vec![1]));
    answers.insert("/east".to_owned(), ("500 Oh", String::new(), Vec::new()));
    let (origin, _) = serve(answers);
    let world = named(&format!("{origin}/tileset.json")).unwrap();
    assert_eq!((world.tree.representations(), world.tree.wire_bytes(RepId(0))), (1, length), "{:?}", world.notes);
    let notes: String = world.notes.iter().map(|note| format!("{note}\n")).collect();
    assert!(notes.contains("encoded as \"br\"") && notes.contains("status 500"), "{notes}");
    let absent = named(&format!("{origin}/absent.json")).unwrap_err();
    assert!(absent.contains("/absent.json: status 404 Not Found; expected 200"), "{absent}");
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    assert!(named(&format!("http://{nobody}/tileset.json")).unwrap_err().contains("tileset.json: "));
    assert!(named("http:///tileset.json").unwrap_err().contains("expected http://host/path/tileset.json"));
}
