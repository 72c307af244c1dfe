//! Orthoviews beside geometry: what a direction adds, what wins near and far, and the benefit by element along a path.

mod elements;
mod random_tree;

use elements::{errors_of, shares_of};
use foresight_scheduler::benefit::accuracy::{accuracy, sharpness};
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::element::{self, ELEMENTS, nearest};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::integral::{AddedBenefit, Leg, Method, Target, integrate};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, NodeId, RepId, Representation};
use foresight_scheduler::predict::PredictedPath;
use foresight_scheduler::select::certified::{
    Instance, Link, Objective, ObjectiveSettings, Standing, Winner, certified_winner, exhaustive_winner,
};
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use random_tree::Tape;

/// Top, four sides, four upper corners; z up.
const NINE: [u8; 9] = [14, 22, 4, 16, 10, 26, 20, 8, 2];

fn looking(from: DVec3, at: DVec3) -> View {
    let orientation = DQuat::from_rotation_arc(DVec3::NEG_Z, (at - from).normalize());
    View { position: from, orientation: orientation.normalize(), fov_y: 1.0, viewport: [1600, 900] }
}

fn orthoview(direction: u8, wire_bytes: u32, error: f32) -> Representation {
    let decoded_bytes = 8 * wire_bytes;
    Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: Some(direction) }
}

fn quality(tree: &LodTree, view: &View, held: &[RepId]) -> f64 {
    let mut cut = Cut::default();
    cut.make(tree, view, Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    let mut coverage = Coverage::new(tree, Refinement::Partial);
    held.iter().for_each(|&rep| assert!(coverage.insert(tree, rep)));
    evaluate(tree, &cut, &coverage, |_| {}).mean().expect("in view")
}

/// \[HIBR\] Fig. 5: seen from any side above the ground, the best direction of nine shows most, a second and a third
/// help, and more help little. Surfaces as of trees and rubble: every element but those that face down.
#[test]
fn a_second_and_third_direction_help_and_more_help_little() {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for direction in NINE {
        builder.add(orthoview(direction, 20_000, 0.4)).unwrap();
    }
    let normals = element::normals();
    builder.surface(core::array::from_fn(|s| if normals[s].z >= 0.0 { 1.0 } else { 0.0 })).unwrap();
    builder.close(Some(Aabb { min: DVec3::splat(-5.0), max: DVec3::splat(5.0) }), 1.0).unwrap();
    let tree = builder.finish().unwrap();
    let mut mean = [0.0; NINE.len() + 1];
    let eyes: Vec<DVec3> = (0..200)
        .map(|i| {
            let (z, angle) = ((f64::from(i) + 0.5) / 200.0, 2.399_963 * f64::from(i));
            DVec3::new(libm::cos(angle), libm::sin(angle), 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
        })
        .collect();
    for eye in &eyes {
        let view = looking(*eye * 40.0, DVec3::ZERO);
        let mut held = Vec::new();
        for mean in &mut mean[1..] {
            let with = |rep: RepId, held: &[RepId]| quality(&tree, &view, &[held, &[rep]].concat());
            let left = (0..NINE.len() as u32).map(RepId).filter(|rep| !held.contains(rep));
            let best = left.max_by(|&a, &b| with(a, &held).total_cmp(&with(b, &held))).expect("one is left");
            held.push(best);
            *mean += quality(&tree, &view, &held) / eyes.len() as f64;
        }
    }
    println!("mean quality by number of directions: {:.3?}", &mean[1..]);
    let gains: Vec<f64> = mean.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(gains.windows(2).all(|pair| pair[1] <= pair[0] + 1e-12), "{gains:?}");
    let (first, more, rest) = (mean[1], mean[3] - mean[1], mean[NINE.len()] - mean[3]);
    assert!(first > 0.6 && more > 0.05 && rest < 0.3 * more, "{mean:?}");
}

/// A town of 400 m: a quadtree of cells with orthoviews of 256 pixels along a side down to 100 m, nine buildings with
/// geometry in each of the smallest, sizes as of a built city.
fn town() -> LodTree {
    fn node(b: &mut LodTreeBuilder, corner: DVec3, side: f64) {
        b.open().unwrap();
        for (i, direction) in NINE.into_iter().enumerate() {
            let bytes = [26_000, 20_000, 20_000, 20_000, 20_000, 54_000, 54_000, 54_000, 54_000][i];
            b.add(orthoview(direction, bytes, side as f32 / 256.0)).unwrap();
        }
        for i in 0..if side > 150.0 { 4 } else { 0 } {
            node(b, corner + 0.5 * side * DVec3::new(f64::from(i % 2), f64::from(i / 2), 0.0), 0.5 * side);
        }
        for i in 0..if side > 150.0 { 0 } else { 9 } {
            b.open().unwrap();
            for (wire_bytes, error) in [(2_000, 1.0), (40_000, 0.15), (200_000, 0.02)] {
                let decoded_bytes = 6 * wire_bytes;
                b.add(Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: None })
                    .unwrap();
            }
            let mut walls = [0.0f32; ELEMENTS];
            for normal in [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y] {
                walls[nearest(normal)] = 28.0 * 24.0;
            }
            walls[nearest(DVec3::Z)] = 28.0 * 28.0;
            b.surface(walls).unwrap();
            let min = corner + DVec3::new(f64::from(i % 3) * 33.0 + 2.0, f64::from(i / 3) * 33.0 + 2.0, 0.0);
            b.close(Some(Aabb { min, max: min + DVec3::new(28.0, 28.0, 24.0) }), 1.0).unwrap();
        }
        b.close(None, 1.0).unwrap();
    }
    let mut builder = LodTreeBuilder::default();
    node(&mut builder, DVec3::new(-200.0, -200.0, 0.0), 400.0);
    builder.finish().unwrap()
}

/// What a client that stands still fetches, best first, until little is to be gained.
fn fetched(tree: &LodTree, view: View) -> Vec<RepId> {
    let settings =
        ObjectiveSettings { alpha: 1.0, attenuation: 0.0, cut: CutSettings { opening: 0.0, ..CutSettings::default() } };
    let region = Region::Reachable { angle: 0.0, reach: 0.0, stand_off: 0.5 };
    let mut objective = Objective::default();
    let path = PredictedPath { weight: 1.0, views: vec![view] };
    objective.make(tree, &[path], &[0.0, 4.0], (&view, region), &settings);
    let link =
        Link { seconds_per_byte: 1e-6, request_cost_s: 0.0, first_byte_s: 0.0, arrival_per_byte_s: 0.0, arrival: None };
    let standing = Standing::new(tree, Coverage::new(tree, Refinement::Partial));
    let mut instance = Instance { tree, standing, objective, link };
    let (mut all, mut first) = (Vec::new(), 0.0);
    loop {
        let Winner { rep, ratio, .. } = certified_winner(&mut instance, 0.0);
        assert_eq!(exhaustive_winner(&mut instance).rep, rep);
        first = f64::max(first, ratio);
        let Some(rep) = rep.filter(|_| ratio > 1e-3 * first) else { return all };
        instance.standing.insert(tree, rep);
        all.push(rep);
    }
}

/// On one tree: from afar the few orthoviews that face the camera are all that is worth its bytes; from the street they
/// come first, being cheap, and then what is near is fetched as geometry.
#[test]
fn geometry_wins_near_and_orthoviews_win_far() {
    let tree = town();
    let directed = |rep: &RepId| tree.direction(*rep).is_some();
    let middle = DVec3::new(0.0, 0.0, 12.0);
    let far = fetched(&tree, looking(DVec3::new(2400.0, 2000.0, 600.0), middle));
    let near = fetched(&tree, looking(DVec3::new(30.5, -120.0, 2.0), DVec3::new(30.5, 0.0, 6.0)));
    let bytes = |reps: &[RepId], directions: bool| -> u64 {
        reps.iter().filter(|rep| directed(rep) == directions).map(|&rep| tree.wire_bytes(rep)).sum()
    };
    for (name, reps) in [("far", &far), ("near", &near)] {
        println!("{name}: {} B of orthoviews, {} B of geometry", bytes(reps, true), bytes(reps, false));
    }
    assert!(far.iter().filter(|rep| directed(rep)).count() <= 3 && directed(&far[0]), "{far:?}");
    assert!(bytes(&far, true) > bytes(&far, false), "{far:?}");
    assert!(bytes(&near, false) > 2 * bytes(&near, true), "{near:?}");
    // From the +x, +y side nothing is fetched that looks from the other.
    let looks_away = |rep: &RepId| {
        tree.direction(*rep).is_some_and(|code| element::towards_eye(code).dot(DVec3::new(1.0, 1.0, 0.0)) < -0.1)
    };
    assert!(!far.iter().any(looks_away), "{far:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(60) })]

    /// The integral over a leg, summed over the elements of every leaf, is that of the benefit of its views.
    #[test]
    fn integrals_by_element_add_up(tape in prop::collection::vec(any::<u16>(), 0..200)) {
        let mut tape = Tape::new([vec![1], tape].concat());
        let tree = tape.tree(16);
        prop_assume!(tree.has_directions());
        let start = tape.view();
        let leg = Leg::new(&start, tape.point(20.0), tape.point(0.3), 0.0, 1.0).unwrap();
        let mut coverage = Coverage::new(&tree, Refinement::Partial);
        for rep in (0..tree.representations() as u32).map(RepId).filter(|rep| rep.0 % 2 == 0) {
            coverage.insert(&tree, rep);
        }
        let cut = CutSettings { opening: 0.0, ..CutSettings::default() };
        let mut sum = 0.0;
        for leaf in (0..tree.nodes() as u32).map(NodeId).filter(|&n| tree.is_leaf(n) && tree.importance(n) > 0.0) {
            let held = tree.ancestors(leaf).flat_map(|n| tree.own(n)).filter(|&rep| coverage.contains(rep));
            for (s, error) in errors_of(&tree, held).into_iter().enumerate() {
                let target = Target::of(&tree, leaf, false).element(&tree, leaf, s);
                let benefit =
                    AddedBenefit { leg, target, after: error, before: f64::INFINITY, arrival_s: 0.0, cut, attenuation: 0.0 };
                let method = Method::GaussLegendre { nodes: 8, panels: 8, split: true };
                sum += integrate(&benefit, &method).unwrap().value();
            }
        }
        let (mut dense, mut made) = (0.0, Cut::default());
        let steps = 2000;
        for i in 0..steps {
            made.make(&tree, &leg.view((f64::from(i) + 0.5) / f64::from(steps)), Region::Frustum, &cut);
            dense += evaluate(&tree, &made, &coverage, |_| {}).benefit / f64::from(steps);
        }
        prop_assert!((sum - dense).abs() < 2e-3 * (0.05 + dense), "{sum} {dense}");
    }

    /// A view's benefit is at most its weight, grows with what is held, and by less the more is held.
    #[test]
    fn the_benefit_of_a_view_is_submodular(tape in prop::collection::vec(any::<u16>(), 0..300)) {
        let mut tape = Tape::new([vec![1], tape].concat());
        let tree = tape.tree(24);
        let mut cut = Cut::default();
        let opening = [0.15, 0.0, 1.0][tape.below(3)];
        cut.make(&tree, &tape.view(), Region::Frustum, &CutSettings { opening, ..CutSettings::default() });
        let benefit = |held: &Coverage| evaluate(&tree, &cut, held, |_| {}).benefit;
        let (mut small, mut large) = (Coverage::new(&tree, Refinement::Partial), Coverage::new(&tree, Refinement::Partial));
        let one = RepId(tape.below(tree.representations()) as u32);
        for rep in (0..tree.representations() as u32).map(RepId).filter(|&rep| rep != one) {
            let which = tape.below(3);
            if which > 0 {
                large.insert(&tree, rep);
            }
            if which > 1 {
                small.insert(&tree, rep);
            }
        }
        let before = [benefit(&small), benefit(&large)];
        small.insert(&tree, one);
        large.insert(&tree, one);
        let after = [benefit(&small), benefit(&large)];
        let [gain_small, gain_large] = [after[0] - before[0], after[1] - before[1]];
        // Areas of groups are sums in single precision.
        let slack = 1e-6 * cut.total_weight;
        prop_assert!(before[0] <= before[1] + slack && gain_large >= -slack && gain_small >= gain_large - slack,
            "{before:?} {after:?}");
        prop_assert!(after[1] <= cut.total_weight + slack);
    }

    /// Shares sum to 1 where anything faces the eye, and are those of the definition.
    #[test]
    fn shares_follow_the_definition(tape in prop::collection::vec(any::<u16>(), 0..300)) {
        let mut tape = Tape::new([vec![1], tape].concat());
        let tree = tape.tree(24);
        let (view, reach) = (tape.view(), 20.0 * tape.unit());
        for node in (0..tree.nodes() as u32).map(NodeId) {
            let centre = tree.centre(node) - view.position;
            let found = element::shares(&tree, node, centre, tree.half(node), reach);
            let expected = shares_of(&tree, node, view.position, reach);
            prop_assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?} {expected:?}");
            let s = sharpness(1000.0, 10.0);
            prop_assert!(accuracy(f64::from(f32::INFINITY), s) == 0.0);
        }
    }
}
