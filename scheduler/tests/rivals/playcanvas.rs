use crate::session::{Dice, Session, cube, random_tree, rep, turned, two_levels, view_at};
use core::f64::consts::PI;
use foresight_scheduler::lod_tree::{LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::policy::playcanvas::{PlayCanvas, PlayCanvasSettings};
use proptest::prelude::*;

const AMPLE: u64 = 1 << 40;
const NOTHING: [u32; 0] = [];

fn session(tree: &LodTree, budget: u64, rate: u64) -> Session<'_> {
    Session::new(tree, budget, Box::new(PlayCanvas::new(tree, PlayCanvasSettings::default())), rate)
}

#[test]
fn the_nearer_of_equals_are_chosen_and_asked_for_in_the_tree_s_order() {
    // Each leaf's part of the root is 3 kB / 3: a step adds 3 kB. Half of 18 kB is the root and two steps.
    let leaves = [-50.0, -20.0, -10.0].map(|z| ([0.0, 0.0, z], 4, 0.0));
    let tree = two_levels(Some(rep(3, 10.0)), &leaves);
    let mut s = session(&tree, 18_000, 1_000_000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [0]);
    for _ in 0..9 {
        s.tick(&view);
        assert_eq!(s.fetched(), NOTHING);
    }
    // The next balance is due ten frames later.
    s.tick(&view);
    assert_eq!(s.fetched(), [2]);
    s.ticks(30, &view);
    assert_eq!([0, 1, 2, 3].map(|r| s.resident(r)), [true, false, true, true]);
}

#[test]
fn error_removed_weighs_against_coverage() {
    // Coverage at 9 and 24 m, tan 45° / tan 22.5° = 2.414: (1.732 / (1.732 + 21.73))² = 5.45e-3, (1.732 / 59.67)² =
    // 8.42e-4. Errors removed: 1 and 10 m. 5.45e-3 < 8.42e-3, so the farther is worth more.
    let leaves = [([0.0, 0.0, -10.0], 4, 9.0), ([0.0, 0.0, -25.0], 4, 0.0)];
    let tree = two_levels(Some(rep(2, 10.0)), &leaves);
    let mut s = session(&tree, 11_000, 1_000_000);
    s.ticks(40, &view_at(0.0, 0.0, 0.0));
    assert_eq!([0, 1, 2].map(|r| s.resident(r)), [true, false, true]);
    // With 2 m the nearer one is worth 1.09e-2.
    let leaves = [([0.0, 0.0, -10.0], 4, 8.0), ([0.0, 0.0, -25.0], 4, 0.0)];
    let tree = two_levels(Some(rep(2, 10.0)), &leaves);
    let mut s = session(&tree, 11_000, 1_000_000);
    s.ticks(40, &view_at(0.0, 0.0, 0.0));
    assert_eq!([0, 1, 2].map(|r| s.resident(r)), [true, true, false]);
}

#[test]
fn what_is_behind_counts_as_three_times_as_far() {
    // 19 m behind count as 57 m: less than 49 m ahead, more than 69 m.
    for (ahead, chosen) in [(-50.0, 2), (-70.0, 1)] {
        let tree = two_levels(Some(rep(2, 10.0)), &[([0.0, 0.0, 20.0], 4, 0.0), ([0.0, 0.0, ahead], 4, 0.0)]);
        let mut s = session(&tree, 11_000, 1_000_000);
        s.ticks(40, &view_at(0.0, 0.0, 0.0));
        assert!(s.resident(chosen) && !s.resident(3 - chosen));
    }
}

#[test]
fn a_step_is_worth_the_best_run_that_it_opens() {
    // Levels of 20, 90 and 100 kB with errors of 10, 8 and 0 m: 2 m for 70 kB, but 10 m for 80 kB. Another object
    // removes 4 m for 40 kB. 0.125 > 0.1 > 0.029. Half of 260 kB is 130 kB: 20 + 20 + 70 + 10, and 40 do not fit.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for (x, levels) in [(-5.0, &[(20, 10.0), (90, 8.0), (100, 0.0)][..]), (5.0, &[(20, 10.0), (60, 6.0)])] {
        b.open().unwrap();
        for &(kilobytes, error) in levels {
            b.add(rep(kilobytes, error)).unwrap();
        }
        b.close(Some(cube([x, 0.0, -20.0], 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = session(&tree, 260_000, 1_000_000);
    let view = view_at(0.0, 0.0, 0.0);
    let mut order = Vec::new();
    for _ in 0..60 {
        s.tick(&view);
        order.extend(s.fetched());
    }
    // One level after the other; 90 and 100 kB cannot both be there while 100 kB more are on their way.
    assert_eq!(order, [0, 3, 1]);
    assert_eq!([0, 1, 3, 4].map(|r| s.resident(r)), [true, true, true, false]);
    // 20 kB cool down for 100 frames and make room.
    s.ticks(200, &view);
    assert!(!s.resident(0) && !s.resident(4));
}

#[test]
fn a_level_that_is_not_better_is_left_out() {
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    b.add(rep(1, 4.0)).unwrap();
    b.open().unwrap();
    b.add(rep(2, 4.0)).unwrap();
    b.open().unwrap();
    b.add(rep(3, 1.0)).unwrap();
    b.close(Some(cube([0.0, 0.0, -20.0], 1.0)), 1.0).unwrap();
    b.close(None, 1.0).unwrap();
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = session(&tree, AMPLE, 1_000_000);
    let mut order = Vec::new();
    for _ in 0..40 {
        s.tick(&view_at(0.0, 0.0, 0.0));
        order.extend(s.fetched());
    }
    assert_eq!(order, [0, 2]);
}

#[test]
fn the_queue_serves_first_come_first() {
    // One load at a time, which takes 15 frames. When the first object's coarse level is there, the third one's has
    // been waiting for longer than the first one's fine level.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    for x in [-10.0, 0.0, 10.0] {
        b.open().unwrap();
        b.add(rep(1, 10.0)).unwrap();
        b.add(Representation { decoded_bytes: 2000, ..rep(1, 0.0) }).unwrap();
        b.close(Some(cube([x, 0.0, -20.0], 1.0)), 1.0).unwrap();
    }
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    let settings = PlayCanvasSettings { max_loads: 1, ..Default::default() };
    let mut s = Session::new(&tree, AMPLE, Box::new(PlayCanvas::new(&tree, settings)), 67);
    let mut order = Vec::new();
    for _ in 0..80 {
        s.tick(&view_at(0.0, 0.0, 0.0));
        order.extend(s.fetched());
    }
    assert_eq!(order, [0, 2, 4, 1, 3, 5]);
}

#[test]
fn what_no_node_shows_is_unloaded_a_hundred_frames_later_and_comes_back_when_needed() {
    let tree = two_levels(Some(rep(1, 10.0)), &[([0.0, 0.0, -10.0], 4, 0.0), ([0.0, 0.0, -20.0], 4, 0.0)]);
    let mut s = session(&tree, AMPLE, 1_000_000);
    let view = view_at(0.0, 0.0, 0.0);
    let mut gone = None;
    for frame in 1..200 {
        s.tick(&view);
        if s.discarded() == [0] {
            gone = gone.or(Some(frame));
        }
    }
    // Asked for in frame 11, there in 13, in the balance of frame 21 the root is not in use any more: last in 20.
    assert_eq!(gone, Some(120));
    assert!(s.resident(1) && s.resident(2));
}

#[test]
fn two_at_once_and_no_more_after_three_failures() {
    let leaves = [-10.0, -20.0, -30.0].map(|z| ([0.0, 0.0, z], 4, 0.0));
    let tree = two_levels(None, &leaves);
    let mut s = session(&tree, AMPLE, 1);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [0, 1]);
    for _ in 0..2 {
        s.scheduler.failed(RepId(0), s.now).unwrap();
        s.tick(&view);
        assert_eq!(s.fetched(), [0]);
    }
    s.scheduler.failed(RepId(0), s.now).unwrap();
    s.tick(&view);
    assert_eq!(s.fetched(), [2]);
    s.ticks(30, &view);
    assert_eq!(s.fetched(), NOTHING);
}

#[test]
fn balances_follow_the_camera_by_metres_and_right_angles() {
    let tree = two_levels(Some(rep(2, 10.0)), &[([0.0, 0.0, -30.0], 4, 0.0), ([0.0, 0.0, 30.0], 4, 0.0)]);
    let mut s = session(&tree, 11_000, 1_000_000);
    let view = view_at(0.0, 0.0, 0.0);
    s.ticks(60, &view);
    assert!(s.resident(1) && !s.resident(2));
    // 86° are not enough.
    s.ticks(60, &turned(view, 1.5));
    assert!(s.resident(1) && !s.resident(2));
    s.ticks(240, &turned(view, PI));
    assert!(s.resident(2) && !s.resident(1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_tree_and_budget_are_survived(seed: u64, depth in 0u32..6, budget in 0u64..2_000_000, rate in 1u64..200_000) {
        let tree = random_tree(seed, depth);
        let mut s = session(&tree, budget, rate).with_failures(seed);
        let mut dice = Dice(seed | 1);
        for _ in 0..30 {
            let at = view_at(dice.below(120) as f64 - 60.0, dice.below(60) as f64 - 30.0, -(dice.below(120) as f64));
            s.ticks(1 + dice.below(12) as usize, &turned(at, dice.below(6) as f64));
        }
    }
}
