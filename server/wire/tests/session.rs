//! Sessions driven by clients of a few lines.

mod client;

use client::{Client, TICK_NS, hello, rows, session_world, small_city, view_at};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::state::Status;
use foresight_wire::message::{
    Camera, ClientMessage, ErrorCode, Event, Failure, Hello, LinkGuess, Mode, Path, ServerMessage, Settings, Views,
    Waypoint,
};
use foresight_wire::session::{Session, SessionLimits};

const MS: u64 = 1_000_000;

fn event(t_ns: u64, rep: u32) -> Event {
    Event { t_ns, rep }
}

fn fetched(answers: &[ServerMessage]) -> Vec<u32> {
    answers.iter().filter_map(|a| if let ServerMessage::Fetch(fetch) = a { Some(fetch.rep) } else { None }).collect()
}

fn errors(answers: &[ServerMessage]) -> Vec<(ErrorCode, &str)> {
    let mut errors = Vec::new();
    for answer in answers {
        if let ServerMessage::Error(error) = answer {
            errors.push((error.code, error.message.as_str()));
        }
    }
    errors
}

fn open<'a>(tree: &'a LodTree, hello: &Hello) -> (Session<'a>, Vec<ServerMessage>) {
    open_within(tree, &SessionLimits::default(), hello)
}

fn open_within<'a>(tree: &'a LodTree, limits: &SessionLimits, hello: &Hello) -> (Session<'a>, Vec<ServerMessage>) {
    let world = session_world(tree, &|rep: RepId| format!("{}.glb", rep.0));
    Session::open("s".to_owned(), world, limits, hello).expect("a session")
}

/// Frames of a client that obeys at once until nothing more is fetched; time goes on by 100 ms a frame.
fn settle(session: &mut Session, mut now: u64) -> u64 {
    let mut events = Vec::new();
    loop {
        events.push(view_at(now, 0.0));
        let answers = session.frame(now, &events);
        assert_eq!(errors(&answers), []);
        now += 100 * MS;
        events = fetched(&answers).into_iter().map(|rep| ClientMessage::Completed(event(now, rep))).collect();
        if events.is_empty() && session.state().requests().is_empty() {
            return now;
        }
    }
}

#[test]
fn a_client_that_obeys_sees_the_city_and_stays_within_its_memory() {
    let city = small_city();
    let budget = 4 << 20;
    let (mut session, opened) = open(&city.tree, &hello(budget));
    let ServerMessage::Welcome(welcome) = &opened[0] else { panic!("{opened:?}") };
    assert_eq!((welcome.representations, welcome.resumed), (city.tree.representations() as u64, false));
    let mut client = Client::new(400_000.0);
    let (mut last, mut estimates_sent) = (None, 0);
    for tick in 0..600u64 {
        let now = tick * TICK_NS;
        let mut frame = client.events(&city.tree, now);
        frame.push(view_at(now, tick as f64 * 0.2));
        let answers = session.frame(now, &frame);
        client.obey(&answers, now);
        assert_eq!(errors(&answers), []);
        for answer in &answers {
            match answer {
                ServerMessage::Estimates(estimates) => {
                    last = estimates.quality;
                    estimates_sent += 1;
                }
                ServerMessage::Fetch(fetch) => {
                    assert!(fetch.urgency <= 7 && fetch.deadline_ns > now && fetch.uri.ends_with(".glb"), "{fetch:?}");
                }
                _ => {}
            }
        }
        assert!(session.state().used_bytes() <= budget);
        assert!(client.held_bytes(&city.tree) <= budget, "at {now}");
    }
    assert!(last.is_some_and(|quality| quality > 0.5), "{last:?}");
    assert_eq!(estimates_sent, 10, "one a second");
    assert!(session.heap_bytes() < 1 << 20, "{}", session.heap_bytes());
    assert!((session.link().rate / 400_000.0 - 1.0).abs() < 0.3, "{:?}", session.link());
}

#[test]
fn what_is_wrong_with_a_hello_is_said_with_what_was_expected() {
    let tree = rows(4);
    let limits =
        SessionLimits { memory_bytes_max: 1000, residents_max: 2, text_bytes_max: 10, ..SessionLimits::default() };
    let good = Hello { memory_bytes: 1000, ..hello(1000) };
    let bad = [
        (Hello { version: 7, ..good.clone() }, ErrorCode::Version, "version 7"),
        (Hello { world: "moon".to_owned(), ..good.clone() }, ErrorCode::World, "expected city"),
        (Hello { memory_bytes: 0, ..good.clone() }, ErrorCode::Value, "expected 1 to 1000"),
        (Hello { memory_bytes: 1001, ..good.clone() }, ErrorCode::Value, "expected 1 to 1000"),
        (Hello { resident: vec![0, 1, 2], ..good.clone() }, ErrorCode::Value, "expected at most 2"),
        (Hello { client: Some("x".repeat(11)), ..good.clone() }, ErrorCode::Value, "expected at most 10"),
        (Hello { policy: Some("best".to_owned()), ..good.clone() }, ErrorCode::Value, "unknown policy `best`"),
        (
            Hello { link: Some(LinkGuess { rate: f64::NAN, latency_s: 0.1 }), ..good.clone() },
            ErrorCode::Value,
            "rate_guess is NaN",
        ),
    ];
    let world = session_world(&tree, &|_| String::new());
    for (hello, code, words) in bad {
        let error = Session::open(String::new(), world, &limits, &hello).map(drop).expect_err(words);
        assert!(error.fatal && error.code == code && error.message.contains(words), "{error:?}");
    }
}

#[test]
fn what_crosses_a_cancellation_is_no_error_and_leaves_nothing_behind() {
    let tree = rows(8);
    let (mut session, _) = open(&tree, &Hello { memory_bytes: 1 << 20, ..hello(1 << 20) });
    let told = fetched(&session.frame(0, &[view_at(0, 0.0)]));
    // The budget shrinks to nothing: everything is cancelled.
    let shrink = ClientMessage::Settings(Settings { memory_bytes: Some(1), ..Settings::default() });
    let answers = session.frame(10 * MS, &[shrink, view_at(10 * MS, 0.0)]);
    let cancelled = |rep: u32| answers.contains(&ServerMessage::Cancel { rep });
    assert!(!told.is_empty() && told.iter().all(|&rep| cancelled(rep)), "{told:?} {answers:?}");
    assert_eq!(session.state().used_bytes(), 0);
    // Meanwhile the first had arrived and been completed.
    let crossing = [ClientMessage::Arrived(event(11 * MS, told[0])), ClientMessage::Completed(event(12 * MS, told[0]))];
    let answers = session.frame(20 * MS, &crossing);
    assert_eq!(errors(&answers), []);
    assert!(answers.contains(&ServerMessage::Discard { rep: told[0] }), "{answers:?}");
    assert_eq!(session.state().used_bytes(), 0);
    // A minute later nothing of that kind is expected.
    let late = 61_100 * MS;
    let answers = session.frame(late, &[ClientMessage::Completed(event(late, told[0]))]);
    assert_eq!(errors(&answers)[0].0, ErrorCode::Event);
}

#[test]
fn what_a_cancelled_request_had_freed_on_its_arrival_is_gone() {
    let tree = rows(12);
    let (mut session, _) = open(&tree, &Hello { memory_bytes: 60_000, ..hello(60_000) });
    let now = settle(&mut session, 0);
    // Elsewhere, something has to go for what comes.
    let answers = session.frame(now, &[view_at(now, 70.0)]);
    let swap = answers.iter().find_map(|answer| match answer {
        ServerMessage::Fetch(fetch) if !fetch.discard_on_arrival.is_empty() => Some(fetch.clone()),
        _ => None,
    });
    let Some(swap) = swap else { panic!("{answers:?}") };
    let freed = RepId(swap.discard_on_arrival[0]);
    // The budget shrinks until that request is cancelled, and what it had doomed stays.
    let mut bytes = 60_000;
    let mut is_cancelled = false;
    while !is_cancelled && bytes > 1000 {
        bytes -= 1000;
        let shrink = ClientMessage::Settings(Settings { memory_bytes: Some(bytes), ..Settings::default() });
        is_cancelled = session.frame(now, &[shrink]).contains(&ServerMessage::Cancel { rep: swap.rep });
    }
    assert!(is_cancelled);
    assert_eq!(session.state().status(freed), Status::Resident);
    // It had arrived.
    let answers = session.frame(now + MS, &[ClientMessage::Arrived(event(now, swap.rep))]);
    assert_eq!(errors(&answers), []);
    assert_ne!(session.state().status(freed), Status::Resident);
}

#[test]
fn what_needs_a_failure_is_given_up_with_it() {
    let tree = rows(3);
    let (mut session, _) = open(&tree, &hello(1 << 20));
    let told = fetched(&session.frame(0, &[view_at(0, 0.0)]));
    let needs = |rep: u32| tree.prerequisite(RepId(rep)).is_some();
    let second = told.iter().copied().find(|&rep| needs(rep)).expect("a second level is fetched with its first");
    let first = tree.prerequisite(RepId(second)).expect("it needs one").0;
    let failed = |rep| ClientMessage::Failed(Failure { t_ns: MS, rep, reason: "404".to_owned() });
    let answers = session.frame(MS, &[failed(first)]);
    assert!(answers.contains(&ServerMessage::Cancel { rep: second }), "{answers:?}");
    assert_eq!(session.state().status(RepId(second)), Status::Absent);
    // A client that knows what needs what says so itself, and is told nothing.
    let (mut session, _) = open(&tree, &hello(1 << 20));
    assert_eq!(fetched(&session.frame(0, &[view_at(0, 0.0)])), told);
    let needing: Vec<u32> =
        told.iter().copied().filter(|&rep| tree.prerequisite(RepId(rep)) == Some(RepId(first))).collect();
    let above: Vec<u32> = told
        .iter()
        .copied()
        .filter(|&rep| tree.prerequisite(RepId(rep)).is_some_and(|p| needing.contains(&p.0)))
        .collect();
    let all: Vec<_> = [vec![first], needing, above].concat().into_iter().map(failed).collect();
    let answers = session.frame(MS, &all);
    assert!(!answers.iter().any(|answer| matches!(answer, ServerMessage::Cancel { .. })), "{answers:?}");
    assert_eq!(errors(&answers), []);
}

#[test]
fn a_session_goes_on_with_what_the_client_holds() {
    let tree = rows(10);
    let (mut session, _) = open(&tree, &hello(1 << 20));
    let told = fetched(&session.frame(0, &[view_at(0, 0.0)]));
    let whole: Vec<u32> = told.iter().copied().filter(|&rep| tree.prerequisite(RepId(rep)).is_none()).collect();
    let (kept, lost, decoded) = (whole[0], whole[1], whole[2]);
    let done = [kept, lost].map(|rep| ClientMessage::Completed(event(MS, rep)));
    session.frame(MS, &done);
    // The connection breaks; one is lost, another has come; of the rest the client says that one still responds.
    let again = Hello { resident: vec![kept, decoded], resume: Some("s".to_owned()), ..hello(1 << 20) };
    let answers = session.resume(30_000 * MS, &again);
    let ServerMessage::Welcome(welcome) = &answers[0] else { panic!("{answers:?}") };
    assert!(welcome.resumed);
    let status = |session: &Session, rep: u32| session.state().status(RepId(rep));
    assert_eq!(
        [kept, lost, decoded].map(|rep| status(&session, rep)),
        [Status::Resident, Status::Absent, Status::Resident]
    );
    let running: Vec<u32> = session.state().requests().iter().map(|request| request.rep.0).collect();
    let now = 30_001 * MS;
    let goes_on = *running.iter().find(|&&rep| tree.prerequisite(RepId(rep)).is_none()).expect("one");
    let answers = session.frame(now, &[ClientMessage::Responded(event(now, goes_on)), view_at(now, 0.0)]);
    assert_eq!(errors(&answers).iter().filter(|(code, _)| *code == ErrorCode::Event).count(), 0);
    // What went on is not asked for again; what was lost, and what was over, is.
    let asked = fetched(&answers);
    assert!(!asked.contains(&goes_on) && !asked.contains(&kept) && asked.contains(&lost), "{asked:?}");
    assert!(session.state().used_bytes() <= 1 << 20);
    // Another way of refining cannot go on.
    let other = Hello { refinement: foresight_wire::message::Refinement::Atomic, ..again };
    assert!(matches!(&session.resume(now, &other)[..], [ServerMessage::Error(error)] if error.fatal));
}

#[test]
fn a_cache_is_warmed_around_what_the_client_fetches_itself() {
    let tree = rows(6);
    let (mut session, _) = open(&tree, &Hello { mode: Mode::Warm, ..hello(1 << 20) });
    let own = [0u32, 3].map(|rep| ClientMessage::Arrived(event(0, rep)));
    let answers = session.frame(0, &[&own[..], &[view_at(0, 0.0)]].concat());
    assert_eq!(errors(&answers), []);
    let told = fetched(&answers);
    assert!(!told.contains(&0) && !told.contains(&3) && !told.is_empty(), "{told:?}");
    assert_eq!(session.state().used_bytes(), {
        let own = tree.decoded_bytes(RepId(0)) + tree.decoded_bytes(RepId(3));
        own + told.iter().map(|&rep| tree.wire_bytes(RepId(rep)) + tree.decoded_bytes(RepId(rep))).sum::<u64>()
    });
    // What does not fit is left out of account.
    let (mut session, _) = open(&tree, &Hello { mode: Mode::Warm, memory_bytes: 2000, ..hello(2000) });
    let all: Vec<_> = (0..18).map(|rep| ClientMessage::Arrived(event(0, rep))).collect();
    assert_eq!(errors(&session.frame(0, &all)), []);
    assert!(session.state().used_bytes() <= 2000);
}

#[test]
fn a_shadow_decides_by_what_the_client_holds_and_says_nothing() {
    let tree = rows(6);
    let (mut session, opened) = open(&tree, &Hello { mode: Mode::Shadow, ..hello(1 << 20) });
    assert!(matches!(&opened[0], ServerMessage::Welcome(welcome) if !welcome.driving));
    let answers = session.frame(0, &[view_at(0, 0.0)]);
    assert!(fetched(&answers).is_empty());
    let would = fetched(session.unsent());
    assert!(!would.is_empty());
    assert_eq!(session.state().used_bytes(), 0);
    // Nothing is decided until a quarter of a second later, and then the same unless the client has it.
    session.frame(100 * MS, &[view_at(100 * MS, 0.0), ClientMessage::Completed(event(100 * MS, would[0]))]);
    assert_eq!(session.unsent(), []);
    session.frame(250 * MS, &[view_at(250 * MS, 0.0)]);
    let would_now = fetched(session.unsent());
    assert!(!would_now.contains(&would[0]) && would_now.contains(&would[1]), "{would:?} {would_now:?}");
}

#[test]
fn the_kill_switch_leaves_the_client_to_itself_and_back() {
    let tree = rows(6);
    let (mut session, _) = open(&tree, &hello(1 << 20));
    assert_eq!(session.set_driving(false), [ServerMessage::Switch { driving: false }]);
    assert_eq!(session.set_driving(false), []);
    let own = ClientMessage::Completed(event(0, 0));
    let answers = session.frame(0, &[own, view_at(0, 0.0)]);
    assert!(fetched(&answers).is_empty() && errors(&answers).is_empty());
    assert_eq!(session.state().status(RepId(0)), Status::Resident);
    assert_eq!(session.wake_ns(), None);
    assert_eq!(session.set_driving(true), [ServerMessage::Switch { driving: true }]);
    let told = fetched(&session.frame(MS, &[view_at(MS, 0.0)]));
    assert!(!told.is_empty() && !told.contains(&0));
}

#[test]
fn urgency_falls_from_what_is_missing_in_view_to_what_only_a_surprise_would_show() {
    let tree = rows(30);
    let policy = Some("foresight:alpha=0.5:turn-rate=20".to_owned());
    let (mut session, _) = open(&tree, &Hello { policy, ..hello(8 << 20) });
    let (mut first, mut seen) = (None, std::collections::BTreeSet::new());
    let mut now = 0;
    // Along the row, looking across it: most of it lies beside the view.
    let half = 0.5f64.sqrt();
    for x in 0..200 {
        let position = [f64::from(x) * 0.5 - 50.0, -20.0, 20.0];
        let camera =
            Camera { position, orientation: [half, 0.0, 0.0, half], fov_y: 1.0, viewport: [1280, 720], weight: 1.0 };
        let answers = session.frame(now, &[ClientMessage::View(Views { t_ns: now, cameras: vec![camera] })]);
        let events: Vec<_> = answers
            .iter()
            .filter_map(|answer| match answer {
                ServerMessage::Fetch(fetch) => {
                    first.get_or_insert(fetch.urgency);
                    seen.insert(fetch.urgency);
                    Some(ClientMessage::Completed(event(now, fetch.rep)))
                }
                _ => None,
            })
            .collect();
        session.frame(now, &events);
        now += 50 * MS;
    }
    assert_eq!(first, Some(0));
    let any = |urgencies: core::ops::RangeInclusive<u8>| seen.iter().any(|urgency| urgencies.contains(urgency));
    assert!(any(1..=2) && any(3..=7) && seen.iter().all(|u| *u <= 7), "{seen:?}");
}

#[test]
fn it_is_woken_while_nothing_comes_and_says_why_it_waits_once() {
    let tree = rows(4);
    let (mut session, _) = open(&tree, &Hello { memory_bytes: 10, ..hello(10) });
    assert_eq!(session.wake_ns(), None);
    let answers = session.frame(0, &[view_at(0, 0.0)]);
    let why = |answers: &[ServerMessage]| -> Vec<String> {
        let because =
            |a: &ServerMessage| if let ServerMessage::Wait { because, .. } = a { because.clone() } else { None };
        answers.iter().filter_map(because).collect()
    };
    assert!(why(&answers)[0].contains("the memory budget is 10 bytes; expected at least"), "{answers:?}");
    let (mut last, mut ticks) = (0, 0);
    while last < 10_000 * MS {
        let wake = session.wake_ns().expect("there is a view");
        assert!((100 * MS..=1_600 * MS).contains(&(wake - last)), "{last} {wake}");
        assert_eq!(session.tick(wake), []);
        (last, ticks) = (wake, ticks + 1);
    }
    assert!(ticks < 12, "{ticks}");
    let bigger = ClientMessage::Settings(Settings { memory_bytes: Some(1 << 20), ..Settings::default() });
    let answers = session.frame(last, &[bigger]);
    assert!(!fetched(&answers).is_empty() && why(&answers).len() == 1, "{answers:?}");
}

#[test]
fn clocks_that_jump_are_followed_and_said_once() {
    let tree = rows(4);
    let (mut session, _) = open(&tree, &hello(1 << 20));
    // A client whose clock began elsewhere.
    let epoch = 1_700_000_000_000_000_000u64;
    let answers = session.frame(MS, &[view_at(epoch, 0.0)]);
    assert_eq!(errors(&answers).len(), 1, "{answers:?}");
    let fetch = answers.iter().find_map(|a| if let ServerMessage::Fetch(fetch) = a { Some(fetch) } else { None });
    assert!(fetch.is_some_and(|fetch| (epoch..epoch + 60_000 * MS).contains(&fetch.deadline_ns)), "{fetch:?}");
    assert_eq!(errors(&session.frame(20 * MS, &[view_at(epoch + 19 * MS, 0.0)])), []);
    // It goes back by an hour, and on.
    assert_eq!(errors(&session.frame(40 * MS, &[view_at(epoch - 3_600_000 * MS, 0.0)])).len(), 1);
    assert_eq!(errors(&session.frame(60 * MS, &[view_at(epoch - 3_599_980 * MS, 0.0)])), []);
    assert_eq!((session.clock_jumps(), session.now_ns()), (2, 60 * MS));
}

#[test]
fn every_list_has_its_bound() {
    let tree = rows(4);
    let limits =
        SessionLimits { messages_max: 8, cameras_max: 2, path_views_max: 3, errors_max: 2, ..SessionLimits::default() };
    let (mut session, _) = open_within(&tree, &limits, &hello(1 << 20));
    let ClientMessage::View(Views { cameras, .. }) = view_at(0, 0.0) else { panic!("a view") };
    let camera: Camera = cameras[0];
    let three = ClientMessage::View(Views { t_ns: 0, cameras: vec![camera; 3] });
    let path = ClientMessage::Path(Path { views: vec![Waypoint { t_ns: 0, camera }; 4] });
    let answers = session.frame(0, &[three, path]);
    let words: Vec<_> = errors(&answers).into_iter().map(|(_, words)| words.to_owned()).collect();
    assert_eq!(words, ["the view has 3 cameras; expected 1 to 2", "the path has 4 views; expected at most 3"]);
    let beyond = vec![ClientMessage::Completed(event(0, 99)); 20];
    let answers = session.frame(0, &beyond);
    let words: Vec<_> = errors(&answers).into_iter().map(|(_, words)| words.to_owned()).collect();
    assert_eq!(words.len(), 3, "{words:?}");
    assert!(words[0].contains("20 messages; expected at most 8") && words[2].starts_with("7 more errors"), "{words:?}");
    // Two cameras are observed together.
    let two = ClientMessage::View(Views { t_ns: 0, cameras: vec![camera, Camera { weight: 3.0, ..camera }] });
    assert_eq!(errors(&session.frame(0, &[two])), []);
    assert_eq!(session.state().cameras().len(), 2);
    // Nothing is listened to after a bye.
    session.frame(0, &[ClientMessage::Bye]);
    assert!(session.finished() && session.wake_ns().is_none());
    assert_eq!(errors(&session.frame(0, &[view_at(0, 0.0)]))[0].0, ErrorCode::Order);
}
