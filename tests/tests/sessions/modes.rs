//! What a client can ask of a session beyond orders for one camera: several cameras, a path that is announced, a cache that
//! is warmed, the binary encoding of a whole flight.

use std::collections::BTreeSet;
use std::time::Duration;

use crate::WORLD;
use foresight_index::world::World;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_tests::sidecar::case::Case;
use foresight_tests::sidecar::client::{Client, Received, hello};
use foresight_tests::sidecar::process::Server;
use foresight_wire::encoding::Encoding;
use foresight_wire::message::{Camera, ClientMessage, Event, Hello, Mode, Path, ServerMessage, Views, Waypoint};
use glam::DVec3;

/// Trusts the prediction alone: what the cameras do not come to see is worth nothing.
const TRUSTING: &str = "added-benefit";
/// The same, and believes what the client announces.
const LISTENING: &str = "added-benefit:predictor=known-path";
/// Of views, ns.
const STEP_NS: u64 = 50_000_000;
const STEPS: u64 = 30;

fn world() -> World {
    foresight_index::specification::open("city:blocks=4", &(std::sync::Arc::new(|_, _| {}) as _)).expect("a world")
}

/// From a street corner near the middle, along x or against it; z is up.
fn camera(tree: &LodTree, along: f64, weight: f64) -> Camera {
    let centre = tree.bounds(foresight_scheduler::lod_tree::NodeId(0)).centre();
    // Turns −z into ±x with y up turned into z.
    let orientation = if along > 0.0 { [0.5, -0.5, -0.5, 0.5] } else { [0.5, 0.5, 0.5, 0.5] };
    Camera { position: [centre.x, centre.y, 2.0], orientation, fov_y: 1.0, viewport: [800, 600], weight }
}

/// Which of the representations lie wholly before and behind a camera that looks along `along` of the x axis.
fn sides(tree: &LodTree, reps: &BTreeSet<u32>, camera: &Camera, along: f64) -> (usize, usize) {
    let eye = DVec3::from_array(camera.position);
    let (mut before, mut behind) = (0, 0);
    for &rep in reps {
        let bounds = tree.bounds(tree.node_of(RepId(rep)));
        let ends = [(bounds.min.x - eye.x) * along, (bounds.max.x - eye.x) * along];
        before += usize::from(ends[0].min(ends[1]) > 0.0);
        behind += usize::from(ends[0].max(ends[1]) < 0.0);
    }
    (before, behind)
}

/// What a standing client with these cameras is told to fetch within 1.5 s, everything coming at once.
fn told(server: &Server, policy: &str, cameras: &[Camera], path: Option<Path>) -> BTreeSet<u32> {
    let mut client = Client::connect(server.port(), Encoding::Json);
    client.greet(Hello { policy: Some(policy.to_owned()), ..hello("w") });
    client.socket.get_ref().set_read_timeout(Some(Duration::from_millis(20))).expect("a timeout can be set");
    let mut reps = BTreeSet::new();
    let mut happened: Vec<ClientMessage> = path.map(ClientMessage::Path).into_iter().collect();
    for step in 1..=STEPS {
        let t_ns = step * STEP_NS;
        happened.push(ClientMessage::View(Views { t_ns, cameras: cameras.to_vec() }));
        assert!(client.send(&happened), "the frame is sent");
        happened.clear();
        loop {
            match client.read() {
                Received::Nothing => break,
                Received::Messages(messages) => {
                    for message in messages {
                        let ServerMessage::Fetch(fetch) = message else { continue };
                        assert!(reps.insert(fetch.rep), "{} is fetched twice", fetch.rep);
                        let event = Event { t_ns, rep: fetch.rep };
                        happened.push(ClientMessage::Responded(event));
                        happened.push(ClientMessage::Arrived(event));
                        happened.push(ClientMessage::Completed(event));
                    }
                }
                other => panic!("expected an answer, not {other:?}"),
            }
        }
    }
    reps
}

#[test]
fn every_camera_of_several_is_served() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &WORLD);
    let world = world();
    let tree = &world.tree;
    let (ahead, back) = (camera(tree, 1.0, 1.0), camera(tree, -1.0, 1.0));
    let one = told(&server, TRUSTING, &[ahead], None);
    let two = told(&server, TRUSTING, &[ahead, back], None);
    let (of_one, of_two) = (sides(tree, &one, &ahead, 1.0), sides(tree, &two, &ahead, 1.0));
    println!("before and behind: one camera {of_one:?}, two {of_two:?}");
    assert!(of_one.0 > 0 && of_one.1 == 0, "{of_one:?}");
    assert!(of_two.0 > 0 && of_two.1 > 0, "{of_two:?}");
}

#[test]
fn what_an_announced_path_comes_to_see_is_fetched_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &WORLD);
    let world = world();
    let tree = &world.tree;
    let (ahead, back) = (camera(tree, 1.0, 1.0), camera(tree, -1.0, 1.0));
    let waypoint = |t_ns, camera| Waypoint { t_ns, camera };
    // Turns round two seconds after the flight's 1.5 s.
    let turns = [waypoint(0, ahead), waypoint(3_400_000_000, ahead), waypoint(3_500_000_000, back)];
    let path = Path { views: turns.into_iter().chain([waypoint(60_000_000_000, back)]).collect() };
    let unannounced = told(&server, LISTENING, &[ahead], None);
    let announced = told(&server, LISTENING, &[ahead], Some(path));
    let (without, with) = (sides(tree, &unannounced, &ahead, 1.0), sides(tree, &announced, &ahead, 1.0));
    println!("before and behind: unannounced {without:?}, announced {with:?}");
    assert!(without.1 == 0 && with.1 > 0, "{without:?} {with:?}");
}

#[test]
fn a_warmed_client_is_not_told_what_it_has_got_by_itself() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = Server::start(folder.path(), &WORLD);
    let warm = || Hello { mode: Mode::Warm, ..hello("w") };
    let mut first = Client::connect(server.port(), Encoding::Json);
    first.greet(warm());
    let mut suggested = Vec::new();
    for _ in 0..6 {
        let rep = first.fetch();
        assert!(first.complete(rep));
        suggested.push(rep);
    }
    // A second client has the fourth of these by its own rules before anything is said.
    let own = suggested[3];
    let mut second = Client::connect(server.port(), Encoding::Json);
    second.greet(warm());
    assert!(second.send(&[ClientMessage::Arrived(Event { t_ns: 0, rep: own })]));
    for _ in 0..8 {
        let rep = second.fetch();
        assert_ne!(rep, own, "it is there already");
        assert!(second.complete(rep));
    }
}

#[test]
fn a_whole_flight_in_the_binary_encoding_announced_and_warmed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let line = "--world city:blocks=12 --path steady:speed=10,duration=4 --link constant:8Mbit,40ms --memory 32MiB";
    let case = Case::open(line, None);
    for (name, options) in [
        ("announced", &["--encoding", "messagepack", "--announce", "2"][..]),
        ("warmed", &["--encoding", "messagepack", "--mode", "warm"]),
    ] {
        let recordings = folder.join(name);
        let record = recordings.display().to_string();
        let server = Server::start(folder, &["--world", case.world(), "--link", case.link(), "--record", &record]);
        let live = case.fly(folder, &server, &format!("{name}.jsonl"), options);
        let (code, log) = server.stop();
        assert_eq!(code, Some(0), "{log}");
        assert!(live.flown.requested_while_resident().is_empty());
        let (fetched, errors) = (live.flown.count("completed"), &live.summary["errors"]);
        println!("{name}: {fetched} fetched, mean deficit {:.4}", live.deficit());
        assert!(fetched > 0 && errors.as_array().is_some_and(Vec::is_empty), "{errors}");
        let replayed = case.replay_recording(&recordings);
        let agreement = &replayed["agreement"];
        let of = |key: &str| agreement[key].as_u64().unwrap_or_else(|| panic!("{key} in {agreement}"));
        assert!(of("decisions") > 0 && of("decisions") == of("decisions_equal"), "{agreement}");
    }
}
