//! Bytes as a session: what the fuzz targets of the messages drive.

use std::borrow::Cow;
use std::sync::LazyLock;

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, RepId, Representation};
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{ClientMessage, Hello};
use foresight_wire::recording::{Input, Reader, feed, open};
use foresight_wire::session::{Session, SessionLimits, SessionWorld};
use glam::DVec3;

/// Time between two lines, ns.
const LINE_NS: u64 = 50_000_000;

/// Six nodes in a row along x before a camera that looks along −z, each with two levels of which the second needs the
/// first.
static TREE: LazyLock<LodTree> = LazyLock::new(|| tree().expect("a tree made by hand"));

fn tree() -> Result<LodTree, LodTreeError> {
    let mut builder = LodTreeBuilder::default();
    builder.open()?;
    for x in 0..6 {
        builder.open()?;
        let level = |wire_bytes, error, prerequisite| Representation {
            wire_bytes,
            decoded_bytes: 4 * wire_bytes,
            error,
            prerequisite,
            direction: None,
        };
        let first = builder.add(level(1000, 1.0, None))?;
        builder.add(level(10_000, 0.01, Some(first)))?;
        let min = DVec3::new(f64::from(x) * 10.0 - 30.0, -4.0, -30.0);
        builder.close(Some(Aabb { min, max: min + 8.0 }), 1.0)?;
    }
    builder.close(None, 1.0)?;
    builder.finish()
}

fn world() -> SessionWorld<'static> {
    SessionWorld {
        name: "row",
        identity: "0",
        base: "/row/",
        tree: &TREE,
        uri: &|rep: RepId| format!("{}.glb", rep.0),
        up: DVec3::Y,
    }
}

/// Lines: first a `hello`, then one every 50 ms: a frame (a JSON list), another `hello` of a broken connection (a JSON
/// object), or nothing, which is a tick. Refused if one of them is none of that, or if the session cannot be opened. The
/// memory in use never exceeds the budget, but for one that has shrunk.
///
/// # Panics
/// If the memory does, or the session panics.
pub fn lines(bytes: &[u8]) -> Result<(), String> {
    let mut lines = bytes.split(|&byte| byte == b'\n');
    let hello: Hello = serde_json::from_slice(lines.next().unwrap_or_default()).map_err(|error| error.to_string())?;
    let limits = SessionLimits { memory_bytes_max: 1 << 24, ..SessionLimits::default() };
    let (mut session, _) = Session::open("s".to_owned(), world(), &limits, &hello).map_err(|error| error.message)?;
    let mut refused = None;
    for (place, line) in lines.enumerate() {
        let input = match line {
            [] => Input::Tick,
            [b'{', ..] => match serde_json::from_slice::<Hello>(line) {
                Ok(hello) => Input::Resume { hello: Cow::Owned(hello) },
                Err(error) => {
                    refused = Some(format!("line {}: {error}", place + 2));
                    continue;
                }
            },
            _ => match Encoding::Json.read::<ClientMessage>(line) {
                Ok(messages) => Input::Frame { messages: Cow::Owned(messages) },
                Err(error) => {
                    refused = Some(format!("line {}: {error}", place + 2));
                    continue;
                }
            },
        };
        let before = session.state().used_bytes().max(session.state().budget);
        feed(&mut session, (place as u64 + 1) * LINE_NS, &input);
        let (used, budget) = (session.state().used_bytes(), session.state().budget);
        assert!(used <= budget.max(before), "{used} bytes are in use, the budget is {budget}");
    }
    refused.map_or(Ok(()), Err)
}

/// A recording: read, and replayed as far as it goes.
///
/// # Errors
/// What is no recording, or does not open.
pub fn recording(bytes: &[u8]) -> Result<(), String> {
    let mut reader = Reader::new("recording", bytes).map_err(|error| error.to_string())?;
    let header = reader.header().clone();
    let of = SessionWorld { name: &header.world, ..world() };
    let mut session = open(&header, of).map(|(session, _)| session).map_err(|error| error.message);
    for entry in reader.by_ref() {
        let entry = entry.map_err(|error| error.to_string())?;
        if let Ok(session) = &mut session {
            feed(session, entry.received_ns, &entry.input);
        }
    }
    session.map(drop)
}
