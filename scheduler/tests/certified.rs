//! Branch and bound against evaluating every candidate: the same winner, and no bound below what it bounds.

mod random_tree;

use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{CutSettings, Region};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, NodeId, RepId, Representation};
use foresight_scheduler::predict::PredictedPath;
use foresight_scheduler::select::certified::{
    Ask, Instance, Link, Objective, ObjectiveSettings, Ranked, Search, Standing, Stop, certified_winner,
    exhaustive_winner,
};
use foresight_scheduler::view::View;
use glam::DVec3;
use random_tree::Tape;

const EXACT: Stop = Stop { tolerance: 0.0, floor: 0.0, evaluations_max: u64::MAX };

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn tape(&mut self, length: usize) -> Tape {
        Tape::new((0..length).map(|_| self.next() as u16).collect())
    }
}

fn full() -> bool {
    std::env::var_os("FORESIGHT_FULL").is_some()
}

/// About `leaves` boxes on a square of 300 m, in nodes of 2 to 40 children, some levels a node, some needing others.
///
/// In one of three, most representations show one direction only, several to a node.
fn world(random: &mut Random, leaves: usize) -> LodTree {
    fn node(
        b: &mut LodTreeBuilder,
        random: &mut Random,
        leaves: usize,
        corner: DVec3,
        side: f64,
        above: Option<RepId>,
        directions: bool,
    ) {
        b.open().expect("nested");
        let count = if leaves <= 1 { 1 + random.below(3) } else { random.below(3) } * if directions { 2 } else { 1 };
        let mut before = above.filter(|_| random.below(8) == 0);
        for level in 0..count {
            let wire_bytes = 500 + random.below(60_000) as u32;
            let error = 0.05 * side * libm::exp2(-(level as f64)) * (0.5 + random.unit());
            let rep = Representation {
                wire_bytes,
                decoded_bytes: 3 * wire_bytes,
                error: error as f32,
                prerequisite: before.filter(|_| random.below(2) == 0),
                direction: [14, 22, 4, 16, 10, 26, 20, 8].get(random.below(10)).filter(|_| directions).copied(),
            };
            before = Some(b.add(rep).expect("in order"));
        }
        if leaves <= 1 {
            let half = DVec3::new(0.4 * side, 1.0 + 10.0 * random.unit(), 0.4 * side);
            if directions && random.below(4) > 0 {
                let shares = core::array::from_fn(|_| [0.0, 1.0, 0.0][random.below(3)] + 0.01 * random.unit() as f32);
                b.surface(shares).expect("shares are positive");
            }
            let min = corner + DVec3::new(0.1 * side, 0.0, 0.1 * side);
            return b.close(Some(Aabb { min, max: min + 2.0 * half }), 1.0).expect("a box");
        }
        let widest = [3, 5, 39][random.below(3)];
        let children = (2 + random.below(widest)).min(leaves);
        let across = (children as f64).sqrt().ceil();
        for i in 0..children {
            let place = DVec3::new((i as f64 % across).floor(), 0.0, (i as f64 / across).floor());
            let share = leaves / children + usize::from(i < leaves % children);
            node(b, random, share, corner + place * (side / across), side / across, before, directions);
        }
        b.close(None, 1.0).expect("children have boxes");
    }
    let mut builder = LodTreeBuilder::default();
    let directions = random.below(3) == 0;
    node(&mut builder, random, leaves, DVec3::new(-150.0, 0.0, -150.0), 300.0, None, directions);
    builder.finish().expect("a tree")
}

/// Paths of random views among the boxes: some follow each other closely, some do not.
fn objective(random: &mut Random, tree: &LodTree) -> Objective {
    let mut tape = random.tape(200);
    let samples = 1 + random.below(4);
    let count = 1 + random.below(3);
    let closely = random.below(2) == 0;
    let paths: Vec<_> = (0..count)
        .map(|_| {
            let first = tape.view();
            let views = (0..samples).map(|i| match closely {
                true => View { position: first.position + first.forward() * (4.0 * i as f64), ..first },
                false => tape.view(),
            });
            PredictedPath { weight: 1.0 / count as f64, views: views.collect() }
        })
        .collect();
    let bounds: Vec<f64> = (0..=samples).map(|i| 1.1 * i as f64).collect();
    let settings = ObjectiveSettings {
        alpha: [0.7, 0.7, 0.0, 1.0][random.below(4)],
        attenuation: [0.0, 0.5][random.below(2)],
        cut: CutSettings { opening: [0.3, 0.3, 0.0, 1.5][random.below(4)], near: 0.1, centre_falloff: 0.0 },
    };
    let region = Region::Reachable { angle: 2.0 * random.unit(), reach: 30.0 * random.unit(), stand_off: 0.5 };
    let mut objective = Objective::default();
    objective.make(tree, &paths, &bounds, (&paths[0].views[0], region), &settings);
    objective
}

fn link(random: &mut Random) -> Link<'static> {
    let seconds_per_byte = [1e-6, 2e-5, 1e-9][random.below(3)];
    Link {
        seconds_per_byte,
        request_cost_s: [0.0, 0.0, 0.03][random.below(3)],
        first_byte_s: random.unit(),
        arrival_per_byte_s: [0.0, seconds_per_byte][random.below(2)],
        arrival: None,
    }
}

fn held(random: &mut Random, tree: &LodTree) -> Standing {
    let share = [0, 0, 2, 4, 10][random.below(5)];
    let mut coverage = Coverage::new(tree, Refinement::Partial);
    for rep in (0..tree.representations() as u32).map(RepId) {
        if random.below(10) < share {
            coverage.insert(tree, rep);
        }
    }
    Standing::new(tree, coverage)
}

fn exhaustive(search: &mut Search, ask: &Ask, standing: &mut Standing) -> Option<Ranked> {
    let mut best: Option<Ranked> = None;
    for rep in (0..ask.tree.representations() as u32).map(RepId) {
        if let Some(ranked) = search.exact(ask, standing, rep)
            && ranked.ratio > best.as_ref().map_or(0.0, |b| b.ratio)
        {
            best = Some(ranked);
        }
    }
    best
}

/// Decides again and again within one sampling: taking what wins, giving some back, discarding. Returns how often.
fn decide_all_along(random: &mut Random, tree: &LodTree, decisions: usize) -> usize {
    let objective = objective(random, tree);
    let mut standing = held(random, tree);
    let link = link(random);
    let ask = Ask { tree, objective: &objective, link, allowed: &|rep: RepId| rep.0 % 7 != 3 };
    let (mut search, mut naive) = (Search::default(), Search::default());
    search.restart(tree, &standing);
    let mut made = 0;
    for _ in 0..decisions {
        let expected = exhaustive(&mut naive, &ask, &mut standing);
        let found = search.next(&ask, &mut standing, EXACT);
        let key = |r: &Option<Ranked>| r.as_ref().map(|r| (r.rep, r.members.clone(), r.ratio, r.gain));
        assert_eq!(key(&found), key(&expected), "{} representations", tree.representations());
        made += 1;
        if let Some(found) = &found {
            assert!(search.upper() <= found.ratio * (1.0 + 1e-5));
        }
        match (found, random.below(4)) {
            (Some(found), 0) => search.give_back(&found),
            (Some(found), _) => {
                for &member in &found.members {
                    standing.insert(tree, member);
                    search.added(&ask, member);
                }
            }
            (None, _) => {}
        }
        if random.below(3) == 0 {
            let kept: Vec<RepId> = standing.plan().iter().collect();
            if !kept.is_empty() {
                let gone = kept[random.below(kept.len())];
                standing.remove(tree, gone);
                search.removed(&ask, &standing, gone);
            }
        }
    }
    made
}

#[test]
fn the_winner_is_the_exhaustive_one() {
    let mut random = Random(1);
    let (rounds, large) = if full() { (12_000, 60) } else { (300, 1) };
    let mut made = 0;
    for round in 0..rounds {
        let tree = match round % 3 {
            0 => random.tape(300).tree(24),
            1 => {
                let leaves = 1 + random.below(12);
                world(&mut random, leaves)
            }
            _ => {
                let leaves = 10 + random.below(90);
                world(&mut random, leaves)
            }
        };
        made += decide_all_along(&mut random, &tree, 10);
    }
    for _ in 0..large {
        let tree = world(&mut random, 5_500);
        made += decide_all_along(&mut random, &tree, 4);
    }
    println!("{made} decisions");
}

#[test]
fn no_bound_is_below_what_it_bounds() {
    let mut random = Random(2);
    for round in 0..if full() { 4_000 } else { 200 } {
        let tree = if round % 2 == 0 { random.tape(300).tree(24) } else { world(&mut random, 40) };
        let objective = objective(&mut random, &tree);
        let mut standing = held(&mut random, &tree);
        let ask = Ask { tree: &tree, objective: &objective, link: link(&mut random), allowed: &|_| true };
        let mut search = Search::default();
        let reps = (0..tree.representations() as u32).map(RepId);
        // By itself, without what it needs first: that is what a node's bound is for.
        let mut alone = |rep: RepId| {
            let offset = ask.link.arrival_of(tree.wire_bytes(rep));
            search.marginal(&ask, &standing, rep, offset) / ask.link.cost(&tree, &[rep])
        };
        let exact: Vec<f64> = reps.map(&mut alone).collect();
        let mut search = Search::default();
        for node in (0..tree.nodes() as u32).map(NodeId) {
            let (own, beneath) = search.bounds_of(&ask, &standing, node);
            for rep in tree.own(node).filter(|&r| !standing.plan().contains(r)) {
                let bound = own.iter().find(|(r, _)| *r == rep).map_or(0.0, |(_, b)| *b);
                assert!(bound >= exact[rep.index()], "{bound} {}", exact[rep.index()]);
            }
            for rep in tree.beneath(node).filter(|&r| tree.node_of(r) != node && !standing.plan().contains(r)) {
                assert!(beneath >= exact[rep.index()], "{beneath} {}", exact[rep.index()]);
            }
            if !tree.has_directions() {
                let rough = search.rough_bound_of(&ask, &standing, node);
                for rep in tree.beneath(node).filter(|&r| !standing.plan().contains(r)) {
                    assert!(rough >= exact[rep.index()], "{rough} {}", exact[rep.index()]);
                }
            }
        }
        let _ = &mut standing;
    }
}

fn instance<'a>(tree: &'a LodTree, random: &mut Random) -> Instance<'a> {
    Instance {
        tree,
        standing: Standing::new(tree, Coverage::new(tree, Refinement::Partial)),
        objective: objective(random, tree),
        link: Link {
            seconds_per_byte: 1e-6,
            request_cost_s: 0.0,
            first_byte_s: 0.1,
            arrival_per_byte_s: 1e-6,
            arrival: None,
        },
    }
}

#[test]
fn a_tolerance_is_kept_and_saves_work() {
    let mut random = Random(3);
    let tree = world(&mut random, 3_000);
    for _ in 0..5 {
        let mut instance = instance(&tree, &mut random);
        let best = exhaustive_winner(&mut instance);
        for tolerance in [0.0, 1e-3, 0.1, 0.5] {
            let winner = certified_winner(&mut instance, tolerance);
            assert!(winner.ratio >= best.ratio * (1.0 - tolerance), "{winner:?} {best:?}");
            let proven = winner.certificate;
            assert!(proven.ratio_upper >= best.ratio && proven.regret <= tolerance + 1e-5, "{proven:?}");
            assert!(best.ratio == 0.0 || proven.evaluations < best.certificate.evaluations);
        }
    }
}

/// `count` equal boxes at one place ahead, in nodes of 16, each with one representation of `wire_bytes(i)` bytes.
fn coincident(count: usize, wire_bytes: impl Fn(usize) -> u32 + Copy) -> LodTree {
    fn fill(b: &mut LodTreeBuilder, from: usize, count: usize, wire_bytes: impl Fn(usize) -> u32 + Copy) {
        b.open().expect("nested");
        if count == 1 {
            let wire_bytes = wire_bytes(from);
            let rep = Representation { wire_bytes, decoded_bytes: 9, error: 0.5, prerequisite: None, direction: None };
            b.add(rep).expect("in order");
            let content = Aabb { min: DVec3::new(-1.0, -1.0, -12.0), max: DVec3::new(1.0, 1.0, -10.0) };
            return b.close(Some(content), 1.0).expect("a box");
        }
        let step = count.div_ceil(16);
        for start in (0..count).step_by(step) {
            fill(b, from + start, step.min(count - start), wire_bytes);
        }
        b.close(None, 1.0).expect("children have boxes");
    }
    let mut builder = LodTreeBuilder::default();
    fill(&mut builder, 0, count, wire_bytes);
    builder.finish().expect("a tree")
}

fn ahead(tree: &LodTree) -> Objective {
    let view = View { position: DVec3::ZERO, orientation: glam::DQuat::IDENTITY, fov_y: 1.0, viewport: [640, 480] };
    let path = PredictedPath { weight: 1.0, views: vec![view] };
    let settings = ObjectiveSettings { alpha: 1.0, attenuation: 0.0, cut: CutSettings::default() };
    let mut objective = Objective::default();
    let region = Region::Reachable { angle: 0.0, reach: 0.0, stand_off: 0.5 };
    objective.make(tree, &[path], &[0.0, 4.0], (&view, region), &settings);
    objective
}

#[test]
fn all_equal_candidates_and_differences_of_one_byte_in_a_gigabyte() {
    let mut random = Random(4);
    let equal = coincident(1_000, |_| 1_000);
    let odd_one = coincident(1_000, |i| if i == 777 { 1_000_000_000 } else { 1_000_000_001 });
    for (tree, expected) in [(&equal, RepId(0)), (&odd_one, RepId(777))] {
        let mut instance = Instance { objective: ahead(tree), ..instance(tree, &mut random) };
        instance.link.first_byte_s = 0.0;
        instance.link.arrival_per_byte_s = 0.0;
        assert_eq!(certified_winner(&mut instance, 0.0).rep, Some(expected));
        assert_eq!(exhaustive_winner(&mut instance).rep, Some(expected));
    }
}

#[test]
fn a_million_coincident_objects_take_bounded_work() {
    let mut random = Random(5);
    let tree = coincident(1_000_000, |_| 1_000);
    let objective = ahead(&tree);
    let mut standing = Standing::new(&tree, Coverage::new(&tree, Refinement::Partial));
    let link = Link { arrival_per_byte_s: 0.0, ..link(&mut random) };
    let ask = Ask { tree: &tree, objective: &objective, link, allowed: &|_| true };
    let mut search = Search::default();
    search.restart(&tree, &standing);
    // The first of all equals would take a million evaluations: cut short, what may be missed is bounded, and the bound is
    // that of the box, not of its exact solid angle.
    let stop = Stop { evaluations_max: 10_000, ..EXACT };
    let found = search.next(&ask, &mut standing, stop).expect("something gains");
    assert!(found.gain > 0.0 && search.evaluations() < 10_500, "{}", search.evaluations());
    assert!(found.ratio <= search.upper() && search.upper() < 1.5 * found.ratio);
}

#[test]
fn nothing_is_chosen_where_nothing_gains() {
    let mut random = Random(6);
    let tree = coincident(100, |_| 10);
    let objective = ahead(&tree);
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    (0..100).for_each(|r| {
        coverage.insert(&tree, RepId(r));
    });
    let mut instance = Instance { objective, standing: Standing::new(&tree, coverage), ..instance(&tree, &mut random) };
    let winner = certified_winner(&mut instance, 0.0);
    assert_eq!((winner.rep, winner.certificate.ratio_upper, winner.certificate.regret), (None, 0.0, 0.0));
    assert_eq!(exhaustive_winner(&mut instance).rep, None);
}
