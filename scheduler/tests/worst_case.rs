//! The worst case against closed forms, and against brute force over dense samples of the neighbourhood.

mod elements;
mod random_tree;

use elements::{errors_of, shares_of};
use foresight_scheduler::benefit::accuracy::{accuracy, sharpness};
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::frustum::Frustum;
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::benefit::solid_angle::of_box;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, NodeId, RepId, Representation};
use foresight_scheduler::view::View;
use foresight_scheduler::worst_case::max_min::{Family, SampledViews, Stretch, saturate};
use foresight_scheduler::worst_case::minimum::{MinimumSettings, certified, sampled, worst_views};
use foresight_scheduler::worst_case::neighbourhood::Neighbourhood;
use foresight_scheduler::worst_case::target::Targets;
use foresight_scheduler::worst_case::union::{self, UnionSettings};
use foresight_scheduler::worst_case::view_box::ViewBox;
use foresight_scheduler::worst_case::{clearance, union_cut};
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use random_tree::Tape;

fn cases(few: u32) -> ProptestConfig {
    let full = std::env::var_os("FORESIGHT_FULL").is_some();
    ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(if full { 20 * few } else { few }) }
}

fn tape() -> impl Strategy<Value = Vec<u16>> {
    prop::collection::vec(any::<u16>(), 0..300)
}

fn look_ahead(position: DVec3) -> View {
    View { position, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1000, 1000] }
}

/// One box with one representation of error `error`, resident or not.
fn one_box(centre: DVec3, half: DVec3, error: f32, resident: bool) -> (LodTree, Coverage) {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    let rep = Representation { wire_bytes: 1, decoded_bytes: 1, error, prerequisite: None, direction: None };
    builder.add(rep).unwrap();
    builder.close(Some(Aabb { min: centre - half, max: centre + half }), 1.0).unwrap();
    let tree = builder.finish().unwrap();
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    if resident {
        coverage.insert(&tree, RepId(0));
    }
    (tree, coverage)
}

fn some_coverage(tape: &mut Tape, tree: &LodTree, refinement: Refinement) -> Coverage {
    let mut coverage = Coverage::new(tree, refinement);
    for rep in (0..tree.representations() as u32).map(RepId) {
        if tape.below(2) == 0 {
            coverage.insert(tree, rep);
        }
    }
    coverage
}

/// One of the four kinds, small or large, about a view of the tape.
fn some_neighbourhood(tape: &mut Tape) -> Neighbourhood {
    let view = tape.view();
    let reach = [0.0, 2.0, 20.0, 200.0][tape.below(4)] * tape.unit();
    let angle = [0.0, 0.2, 1.5, 7.0][tape.below(4)] * tape.unit();
    let up = [DVec3::Y, DVec3::Z, DVec3::new(0.6, 0.0, 0.8)][tape.below(3)];
    let made = match tape.below(4) {
        0 => Neighbourhood::free(view, reach, angle),
        1 => Neighbourhood::walking(view, reach, angle, up, tape.unit(), 1.5 * tape.unit()),
        2 => Neighbourhood::orbiting(
            view,
            view.position + DVec3::new(7.0, 1.0, -3.0) * (0.1 + tape.unit()),
            up,
            reach,
            angle,
        ),
        _ => {
            let mut corners: Vec<DVec3> = (0..6).map(|_| tape.point(100.0)).collect();
            corners.insert(3, view.position);
            Neighbourhood::path_bound(view, &corners, reach, angle)
        }
    };
    made.unwrap().with_stand_off([0.0, 0.5][tape.below(2)])
}

/// A view somewhere in the neighbourhood: the sample of a box without extent.
fn somewhere(tape: &mut Tape, neighbourhood: &Neighbourhood) -> View {
    let whole = neighbourhood.whole();
    let mut point = ViewBox { mid: whole.mid, half: [0.0; 5] };
    for axis in 0..5 {
        point.mid[axis] += (2.0 * tape.unit() - 1.0) * whole.half[axis];
    }
    neighbourhood.sample(&point)
}

fn deficit_by_cut(tree: &LodTree, coverage: &Coverage, view: &View, settings: &CutSettings) -> f64 {
    let mut cut = Cut::default();
    cut.make(tree, view, Region::Frustum, settings);
    let quality = evaluate(tree, &cut, coverage, |_| {});
    (quality.weight - quality.benefit) * cut.scale
}

proptest! {
    #![proptest_config(cases(300))]

    /// Whatever is sampled is contained; boxes hold the views sampled from them; the covering radius is kept.
    #[test]
    fn neighbourhoods_are_consistent(tape in tape()) {
        let mut tape = Tape::new(tape);
        let neighbourhood = some_neighbourhood(&mut tape);
        let view = somewhere(&mut tape, &neighbourhood);
        prop_assert!(neighbourhood.contains(&view), "{neighbourhood:?} {view:?}");
        prop_assert!(neighbourhood.contains(neighbourhood.view()));
        let mut part = neighbourhood.whole();
        for _ in 0..tape.below(12) {
            let Some(axis) = neighbourhood.longest(&part, 0.05) else { break };
            part = part.split(axis)[tape.below(2)];
        }
        if !neighbourhood.is_outside(&part) {
            let mut point = ViewBox { mid: part.mid, half: [0.0; 5] };
            for axis in 0..5 {
                point.mid[axis] += (2.0 * tape.unit() - 1.0) * part.half[axis];
            }
            if !neighbourhood.is_outside(&point) {
                let (views, inner) = (neighbourhood.views(&part), neighbourhood.sample(&point));
                let off = inner.position - views.eye;
                let slack = 1e-9 * (1.0 + views.radius);
                prop_assert!((off.abs() - views.half).max_element() <= slack && off.length() <= views.radius + slack);
                prop_assert!(views.orientation.angle_between(inner.orientation) <= views.turn + 1e-6);
            }
        }
        let covering = neighbourhood.covering(1 + tape.below(64), 0.05);
        let near = |v: &View| v.position.distance(view.position) <= covering.radius_m * (1.0 + 1e-9) + 1e-9
            && v.orientation.angle_between(view.orientation) <= covering.radius_rad + 1e-6;
        prop_assert!(covering.views.iter().any(near), "{covering:?} {view:?}");
        // Distances to a box.
        let (middle, half) = (tape.point(100.0), DVec3::splat(5.0 * tape.unit()));
        let bounds = Aabb { min: middle - half, max: middle + half };
        let distance = ((middle - view.position).abs() - half).max(DVec3::ZERO).length();
        prop_assert!(neighbourhood.nearest(&bounds) <= distance + 1e-9);
        prop_assert!(neighbourhood.nearest(&bounds) <= neighbourhood.nearest_at_most(&bounds) + 1e-9);
        let angles = neighbourhood.angles(&bounds, DVec3::Y);
        let angle = libm::acos((view.position - middle).normalize_or_zero().y.clamp(-1.0, 1.0));
        prop_assert!(view.position == middle || angles.0 - 1e-6 <= angle && angle <= angles.1 + 1e-6, "{angles:?} {angle}");
    }

    /// The deficit over the targets is that of the view's own cut where every group is opened, and no sampled view
    /// exceeds the certified bounds; the covering set never does.
    #[test]
    fn minimum_is_enclosed(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let refinement = [Refinement::Partial, Refinement::Atomic][tape.below(2)];
        let coverage = some_coverage(&mut tape, &tree, refinement);
        let neighbourhood = some_neighbourhood(&mut tape);
        let settings = CutSettings { opening: [0.0, 0.3, 2.0][tape.below(3)], ..CutSettings::default() };
        let targets = Targets::new(&tree, &neighbourhood, &coverage, &settings).unwrap();
        let by_leaf = CutSettings { opening: 0.0, near: settings.near.max(neighbourhood.stand_off()), ..settings };
        let found = certified(&targets, &neighbourhood, &MinimumSettings {
            tolerance: 0.05, evaluations_max: 3000, samples: 1 + tape.below(8),
        }).unwrap();
        prop_assert!(found.worth.lower <= found.worth.value && found.worth.value <= found.worth.upper + 1e-12, "{found:?}");
        prop_assert!(neighbourhood.contains(&found.worst));
        for _ in 0..24 {
            let view = somewhere(&mut tape, &neighbourhood);
            let here = targets.at(&view);
            if settings.opening == 0.0 {
                let by_cut = deficit_by_cut(&tree, &coverage, &view, &by_leaf);
                prop_assert!((here.deficit - by_cut).abs() <= 1e-9, "{} {by_cut}", here.deficit);
            }
            prop_assert!(-here.deficit >= found.worth.lower - 1e-12, "{} {found:?}", here.deficit);
        }
        let met = targets.at(&found.worst).deficit;
        prop_assert!((met + found.worth.value).abs() < 1e-9);
        let estimate = sampled(&targets, &neighbourhood, 32).unwrap();
        prop_assert!(estimate.value >= found.worth.lower - 1e-9);
        let worst = worst_views(&targets, &neighbourhood, 16, 3, 0.1);
        prop_assert!((worst.iter().map(|w| w.0).sum::<f64>() - 1.0).abs() < 1e-9);
    }

    /// The enclosure over a box of views holds every view of it, and of a single view it is tight.
    #[test]
    fn deficits_of_boxes_are_enclosed(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let coverage = some_coverage(&mut tape, &tree, Refinement::Partial);
        let neighbourhood = some_neighbourhood(&mut tape);
        let settings = CutSettings { opening: [0.0, 0.3, 2.0][tape.below(3)], ..CutSettings::default() };
        let targets = Targets::new(&tree, &neighbourhood, &coverage, &settings).unwrap();
        let mut part = neighbourhood.whole();
        for _ in 0..tape.below(20) {
            let Some(axis) = neighbourhood.longest(&part, 0.05) else { break };
            part = part.split(axis)[tape.below(2)];
        }
        let mut items = Vec::new();
        targets.enclose(&neighbourhood.views(&part), None, &mut items);
        let bounds = targets.deficit_bounds(&items);
        for _ in 0..8 {
            let mut point = ViewBox { mid: part.mid, half: [0.0; 5] };
            for axis in 0..5 {
                point.mid[axis] += (2.0 * tape.unit() - 1.0) * part.half[axis];
            }
            if neighbourhood.is_outside(&point) || neighbourhood.is_outside(&part) {
                continue;
            }
            let here = targets.at(&neighbourhood.sample(&point)).deficit;
            prop_assert!(bounds.lo - 1e-9 <= here && here <= bounds.hi + 1e-9, "{bounds:?} {here}");
            let mut items = Vec::new();
            targets.enclose(&neighbourhood.views(&point), None, &mut items);
            let tight = targets.deficit_bounds(&items);
            prop_assert!(tight.lo - 1e-9 <= here && here <= tight.hi + 1e-9, "{tight:?} {here}");
        }
    }

    /// The union's bounds hold the sum over leaves, at every budget, and so do the gains of representations.
    #[test]
    fn union_is_enclosed(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let refinement = [Refinement::Partial, Refinement::Atomic][tape.below(2)];
        let mut coverage = some_coverage(&mut tape, &tree, refinement);
        let neighbourhood = some_neighbourhood(&mut tape);
        let view = *neighbourhood.view();
        let cut_settings = CutSettings { opening: 0.0, ..CutSettings::default() };
        let mut cut = Cut::default();
        union_cut(&mut cut, &tree, &view, neighbourhood.region(), &cut_settings);
        let by_leaf = |coverage: &Coverage| -> f64 {
            let sum: f64 = cut.patches.iter().map(|p| {
                let bounds = tree.bounds(p.node);
                let distance = neighbourhood.nearest(&bounds).max(neighbourhood.stand_off()).max(0.1);
                let s = sharpness(Frustum::new(&view).pixels_per_radian, distance);
                if !tree.has_directions() {
                    return p.weight * accuracy(f64::from(coverage.best_above(&tree, p.node)), s);
                }
                let counting = tree.ancestors(p.node).filter(|&n| coverage.counts(&tree, n));
                let errors = errors_of(&tree, counting.flat_map(|n| tree.own(n)).filter(|&r| coverage.contains(r)));
                let reach = match neighbourhood.region() {
                    Region::Reachable { reach, .. } => reach,
                    Region::Frustum => 0.0,
                };
                let shares = shares_of(&tree, p.node, view.position, reach);
                p.weight * shares.iter().zip(errors).map(|(share, e)| share * accuracy(e, s)).sum::<f64>()
            }).sum();
            sum * cut.scale
        };
        let budget = [1, 10, 1 << 22][tape.below(3)];
        let settings = UnionSettings { evaluations_max: budget, ..UnionSettings::default() };
        let found = union::worth(&tree, &neighbourhood, &coverage, &settings).unwrap();
        let exact = by_leaf(&coverage);
        // The cut's own solid angles are good to 10⁻⁷ where the eye is almost in a face.
        // Errors of orthoviews are products in single precision.
        let slack = 1e-7 * (1.0 + exact) * if tree.has_directions() { 10.0 } else { 1.0 };
        prop_assert!(found.lower - slack <= exact && exact <= found.upper + slack, "{found:?} {exact}");
        if budget > 10 {
            prop_assert!(found.gap() <= 1.001e-3 * found.value.max(1e-4 * cut.total_weight * cut.scale) + 1e-12, "{found:?} {}", cut.total_weight);
        }
        let rep = RepId(tape.below(tree.representations()) as u32);
        coverage.remove(&tree, rep);
        let before = by_leaf(&coverage);
        let gained = union::gain(&tree, &neighbourhood, &coverage, rep, &settings).unwrap();
        coverage.insert(&tree, rep);
        let exact = by_leaf(&coverage) - before;
        prop_assert!(gained.lower - slack <= exact && exact <= gained.upper + slack, "{gained:?} {exact}");
    }

    /// SATURATE keeps its guarantee against every choice of tiny instances.
    #[test]
    fn saturate_keeps_its_guarantee(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(8);
        let views: Vec<View> = (0..1 + tape.below(4)).map(|_| tape.view()).collect();
        let reps = tree.representations() as u32;
        let elements: Vec<_> = (0..reps).map(|r| (1.0 + 9.0 * tape.unit(), vec![RepId(r)])).collect();
        let costs: Vec<f64> = elements.iter().map(|e| e.0).collect();
        let empty = Coverage::new(&tree, Refinement::Partial);
        let mut family = SampledViews::new(&tree, &views, empty, elements, &CutSettings::default()).unwrap();
        let missing = family.deficits();
        let budget = 25.0 * tape.unit();
        let worst_of = |family: &SampledViews<'_>| family.deficits().into_iter().fold(0.0, f64::max);
        let mut least = f64::INFINITY;
        for set in 0..1u32 << reps {
            let members: Vec<usize> = (0..reps as usize).filter(|&i| set >> i & 1 != 0).collect();
            if members.iter().map(|&m| costs[m]).sum::<f64>() <= budget {
                family.clear();
                members.iter().for_each(|&m| family.choose(m));
                least = least.min(worst_of(&family));
            }
        }
        let tolerance = 1e-3;
        let found = saturate(&mut family, &missing, budget, tolerance, Stretch::Guaranteed).unwrap();
        let gamma = 1.0 + libm::log(missing.iter().sum::<f64>() / tolerance).max(0.0);
        prop_assert!(found.cost <= gamma * budget + 1e-9);
        prop_assert!(found.least_deficit <= least + 1e-9, "{found:?} {least}");
        prop_assert!(found.deficit <= least + 2.0 * tolerance + 1e-9, "{found:?} {least}");
        family.clear();
        found.chosen.iter().for_each(|&e| family.choose(e));
        prop_assert!((worst_of(&family) - found.deficit).abs() < 1e-9);
        let kept = saturate(&mut family, &missing, budget, tolerance, Stretch::Kept).unwrap();
        prop_assert!(kept.cost <= budget + 1e-9);
    }

    /// The nearest content, by search and by looking at every leaf.
    #[test]
    fn clearance_is_the_nearest_leaf(tape in tape()) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(24);
        let eye = tape.point(150.0);
        let distance = |n: NodeId| ((tree.centre(n) - eye).abs() - tree.half(n)).max(DVec3::ZERO).length();
        let exact = (0..tree.nodes() as u32).map(NodeId).filter(|&n| tree.is_leaf(n)).map(distance).fold(f64::INFINITY, f64::min);
        prop_assert_eq!(clearance(&tree, eye), exact);
    }
}

/// One box straight ahead, approached: the union is its solid angle from here with the accuracy from the closest point,
/// the minimum its largest deficit, at the closest point too where it still fits into the view.
#[test]
fn a_box_straight_ahead() {
    let (centre, half) = (DVec3::new(0.0, 0.0, -20.0), DVec3::splat(1.0));
    let (tree, coverage) = one_box(centre, half, 0.5, true);
    let view = look_ahead(DVec3::ZERO);
    let neighbourhood = Neighbourhood::free(view, 5.0, 0.0).unwrap();
    let pixels = view.pixels_per_radian();
    let omega = of_box(centre, half);
    let closest = accuracy(0.5, sharpness(pixels, 14.0));
    let found = union::worth(&tree, &neighbourhood, &coverage, &UnionSettings::default()).unwrap();
    assert!((found.value - omega * closest).abs() <= 1e-9 && found.gap() < 1e-9, "{found:?} {}", omega * closest);
    let leaves = CutSettings { opening: 0.0, ..CutSettings::default() };
    let targets = Targets::new(&tree, &neighbourhood, &coverage, &leaves).unwrap();
    let found = certified(&targets, &neighbourhood, &MinimumSettings::OFFLINE).unwrap();
    let exact = of_box(centre + DVec3::new(0.0, 0.0, 5.0), half) * (1.0 - closest);
    assert!(found.worth.lower <= -exact && -exact <= found.worth.upper + 0.011 * found.weight, "{found:?} {exact}");
    assert!(found.gap() <= 0.01, "{found:?}");
}

/// Nothing resident and a client that turns only: the minimum is minus the box's solid angle, wherever it is seen whole;
/// a box behind counts only if the turn reaches it, and with ωε ≥ π every box does.
#[test]
fn a_box_behind() {
    let (centre, half) = (DVec3::new(0.0, 0.0, 20.0), DVec3::splat(1.0));
    let (tree, coverage) = one_box(centre, half, 0.5, false);
    let omega = of_box(centre, half);
    for (angle, expected) in [(0.0, 0.0), (2.0, 0.0), (3.2, omega), (100.0, omega)] {
        let neighbourhood = Neighbourhood::free(look_ahead(DVec3::ZERO), 0.0, angle).unwrap();
        let leaves = CutSettings { opening: 0.0, ..CutSettings::default() };
        let targets = Targets::new(&tree, &neighbourhood, &coverage, &leaves).unwrap();
        let found = certified(&targets, &neighbourhood, &MinimumSettings::OFFLINE).unwrap();
        assert!(found.worth.lower <= -expected && found.gap() <= 0.01, "{angle} {found:?} {expected}");
        assert!((found.worth.value + expected).abs() <= 0.01 * omega, "{angle} {found:?} {expected}");
    }
    let (tree, coverage) = one_box(centre, half, 0.5, true);
    let union = |angle| {
        let neighbourhood = Neighbourhood::free(look_ahead(DVec3::ZERO), 0.0, angle).unwrap();
        union::worth(&tree, &neighbourhood, &coverage, &UnionSettings::default()).unwrap().value
    };
    assert_eq!(union(2.0), 0.0);
    let seen = omega * accuracy(0.5, sharpness(look_ahead(DVec3::ZERO).pixels_per_radian(), 19.0));
    assert!((union(core::f64::consts::PI) - seen).abs() < 1e-9);
}

/// From nearer, more of the sides is seen: what shows the front only is worse in the union than by distance alone.
#[test]
fn a_direction_shows_a_smaller_share_of_what_can_be_reached() {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    // From +z, where the camera is: code 9·1 + 3·1 + 2.
    let rep = Representation { wire_bytes: 1, decoded_bytes: 1, error: 0.5, prerequisite: None, direction: Some(14) };
    builder.add(rep).unwrap();
    let (centre, half) = (DVec3::new(0.0, 0.0, -20.0), DVec3::splat(1.0));
    builder.close(Some(Aabb { min: centre - half, max: centre + half }), 1.0).unwrap();
    let tree = builder.finish().unwrap();
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    coverage.insert(&tree, RepId(0));
    let view = look_ahead(DVec3::ZERO);
    for reach in [0.0, 5.0, 10.0] {
        let neighbourhood = Neighbourhood::free(view, reach, 0.1).unwrap();
        let found = union::worth(&tree, &neighbourhood, &coverage, &UnionSettings::default()).unwrap();
        // Equal faces: the front at 21 m, four sides at 1 m, what can be moved added to each; from behind none before 19 m.
        let share = (21.0 + reach) / (21.0 + reach + 4.0 * (1.0 + reach));
        let exact = of_box(centre, half) * share * accuracy(0.5, sharpness(view.pixels_per_radian(), 19.0 - reach));
        assert!((found.value - exact).abs() < 1e-6, "{reach} {found:?} {exact}");
    }
    // From behind it shows nothing.
    let behind = View {
        position: DVec3::new(0.0, 0.0, -40.0),
        orientation: DQuat::from_rotation_y(core::f64::consts::PI),
        ..view
    };
    let neighbourhood = Neighbourhood::free(behind, 1.0, 0.1).unwrap();
    let found = union::worth(&tree, &neighbourhood, &coverage, &UnionSettings::default()).unwrap();
    assert!(found.upper < 1e-12);
}
