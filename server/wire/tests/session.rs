//! Sessions driven by clients of a few lines.

mod client;

use client::{Client, hello, small_city, tree_world, view_at};
use foresight_scheduler::lod_tree::RepId;
use foresight_wire::message::ServerMessage;
use foresight_wire::session::{Session, SessionLimits};

const TICK_NS: u64 = 16_666_667;

#[test]
fn a_client_that_obeys_sees_the_city_and_stays_within_its_memory() {
    let city = small_city();
    let uri = |rep: RepId| city.uri(rep).into_owned();
    let world = tree_world(&city, &uri);
    let budget = 4 << 20;
    let (mut session, opened) =
        Session::open("s".to_owned(), world, &SessionLimits::default(), &hello(budget)).expect("a session");
    let ServerMessage::Welcome(welcome) = &opened[0] else { panic!("{opened:?}") };
    assert_eq!((welcome.representations, welcome.resumed), (city.tree.representations() as u64, false));
    let mut client = Client::new(400_000.0);
    let mut last = None;
    for tick in 0..600u64 {
        let now = tick * TICK_NS;
        let mut frame = client.events(&city.tree, now);
        frame.push(view_at(now, tick as f64 * 0.2));
        let answers = session.frame(now, &frame);
        client.obey(&answers, now);
        for answer in &answers {
            match answer {
                ServerMessage::Error(error) => panic!("{error:?}"),
                ServerMessage::Estimates(estimates) => last = estimates.quality,
                _ => {}
            }
        }
        assert!(session.state().used_bytes() <= budget);
        assert!(client.held_bytes(&city.tree) <= budget, "at {now}");
    }
    assert!(last.is_some_and(|quality| quality > 0.5), "{last:?}");
    assert!(session.heap_bytes() < 1 << 20, "{}", session.heap_bytes());
    assert!((session.link().rate / 400_000.0 - 1.0).abs() < 0.3, "{:?}", session.link());
}
