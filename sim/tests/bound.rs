//! The upper bound of a frame against the best of all sets of representations.

#[path = "../../scheduler/tests/random_tree/mod.rs"]
mod random_tree;

use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::view::View;
use foresight_sim::bound::{CheapestBeneath, FrameBound, Limits};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use random_tree::Tape;

/// Representations of the trees that are searched whole.
const REPS_MAX: usize = 10;
/// Of single-precision areas: what the bound adds, and what a measured quality may be off itself.
const ROUNDING: f64 = 1e-5;

fn cases(few: u32) -> ProptestConfig {
    let full = std::env::var_os("FORESIGHT_FULL").is_some();
    let cases = if full { 20 * few } else { few };
    ProptestConfig { failure_persistence: None, max_shrink_iters: 20_000, ..ProptestConfig::with_cases(cases) }
}

/// Wire bytes, decoded bytes and quality of every set.
fn every_set(tree: &LodTree, cut: &Cut) -> Vec<(u64, u64, f64)> {
    (0..1u32 << tree.representations())
        .map(|set| {
            let mut coverage = Coverage::new(tree, Refinement::Partial);
            let (mut wire, mut decoded) = (0, 0);
            for rep in (0..tree.representations() as u32).filter(|r| set >> r & 1 != 0).map(RepId) {
                coverage.insert(tree, rep);
                wire += tree.wire_bytes(rep);
                decoded += tree.decoded_bytes(rep);
            }
            (wire, decoded, evaluate(tree, cut, &coverage, |_| {}).mean().unwrap_or(0.0))
        })
        .collect()
}

fn best_within(sets: &[(u64, u64, f64)], wire: u64, memory: u64) -> f64 {
    sets.iter().filter(|s| s.0 <= wire && s.1 <= memory).map(|s| s.2).fold(0.0, f64::max)
}

fn frame(tape: &mut Tape) -> (LodTree, Cut) {
    let tree = tape.tree(REPS_MAX);
    let opening = [0.15, 0.0, 1.0][tape.below(3)];
    let mut cut = Cut::default();
    cut.make(&tree, &tape.view(), Region::Frustum, &CutSettings { opening, ..CutSettings::default() });
    (tree, cut)
}

proptest! {
    #![proptest_config(cases(400))]

    /// No set within the limits is better than the bound, and wider limits do not lower it.
    #[test]
    fn no_set_is_above_the_bound(tape in prop::collection::vec(any::<u16>(), 0..300)) {
        let mut tape = Tape::new(tape);
        let (tree, cut) = frame(&mut tape);
        let cheapest = CheapestBeneath::new(&tree);
        let Some(mut problem) = FrameBound::new(&tree, &cheapest, &cut) else { return Ok(()) };
        let sets = every_set(&tree, &cut);
        // Limits that just hold a set are the sharpest.
        let mut limits: Vec<(u64, u64)> = sets.iter().map(|s| (s.0, s.1)).collect();
        limits.sort_unstable();
        limits.dedup();
        let step = 1 + limits.len() / 32;
        for &(wire, memory) in limits.iter().step_by(step) {
            for (wire, memory) in [(wire, memory), (wire, u64::MAX), (u64::MAX, memory)] {
                let bound = problem.bound(Limits { wire: wire as f64, memory: memory as f64 });
                let best = best_within(&sets, wire, memory);
                prop_assert!((0.0..=1.0).contains(&bound));
                prop_assert!(best <= bound + 1e-9, "within {wire} and {memory}: {best} > {bound}");
                for wider in [(wire as f64 * 1.5 + 1.0, memory as f64), (wire as f64, memory as f64 * 1.5 + 1.0)] {
                    let higher = problem.bound(Limits { wire: wider.0, memory: wider.1 });
                    prop_assert!(higher >= bound - 1e-12, "{wider:?}: {higher} < {bound}");
                }
            }
        }
    }

    /// With more bytes than the world has, every leaf opened, the bound is the quality of everything.
    #[test]
    fn without_limits_the_bound_is_what_everything_gives(tape in prop::collection::vec(any::<u16>(), 0..300)) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(REPS_MAX);
        let mut cut = Cut::default();
        cut.make(&tree, &tape.view(), Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
        let cheapest = CheapestBeneath::new(&tree);
        let Some(mut problem) = FrameBound::new(&tree, &cheapest, &cut) else { return Ok(()) };
        let best = best_within(&every_set(&tree, &cut), u64::MAX, u64::MAX);
        let bound = problem.bound(Limits { wire: 1e9, memory: 1e9 });
        prop_assert!((best..=best + 1e-3 + ROUNDING).contains(&(bound + 1e-9)), "{best} {bound}");
    }
}

/// A coarse parent, not the root, over two leaves, seen so that both leaves weigh the same.
fn two_leaves() -> (LodTree, Cut) {
    let rep = |wire_bytes, error| Representation {
        wire_bytes,
        decoded_bytes: 3 * wire_bytes,
        error,
        prerequisite: None,
        direction: None,
    };
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    builder.open().unwrap();
    builder.add(rep(1000, 0.75)).unwrap();
    for x in [-6.0, 4.0] {
        builder.open().unwrap();
        builder.add(rep(10_000, 0.25)).unwrap();
        let min = DVec3::new(x, -1.0, -21.0);
        builder.close(Some(Aabb { min, max: min + DVec3::new(2.0, 2.0, 1.0) }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.close(None, 1.0).unwrap();
    let tree = builder.finish().unwrap();
    let view = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1600, 900] };
    let mut cut = Cut::default();
    cut.make(&tree, &view, Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    (tree, cut)
}

/// Both leaves weigh one half, so with a the accuracy of a leaf and b that of the parent everything is known: nothing
/// below 1 kB, b from 1 kB, (a + b)/2 from 11 kB, a from 20 kB. The dual is the concave hull of these steps, less what alone
/// exceeds the limit.
#[test]
fn two_leaves_by_hand() {
    let (tree, cut) = two_leaves();
    assert_eq!(cut.patches.len(), 2);
    assert!((cut.patches[0].weight - cut.patches[1].weight).abs() < 1e-12);
    let sharpness = cut.patches[0].sharpness;
    // The nearest point of each leaf is 4 m aside and 20 m ahead.
    let pixels_per_metre = 900.0 / (2.0 * libm::tan(0.5)) / (16.0f64 + 400.0).sqrt();
    assert!((sharpness.sqrt() * HALF_ACCURACY_PX / pixels_per_metre - 1.0).abs() < 1e-7);
    let accuracy = |error: f64| 1.0 / (1.0 + error * error * sharpness);
    let (a, b) = (accuracy(0.25), accuracy(0.75));
    let sets = every_set(&tree, &cut);
    let cheapest = CheapestBeneath::new(&tree);
    let mut problem = FrameBound::new(&tree, &cheapest, &cut).unwrap();
    // Corners of the hull: (0, 0), (1000, b), then straight to (20000, a), because (11000, (a + b)/2) lies beneath; nothing
    // fits below 1 kB, and no leaf below 10 kB.
    let hull = |w: f64| match w {
        w if w < 1e3 => 0.0,
        w if w < 1e4 => b,
        w => (b + (a - b) * (w - 1e3) / 19e3).min(a),
    };
    let steps = [(0, 0.0), (999, 0.0), (1000, b), (10_999, b), (11_000, 0.5 * (a + b)), (19_999, 0.5 * (a + b))];
    for (wire, best) in steps.into_iter().chain([(20_000, a), (99_999, a)]) {
        assert!((best_within(&sets, wire, u64::MAX) - best).abs() < 1e-12, "{wire}");
        let by_wire = problem.bound(Limits { wire: wire as f64, memory: 1e9 });
        let by_memory = problem.bound(Limits { wire: 1e9, memory: 3.0 * wire as f64 });
        for bound in [by_wire, by_memory] {
            assert!(best <= bound, "{wire}: {best} {bound}");
            // Between two multipliers of the grid, a ratio of 1.3 apart, the dual is at most 30 % above the hull.
            let above = bound - ROUNDING - hull(wire as f64);
            assert!((-1e-9..=0.3 * hull(wire as f64) + 1e-6).contains(&above), "{wire}: {bound} {}", hull(wire as f64));
        }
    }
}
