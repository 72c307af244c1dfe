use crate::session::{Dice, Session, random_tree, rep, turned, two_levels, view_at};
use foresight_scheduler::lod_tree::{LodTree, LodTreeBuilder, Representation};
use foresight_scheduler::policy::lookahead::{Lookahead, LookaheadSettings};
use proptest::prelude::*;

const AMPLE: u64 = 1 << 40;

fn session<'a>(tree: &'a LodTree, budget: u64, max_requests: usize, rate: u64) -> Session<'a> {
    let settings = LookaheadSettings { max_requests, ..Default::default() };
    Session::new(tree, budget, Box::new(Lookahead::new(tree, settings)), rate)
}

#[test]
fn the_cover_comes_first_then_the_union_by_distance_in_all_directions() {
    let leaves = [([0.0, 0.0, -50.0], 1, 0.1), ([0.0, 0.0, 30.0], 1, 0.1), ([0.0, 0.0, -40.0], 1, 0.1)];
    let tree = two_levels(Some(rep(1, 10.0)), &leaves);
    let mut s = session(&tree, AMPLE, 9, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 2, 3, 1]);
}

#[test]
fn requests_are_limited_and_continue_in_order() {
    let leaves: Vec<_> = (0..200).map(|i| ([0.0, 0.0, -50.0 - 3.0 * f64::from(i)], 1, 0.0)).collect();
    let tree = two_levels(None, &leaves);
    // One representation per tick.
    let mut s = session(&tree, AMPLE, 4, 1000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    let mut order = s.fetched();
    assert_eq!(order.len(), 4);
    for _ in 0..196 {
        s.tick(&view);
        order.extend(s.fetched());
    }
    assert_eq!(order, (0..200).collect::<Vec<_>>());
}

#[test]
fn positions_around_the_viewer_need_more_than_its_own() {
    // At 33 m from the box, 500·1/33 = 15.2 px: the coarse level is enough for the viewer. The look-ahead positions
    // are 2 m away, the box's side; 2 m nearer, 500·1/31 = 16.1 px ask for the fine one.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    let coarse = b.add(rep(1, 1.0)).unwrap();
    b.add(Representation { prerequisite: Some(coarse), ..rep(1, 0.1) }).unwrap();
    b.close(Some(crate::session::cube([0.0, 0.0, -34.0], 1.0)), 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = session(&tree, AMPLE, 4, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 1]);
    // 10 m further off nobody asks for it.
    let mut s = session(&tree, AMPLE, 4, 1);
    s.tick(&view_at(0.0, 0.0, 10.0));
    assert_eq!(s.fetched(), [0]);
}

#[test]
fn the_queue_is_made_anew_after_a_tenth_of_the_smallest_cell() {
    // Side 2 m: 0.2 m. The leaf is wanted at 16 px or more of its parent's error: nearer than 500·2/16 = 62.5 m.
    let tree = two_levels(Some(rep(1, 2.0)), &[([0.0, 0.0, -70.0], 1, 0.0)]);
    let mut s = session(&tree, AMPLE, 4, 1_000_000);
    // 69 m from here to the box: look-ahead reaches to 67 m.
    s.ticks(4, &view_at(0.0, 0.0, 0.0));
    assert!(s.resident(0) && !s.resident(1));
    // 64.6 m, and 62.6 m for the nearest look-ahead position; then 0.19 m nearer, which is not looked at.
    s.tick(&view_at(0.0, 0.0, -4.4));
    assert_eq!(s.fetched(), [] as [u32; 0]);
    s.tick(&view_at(0.0, 0.0, -4.59));
    assert_eq!(s.fetched(), [] as [u32; 0]);
    s.tick(&view_at(0.0, 0.0, -4.61));
    assert_eq!(s.fetched(), [1]);
}

#[test]
fn what_left_the_union_first_goes_first_and_nothing_goes_for_more_than_fits() {
    // Three objects 200 m apart, each with a coarse level that suffices from 62.5 m and a fine one.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for x in [0.0, 200.0, 400.0] {
        b.open().unwrap();
        b.add(rep(1, 2.0)).unwrap();
        b.add(rep(20, 0.0)).unwrap();
        b.close(Some(crate::session::cube([x, 0.0, -20.0], 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    // Three coarse ones and two fine ones are 43 kB; a third fine one asks for 40 kB more.
    let mut s = session(&tree, 70_000, 4, 1_000_000);
    let mut gone = Vec::new();
    for x in [0.0, 200.0, 400.0] {
        for _ in 0..6 {
            s.tick(&view_at(x, 0.0, 0.0));
            gone.extend(s.discarded());
        }
    }
    assert_eq!(gone[..1], [1]);
    assert!(s.resident(5));
    // A budget that one fine level fills: everything that is left is needed, or makes room.
    let mut s = session(&tree, 30_000, 4, 1_000_000);
    s.ticks(30, &view_at(0.0, 0.0, 0.0));
    assert!(s.resident(0) && s.resident(2) && s.resident(4) && !s.resident(1));
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.actions, []);
}

#[test]
fn of_many_directions_each_position_takes_the_three_that_face_it() {
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for code in (0..27).filter(|&c| c != 13) {
        b.add(Representation { direction: Some(code), ..rep(1, 0.1) }).unwrap();
    }
    b.close(Some(crate::session::cube([1.0, 2.0, -300.0], 1.0)), 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = session(&tree, AMPLE, 26, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    // The cover is (0,0,1), code 14. The viewer sees the object along (1,2,−300): next come (0,−1,1), code 11, and
    // (−1,0,1), 5. From 2 m further right, along (−1,2,−300), (1,0,1), code 23, is third; from 2 m further up, along
    // (1,0,−300), code 5 is second and (0,1,1), code 17, as good as 11: the lower goes. From code 14 on, the id is one less.
    assert_eq!(s.fetched(), [13, 5, 11, 22]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_tree_and_budget_are_survived(seed: u64, depth in 0u32..6, budget in 0u64..2_000_000, rate in 1u64..200_000) {
        let tree = random_tree(seed, depth);
        let mut s = session(&tree, budget, 4, rate).with_failures(seed);
        let mut dice = Dice(seed | 1);
        for _ in 0..30 {
            let at = view_at(dice.below(120) as f64 - 60.0, dice.below(60) as f64 - 30.0, -(dice.below(120) as f64));
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
