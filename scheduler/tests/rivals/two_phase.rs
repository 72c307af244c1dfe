use crate::session::{Dice, Session, cube, random_tree, rep, turned, two_levels, view_at};
use core::f64::consts::PI;
use foresight_scheduler::lod_tree::{LodTree, LodTreeBuilder, Representation};
use foresight_scheduler::policy::two_phase::{TwoPhase, TwoPhaseSettings};
use foresight_scheduler::units::Time;
use proptest::prelude::*;

const AMPLE: u64 = 1 << 40;
const NOTHING: [u32; 0] = [];

fn session(tree: &LodTree, budget: u64, max_requests: usize, rate: u64) -> Session<'_> {
    let settings = TwoPhaseSettings { max_requests, ..Default::default() };
    Session::new(tree, budget, Box::new(TwoPhase::new(tree, settings)), rate)
}

/// Cubes of 2 m with a coarse level that suffices from 500 · 1 / 16 = 31.25 m, and a fine one; 1 kB each.
fn objects(centres: &[[f64; 3]]) -> LodTree {
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for &centre in centres {
        b.open().unwrap();
        b.add(rep(1, 1.0)).unwrap();
        b.add(rep(1, 0.0)).unwrap();
        b.close(Some(cube(centre, 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    b.finish().unwrap()
}

#[test]
fn the_cover_then_what_is_in_view_then_all_around() {
    // Behind: at 170° and 180° from the direction of view, whatever the distance.
    let leaves = [
        ([0.0, 0.0, -50.0], 1, 0.1),
        ([0.0, 0.0, 20.0], 1, 0.1),
        ([0.0, 0.0, -40.0], 1, 0.1),
        ([10.0, 0.0, 57.0], 1, 0.1),
    ];
    let tree = two_levels(Some(rep(1, 10.0)), &leaves);
    let mut s = session(&tree, AMPLE, 9, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 3, 1, 4, 2]);
}

#[test]
fn farther_views_look_along_the_track_only() {
    // Views stand 2 m apart, the side of a cube. The first object is 35 m from V₁, 33 m from V₂ and 31 m from V₃, which
    // needs it fine. The second is 31.17 m from V₄ and 31.15 m from V₅, but at 86° and 90° from the direction of view;
    // from V₃, at 83°, it is 31.29 m away.
    let tree = objects(&[[0.0, 0.0, -36.0], [32.15, 0.0, -8.0]]);
    let mut s = session(&tree, AMPLE, 9, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 2, 1]);
    // 31.195 m from V₃.
    let tree = objects(&[[0.0, 0.0, -36.0], [32.05, 0.0, -8.0]]);
    let mut s = session(&tree, AMPLE, 9, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 2, 1, 3]);
}

#[test]
fn the_next_segment_begins_where_the_second_view_stands() {
    // V₅ is 33 m from the object, and 31 m once V₁ is 2 m further on.
    let tree = objects(&[[0.0, 0.0, -42.0]]);
    let mut s = session(&tree, AMPLE, 4, 1_000_000);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0]);
    s.tick(&view_at(0.0, 0.0, -1.9));
    assert_eq!(s.fetched(), NOTHING);
    s.tick(&view_at(0.0, 0.0, -2.0));
    assert_eq!(s.fetched(), [1]);
}

#[test]
fn the_track_is_the_announced_path_or_the_direction_of_movement() {
    // 33 m to the right; V₂ is 2 m nearer if the track goes there.
    let tree = objects(&[[34.0, 0.0, 0.0]]);
    let view = view_at(0.0, 0.0, 0.0);
    let mut s = session(&tree, AMPLE, 4, 1_000_000);
    s.tick(&view);
    assert_eq!(s.fetched(), [0]);
    let mut s = session(&tree, AMPLE, 4, 1_000_000);
    let path = [0.0, 0.5, 30.0].map(|x| (Time::from_secs(x), view_at(x, 0.0, 0.0)));
    s.scheduler.announce_path(&path).unwrap();
    s.tick(&view);
    assert_eq!(s.fetched(), [0, 1]);
    // Having moved there from 2 m to the left.
    let mut s = session(&tree, AMPLE, 4, 1_000_000);
    s.tick(&view_at(-2.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0]);
    s.tick(&view);
    assert_eq!(s.fetched(), [1]);
}

#[test]
fn turning_changes_what_is_in_view_and_keeps_the_track() {
    // One at a time. Behind, the nearer is the later by angle; turned round, it is the first in view.
    let leaves = [([0.0, 0.0, -50.0], 1, 0.1), ([8.0, 0.0, 50.0], 1, 0.1), ([0.0, 0.0, 30.0], 1, 0.1)];
    let tree = two_levels(None, &leaves);
    let mut s = session(&tree, AMPLE, 1, 1000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [0]);
    s.tick(&turned(view, PI));
    assert_eq!(s.fetched(), [2]);
}

#[test]
fn what_is_in_no_set_goes_least_recently_in_one_first() {
    // 400 m apart, 19 m away: fine where the viewer is, coarse from elsewhere. 2 kB each while on its way.
    let tree = objects(&[[0.0, 0.0, -20.0], [400.0, 0.0, -20.0], [800.0, 0.0, -20.0]]);
    // Three coarse ones, two fine ones: 5 kB. The third fine one asks for two.
    let mut s = session(&tree, 6_500, 4, 1_000_000);
    let mut gone = Vec::new();
    for x in [0.0, 400.0, 800.0] {
        for _ in 0..8 {
            s.tick(&view_at(x, 0.0, 0.0));
            gone.extend(s.discarded());
        }
    }
    assert_eq!(gone, [1]);
    assert_eq!([1, 3, 5].map(|r| s.resident(r)), [false, true, true]);
}

#[test]
fn the_queue_ends_where_memory_does() {
    // 1 kB on the wire and 10 kB in memory each, memory for two: what is in view. Turned round, the third comes first,
    // and of the two behind, at the same angle, the first in the tree.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for z in [-50.0, 30.0, -40.0] {
        b.open().unwrap();
        b.add(Representation { decoded_bytes: 10_000, ..rep(1, 0.1) }).unwrap();
        b.close(Some(cube([0.0, 0.0, z], 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = session(&tree, 25_000, 4, 1_000_000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [2, 0]);
    s.ticks(5, &view);
    s.tick(&turned(view, PI));
    assert_eq!((s.discarded(), s.fetched()), (vec![2], vec![1]));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_tree_and_budget_are_survived(seed: u64, depth in 0u32..6, budget in 0u64..2_000_000, rate in 1u64..200_000) {
        let tree = random_tree(seed, depth);
        let policy = Box::new(TwoPhase::new(&tree, TwoPhaseSettings::default()));
        let open = if seed % 2 == 0 { Session::new } else { Session::atomic };
        let mut s = open(&tree, budget, policy, rate).with_failures(seed);
        let mut dice = Dice(seed | 1);
        let place = |dice: &mut Dice| view_at(dice.below(120) as f64 - 60.0, 0.0, -(dice.below(120) as f64));
        if seed % 3 == 0 {
            let path: Vec<_> = (0..20).map(|i| (Time(i * 100_000_000), place(&mut dice))).collect();
            s.scheduler.announce_path(&path).unwrap();
        }
        for _ in 0..30 {
            let at = place(&mut dice);
            s.ticks(1 + dice.below(12) as usize, &turned(at, dice.below(6) as f64));
        }
    }

    #[test]
    fn with_ample_memory_every_view_gets_sharp(seed: u64, depth in 0u32..6) {
        let tree = random_tree(seed, depth);
        let mut s = session(&tree, AMPLE, 4, 2_000_000);
        let view = view_at(5.0, 3.0, 10.0);
        s.ticks(5, &view_at(0.0, 0.0, -60.0));
        s.ticks(1500, &view);
        s.assert_sharp(&view, 16.0);
        s.assert_sharp(&turned(view, 2.0), 16.0);
    }
}
