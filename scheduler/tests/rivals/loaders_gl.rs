use crate::session::{Dice, Session, chains, groups, random_tree, rep, turned, two_levels, view_at};
use core::f64::consts::PI;
use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::policy::loaders_gl::{LoadersGl, LoadersGlSettings};
use proptest::prelude::*;

const AMPLE: u64 = 1 << 40;

fn session<'a>(tree: &'a LodTree, budget: u64, settings: LoadersGlSettings, rate: u64) -> Session<'a> {
    Session::new(tree, budget, Box::new(LoadersGl::new(tree, settings)), rate)
}

fn shipped<'a>(tree: &'a LodTree, budget: u64, rate: u64) -> Session<'a> {
    session(tree, budget, LoadersGlSettings::default(), rate)
}

#[test]
fn beneath_a_tile_with_content_children_come_one_after_the_other_farthest_first() {
    let leaves = [([0.0, 0.0, -50.0], 1, 0.1), ([0.0, 0.0, 70.0], 1, 0.1), ([0.0, 0.0, -60.0], 1, 0.1)];
    let tree = two_levels(Some(rep(1, 10.0)), &leaves);
    let mut s = shipped(&tree, AMPLE, 1000);
    let view = view_at(0.0, 0.0, 0.0);
    // Root, then the leaf 69 m behind, then those 59 m and 49 m ahead; each takes a tick to come and one to be decoded.
    let mut order = Vec::new();
    for _ in 0..8 {
        s.tick(&view);
        order.push(s.fetched());
    }
    assert_eq!(order[0], [0, 2]);
    assert_eq!(order[1..].iter().flatten().copied().collect::<Vec<_>>(), [3, 1]);
    // Two at the most were on their way at once.
    assert!(order.iter().all(|fetched| fetched.len() <= 2));
}

#[test]
fn the_centre_goes_first() {
    // ⌊9999·fov⌋ with fov = 1 − z/√(z² + (10 − √3)²): 207, 0, 359, 164.
    let leaves = [
        ([10.0, 0.0, -40.0], 1, 0.1),
        ([0.0, 0.0, -50.0], 1, 0.1),
        ([-10.0, 0.0, -30.0], 1, 0.1),
        ([10.0, 0.0, -45.0], 1, 0.1),
    ];
    let tree = two_levels(None, &leaves);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [1, 3, 0, 2]);
}

#[test]
fn then_the_parents_error_and_before_all_whether_the_reduced_height_needs_it() {
    // On the axis. Errors are 1000/1.15 = 869.6 px at 1 m and 1 m of error. The coarse tiles have the root for a parent:
    // 0. The fine one at 50 m has 869.6·8/49 = 142 px above it, of the root's 869.6·8/49: 0 too. The one at 80 m has
    // 88.1 px above it: 3797. The third level at 50 m has an error of 869.6·0.4·0.3/49 = 2.1 px at the reduced height
    // and 869.6·1·0.3/49 = 5.3 px above it, not above 8 px: it waits.
    let tree = chains(&[([0.0, 0.0, -50.0], &[8.0, 1.0, 0.4]), ([0.0, 0.0, -80.0], &[8.0, 0.4])]);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 1, 3, 4, 2]);
}

#[test]
fn refinement_stops_at_the_target() {
    // 869.6·0.45/49 = 7.99 px, and 8.2 px with 0.46 m.
    for (error, count) in [(0.45, 1), (0.46, 2)] {
        let tree = chains(&[([0.0, 0.0, -50.0], &[error, 0.1])]);
        let mut s = shipped(&tree, AMPLE, 1);
        s.tick(&view_at(0.0, 0.0, 0.0));
        assert_eq!(s.fetched().len(), count);
    }
}

#[test]
fn nothing_waits_for_the_camera_to_stand_still_or_slow_down() {
    let tree = two_levels(None, &[([40.0, 0.0, -45.0], 1, 0.1)]);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&turned(view_at(-5.0, 0.0, 0.0), PI));
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0]);
}

#[test]
fn downloads_are_not_aborted_and_64_run_at_once() {
    let tree = groups(&[&[([0.0, 0.0, -50.0], 10)], &[([0.0, 0.0, 50.0], 10)]]);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    s.tick(&turned(view_at(0.0, 0.0, 0.0), PI));
    assert_eq!((s.cancelled(), s.fetched()), (vec![], vec![1]));
    let leaves: Vec<_> = (0..90).map(|i| ([0.0, 0.0, -50.0 - 3.0 * f64::from(i)], 1, 0.1)).collect();
    let tree = two_levels(None, &leaves);
    let mut s = shipped(&tree, AMPLE, 1);
    s.ticks(5, &view_at(0.0, 0.0, 0.0));
    assert_eq!(s.scheduler.state().requests().len(), 64);
}

#[test]
fn above_half_the_budget_the_last_touched_of_the_oldest_frame_goes_first() {
    let tree = groups(&[&[([0.0, 0.0, -50.0], 30), ([0.0, 0.0, -60.0], 30)], &[([0.0, 0.0, 50.0], 30)]]);
    let mut s = shipped(&tree, 160_000, 1_000_000);
    let ahead = view_at(0.0, 0.0, 0.0);
    s.ticks(5, &ahead);
    let mut gone = Vec::new();
    for _ in 0..5 {
        s.tick(&turned(ahead, PI));
        gone.extend(s.discarded());
    }
    assert_eq!(gone, [1]);
}

#[test]
fn a_failed_tile_is_not_asked_for_again_and_holds_up_its_nearer_siblings() {
    let leaves = [([0.0, 0.0, -50.0], 1, 0.1), ([0.0, 0.0, -60.0], 1, 0.1)];
    let tree = two_levels(Some(rep(1, 10.0)), &leaves);
    let mut s = shipped(&tree, AMPLE, 1000);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    assert_eq!(s.fetched(), [0, 2]);
    s.fail_request(2);
    for _ in 0..20 {
        s.tick(&view);
        assert!(s.fetched().is_empty());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn any_tree_and_budget_are_survived(seed: u64, depth in 0u32..6, budget in 0u64..2_000_000, rate in 1u64..200_000) {
        let tree = random_tree(seed, depth);
        let mut s = shipped(&tree, budget, rate).with_failures(seed);
        let mut dice = Dice(seed | 1);
        for _ in 0..30 {
            let at = view_at(dice.below(120) as f64 - 60.0, dice.below(60) as f64 - 30.0, -(dice.below(120) as f64));
            s.ticks(1 + dice.below(12) as usize, &turned(at, dice.below(6) as f64));
        }
    }

    #[test]
    fn with_ample_memory_the_view_gets_sharp(seed: u64, depth in 0u32..6, target in 1.0f64..32.0) {
        let tree = random_tree(seed, depth);
        let settings = LoadersGlSettings { error_target_px: target, ..Default::default() };
        let mut s = session(&tree, AMPLE, settings, 2_000_000);
        let view = view_at(5.0, 3.0, 10.0);
        s.ticks(5, &view_at(0.0, 0.0, -60.0));
        s.ticks(500, &view);
        s.assert_sharp(&view, target);
    }
}
