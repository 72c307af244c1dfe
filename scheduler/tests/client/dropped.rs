//! What the client lets go by itself.

use super::*;
use foresight_scheduler::scheduler::SchedulerError;
use std::collections::VecDeque;

/// Does what is written down.
struct Script(VecDeque<Action>);

impl Policy for Script {
    fn name(&self) -> &str {
        "script"
    }

    fn observe(&mut self, _state: &foresight_scheduler::state::ClientState, _view: &View, _now: Time) {}

    fn decide(&mut self, _state: &foresight_scheduler::state::ClientState, now: Time) -> Action {
        self.0.pop_front().unwrap_or(Action::WaitUntil(now + TICK))
    }
}

fn fetch(rep: u32, doomed: &[u32]) -> Action {
    Action::Fetch { rep: RepId(rep), discard_on_arrival: doomed.iter().map(|&d| RepId(d)).collect() }
}

/// Three representations of 100, 200 and 400 bytes, wire and decoded.
fn three() -> LodTree {
    leaves(&[DVec3::new(0.0, 0.0, -10.0)], &[(100, 4.0), (200, 2.0), (400, 1.0)])
}

/// Memory in each state: in flight 2·bytes, with what it hands over taken off; arrived 2·bytes; resident bytes.
#[test]
fn memory_is_freed_wherever_it_was_held() {
    let tree = three();
    let script = Script([fetch(0, &[]), fetch(1, &[]), fetch(2, &[0, 1])].into());
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(10_000), Box::new(script));
    let now = Time::ZERO;
    for rep in [RepId(0), RepId(1)] {
        assert_eq!(scheduler.next(now).unwrap(), fetch(rep.0, &[]));
        scheduler.arrived(rep, now).unwrap();
        scheduler.completed(rep, now).unwrap();
    }
    scheduler.next(now).unwrap();
    let used = |s: &Scheduler| s.state().used_bytes();
    // 100 and 200 resident; 400 on the wire, and decoded 400 less the 300 handed over.
    assert_eq!(used(&scheduler), 300 + 400 + 100);
    // A doomed one goes before its time: its 100 bytes are free, and 100 more have to be reserved.
    scheduler.dropped(RepId(0), now).unwrap();
    assert_eq!(used(&scheduler), 200 + 400 + 200);
    assert_eq!(scheduler.state().status(RepId(0)), Status::Absent);
    assert_eq!(scheduler.state().requests()[0].discard_on_arrival, [RepId(1)]);
    assert_eq!(scheduler.arrived(RepId(2), now).unwrap(), [RepId(1)]);
    assert_eq!(used(&scheduler), 800);
    // Decoding is aborted.
    scheduler.dropped(RepId(2), now).unwrap();
    assert_eq!(used(&scheduler), 0);
    assert!(
        scheduler.state().resident().iter().next().is_none() && scheduler.state().planned().iter().next().is_none()
    );
    for (event, rep) in [("dropped", 0), ("dropped", 2)] {
        let refused = scheduler.dropped(RepId(rep), now);
        assert_eq!(refused, Err(SchedulerError::Unexpected { rep, event, status: Status::Absent }));
    }
    assert!(matches!(scheduler.dropped(RepId(3), now), Err(SchedulerError::NoSuchRepresentation { .. })));
}

/// A request that is aborted spares what it had doomed.
#[test]
fn an_aborted_request_spares_what_it_had_doomed() {
    let tree = three();
    let script = Script([fetch(0, &[]), fetch(1, &[0])].into());
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(400), Box::new(script));
    scheduler.next(Time::ZERO).unwrap();
    scheduler.arrived(RepId(0), Time::ZERO).unwrap();
    scheduler.completed(RepId(0), Time::ZERO).unwrap();
    scheduler.next(Time::ZERO).unwrap();
    assert_eq!(scheduler.state().status(RepId(0)), Status::Doomed);
    scheduler.dropped(RepId(1), Time::ZERO).unwrap();
    let state = scheduler.state();
    assert_eq!((state.status(RepId(0)), state.used_bytes()), (Status::Resident, 100));
    assert!(state.planned().contains(RepId(0)) && !state.planned().contains(RepId(1)));
}

/// What failed is asked for again after a while; what was dropped, at the next decision.
#[test]
fn nothing_is_held_against_what_was_dropped() {
    let tree = leaves(&[DVec3::new(0.0, 0.0, -10.0)], &[(2000, 1.0), (50_000, 0.01)]);
    for sampled in [false, true] {
        let mut client = Client::new(
            &tree,
            1 << 20,
            foresight(|s| {
                if sampled {
                    s.choice = foresight_scheduler::policy::foresight::ChoiceMethod::Sampled;
                }
            }),
        );
        let see = |s: &mut Scheduler, now: Time| s.observe(&at(DVec3::ZERO), now).unwrap();
        client.ticks(60, see);
        assert_eq!((client.status(1), client.fetched()), (Status::Resident, vec![0, 1]));
        client.lets_go(RepId(1), false);
        client.ticks(1, see);
        assert_eq!(client.status(1), Status::InFlight);
        client.lets_go(RepId(1), false);
        client.ticks(1, see);
        assert_eq!(client.status(1), Status::InFlight, "an aborted request is repeated");
        // Everything goes, as when a graphics device is lost: the coarse one comes first again.
        client.lets_go(RepId(0), false);
        client.lets_go(RepId(1), false);
        assert_eq!(client.scheduler.state().used_bytes(), 0);
        client.log.clear();
        client.ticks(60, see);
        assert_eq!(client.fetched(), [0, 1]);
    }
}

/// What the client has by its own doing is not fetched, and not forgotten when memory is short.
#[test]
fn what_the_client_has_by_itself_counts_at_once() {
    let tree = leaves(&[DVec3::new(0.0, 0.0, -10.0), DVec3::new(2.0, 0.0, -15.0)], &[(100_000, 0.01)]);
    let mut client = Client::new(&tree, 400_000, foresight(|_| {}));
    let see = |s: &mut Scheduler, now: Time| s.observe(&at(DVec3::ZERO), now).unwrap();
    client.bytes_per_tick = 1;
    client.ticks(3, see);
    assert_eq!(client.fetched(), [0]);
    client.scheduler.preload(RepId(1)).unwrap();
    client.ticks(120, see);
    assert_eq!((client.fetched(), client.status(1)), (vec![0], Status::Resident));
    client.scheduler.set_budget(300_000);
    client.obey();
    assert_eq!((client.status(0), client.status(1)), (Status::InFlight, Status::Resident));
    client.scheduler.set_budget(299_999);
    client.obey();
    assert_eq!(client.scheduler.state().residents().count() + client.scheduler.state().requests().len(), 1);
}
