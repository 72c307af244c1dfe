//! Recorded sessions: a client that is the simulator's, speaking through messages, reaches what the simulator reaches.

use foresight_index::generate::city::{CityParams, city};
use foresight_index::world::World;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::session_replay::{SessionReplayError, Simulation, judge, replay_recording};
use foresight_traces::client::{ClientSettings, Pipeline};
use foresight_traces::flight::{Flight, tick_time};
use foresight_traces::link::LinkTrace;
use foresight_traces::link::shared::SharedLink;
use foresight_traces::path::turn::turn;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{
    Camera, ClientMessage, Event, Hello, Mode, Progress, Refinement, ServerMessage, VERSION, Views,
};
use foresight_wire::recording::{Entry, Header, Input, Writer};
use foresight_wire::session::{Session, SessionLimits, SessionWorld};
use glam::DVec3;
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

fn small_city() -> World {
    city(&CityParams { blocks_x: 6, blocks_y: 6, seed: 3, ..CityParams::default() }).expect("a small city")
}

fn flight(seconds: f64) -> Flight {
    let path = turn(30.0, seconds).expect("a made path");
    Flight::sample(seconds, |t| {
        let (position, orientation) = path.at(t);
        View { position: position + DVec3::new(-200.0, 5.0, 20.0), orientation, fov_y: 1.0, viewport: [1280, 720] }
    })
}

fn link() -> LinkTrace {
    LinkTrace::constant("constant", 8_000_000, Time(40_000_000)).expect("a link")
}

fn hello(memory_bytes: u64, policy: &str) -> Hello {
    Hello {
        version: VERSION,
        world: "city".to_owned(),
        memory_bytes,
        refinement: Refinement::Partial,
        policy: Some(policy.to_owned()),
        mode: Mode::Drive,
        resume: None,
        resident: Vec::new(),
        client: None,
        link: None,
    }
}

/// The simulator's client on the simulator's link, at its ticks, with `late` added to every time that it says; its
/// recording.
fn record(world: &World, flight: &Flight, link: &LinkTrace, hello: &Hello, late: u64) -> Vec<u8> {
    let tree = &world.tree;
    let identity = world.hash().to_hex().to_string();
    let uri = |rep: RepId| world.uri(rep).into_owned();
    let of = SessionWorld { name: "city", identity: &identity, base: "/worlds/city/", tree, uri: &uri, up: world.up };
    let limits = SessionLimits::default();
    let (mut session, opened) = Session::open("1".to_owned(), of, &limits, hello).expect("a session");
    let mut writer = Writer::new(Vec::new(), &Header::new("1", &of, &limits, hello)).expect("memory");
    writer.push(&Entry::new(0, Input::Open, &opened, &session)).expect("memory");
    let (mut shared, mut pipeline) = (SharedLink::new(link, Time::ZERO), Pipeline::new(ClientSettings::default()));
    let mut transfers: Vec<(u64, RepId)> = Vec::new();
    let mut joining: BTreeMap<(Time, u64), RepId> = BTreeMap::new();
    let mut held = BTreeSet::new();
    let mut next_id = 0;
    for (tick, view) in flight.views.iter().enumerate() {
        let now = tick_time(tick as u64);
        let said = |at: Time| at.0 + late;
        let mut frame = Vec::new();
        let mut arrivals = Vec::new();
        shared.advance(now, &mut arrivals);
        arrivals.push((u64::MAX, now));
        for (id, at) in arrivals {
            while let Some(first) = joining.first_entry().filter(|first| first.key().0 <= at) {
                let ((joins, id), rep) = first.remove_entry();
                if transfers.iter().any(|t| t.0 == id) {
                    frame.push(ClientMessage::Responded(Event { t_ns: said(joins), rep: rep.0 }));
                }
            }
            let Some(place) = transfers.iter().position(|t| t.0 == id) else { continue };
            let (_, rep) = transfers.remove(place);
            frame.push(ClientMessage::Arrived(Event { t_ns: said(at), rep: rep.0 }));
            pipeline.arrived(rep, tree.decoded_bytes(rep), at);
        }
        let ready = |rep: RepId| tree.prerequisite(rep).is_none_or(|p| held.contains(&p));
        let mut shown = Vec::new();
        pipeline.upload(now, ready, |rep| shown.push(rep));
        for rep in shown {
            held.insert(rep);
            frame.push(ClientMessage::Completed(Event { t_ns: said(now), rep: rep.0 }));
        }
        let in_flight_bytes = transfers.iter().map(|t| shared.delivered(t.0)).sum();
        let total_bytes = shared.total_delivered();
        frame.push(ClientMessage::Progress(Progress { t_ns: said(now), total_bytes, in_flight_bytes }));
        let camera = Camera {
            position: view.position.to_array(),
            orientation: view.orientation.to_array(),
            fov_y: view.fov_y,
            viewport: view.viewport,
            weight: 1.0,
        };
        frame.push(ClientMessage::View(Views { t_ns: said(now), cameras: vec![camera] }));
        // As a socket carries it.
        let frame: Vec<ClientMessage> = Encoding::Json.read(&Encoding::Json.write(&frame)).expect("what was written");
        let answers = session.frame(now.0, &frame);
        writer
            .push(&Entry::new(now.0, Input::Frame { messages: Cow::Owned(frame) }, &answers, &session))
            .expect("memory");
        for answer in &answers {
            match answer {
                ServerMessage::Fetch(fetch) => {
                    let rep = RepId(fetch.rep);
                    shared.start(next_id, tree.wire_bytes(rep), now);
                    transfers.push((next_id, rep));
                    joining.insert((now + link.rtt_at(now), next_id), rep);
                    next_id += 1;
                }
                ServerMessage::Cancel { rep } => {
                    if let Some(place) = transfers.iter().position(|t| t.1.0 == *rep) {
                        shared.cancel(transfers.remove(place).0, now);
                    }
                }
                ServerMessage::Error(error) => panic!("{error:?}"),
                _ => {}
            }
        }
    }
    writer.into_inner()
}

#[test]
fn the_simulators_client_over_messages_sees_what_the_simulator_sees() {
    let (world, flight, link) = (small_city(), flight(15.0), link());
    for (policy, memory) in [("foresight", 4 << 20), ("foresight", 64 << 20), ("3d-tiles-renderer", 16 << 20)] {
        for late in [0, 25_000_000] {
            let recording = record(&world, &flight, &link, &hello(memory, policy), late);
            let recorded = replay_recording("recording", &world, &recording[..]).expect("a recording");
            let simulation =
                Simulation { link: &link, link_name: "constant", flight: None, client: ClientSettings::default() };
            let outcome = judge("recording", &world.tree, &recorded, &CutSettings::default(), Some(&simulation))
                .expect("a session that can be judged");
            let agreement = &outcome.agreement;
            assert!(agreement.is_complete(), "{:?}", agreement.first_difference);
            assert!(agreement.decisions > 50 && agreement.decisions == agreement.decisions_equal, "{agreement:?}");
            let simulated = outcome.simulated.expect("as asked for");
            let live = outcome.live.expect("there are views");
            assert_eq!(live.mean_deficit, simulated.outcome.mean_deficit, "{policy} {memory} {late}");
            assert_eq!(simulated.relative_difference, Some(0.0));
            assert_eq!(
                (live.evictions, live.bytes_fetched),
                (simulated.outcome.evictions, simulated.outcome.bytes_fetched)
            );
            assert_eq!(live.bytes_wasted, simulated.outcome.bytes_wasted);
            let differences = simulated.differences;
            for shift in [&differences.requests, &differences.completions] {
                assert!(shift.matched > 0 && shift.live_only + shift.simulated_only == 0, "{shift:?}");
                // Times that are said with 25 ms more count from the first view, which is as late.
                assert_eq!(shift.p99_amount_ms, Some(0.0), "{shift:?}");
            }
        }
    }
}

#[test]
fn a_changed_answer_is_found_and_another_world_is_refused() {
    let (world, flight, link) = (small_city(), flight(2.0), link());
    let recording = record(&world, &flight, &link, &hello(16 << 20, "foresight"), 0);
    let text = String::from_utf8(recording).expect("JSON");
    let (line, fetching) =
        text.lines().enumerate().find(|(_, line)| line.contains("\"type\":\"fetch\",\"rep\":")).expect("a fetch");
    let changed = fetching.replacen("\"urgency\":0", "\"urgency\":6", 1);
    let text = text.replacen(fetching, &changed, 1);
    let recorded = replay_recording("recording", &world, text.as_bytes()).expect("a recording");
    let outcome = judge("recording", &world.tree, &recorded, &CutSettings::default(), None).expect("views");
    let agreement = outcome.agreement;
    assert_eq!(agreement.decisions_equal + 1, agreement.decisions);
    assert_eq!(agreement.first_difference.expect("one").line, line as u64 + 1);

    let other = city(&CityParams { blocks_x: 2, blocks_y: 2, ..CityParams::default() }).expect("a city");
    let error = replay_recording("recording", &other, text.as_bytes()).map(drop).expect_err("another world");
    assert!(matches!(error, SessionReplayError::World { .. }), "{error}");
    let error = replay_recording("recording", &world, &b"{}"[..]).map(drop).expect_err("no recording");
    assert!(error.to_string().contains("recording, line 1: "), "{error}");
}
