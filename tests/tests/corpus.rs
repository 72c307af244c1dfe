//! The fuzz corpora: every file under `tests/corpus/<target>/`, and mutations of them, go through the byte-level
//! parsers. A file named `good-…` must be accepted, one named `bad-…` refused; nothing may panic or take long.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use foresight_tests::{entry, full, parser::TARGETS};
use proptest::prelude::*;
use proptest::sample::Index;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};

/// Largest file in a corpus, bytes. Mutations grow it by at most as much again.
const LARGEST: usize = 64 << 10;

/// What one parse of at most twice [`LARGEST`] bytes may take, in a debug build on a busy machine.
const LIMIT: Duration = Duration::from_secs(10);

/// Parses on a thread of its own, so that a panic, an overflowing loop or a hang is seen and named here.
fn parse(target: &'static str, bytes: Vec<u8>) -> Result<Result<(), String>, String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let answer = entry(target, &bytes);
        // The receiver is gone if the limit passed.
        let _ = sender.send(answer);
    });
    match receiver.recv_timeout(LIMIT) {
        Ok(answer) => Ok(answer),
        Err(RecvTimeoutError::Timeout) => Err(format!("{target}: not parsed within {LIMIT:?}")),
        Err(RecvTimeoutError::Disconnected) => Err(format!("{target}: the parser panicked")),
    }
}

/// Files of a target's corpus by name.
fn corpus(target: &str) -> BTreeMap<String, Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let files: BTreeMap<_, _> = entries
        .map(|entry| {
            let entry = entry.expect("an entry");
            let name = entry.file_name().into_string().expect("names are UTF-8");
            (name, std::fs::read(entry.path()).expect("a corpus file can be read"))
        })
        .collect();
    for (name, bytes) in &files {
        assert!(bytes.len() <= LARGEST, "{target}/{name}: {} bytes, at most {LARGEST}", bytes.len());
    }
    files
}

#[test]
fn every_target_has_a_corpus_and_every_corpus_a_target() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let entries = std::fs::read_dir(folder).expect("the corpora can be listed");
    let mut folders: Vec<_> =
        entries.map(|entry| entry.expect("an entry").file_name().into_string().expect("names are UTF-8")).collect();
    folders.sort();
    let mut targets: Vec<_> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    targets.sort();
    assert_eq!(folders, targets);
    for (target, _) in TARGETS {
        let files = corpus(target);
        for kind in ["good-", "bad-"] {
            assert!(files.keys().any(|name| name.starts_with(kind)), "{target} has no file {kind}…");
        }
    }
}

#[test]
fn files_are_accepted_or_refused_as_their_names_say() {
    let mut wrong = Vec::new();
    for (target, _) in TARGETS {
        for (name, bytes) in corpus(target) {
            match parse(target, bytes) {
                Err(failure) => wrong.push(format!("{target}/{name}: {failure}")),
                Ok(Err(refusal)) if name.starts_with("good-") => {
                    wrong.push(format!("{target}/{name} refused: {refusal}"))
                }
                Ok(Ok(())) if name.starts_with("bad-") => wrong.push(format!("{target}/{name} accepted")),
                Ok(_) => {}
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// One change to a file. Positions are relative to its length at that moment.
#[derive(Clone, Debug)]
enum Edit {
    /// Inverts one bit.
    Flip(Index, u8),
    /// Sets one byte.
    Set(Index, u8),
    /// Cuts the end off.
    Truncate(Index),
    /// Takes a range out.
    Remove(Index, Index),
    /// Puts a range of another file of the corpus in.
    Splice(Index, Index, Index),
    /// Puts a token in that parsers stumble over.
    Insert(Index, &'static [u8]),
    /// Overwrites four bytes with an integer, little-endian: lengths and offsets.
    Word(Index, u32),
}

const TOKENS: [&[u8]; 16] = [
    b"1e999",
    b"-1e308",
    b"NaN",
    b"inf",
    b"-0",
    b"18446744073709551616",
    b"-9223372036854775809",
    b"null",
    b"[[[[[[[[[[[[[[[[",
    b"{\"children\":[{",
    b"\"",
    b"\\ud800",
    b"\0",
    b"\xff\xfe",
    b"\r\n",
    b",",
];

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let at = any::<Index>;
    let word = prop_oneof![Just(0), Just(1), Just(u32::MAX), Just(i32::MAX as u32), any::<u32>()];
    let edit = prop_oneof![
        (at(), 0..8u8).prop_map(|(place, bit)| Edit::Flip(place, bit)),
        (at(), any::<u8>()).prop_map(|(place, byte)| Edit::Set(place, byte)),
        at().prop_map(Edit::Truncate),
        (at(), at()).prop_map(|(from, to)| Edit::Remove(from, to)),
        (at(), at(), at()).prop_map(|(place, from, to)| Edit::Splice(place, from, to)),
        (at(), prop::sample::select(&TOKENS[..])).prop_map(|(place, token)| Edit::Insert(place, token)),
        (at(), word).prop_map(|(place, word)| Edit::Word(place, word)),
    ];
    prop::collection::vec(edit, 1..6)
}

fn range(from: &Index, to: &Index, length: usize) -> std::ops::Range<usize> {
    let (from, to) = (from.index(length + 1), to.index(length + 1));
    from.min(to)..from.max(to)
}

fn mutate(bytes: &mut Vec<u8>, other: &[u8], edit: &Edit) {
    let length = bytes.len();
    match edit {
        Edit::Flip(place, bit) if length > 0 => bytes[place.index(length)] ^= 1 << bit,
        Edit::Set(place, byte) if length > 0 => bytes[place.index(length)] = *byte,
        Edit::Truncate(place) => bytes.truncate(place.index(length + 1)),
        Edit::Remove(from, to) => drop(bytes.drain(range(from, to, length))),
        Edit::Splice(place, from, to) => {
            let part = &other[range(from, to, other.len())];
            let place = place.index(length + 1);
            bytes.splice(place..place, part.iter().copied());
        }
        Edit::Insert(place, token) => {
            let place = place.index(length + 1);
            bytes.splice(place..place, token.iter().copied());
        }
        Edit::Word(place, word) if length >= 4 => {
            let place = place.index(length - 3);
            bytes[place..place + 4].copy_from_slice(&word.to_le_bytes());
        }
        Edit::Flip(..) | Edit::Set(..) | Edit::Word(..) => {}
    }
    bytes.truncate(2 * LARGEST);
}

/// Runs mutations of every corpus, the same ones each time.
fn mutations(cases: u32) {
    for (target, _) in TARGETS {
        let files: Vec<Vec<u8>> = corpus(target).into_values().collect();
        let config = Config { cases, failure_persistence: None, ..Config::default() };
        let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
        let strategy = (any::<Index>(), any::<Index>(), edits());
        let outcome = runner.run(&strategy, |(file, other, edits)| {
            let mut bytes = files[file.index(files.len())].clone();
            let other = &files[other.index(files.len())];
            edits.iter().for_each(|edit| mutate(&mut bytes, other, edit));
            let shown = String::from_utf8_lossy(&bytes).into_owned();
            parse(target, bytes).map(drop).map_err(|failure| TestCaseError::fail(format!("{failure}\n{shown}")))
        });
        if let Err(failure) = outcome {
            panic!("{target}: {failure}");
        }
    }
}

#[test]
fn mutated_files_neither_panic_nor_hang() {
    mutations(512);
}

#[test]
fn many_mutated_files_neither_panic_nor_hang() {
    match full() {
        Ok(()) => mutations(50_000),
        Err(reason) => println!("{reason}"),
    }
}
