use crate::session::{Dice, Session, chains, cube, groups, random_tree, rep, turned, two_levels, view_at};
use core::f64::consts::PI;
use foresight_scheduler::lod_tree::{LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::policy::cesium_native::{CesiumNative, CesiumNativeSettings};
use proptest::prelude::*;

const AMPLE: u64 = 1 << 40;
const NOTHING: [u32; 0] = [];

fn session<'a>(tree: &'a LodTree, budget: u64, settings: CesiumNativeSettings, rate: u64) -> Session<'a> {
    Session::new(tree, budget, Box::new(CesiumNative::new(tree, settings)), rate)
}

fn shipped<'a>(tree: &'a LodTree, budget: u64, rate: u64) -> Session<'a> {
    session(tree, budget, CesiumNativeSettings::default(), rate)
}

#[test]
fn loads_go_by_angle_times_distance() {
    // (1 − cos)·distance: 2.167 m, 0, 1.558 m and 1.195 m.
    let leaves = [
        ([20.0, 0.0, -90.0], 1, 0.1),
        ([0.0, 0.0, -50.0], 1, 0.1),
        ([-10.0, 0.0, -30.0], 1, 0.1),
        ([10.0, 0.0, -40.0], 1, 0.1),
    ];
    let tree = two_levels(None, &leaves);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [1, 3, 2, 0]);
}

#[test]
fn ancestors_and_culled_siblings_are_preloaded_after_what_is_needed() {
    // The eye is in the root's box: 0 m. The leaf behind has 2 · 49 m, but the one ahead goes first at 0.03 · 49 m.
    let leaves = [([10.0, 0.0, -50.0], 1, 0.1), ([0.0, 0.0, 50.0], 1, 0.1)];
    let tree = two_levels(Some(rep(1, 10.0)), &leaves);
    let view = view_at(0.0, 0.0, 0.0);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view);
    assert_eq!(s.fetched(), [1, 0, 2]);
    let settings = CesiumNativeSettings { preload_siblings: false, preload_ancestors: false, ..Default::default() };
    let mut s = session(&tree, AMPLE, settings, 1);
    s.tick(&view);
    assert_eq!(s.fetched(), [1]);
}

#[test]
fn refinement_stops_below_the_target() {
    // At 49 m the second level has 16.02 px and the third 10.2 px.
    let tree = chains(&[([0.0, 0.0, -50.0], &[8.0, 1.57, 1.0, 0.1])]);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    // The one rendered is needed, those above it are preloaded at equal priority in the order of the tree.
    assert_eq!(s.fetched(), [2, 0, 1]);
    let settings = CesiumNativeSettings { error_target_px: 16.1, ..Default::default() };
    let mut s = session(&tree, AMPLE, settings, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [1, 0]);
}

#[test]
fn more_than_20_missing_beneath_a_tile_wait_for_it() {
    let leaves: Vec<_> = (0..21).map(|i| ([0.0, 0.0, -50.0 - 3.0 * f64::from(i)], 1, 0.1)).collect();
    let view = view_at(0.0, 0.0, 0.0);
    let tree = two_levels(Some(rep(1, 10.0)), &leaves);
    let mut s = shipped(&tree, AMPLE, 1000);
    s.tick(&view);
    assert_eq!(s.fetched(), [0]);
    // It arrives, is decoded, and is drawn while they load.
    s.tick(&view);
    s.tick(&view);
    assert!(s.resident(0));
    assert_eq!(s.fetched(), (1..=20).collect::<Vec<_>>());
    let tree = two_levels(Some(rep(1, 10.0)), &leaves[..20]);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view);
    assert_eq!(s.fetched(), (1..=20).collect::<Vec<_>>());
}

#[test]
fn a_coarser_tile_that_would_do_is_urgent_while_finer_ones_are_drawn_for_it() {
    // Two levels of 1000 kB and 1 kB, side by side with a leaf on the axis. From 49 m the coarse level has 20.4 px: the
    // fine one is loaded. From 149 m it would do (6.7 px); although the leaf on the axis has the better priority, the
    // coarse level goes first.
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    b.open().unwrap();
    b.add(rep(1000, 2.0)).unwrap();
    b.add(rep(1, 0.1)).unwrap();
    b.close(Some(cube([20.0, 0.0, -50.0], 1.0)), 1.0).unwrap();
    b.open().unwrap();
    b.add(rep(1, 0.0)).unwrap();
    b.close(Some(cube([0.0, 0.0, 50.0], 1.0)), 1.0).unwrap();
    b.close(None, 1.0).unwrap();
    let tree = b.finish().unwrap();
    let settings = CesiumNativeSettings { max_loads: 1, preload_siblings: false, ..Default::default() };
    let mut s = session(&tree, AMPLE, settings, 1000);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [1]);
    s.tick(&view_at(0.0, 0.0, 0.0));
    s.tick(&view_at(0.0, 0.0, 100.0));
    assert!(s.resident(1));
    assert_eq!(s.fetched(), [0]);
    // Had it never been refined, the leaf would go first.
    let mut s = session(&tree, AMPLE, settings, 1000);
    s.tick(&view_at(0.0, 0.0, 100.0));
    assert_eq!(s.fetched(), [2]);
}

#[test]
fn loads_are_not_aborted_and_20_run_at_once() {
    let tree = groups(&[&[([0.0, 0.0, -50.0], 10)], &[([0.0, 0.0, 50.0], 10)]]);
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    s.tick(&turned(view_at(0.0, 0.0, 0.0), PI));
    assert_eq!((s.cancelled(), s.fetched()), (vec![], vec![1]));
    let leaves: Vec<_> = (0..60).map(|i| ([0.0, 0.0, -50.0 - 3.0 * f64::from(i)], 1, 0.1)).collect();
    let tree = two_levels(None, &leaves);
    let mut s = shipped(&tree, AMPLE, 1);
    s.ticks(5, &view_at(0.0, 0.0, 0.0));
    assert_eq!(s.scheduler.state().requests().len(), 20);
}

#[test]
fn for_what_does_not_fit_the_unvisited_go_oldest_first() {
    // Four leaves of 20 kB round the eye, each beneath an empty node. The fourth needs 40 kB of the 90 kB.
    let at = |i: i32| [-50.0 * libm::sin(f64::from(i) * 1.57), 0.0, -50.0 * libm::cos(f64::from(i) * 1.57)];
    let tree = groups(&[&[(at(0), 20)], &[(at(1), 20)], &[(at(2), 20)], &[(at(3), 20)]]);
    let mut s = shipped(&tree, 90_000, 1_000_000);
    let mut gone = Vec::new();
    for i in [1, 0, 2, 3] {
        for _ in 0..5 {
            s.tick(&turned(view_at(0.0, 0.0, 0.0), 1.57 * f64::from(i)));
            gone.extend(s.discarded());
        }
    }
    assert_eq!(gone, [1]);
    assert!(s.resident(0) && s.resident(2) && s.resident(3));
}

#[test]
fn preloaded_tiles_make_way_for_needed_ones_and_not_for_each_other() {
    // 20 kB each; the budget holds three and no fourth request. The leaf ahead, the root and the leaf behind are loaded.
    let leaves = [([0.0, 0.0, -50.0], 20, 0.1), ([0.0, 0.0, 50.0], 20, 0.1), ([50.0, 0.0, 0.0], 20, 0.1)];
    let tree = two_levels(Some(rep(20, 10.0)), &leaves);
    let view = view_at(0.0, 0.0, 0.0);
    let mut s = shipped(&tree, 80_000, 1_000_000);
    s.ticks(10, &view);
    assert!(s.resident(1) && s.resident(0) && s.resident(3) && !s.resident(2));
    for _ in 0..20 {
        s.tick(&view);
        assert_eq!(s.actions, []);
    }
    // Turned round, the leaf there is needed. The root is drawn in its place until it comes; of what is only preloaded,
    // the first of the tree goes.
    s.tick(&turned(view, PI));
    assert_eq!((s.discarded(), s.fetched()), (vec![1], vec![2]));
}

#[test]
fn a_failed_tile_counts_as_loaded() {
    let tree = two_levels(Some(rep(10, 8.0)), &[([0.0, 0.0, -50.0], 10, 0.1)]);
    let mut s = shipped(&tree, AMPLE, 1);
    let view = view_at(0.0, 0.0, 0.0);
    s.tick(&view);
    s.scheduler.failed(RepId(1), s.now).unwrap();
    s.ticks(5, &view);
    assert_eq!(s.fetched(), NOTHING);
}

#[test]
fn levels_wait_for_their_prerequisite() {
    let mut b = LodTreeBuilder::default();
    b.open().unwrap();
    let coarse = b.add(rep(1, 8.0)).unwrap();
    b.add(Representation { prerequisite: Some(coarse), ..rep(1, 0.1) }).unwrap();
    b.close(Some(cube([0.0, 0.0, -50.0], 1.0)), 1.0).unwrap();
    let tree = b.finish().unwrap();
    let mut s = shipped(&tree, AMPLE, 1);
    s.tick(&view_at(0.0, 0.0, 0.0));
    assert_eq!(s.fetched(), [0, 1]);
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
        let settings = CesiumNativeSettings { error_target_px: target, ..Default::default() };
        let mut s = session(&tree, AMPLE, settings, 2_000_000);
        let view = view_at(5.0, 3.0, 10.0);
        s.ticks(5, &view_at(0.0, 0.0, -60.0));
        s.ticks(300, &view);
        s.assert_sharp(&view, target);
    }
}
