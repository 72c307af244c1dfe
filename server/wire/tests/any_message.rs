//! Any sequence of any messages: no panic, memory within its budget, bounded answers that can be written and read, and
//! the same answers when replayed.

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_wire::encoding::Encoding;
use foresight_wire::message::*;
use foresight_wire::recording::{Entry, Header, Input, Reader, Writer, feed, open};
use foresight_wire::session::{Session, SessionLimits, SessionWorld};
use glam::DVec3;
use proptest::collection::vec;
use proptest::prelude::*;
use std::borrow::Cow;

const REPS: u32 = 30;

/// Ten nodes in a row, each with three levels of which the second needs the first and the third the second.
fn world() -> LodTree {
    let mut builder = LodTreeBuilder::default();
    let of = |wire_bytes: u32, error: f32, prerequisite| Representation {
        wire_bytes,
        decoded_bytes: 3 * wire_bytes,
        error,
        prerequisite,
        direction: None,
    };
    builder.open().expect("a root");
    for x in 0..10 {
        builder.open().expect("a node");
        let first = builder.add(of(500, 1.0, None)).expect("a level");
        let second = builder.add(of(2000, 0.1, Some(first))).expect("a level");
        builder.add(of(9000, 0.01, Some(second))).expect("a level");
        let min = DVec3::new(f64::from(x) * 10.0, -4.0, -30.0);
        builder.close(Some(Aabb { min, max: min + 8.0 }), 1.0).expect("a node");
    }
    builder.close(None, 1.0).expect("a root");
    builder.finish().expect("a world")
}

fn limits() -> SessionLimits {
    SessionLimits {
        memory_bytes_max: 1 << 20,
        messages_max: 12,
        errors_max: 4,
        path_views_max: 6,
        actions_max: 40,
        ..SessionLimits::default()
    }
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![4 => -50.0..50.0f64, 1 => prop::num::f64::ANY, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

fn time() -> impl Strategy<Value = u64> {
    prop_oneof![6 => 0..4_000_000_000u64, 1 => any::<u64>(), 1 => Just(u64::MAX)]
}

fn rep() -> impl Strategy<Value = u32> {
    prop_oneof![6 => 0..REPS, 1 => any::<u32>()]
}

fn bytes() -> impl Strategy<Value = u64> {
    prop_oneof![6 => 0..200_000u64, 1 => any::<u64>(), 1 => Just(0)]
}

fn event() -> impl Strategy<Value = Event> {
    (time(), rep()).prop_map(|(t_ns, rep)| Event { t_ns, rep })
}

fn policy() -> impl Strategy<Value = String> {
    prop_oneof![
        Just("foresight".to_owned()),
        Just("foresight:choice=sampled".to_owned()),
        Just("potree".to_owned()),
        Just("3d-tiles-renderer".to_owned()),
        Just("clairvoyant".to_owned()),
        "[a-z:=,.0-9-]{0,40}",
    ]
}

/// Mostly one that sees the world.
fn camera() -> impl Strategy<Value = Camera> {
    let sane = (-20.0..120.0f64, -0.6..0.6f64).prop_map(|(x, turn)| {
        let (sin, cos) = (libm::sin(0.5 * turn), libm::cos(0.5 * turn));
        Camera {
            position: [x, 0.0, 0.0],
            orientation: [0.0, sin, 0.0, cos],
            fov_y: 1.0,
            viewport: [640, 480],
            weight: 1.0,
        }
    });
    let any = (prop::array::uniform3(number()), prop::array::uniform4(number()), number(), any::<[u32; 2]>(), number())
        .prop_map(|(position, orientation, fov_y, viewport, weight)| Camera {
            position,
            orientation,
            fov_y,
            viewport,
            weight,
        });
    prop_oneof![5 => sane, 1 => any]
}

fn mode() -> impl Strategy<Value = Mode> {
    prop_oneof![3 => Just(Mode::Drive), 1 => Just(Mode::Warm), 1 => Just(Mode::Shadow)]
}

prop_compose! {
    fn hello()(
        version in prop_oneof![9 => Just(VERSION), 1 => any::<u32>()],
        world in prop_oneof![9 => Just("w".to_owned()), 1 => ".{0,8}"],
        memory_bytes in prop_oneof![9 => 1..300_000u64, 1 => any::<u64>()],
        atomic in any::<bool>(),
        policy in prop_oneof![4 => Just(None), 1 => policy().prop_map(Some)],
        mode in mode(),
        resident in vec(rep(), 0..20),
        link in prop_oneof![4 => Just(None), 1 => (number(), number()).prop_map(Some)],
    ) -> Hello {
        let refinement = if atomic { Refinement::Atomic } else { Refinement::Partial };
        let link = link.map(|(rate, latency_s)| LinkGuess { rate, latency_s });
        Hello { version, world, memory_bytes, refinement, policy, mode, resume: None, resident, client: None, link }
    }
}

fn message() -> impl Strategy<Value = ClientMessage> {
    let settings = (prop::option::of(bytes()), prop::option::of(policy()), prop::option::of(mode()))
        .prop_map(|(memory_bytes, policy, mode)| Settings { memory_bytes, policy, mode });
    let waypoint = (time(), camera()).prop_map(|(t_ns, camera)| Waypoint { t_ns, camera });
    prop_oneof![
        6 => (time(), vec(camera(), 0..4)).prop_map(|(t_ns, cameras)| ClientMessage::View(Views { t_ns, cameras })),
        2 => event().prop_map(ClientMessage::Responded),
        2 => event().prop_map(ClientMessage::Arrived),
        3 => event().prop_map(ClientMessage::Completed),
        2 => event().prop_map(ClientMessage::Dropped),
        2 => (event(), ".{0,5}").prop_map(|(e, reason)| ClientMessage::Failed(Failure { t_ns: e.t_ns, rep: e.rep, reason })),
        2 => (time(), bytes(), bytes()).prop_map(|(t_ns, total_bytes, in_flight_bytes)| {
            ClientMessage::Progress(Progress { t_ns, total_bytes, in_flight_bytes })
        }),
        1 => vec(waypoint, 0..8).prop_map(|views| ClientMessage::Path(Path { views })),
        1 => settings.prop_map(ClientMessage::Settings),
        1 => hello().prop_map(|hello| ClientMessage::Hello(Box::new(hello))),
    ]
}

/// What is done to a session.
#[derive(Clone, Debug)]
enum Step {
    Frame(Vec<ClientMessage>),
    /// What a client that obeys says of what it was told to fetch: one of them, by its place.
    Obey(u8, Vec<(usize, u8)>),
    Tick,
    Resume(Box<Hello>),
    Switch(bool),
    Bye,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        8 => vec(message(), 0..14).prop_map(Step::Frame),
        8 => (any::<u8>(), vec((any::<usize>(), 0..6u8), 1..8)).prop_map(|(x, events)| Step::Obey(x, events)),
        2 => Just(Step::Tick),
        1 => hello().prop_map(|hello| Step::Resume(Box::new(hello))),
        1 => any::<bool>().prop_map(Step::Switch),
        1 => Just(Step::Bye),
    ]
}

/// A frame of a client that has been told to fetch `told`.
fn obeying(told: &[u32], x: u8, events: &[(usize, u8)], now: u64) -> Vec<ClientMessage> {
    let mut frame = Vec::new();
    for &(place, kind) in events {
        let Some(&rep) = told.get(place % told.len().max(1)) else { continue };
        let event = Event { t_ns: now, rep };
        frame.push(match kind {
            0 => ClientMessage::Responded(event),
            1 => ClientMessage::Arrived(event),
            2 | 3 => ClientMessage::Completed(event),
            4 => ClientMessage::Failed(Failure { t_ns: now, rep, reason: "404".to_owned() }),
            _ => ClientMessage::Dropped(event),
        });
    }
    let position = [f64::from(x) * 0.4, 0.0, 0.0];
    let orientation = [0.0, 0.0, 0.0, 1.0];
    let camera = Camera { position, orientation, fov_y: 1.2, viewport: [640, 480], weight: 1.0 };
    frame.push(ClientMessage::View(Views { t_ns: now, cameras: vec![camera] }));
    frame
}

fn check_answers(answers: &[ServerMessage], limits: &SessionLimits) -> Result<(), TestCaseError> {
    // Actions, what is given up, errors, and a welcome, a wait and estimates.
    prop_assert!(
        answers.len() <= 2 * limits.actions_max + REPS as usize * 2 + limits.errors_max + 8,
        "{}",
        answers.len()
    );
    for answer in answers {
        if let ServerMessage::Error(error) = answer {
            prop_assert!(error.code != ErrorCode::Internal, "{error:?}");
        }
    }
    for encoding in [Encoding::Json, Encoding::MessagePack] {
        let read: Vec<ServerMessage> = encoding.read(&encoding.write(answers)).expect("what was written");
        prop_assert_eq!(&read[..], answers);
    }
    Ok(())
}

fn has_only_finite_numbers(input: &Input) -> bool {
    let messages: &[ClientMessage] = match input {
        Input::Frame { messages } => messages,
        Input::Resume { hello } => &[ClientMessage::Hello(Box::new(hello.clone().into_owned()))],
        _ => &[],
    };
    // JSON writes what is not finite as null.
    let written = Encoding::Json.write(messages);
    Encoding::Json.read::<ClientMessage>(&written).is_ok_and(|read| read == messages)
}

fn drive(first: &Hello, steps: &[(u64, Step)]) -> Result<(), TestCaseError> {
    let tree = world();
    let uri = |rep: RepId| format!("{}.bin", rep.0);
    let of = SessionWorld { name: "w", identity: "0", base: "/w/", tree: &tree, uri: &uri, up: DVec3::Y };
    let limits = limits();
    let (mut session, opened) = match Session::open("s".to_owned(), of, &limits, first) {
        Ok(opened) => opened,
        Err(error) => {
            prop_assert!(error.fatal && !error.message.is_empty());
            return Ok(());
        }
    };
    check_answers(&opened, &limits)?;
    let header = Header::new("s", &of, &limits, first);
    let mut writer = Writer::new(Vec::new(), &header).expect("memory");
    writer.push(&Entry::new(0, Input::Open, &opened, &session)).expect("memory");
    let (mut told, mut now) = (Vec::new(), 0u64);
    let mut is_written = true;
    for (passed, step) in steps {
        now = now.saturating_add(*passed);
        let input = match step {
            Step::Frame(messages) => Input::Frame { messages: Cow::Borrowed(messages) },
            Step::Obey(x, events) => Input::Frame { messages: Cow::Owned(obeying(&told, *x, events, now)) },
            Step::Tick => Input::Tick,
            Step::Resume(hello) => Input::Resume { hello: Cow::Borrowed(hello) },
            Step::Switch(driving) => Input::Switch { driving: *driving },
            Step::Bye => Input::Frame { messages: Cow::Owned(vec![ClientMessage::Bye]) },
        };
        // A budget may shrink beneath what is in use, after something was taken in within the old one.
        let before = session.state().used_bytes().max(session.state().budget);
        let answers = feed(&mut session, now, &input);
        check_answers(&answers, &limits)?;
        check_answers(session.unsent(), &limits)?;
        let (used, budget) = (session.state().used_bytes(), session.state().budget);
        prop_assert!(used <= budget.max(before), "{used} of {budget}, after {input:?}");
        prop_assert!(session.heap_bytes() < 1 << 20);
        for answer in &answers {
            match answer {
                ServerMessage::Fetch(fetch) => told.push(fetch.rep),
                ServerMessage::Estimates(estimates) => prop_assert!(estimates.rate.is_finite()),
                _ => {}
            }
        }
        is_written &= has_only_finite_numbers(&input);
        if is_written {
            writer.push(&Entry::new(now, input, &answers, &session)).expect("memory");
        }
    }
    // What was written replays to the same answers, and a cut in its last line loses that line at most.
    let written = writer.into_inner();
    let reader = Reader::new("recording", &written[..]).expect("what was written");
    let (mut again, opened_again) = open(reader.header(), of).expect("as before");
    prop_assert_eq!(&opened_again, &opened);
    let mut lines = 1;
    for entry in reader {
        let entry = entry.expect("what was written");
        lines += 1;
        if entry.input != Input::Open {
            let answers = feed(&mut again, entry.received_ns, &entry.input);
            prop_assert_eq!(&answers[..], &entry.out[..]);
            prop_assert_eq!(again.unsent(), &entry.unsent[..]);
        }
    }
    prop_assert_eq!(lines, written.iter().filter(|byte| **byte == b'\n').count());
    let mut cut = Reader::new("recording", &written[..written.len() - 2]).expect("what was written");
    prop_assert_eq!(cut.by_ref().filter(Result::is_ok).count(), lines - 2);
    prop_assert!(cut.cut_off());
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_messages_in_any_order(
        first in hello(),
        steps in vec((prop_oneof![8 => 0..300_000_000u64, 1 => any::<u64>()], step()), 0..40),
    ) {
        drive(&first, &steps)?;
    }

    #[test]
    fn messages_survive_both_encodings(messages in vec(message(), 0..8)) {
        let json = Encoding::Json.write(&messages);
        let packed = Encoding::MessagePack.write(&messages);
        match Encoding::Json.read::<ClientMessage>(&json) {
            // What JSON can carry, MessagePack carries too.
            Ok(read) => {
                prop_assert_eq!(&read, &messages);
                prop_assert_eq!(&Encoding::MessagePack.read::<ClientMessage>(&packed).expect("as in JSON"), &messages);
            }
            // A number that is not finite: refused by both.
            Err(_) => prop_assert!(Encoding::MessagePack.read::<ClientMessage>(&packed).is_err()),
        }
    }
}
