//! What the scheduler computes in one pass, against the same computed naively on random trees.

mod elements;
mod random_tree;

use elements::{errors_of, shares_of};
use foresight_scheduler::benefit::accuracy::{RIVALS_TARGET_PX, accuracy, is_within, sharpness};
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::frustum::Frustum;
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::benefit::solid_angle::of_box_in_frustum;
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use foresight_scheduler::predict::PredictedPath;
use foresight_scheduler::select::discard::{Victim, Victims};
use foresight_scheduler::select::horizon::{Horizon, HorizonSettings};
use foresight_scheduler::view::View;
use glam::DVec3;
use proptest::prelude::*;
use random_tree::Tape;
use std::collections::BTreeSet;

const ATOMIC: [Refinement; 2] = [Refinement::Partial, Refinement::Atomic];

fn cases(few: u32) -> ProptestConfig {
    let full = std::env::var_os("FORESIGHT_FULL").is_some();
    ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(if full { 20 * few } else { few }) }
}

fn tape() -> impl Strategy<Value = Vec<u16>> {
    prop::collection::vec(any::<u16>(), 0..300)
}

fn nodes(tree: &LodTree) -> impl Iterator<Item = NodeId> + use<> {
    (0..tree.nodes() as u32).map(NodeId)
}

fn reps(tree: &LodTree) -> impl Iterator<Item = RepId> + use<> {
    (0..tree.representations() as u32).map(RepId)
}

/// Whether every node that shares `node`'s nearest owner above, and owns something, holds something.
fn counts(tree: &LodTree, held: &BTreeSet<RepId>, refinement: Refinement, node: NodeId) -> bool {
    let owner_above = |n: NodeId| tree.ancestors(n).skip(1).find(|&a| tree.own(a).len() > 0);
    let holds = |n: NodeId| tree.own(n).any(|r| held.contains(&r));
    refinement == Refinement::Partial
        || nodes(tree).filter(|&n| tree.own(n).len() > 0 && owner_above(n) == owner_above(node)).all(holds)
}

fn best_at(tree: &LodTree, held: &BTreeSet<RepId>, refinement: Refinement, node: NodeId) -> f32 {
    if !counts(tree, held, refinement, node) {
        return f32::INFINITY;
    }
    tree.own(node).filter(|r| held.contains(r)).fold(f32::INFINITY, |best, r| best.min(tree.error(r) as f32))
}

fn some_reps(tape: &mut Tape, tree: &LodTree) -> Vec<RepId> {
    reps(tree).filter(|_| tape.below(2) == 0).collect()
}

fn coverage_of(tree: &LodTree, refinement: Refinement, held: &[RepId]) -> Coverage {
    let mut coverage = Coverage::new(tree, refinement);
    for &rep in held {
        coverage.insert(tree, rep);
    }
    coverage
}

/// Up to two paths of up to three views, and the worst case.
fn horizon(tape: &mut Tape, tree: &LodTree, planned: &Coverage) -> (Horizon, f64) {
    let samples = 1 + tape.below(3);
    let believed = [1.0, 0.7][tape.below(2)];
    let mut paths = vec![PredictedPath { weight: believed, views: (0..samples).map(|_| tape.view()).collect() }];
    if believed < 1.0 {
        paths.push(PredictedPath { weight: 1.0 - believed, views: (0..samples).map(|_| tape.view()).collect() });
    }
    let bounds: Vec<f64> = (0..=samples).map(|i| 1.5 * i as f64).collect();
    let settings = HorizonSettings {
        alpha: [0.7, 0.0, 1.0][tape.below(3)],
        attenuation: tape.unit(),
        tolerance: [0.0, 1e-3, 0.1][tape.below(3)],
        cut: CutSettings { opening: [0.3, 0.0, 2.0][tape.below(3)], near: 0.1, centre_falloff: tape.unit() },
    };
    let region = Region::Reachable { angle: 3.0 * tape.unit(), reach: 50.0 * tape.unit(), stand_off: 0.5 };
    let view = paths[0].views[0];
    let mut horizon = Horizon::default();
    horizon.make(tree, planned, &paths, &bounds, (&view, region), &settings);
    (horizon, 5.0 * tape.unit())
}

proptest! {
    #![proptest_config(cases(400))]

    /// After every insertion and removal the folded set is what a fold from scratch gives.
    #[test]
    fn coverage_follows_the_definition(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        for refinement in ATOMIC {
            let (mut coverage, mut held) = (Coverage::new(&tree, refinement), BTreeSet::new());
            for _ in 0..24 {
                let rep = RepId(tape.below(tree.representations()) as u32);
                if tape.below(3) == 2 {
                    prop_assert_eq!(coverage.remove(&tree, rep), held.remove(&rep));
                } else {
                    prop_assert_eq!(coverage.insert(&tree, rep), held.insert(rep));
                }
                prop_assert!(coverage.iter().eq(held.iter().copied()));
                for node in nodes(&tree) {
                    let best = |n: NodeId| best_at(&tree, &held, refinement, n);
                    prop_assert_eq!(coverage.best_at(node), best(node));
                    let above = tree.ancestors(node).map(best).fold(f32::INFINITY, f32::min);
                    prop_assert_eq!(coverage.best_above(&tree, node), above);
                    let beneath = nodes(&tree).any(|n| n != node && tree.is_beneath(n, node) && best(n).is_finite());
                    prop_assert_eq!(coverage.any_beneath(node), beneath);
                    if tree.own(node).len() > 0 {
                        prop_assert_eq!(coverage.counts(&tree, node), counts(&tree, &held, refinement, node));
                    }
                }
            }
        }
    }

    /// With every group opened, the quality is the sum over leaves of solid angle times accuracy.
    #[test]
    fn quality_is_the_sum_over_leaves(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let view = tape.view();
        let mut cut = Cut::default();
        let settings = CutSettings { opening: 0.0, ..CutSettings::default() };
        cut.make(&tree, &view, Region::Frustum, &settings);
        let frustum = Frustum::new(&view);
        for refinement in ATOMIC {
            let some = some_reps(&mut tape, &tree);
            let quality = evaluate(&tree, &cut, &coverage_of(&tree, refinement, &some), |_| {});
            let held: BTreeSet<RepId> = some.into_iter().collect();
            let (mut benefit, mut weight, mut within) = (0.0, 0.0, 0.0);
            for leaf in nodes(&tree).filter(|&n| tree.is_leaf(n)) {
                let (centre, half) = (tree.centre(leaf) - view.position, tree.half(leaf));
                let w = tree.importance(leaf) * of_box_in_frustum(centre, half, &frustum, 0b1111);
                let distance = (centre.abs() - half).max(DVec3::ZERO).length().max(settings.near);
                let s = sharpness(view.pixels_per_radian(), distance);
                // One error, or one for each element of its surface.
                let shown = if tree.has_directions() {
                    let counting = tree.ancestors(leaf).filter(|&n| counts(&tree, &held, refinement, n));
                    let errors = errors_of(&tree, counting.flat_map(|n| tree.own(n)).filter(|r| held.contains(r)));
                    shares_of(&tree, leaf, view.position, 0.0).into_iter().zip(errors).collect()
                } else {
                    let best = tree.ancestors(leaf).map(|n| best_at(&tree, &held, refinement, n));
                    vec![(1.0, f64::from(best.fold(f32::INFINITY, f32::min)))]
                };
                for (share, error) in shown {
                    weight += share * w;
                    benefit += share * w * accuracy(error, s);
                    if error.is_finite() && is_within(error, s, RIVALS_TARGET_PX) {
                        within += share * w;
                    }
                }
            }
            prop_assert!((quality.weight - weight).abs() < 1e-9, "{} {weight}", quality.weight);
            // Errors of orthoviews are products in single precision.
            let rounding = if tree.has_directions() { 1e-6 } else { 1e-9 };
            prop_assert!((quality.benefit - benefit).abs() < rounding, "{} {benefit}", quality.benefit);
            prop_assert!((quality.within_target - within).abs() < rounding, "{} {within}", quality.within_target);
        }
    }

    /// A marginal is the difference that the representation makes to the objective, gained or lost, from any moment on.
    #[test]
    fn a_marginal_is_a_difference_of_the_objective(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let known = some_reps(&mut tape, &tree);
        let (horizon, offset) = horizon(&mut tape, &tree, &coverage_of(&tree, Refinement::Partial, &known));
        let refinement = if tape.below(2) == 0 { Refinement::Partial } else { Refinement::Atomic };
        let mut planned = coverage_of(&tree, refinement, &some_reps(&mut tape, &tree));
        for rep in reps(&tree) {
            for from in [0.0, offset] {
                let marginal = horizon.marginal(&tree, &mut planned, rep, from);
                let was_there = !planned.insert(&tree, rep);
                let with = horizon.benefit_beneath(&tree, &planned, tree.root(), from);
                planned.remove(&tree, rep);
                let without = horizon.benefit_beneath(&tree, &planned, tree.root(), from);
                if was_there {
                    planned.insert(&tree, rep);
                }
                prop_assert!((marginal - (with - without)).abs() < 1e-12, "{rep:?}: {marginal} {with} {without}");
            }
        }
        let whole = horizon.benefit_beneath(&tree, &planned, tree.root(), 0.0);
        prop_assert_eq!(horizon.objective(&tree, &planned), whole);
    }

    /// What a representation adds to a set, it adds at least to every part of the set; and it never takes away.
    #[test]
    fn the_objective_is_monotone_and_submodular(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let (horizon, offset) = horizon(&mut tape, &tree, &Coverage::new(&tree, Refinement::Partial));
        let large = some_reps(&mut tape, &tree);
        let small: Vec<RepId> = large.iter().copied().filter(|_| tape.below(2) == 0).collect();
        let mut large_set = coverage_of(&tree, Refinement::Partial, &large);
        let mut small_set = coverage_of(&tree, Refinement::Partial, &small);
        for rep in reps(&tree).filter(|r| !large.contains(r)) {
            let to_large = horizon.marginal(&tree, &mut large_set, rep, offset);
            let to_small = horizon.marginal(&tree, &mut small_set, rep, offset);
            prop_assert!(to_large >= 0.0 && to_small >= to_large - 1e-12, "{rep:?}: {to_small} {to_large}");
        }
        prop_assert!(horizon.objective(&tree, &small_set) <= horizon.objective(&tree, &large_set) + 1e-12);
    }

    /// A sacrifice frees enough, costs what the objective loses, begins with the least loss per byte, and is undone.
    #[test]
    fn a_sacrifice_costs_what_the_objective_loses(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let some = some_reps(&mut tape, &tree);
        let mut planned = coverage_of(&tree, Refinement::Partial, &some);
        let before = planned.clone();
        let (horizon, _) = horizon(&mut tape, &tree, &planned);
        let last_used = |rep: RepId| rep.0 % 3;
        let kept = tape.below(5) as u32;
        let may_go = |rep: RepId| rep.0 % 5 != kept;
        let per_byte = |rep: RepId| {
            horizon.marginal(&tree, &mut before.clone(), rep, 0.0) / tree.decoded_bytes(rep).max(1) as f64
        };
        let mut victims = Victims::default();
        for &rep in &some {
            // Losses may be known too low; the choice must not rely on them.
            let stale = if tape.below(3) == 2 { 0.0 } else { per_byte(rep) };
            victims.push(Victim { loss_per_byte: stale, last_used: last_used(rep), rep });
        }
        let all: u64 = some.iter().filter(|&&r| may_go(r)).map(|&r| tree.decoded_bytes(r)).sum();
        let bytes = libm::ceil(1.1 * tape.unit() * all as f64) as u64;
        let loss_max = if tape.below(2) == 0 { f64::INFINITY } else { 0.3 * tape.unit() };
        let objective = horizon.objective(&tree, &planned);
        let chosen = victims.choose(&tree, &horizon, &mut planned, &[], bytes, 0.0, loss_max, last_used, may_go);
        let Some(sacrifice) = chosen else {
            prop_assert!(bytes > all || loss_max.is_finite());
            prop_assert!(planned.iter().eq(before.iter()));
            return Ok(());
        };
        let freed: u64 = sacrifice.reps.iter().map(|&r| tree.decoded_bytes(r)).sum();
        prop_assert!(freed >= bytes && freed == sacrifice.bytes);
        prop_assert!(sacrifice.loss <= loss_max);
        prop_assert!(sacrifice.reps.iter().all(|&r| may_go(r) && before.contains(r) && !planned.contains(r)));
        let lost = objective - horizon.objective(&tree, &planned);
        prop_assert!((sacrifice.loss - lost).abs() < 1e-12, "{} {lost}", sacrifice.loss);
        if let Some(&first) = sacrifice.reps.first() {
            let least = some.iter().filter(|&&r| may_go(r)).map(|&r| per_byte(r)).fold(f64::INFINITY, f64::min);
            prop_assert!(per_byte(first) <= least);
        }
        victims.restore(&tree, &horizon, &mut planned, &sacrifice.reps, 0.0, last_used);
        prop_assert!(planned.iter().eq(before.iter()));
    }

    /// However much there is in view, the objective of one view is at most the solid angle of its frustum.
    #[test]
    fn the_objective_is_at_most_the_frustum(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let view: View = tape.view();
        let all = coverage_of(&tree, Refinement::Partial, &reps(&tree).collect::<Vec<_>>());
        let mut horizon = Horizon::default();
        let settings = HorizonSettings { alpha: 0.7, attenuation: 0.0, tolerance: 0.0, cut: CutSettings::default() };
        let region = Region::Reachable { angle: 3.0, reach: 100.0, stand_off: 0.5 };
        let paths = [PredictedPath { weight: 1.0, views: vec![view; 2] }];
        horizon.make(&tree, &all, &paths, &[0.0, 1.0, 2.0], (&view, region), &settings);
        let objective = horizon.objective(&tree, &all);
        prop_assert!((0.0..=Frustum::new(&view).solid_angle * (1.0 + 1e-9)).contains(&objective), "{objective}");
    }
}
