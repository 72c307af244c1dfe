//! Totals over many terms of very different size.

use crate::session::at;
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId};
use foresight_scheduler::transfer::TransferEstimate;
use foresight_scheduler::units::Time;
use glam::DVec3;

/// Compensated (Neumaier): the error does not grow with the number of terms.
fn compensated(terms: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut lost) = (0.0f64, 0.0);
    for term in terms {
        let next = sum + term;
        lost += if sum.abs() >= term.abs() { (sum - next) + term } else { (term - next) + sum };
        sum = next;
    }
    sum + lost
}

/// 2·10⁵ plates facing the eye whose areas span 30 orders of magnitude, in a shuffled order.
fn plates() -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    for i in 0..200_000u64 {
        // The multiplier is odd: a permutation.
        let place = i * 7_919 % 200_000;
        let half = 1e3 * libm::exp10(-15.0 * place as f64 / 200_000.0);
        let middle = DVec3::new(0.0, 0.0, -1e6);
        let extent = DVec3::new(half, half, 0.0);
        builder.open().unwrap();
        if i % 2 == 0 {
            builder.add(crate::session::rep(1000, 0.0)).unwrap();
        }
        builder.close(Some(Aabb { min: middle - extent, max: middle + extent }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

/// All terms are positive, so a plain sum of n terms is off by at most n·2⁻⁵³ of itself; it is that of the terms.
#[test]
fn weights_over_thirty_orders_of_magnitude() {
    let tree = plates();
    let mut cut = Cut::default();
    cut.make(&tree, &at(DVec3::ZERO), Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    let exact = compensated(cut.patches.iter().map(|p| p.weight));
    assert!(cut.patches.len() > 190_000, "{}", cut.patches.len());
    assert!((cut.total_weight / exact - 1.0).abs() < 2e-11, "{} {exact}", cut.total_weight);
}

#[test]
fn qualities_over_thirty_orders_of_magnitude() {
    let tree = plates();
    let mut cut = Cut::default();
    cut.make(&tree, &at(DVec3::ZERO), Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    (0..tree.representations() as u32).for_each(|r| assert!(coverage.insert(&tree, RepId(r))));
    let quality = evaluate(&tree, &cut, &coverage, |_| {});
    let shown = compensated(cut.patches.iter().filter(|p| tree.own(p.node).len() > 0).map(|p| p.weight));
    assert!((quality.benefit / shown - 1.0).abs() < 2e-11, "{} {shown}", quality.benefit);
    assert!(quality.mean().is_some_and(|q| q > 0.4 && q < 0.6));
}

/// S_n of a group is the sum over its leaves, to the last place of the f32 that keeps it.
#[test]
fn areas_of_a_group_over_thirty_orders_of_magnitude() {
    let tree = plates();
    let leaves = (1..tree.nodes() as u32).map(foresight_scheduler::lod_tree::NodeId);
    let exact = compensated(leaves.map(|n| 4.0 * tree.half(n).x * tree.half(n).y));
    let kept = tree.face_areas(tree.root()).z;
    assert!((kept / exact - 1.0).abs() < 1e-7, "{kept} {exact}");
}

/// 10⁷ reports of a few bytes each over an hour: the rate is the mean of the last seconds, not worn away by rounding.
#[test]
fn ten_million_small_receipts() {
    let mut estimate = TransferEstimate::new(1.0, 0.0);
    estimate.responded(Time::ZERO, Time::ZERO);
    for i in 1..=10_000_000u64 {
        estimate.received(3 * i, Time(i * 360_000));
    }
    let rate = 3.0 / 360e-6;
    assert!((estimate.rate() / rate - 1.0).abs() < 1e-9, "{} {rate}", estimate.rate());
}

/// Insertions and removals in any order leave nothing behind.
#[test]
fn a_set_emptied_is_empty() {
    let tree = plates();
    let mut coverage = Coverage::new(&tree, Refinement::Partial);
    for round in 0..3u32 {
        (0..1000).for_each(|i| assert!(coverage.insert(&tree, RepId(i * 97 + round))));
        assert!(coverage.any_beneath(tree.root()));
        (0..1000).rev().for_each(|i| assert!(coverage.remove(&tree, RepId(i * 97 + round))));
        assert!(!coverage.any_beneath(tree.root()) && coverage.iter().next().is_none());
    }
    assert!(coverage.heap_bytes() < 100_000, "{}", coverage.heap_bytes());
}
