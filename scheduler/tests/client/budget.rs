//! Memory that grows and shrinks, with drops in between, under every policy.

use super::random_tree::Tape;
use super::*;
use foresight_scheduler::policy::foresight::{ChoiceMethod, Discards};
use foresight_scheduler::policy::{RIVALS, RivalSettings};
use proptest::prelude::*;

fn policy<'a>(which: usize, tree: &'a LodTree) -> (Refinement, Box<dyn Policy + 'a>) {
    let own = 4;
    match which % (own + RIVALS.len()) {
        0 => (Refinement::Partial, foresight(|_| {})),
        1 => (Refinement::Partial, foresight(|s| s.choice = ChoiceMethod::Sampled)),
        2 => (Refinement::Atomic, foresight(|_| {})),
        3 => (Refinement::Partial, foresight(|s| (s.alpha, s.discards) = (1.0, Discards::LeastRecentlyUsed))),
        rival => {
            let rival = &RIVALS[rival - own];
            let settings = RivalSettings { error_target_px: 16.0, parallel: rival.parallel };
            (Refinement::Partial, (rival.build)(tree, &settings))
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 256, ..ProptestConfig::default() })]

    /// Whenever the scheduler waits, what is in use fits, unless something is being decoded ([`Client::obey`]); when the
    /// client has let go of everything, nothing is in use.
    #[test]
    fn memory_follows_the_budget(which in 0usize..64, choices in prop::collection::vec(any::<u16>(), 0..400)) {
        let mut tape = Tape::new(choices);
        let tree = tape.tree(24);
        let all: u64 = (0..tree.representations() as u32).map(|r| tree.wire_bytes(RepId(r)) + tree.decoded_bytes(RepId(r))).sum();
        let some = |tape: &mut Tape| (all as f64 * 1.2 * tape.unit()) as u64;
        let (refinement, policy) = policy(which, &tree);
        let mut client = Client::with(&tree, some(&mut tape), refinement, policy);
        client.bytes_per_tick = 1 + all / 40;
        let mut view = tape.view();
        if tape.below(8) == 1 {
            // Memory shrinks before anything was seen.
            for rep in 0..tree.representations() as u32 {
                let _ = client.scheduler.preload(RepId(rep));
            }
            client.scheduler.set_budget(some(&mut tape));
            client.obey();
        }
        for _ in 0..12 {
            match tape.below(4) {
                0 => {}
                1 | 2 => client.scheduler.set_budget(some(&mut tape)),
                _ => {
                    let rep = RepId(tape.below(tree.representations()) as u32);
                    let dependents_first = tape.below(2) == 0;
                    client.lets_go(rep, dependents_first);
                }
            }
            if tape.below(3) == 1 {
                view = tape.view();
            }
            client.ticks(1 + tape.below(12), |s, now| s.observe(&view, now).unwrap());
        }
        client.scheduler.set_budget(0);
        client.obey();
        client.ticks(2, |s, now| s.observe(&view, now).unwrap());
        prop_assert_eq!(client.scheduler.state().used_bytes(), (0..tree.representations() as u32).map(RepId)
            .filter(|&r| client.scheduler.state().status(r) == Status::Resident).map(|r| tree.decoded_bytes(r)).sum::<u64>());
        for rep in 0..tree.representations() as u32 {
            client.lets_go(RepId(rep), true);
        }
        prop_assert_eq!(client.scheduler.state().used_bytes(), 0);
        prop_assert!(client.scheduler.state().planned().iter().next().is_none());
    }
}

/// Of three alike at 10, 20 and 40 m, the farthest go first; what has gone comes back when memory does.
#[test]
fn what_loses_least_goes_first() {
    let places = [10.0, 20.0, 40.0].map(|z| DVec3::new(0.1 * z, 0.0, -z));
    let tree = leaves(&places, &[(10_000, 0.05)]);
    for choice in [ChoiceMethod::Certified, ChoiceMethod::Sampled] {
        let mut client = Client::new(&tree, 1 << 20, foresight(|s| s.choice = choice));
        let see = |s: &mut Scheduler, now: Time| s.observe(&at(DVec3::ZERO), now).unwrap();
        client.ticks(60, see);
        for (budget, left) in [(25_000, vec![0, 1]), (10_000, vec![0]), (9_999, vec![])] {
            client.scheduler.set_budget(budget);
            client.obey();
            let resident: Vec<u32> = client.scheduler.state().residents().map(|r| r.0).collect();
            assert_eq!(resident, left, "{choice:?}, {budget} bytes");
        }
        client.scheduler.set_budget(1 << 20);
        client.ticks(60, see);
        assert_eq!(client.scheduler.state().residents().count(), 3);
    }
}

/// A request for what lies far away is given up before what is shown nearby; where nothing else would do, any is.
#[test]
fn requests_are_cancelled_where_that_loses_less() {
    let tree = leaves(&[DVec3::new(0.0, 0.0, -10.0), DVec3::new(20.0, 0.0, -80.0)], &[(100_000, 0.05)]);
    let mut client = Client::new(&tree, 1 << 20, foresight(|_| {}));
    let see = |s: &mut Scheduler, now: Time| s.observe(&at(DVec3::ZERO), now).unwrap();
    client.ticks(13, see);
    assert_eq!((client.status(0), client.status(1)), (Status::Resident, Status::InFlight));
    client.scheduler.set_budget(250_000);
    client.obey();
    assert_eq!((client.status(0), client.status(1)), (Status::Resident, Status::Absent));
    client.scheduler.set_budget(1 << 20);
    client.ticks(1, see);
    assert_eq!(client.status(1), Status::InFlight);
    client.scheduler.set_budget(0);
    client.obey();
    assert_eq!((client.status(0), client.status(1)), (Status::Absent, Status::Absent));
}
