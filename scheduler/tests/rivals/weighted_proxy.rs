use crate::session::{Dice, Session, cube, random_tree, rep, turned, two_levels, view_at};
use core::f64::consts::PI;
use foresight_scheduler::lod_tree::{LodTree, LodTreeBuilder, RepId};
use foresight_scheduler::policy::weighted_proxy::{WeightedProxy, WeightedProxySettings};
use proptest::prelude::*;

const AMPLE: u64 = 1 << 40;
const NOTHING: [u32; 0] = [];

fn session(tree: &LodTree, budget: u64, max_requests: usize, rate: u64) -> Session<'_> {
    let settings = WeightedProxySettings { max_requests, ..Default::default() };
    Session::new(tree, budget, Box::new(WeightedProxy::new(tree, settings)), rate)
}

#[test]
fn lowest_levels_in_view_come_first_and_those_around_when_they_have_come() {
    // Behind, 500 · √3 / d is 29.9 px at 29 m and 15.1 px at 57.5 m: only the first is of interest.
    let leaves = [30.0, 58.5, -10.0, -40.0].map(|z| ([0.0, 0.0, z], 1, 0.1));
    let tree = two_levels(None, &leaves);
    let mut s = session(&tree, AMPLE, 4, 1000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [2, 3]);
    s.tick(&view);
    assert_eq!(s.fetched(), NOTHING);
    s.tick(&view);
    assert_eq!(s.fetched(), [0]);
    s.ticks(5, &view);
    assert!(s.resident(0) && !s.resident(1));
}

#[test]
fn bytes_are_shared_by_nearness_and_number() {
    // Eight leaves at 8 to 16 m, eight at 32 to 64 m: weights 4 : 1 each. All cost 4 kB. Rounds until the nearer ring can
    // pay, at unit weight per stream: 500, 571, 667 with 8, 7, 6 streams left. The farther ring has then been credited
    // 8/4 · 500 + 8/4 · 571 + 8/4 · 667 = 3476 B and needs 262 rounds, the nearer one 800. And so on.
    let near = (0..8).map(|i| ([0.0, 0.0, -9.0 - 0.5 * f64::from(i)], 4, 0.0));
    let far = (0..8).map(|i| ([0.0, 0.0, -33.0 - f64::from(i)], 4, 0.0));
    let tree = two_levels(Some(rep(4, 10.0)), &near.chain(far).collect::<Vec<_>>());
    let mut s = session(&tree, AMPLE, 1, 4000);
    let view = view_at(0.0, 0.0, 0.0);
    let mut order = Vec::new();
    for _ in 0..8 {
        s.tick(&view);
        order.extend(s.fetched());
    }
    assert_eq!(order, [0, 1, 2, 3, 9, 4, 5, 10]);
}

#[test]
fn finer_levels_wait_for_a_lowest_level_in_flight() {
    // The second object's lowest level is large and on its way while the first one's finer level is wanted.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for (x, kilobytes) in [(-5.0, 1), (5.0, 5)] {
        b.open().unwrap();
        b.add(rep(kilobytes, 5.0)).unwrap();
        b.add(rep(2, 0.0)).unwrap();
        b.close(Some(cube([x, 0.0, -20.0], 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = session(&tree, AMPLE, 4, 1000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [0, 2]);
    for _ in 0..5 {
        s.tick(&view);
        assert_eq!(s.fetched(), NOTHING);
    }
    s.tick(&view);
    assert_eq!(s.fetched(), [1, 3]);
}

#[test]
fn refinement_ends_at_the_target() {
    // 500 · 1 / 31 = 16.1 px, 500 · 1 / 32 = 15.6 px.
    for (z, wanted) in [(-35.0, &[1][..]), (-36.0, &[])] {
        let tree = two_levels(Some(rep(1, 1.0)), &[([0.0, 0.0, z], 1, 0.1)]);
        let mut s = session(&tree, AMPLE, 4, 1_000_000);
        let view = view_at(0.0, 0.0, -3.0);
        s.tick(&view);
        assert_eq!(s.fetched(), [0]);
        s.tick(&view);
        assert_eq!(s.fetched(), wanted);
    }
}

#[test]
fn the_least_recently_used_makes_room_and_the_used_does_not() {
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    b.add(rep(1, 1000.0)).unwrap();
    for z in [-20.0, 20.0] {
        b.open().unwrap();
        b.add(rep(10, 0.0)).unwrap();
        b.close(Some(cube([0.0, 0.0, z], 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    // 1 + 10 kB there, 20 kB wanted.
    let mut s = session(&tree, 30_000, 4, 1_000_000);
    let ahead = view_at(0.0, 0.0, 0.0);
    s.ticks(6, &ahead);
    assert!(s.resident(0) && s.resident(1));
    s.tick(&turned(ahead, PI));
    assert_eq!((s.discarded(), s.fetched()), (vec![1], vec![2]));
    // With 20 kB neither fits beside the root.
    let mut s = session(&tree, 20_000, 4, 1_000_000);
    s.ticks(20, &ahead);
    assert!(s.resident(0));
    s.tick(&ahead);
    assert_eq!(s.actions, []);
}

#[test]
fn a_failed_request_is_made_again() {
    let tree = two_levels(Some(rep(10, 2.0)), &[([0.0, 0.0, -10.0], 10, 0.1)]);
    let mut s = session(&tree, AMPLE, 4, 1);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    s.scheduler.failed(RepId(0), s.now).unwrap();
    s.tick(&view);
    assert_eq!(s.fetched(), [0]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_tree_and_budget_are_survived(seed: u64, depth in 0u32..6, budget in 0u64..2_000_000, rate in 1u64..200_000) {
        let tree = random_tree(seed, depth);
        let policy = Box::new(WeightedProxy::new(&tree, WeightedProxySettings::default()));
        let open = if seed % 2 == 0 { Session::new } else { Session::atomic };
        let mut s = open(&tree, budget, policy, rate).with_failures(seed);
        let mut dice = Dice(seed | 1);
        for _ in 0..30 {
            let at = view_at(dice.below(120) as f64 - 60.0, dice.below(60) as f64 - 30.0, -(dice.below(120) as f64));
            s.ticks(1 + dice.below(12) as usize, &turned(at, dice.below(6) as f64));
        }
    }

    #[test]
    fn with_ample_memory_the_view_gets_sharp(seed: u64, depth in 0u32..6) {
        let tree = random_tree(seed, depth);
        let mut s = session(&tree, AMPLE, 4, 2_000_000);
        let view = view_at(5.0, 3.0, 10.0);
        s.ticks(5, &view_at(0.0, 0.0, -60.0));
        s.ticks(1500, &view);
        s.assert_sharp(&view, 16.0);
    }
}
