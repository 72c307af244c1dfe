//! Every place that something resident shows is drawn, and drawn once.

use super::cover::overlap;
use super::*;
use crate::draw::list::{HIDDEN_MAX, Item};
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, NodeId, Representation};
use glam::{DQuat, DVec3};
use proptest::prelude::*;

/// Numbers to draw from; 0 for ever once they are used up.
struct Tape(Vec<u16>, usize);

impl Tape {
    fn below(&mut self, n: usize) -> usize {
        self.1 += 1;
        usize::from(self.0.get(self.1 - 1).copied().unwrap_or(0)) % n
    }

    fn unit(&mut self) -> f64 {
        self.below(1 << 16) as f64 / 65_536.0
    }
}

const UPPER: [u8; 9] = [14, 22, 4, 16, 10, 26, 20, 8, 2];

/// A tree over a box, its children's boxes the box's halves (`apart`) or anything within it; some have no thickness, some
/// nodes own nothing, some representations need others.
fn tree(tape: &mut Tape) -> LodTree {
    let (apart, directions) = (tape.below(2) == 0, tape.below(2) == 0);
    let mut builder = LodTreeBuilder::default();
    let bounds = Aabb { min: DVec3::splat(-32.0), max: DVec3::splat(32.0) };
    let depth = 1 + tape.below(4);
    node(&mut builder, tape, bounds, depth, apart, directions);
    builder.finish().expect("a tree")
}

fn node(b: &mut LodTreeBuilder, tape: &mut Tape, bounds: Aabb, left: usize, apart: bool, directions: bool) {
    b.open().expect("one root");
    let side = (bounds.max - bounds.min).max_element();
    let views = if directions { tape.below(10) } else { 0 };
    for &direction in &UPPER[..views] {
        b.add(rep(side / 32.0, None, Some(direction))).expect("an orthoview");
    }
    let mut before = None;
    for level in 0..tape.below(3) {
        let error = side / 32.0 / f64::from(1 << level);
        before = Some(b.add(rep(error, before.filter(|_| tape.below(2) == 0), None)).expect("triangles"));
    }
    let children = if left == 0 { 0 } else { tape.below(if apart { 9 } else { 12 }) };
    let content = (children == 0 || tape.below(2) == 0).then_some(bounds);
    for child in 0..children {
        let within = if apart { octant(bounds, child) } else { anywhere(tape, bounds) };
        node(b, tape, within, left - 1, apart, directions);
    }
    b.close(content, 1.0).expect("a box");
}

fn rep(error: f64, prerequisite: Option<RepId>, direction: Option<u8>) -> Representation {
    Representation { wire_bytes: 1, decoded_bytes: 1, error: error as f32, prerequisite, direction }
}

fn octant(bounds: Aabb, child: usize) -> Aabb {
    let half = 0.5 * (bounds.max - bounds.min);
    let bit = |axis: usize| (child >> axis & 1) as f64;
    let min = bounds.min + half * DVec3::new(bit(0), bit(1), bit(2));
    Aabb { min, max: min + half }
}

fn anywhere(tape: &mut Tape, bounds: Aabb) -> Aabb {
    let mut at = || DVec3::new(tape.unit(), tape.unit(), tape.unit());
    let (a, b) = (at(), at());
    let side = bounds.max - bounds.min;
    let (a, mut b) = (bounds.min + side * a, bounds.min + side * b);
    if tape.below(8) == 1 {
        b.z = a.z;
    }
    Aabb { min: a.min(b), max: a.max(b) }
}

fn view(tape: &mut Tape) -> View {
    let at = DVec3::new(tape.unit(), tape.unit(), tape.unit()) * 240.0 - DVec3::splat(120.0);
    let turn = DQuat::from_rotation_y(6.3 * tape.unit()) * DQuat::from_rotation_x(tape.unit() - 0.5);
    View { position: at, orientation: turn, fov_y: 0.4 + tape.unit(), viewport: [64, 48] }
}

fn drawable(tree: &LodTree, resident: &BTreeSet<RepId>, rep: RepId) -> bool {
    resident.contains(&rep) && tree.prerequisite(rep).is_none_or(|needs| drawable(tree, resident, needs))
}

/// Of the nodes above a leaf and the leaf, those that show one of its points.
fn showers(tree: &LodTree, items: &[Item], leaf: NodeId, point: DVec3) -> Vec<NodeId> {
    let hides = |b: &Aabb| point.cmpgt(b.min).all() && point.cmplt(b.max).all();
    let shows = |node: &NodeId| {
        let mut own = items.iter().filter(|item| tree.node_of(item.rep) == *node);
        own.any(|item| !item.hidden.iter().any(hides))
    };
    tree.ancestors(leaf).filter(shows).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn every_place_that_something_resident_shows_is_drawn_and_by_two_levels_only_one_behind_the_other(tape in prop::collection::vec(any::<u16>(), 0..400)) {
        let mut tape = Tape(tape, 0);
        let tree = tree(&mut tape);
        let share = tape.below(4);
        let reps = (0..tree.representations() as u32).map(RepId);
        let resident: BTreeSet<RepId> = reps.filter(|_| tape.below(4) <= share).collect();
        let mut settings = ChooseSettings { directions: 1 + tape.below(9), ..ChooseSettings::default() };
        settings.geometry_radius = [None, Some(0.0), Some(60.0), Some(f64::INFINITY)][tape.below(4)];
        settings.bias = [1.0, 4.0, 0.25][tape.below(3)];
        let mut list = DrawList::default();
        // The frame before, from elsewhere, holds back what it likes.
        for _ in 0..2 {
            let view = view(&mut tape);
            choose_in(&tree, None, &resident, &view, &settings, &mut list);
            let frustum = Frustum::new(&view);
            for item in &list.items {
                prop_assert!(drawable(&tree, &resident, item.rep) && item.hidden.len() <= HIDDEN_MAX);
            }
            for leaf in (0..tree.nodes() as u32).map(NodeId).filter(|&node| tree.is_leaf(node)) {
                // An inner node's box may reach into the view beside its children; what is seen are leaves.
                let unseen = |n| frustum.side(tree.centre(n) - view.position, tree.half(n)) == Side::Outside;
                if tree.ancestors(leaf).any(unseen) {
                    continue;
                }
                let any = tree.ancestors(leaf).flat_map(|n| tree.own(n)).any(|rep| drawable(&tree, &resident, rep));
                for _ in 0..4 {
                    let inside = DVec3::new(tape.unit(), tape.unit(), tape.unit()) * 1.8 - DVec3::splat(0.9);
                    let shown = showers(&tree, &list.items, leaf, tree.centre(leaf) + tree.half(leaf) * inside);
                    prop_assert_eq!(shown.is_empty(), !any, "leaf {:?} {:?} {:?}", leaf, shown, list.items);
                    // The finest comes first.
                    let mut coarser = list.items.iter().filter(|item| shown.iter().skip(1).any(|&n| n == tree.node_of(item.rep)));
                    prop_assert!(
                        coarser.all(|item| item.behind > 0.0 && tree.direction(item.rep).is_some()),
                        "leaf {:?} {:?} {:?}", leaf, shown, list.items
                    );
                }
            }
        }
    }
}

/// An octree of `levels` levels beneath the root over a cube of 1024 m, a pixel a 64th of a cell, three directions; leaves
/// have triangles too.
fn octree(levels: usize) -> LodTree {
    fn cell(b: &mut LodTreeBuilder, bounds: Aabb, left: usize) {
        b.open().expect("one root");
        let side = (bounds.max - bounds.min).x;
        for direction in [14, 26, 22] {
            b.add(rep(side / 64.0, None, Some(direction))).expect("an orthoview");
        }
        if left == 0 {
            for finer in [4.0, 16.0] {
                b.add(rep(side / 64.0 / finer, None, None)).expect("triangles");
            }
        } else {
            (0..8).for_each(|child| cell(b, octant(bounds, child), left - 1));
        }
        b.close((left == 0).then_some(bounds), 1.0).expect("a box");
    }
    let mut builder = LodTreeBuilder::default();
    cell(&mut builder, Aabb { min: DVec3::ZERO, max: DVec3::splat(1024.0) }, levels);
    builder.finish().expect("a tree")
}

fn looking(from: DVec3) -> View {
    // Along −z, over the middle.
    View { position: from, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [640, 480] }
}

fn distance(tree: &LodTree, node: NodeId, view: &View) -> f64 {
    let centre = tree.centre(node) - view.position;
    (centre.abs() - tree.half(node)).max(DVec3::ZERO).length().max(1e-3)
}

fn all(tree: &LodTree) -> BTreeSet<RepId> {
    (0..tree.representations() as u32).map(RepId).collect()
}

#[test]
fn with_everything_resident_the_coarsest_that_suffices_is_drawn_and_geometry_where_none_does() {
    let tree = octree(4);
    let resident = all(&tree);
    for (z, radius) in [(1100.0, None), (700.0, None), (700.0, Some(300.0)), (700.0, Some(0.0)), (5000.0, None)] {
        let view = looking(DVec3::new(500.0, 500.0, z));
        let settings = ChooseSettings { geometry_radius: radius, ..ChooseSettings::default() };
        let mut list = DrawList::default();
        let counts = choose_in(&tree, None, &resident, &view, &settings, &mut list);
        assert!(counts.hidden == 0 && !list.items.is_empty());
        let pixels = |node, error| error * view.pixels_per_radian() / distance(&tree, node, &view);
        for item in &list.items {
            let node = tree.node_of(item.rep);
            let near = radius.is_some_and(|radius| distance(&tree, node, &view) < radius);
            let size = pixels(node, tree.error(item.rep));
            let above = tree.parent(node).map(|above| (above, 2.0 * (tree.half(node).x * 2.0 / 64.0)));
            let above_near = |n| radius.is_some_and(|radius| distance(&tree, n, &view) < radius);
            assert!(above.is_none_or(|(n, error)| pixels(n, error) > 1.0 || above_near(n)), "its parent suffices");
            match tree.direction(item.rep) {
                Some(_) => assert!(size <= 1.0 || tree.is_leaf(node) && radius == Some(0.0) && near, "{size} {near}"),
                None => {
                    let splat = pixels(node, tree.half(node).x * 2.0 / 64.0);
                    assert!(near || splat > 1.0, "an orthoview of {splat} pixels would have done");
                    assert!(size <= 1.0 || tree.own(node).next_back() == Some(item.rep));
                }
            }
        }
        let of = |node| list.items.iter().filter(|item| tree.node_of(item.rep) == node).count();
        assert!(
            list.items.iter().filter(|item| tree.direction(item.rep).is_some()).all(|i| of(tree.node_of(i.rep)) == 3)
        );
    }
}

#[test]
fn coarser_and_coarser_is_fewer_and_a_finer_bias_is_more() {
    let tree = octree(4);
    let resident = all(&tree);
    let view = looking(DVec3::new(500.0, 500.0, 1300.0));
    let drawn = |bias| {
        let mut list = DrawList::default();
        choose_in(&tree, None, &resident, &view, &ChooseSettings { bias, ..ChooseSettings::default() }, &mut list);
        list.items.len()
    };
    let counts = [0.5, 1.0, 2.0, 4.0, 1e9].map(drawn);
    assert!(counts.is_sorted_by(|a, b| a > b), "{counts:?}");
    assert_eq!(counts[4], 3);
}

#[test]
fn a_cell_in_part_is_drawn_beside_its_parent_without_its_box() {
    let tree = octree(1);
    let view = looking(DVec3::new(512.0, 512.0, 1500.0));
    // The root from all three, and of the children one from all three, one from one direction only, which is drawn over it.
    let own = |node: u32| tree.own(NodeId(node));
    let mut resident: BTreeSet<RepId> = own(0).chain(own(5).take(3)).chain(own(6).take(1)).collect();
    let mut list = DrawList::default();
    let counts = choose_in(&tree, None, &resident, &view, &ChooseSettings::default(), &mut list);
    assert_eq!((counts.orthoviews, counts.substitutes, counts.hidden), (7, 3, 3), "{list:?}");
    let root = list.items.iter().find(|item| item.rep == RepId(0)).expect("the root");
    let (hidden, child) = (root.hidden[0], tree.bounds(NodeId(5)));
    // As much larger as a pixel of the root, but not into its neighbours.
    assert!(hidden.min.cmple(child.min).all() && hidden.max.cmpge(child.max).all());
    assert!((1..9).filter(|&n| n != 5).all(|n| !overlap(&hidden, &tree.bounds(NodeId(n)))));
    assert!((hidden.max.z - child.max.z - 16.0).abs() < 1e-9, "{hidden:?}");
    // Once the root is gone, one direction is better than none.
    resident.retain(|rep| rep.0 > 2);
    let counts = choose_in(&tree, None, &resident, &view, &ChooseSettings::default(), &mut list);
    assert_eq!((counts.orthoviews, counts.hidden), (4, 0));
    assert_eq!(choose_in(&tree, None, &BTreeSet::new(), &view, &ChooseSettings::default(), &mut list).visited, 1);
    assert!(list.items.is_empty());
}

#[test]
fn a_finer_cell_is_drawn_over_a_coarser_one_that_shows_more_sides() {
    let tree = octree(1);
    let view = View { viewport: [1920, 1440], ..looking(DVec3::new(900.0, 512.0, 1600.0)) };
    // The root from all three; of one child only the side, not what faces up.
    let own = |node: u32| tree.own(NodeId(node));
    let side = own(5).find(|&rep| tree.direction(rep) == Some(22));
    let mut resident: BTreeSet<RepId> = own(0).chain(side).collect();
    let mut list = DrawList::default();
    let counts = choose_in(&tree, None, &resident, &view, &ChooseSettings::default(), &mut list);
    assert_eq!((counts.orthoviews, counts.hidden), (4, 0), "{list:?}");
    for item in &list.items {
        assert_eq!(item.behind, if tree.node_of(item.rep) == NodeId(0) { 32.0 } else { 0.0 }, "{list:?}");
    }
    // With all three of them the root is not needed there.
    resident.extend(own(5).take(3));
    let counts = choose_in(&tree, None, &resident, &view, &ChooseSettings::default(), &mut list);
    assert_eq!((counts.orthoviews, counts.hidden), (6, 3), "{list:?}");
    assert!(list.items.iter().all(|item| item.behind == 0.0));
}

#[test]
fn leaving_detail_what_was_drawn_stays_until_the_parent_is_there_from_all_sides() {
    let tree = octree(1);
    let near = looking(DVec3::new(512.0, 512.0, 6000.0));
    let far = looking(DVec3::new(512.0, 512.0, 20_000.0));
    let (root, rest) = (tree.own(NodeId(0)), tree.beneath(NodeId(0)).skip(3));
    let mut resident: BTreeSet<RepId> = rest.collect();
    let mut list = DrawList::default();
    choose_in(&tree, None, &resident, &near, &ChooseSettings::default(), &mut list);
    let items = list.items.len();
    for rep in root {
        let counts = choose_in(&tree, None, &resident, &far, &ChooseSettings::default(), &mut list);
        assert_eq!((list.items.len(), counts.hidden), (items, 0));
        resident.insert(rep);
    }
    choose_in(&tree, None, &resident, &far, &ChooseSettings::default(), &mut list);
    assert_eq!(list.items.len(), 3);
}

#[test]
fn nothing_swaps_to_and_fro_and_no_swap_shows_a_sample_of_more_than_a_pixel() {
    let tree = octree(3);
    let resident = all(&tree);
    let settings = ChooseSettings::default();
    let mut list = DrawList::default();
    let nodes = |list: &DrawList| list.items.iter().map(|item| tree.node_of(item.rep)).collect::<BTreeSet<_>>();
    let mut swaps = 0;
    // Away at 1 % a step, trembling by 0.3 % and by as much to the side.
    for step in 0..600 {
        let tremble = if step % 2 == 0 { 1.0 } else { -1.0 };
        let away = libm::log(1.01) * f64::from(step / 2);
        let z = 1024.0 + 300.0 * libm::exp(away) * (1.0 + 0.003 * tremble);
        let view = looking(DVec3::new(512.0 + 0.003 * z * tremble, 512.0, z));
        let before = nodes(&list);
        let known = !list.items.is_empty();
        choose_in(&tree, None, &resident, &view, &settings, &mut list);
        let after = nodes(&list);
        if !known {
            continue;
        }
        for &node in after.difference(&before) {
            let coarser = before.range(node..tree.subtree_end(node)).next().is_some();
            let finer = tree.ancestors(node).any(|above| before.contains(&above));
            assert!(!finer, "step {step}: {node:?} was coarse already");
            if coarser {
                swaps += 1;
                let size = tree.error(tree.own(node).next().expect("one")) * view.pixels_per_radian();
                let size = size / distance(&tree, node, &view);
                assert!(size <= 1.0 / 1.15, "{size}");
            }
        }
    }
    assert!(swaps > 50, "{swaps}");
}

#[test]
fn a_direction_stays_until_another_is_clearly_nearer() {
    let tree = octree(0);
    let resident = all(&tree);
    let settings = ChooseSettings { directions: 1, ..ChooseSettings::default() };
    let mut list = DrawList::default();
    let mut changes = Vec::new();
    let mut last = None;
    // From straight above (14) towards the corner (26) and back: half way is 27.4°.
    for step in (0..540).chain((0..540).rev()) {
        let angle = f64::from(step) * 0.1_f64.to_radians();
        let out = DVec3::Z * libm::cos(angle) + DVec3::new(1.0, 1.0, 0.0).normalize() * libm::sin(angle);
        let view = View {
            position: DVec3::splat(512.0) + out * 50_000.0,
            orientation: DQuat::from_rotation_arc(DVec3::NEG_Z, -out),
            fov_y: 1.0,
            viewport: [640, 480],
        };
        choose_in(&tree, None, &resident, &view, &settings, &mut list);
        let direction = tree.direction(list.items[0].rep);
        if last.is_some_and(|last| last != direction) {
            changes.push(angle.to_degrees());
        }
        last = Some(direction);
    }
    assert!(changes.len() == 2 && changes[0] > 28.0 && changes[1] < 26.7, "{changes:?}");
}

#[test]
fn settings_out_of_range_are_named_and_draw_something_all_the_same() {
    let tree = octree(2);
    let resident = all(&tree);
    let sane = ChooseSettings::default();
    assert!(sane.check().is_ok() && ChooseSettings::reference().check().is_ok());
    for (settings, field) in [
        (ChooseSettings { directions: 0, ..sane }, "directions"),
        (ChooseSettings { bias: f64::NAN, ..sane }, "bias"),
        (ChooseSettings { pixels_per_sample: 0.0, ..sane }, "pixels_per_sample"),
        (ChooseSettings { error_px: f64::NAN, ..sane }, "error_px"),
        (ChooseSettings { geometry_radius: Some(f64::NAN), ..sane }, "geometry_radius"),
        (ChooseSettings { swap_margin: f64::INFINITY, ..sane }, "swap_margin"),
        (ChooseSettings { turn_margin: f64::NAN, ..sane }, "turn_margin"),
    ] {
        assert!(settings.check().expect_err(field).to_string().starts_with(field));
        for from in [DVec3::splat(512.0), DVec3::new(512.0, 512.0, 1e9)] {
            let mut list = DrawList::default();
            for _ in 0..2 {
                choose_in(&tree, None, &resident, &looking(from), &settings, &mut list);
                assert!(!list.items.is_empty(), "{field}");
            }
        }
    }
    let mut list = DrawList::default();
    let mut wrong = looking(DVec3::splat(512.0));
    wrong.fov_y = f64::NAN;
    assert_eq!(choose_in(&tree, None, &resident, &wrong, &sane, &mut list), ChooseCounts::default());
    // Of another world: nothing to hold on to.
    list.items = vec![Item { rep: RepId(9_999_999), hidden: Vec::new(), behind: 0.0, tiles: 0, false_colour: None }];
    choose_in(&tree, None, &resident, &looking(DVec3::splat(512.0)), &sane, &mut list);
    assert!(!list.items.is_empty());
}
