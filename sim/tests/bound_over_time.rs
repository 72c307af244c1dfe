//! The bound over time against everything that could be done on tiny replays, and its prices.

#[path = "../../scheduler/tests/random_tree/mod.rs"]
mod random_tree;

use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::units::Time;
use foresight_sim::bound::over_time::{Dual, OverTime, Supply};
use foresight_sim::bound::prices::Prices;
use foresight_sim::bound::shadow::ShadowPrices;
use foresight_sim::bound::whole::{Terms, bounds};
use foresight_sim::bound::{CheapestBeneath, Instance, Stratum, bound, exact, tiny, tiny_with_directions};
use foresight_traces::flight::{TICKS_PER_FRAME, tick_time};
use foresight_traces::link::LinkTrace;
use proptest::prelude::*;
use random_tree::Tape;

const SEEDS: u64 = 60;

/// Never below the best that can be done, and within 15 % of it in the middle where link and memory are scarce.
#[test]
fn the_best_policy_is_below_the_bound_and_near_it() {
    for (stratum, least) in Stratum::ALL.into_iter().zip([0.95, 0.92, 0.85]) {
        let mut ratios = Vec::new();
        for seed in 0..SEEDS {
            let instance = tiny(seed, stratum);
            let (best, bound) = (exact(&instance).unwrap(), bound(&instance));
            assert!(best <= bound, "{stratum:?} {seed}: {best} > {bound}");
            ratios.push(best / bound);
        }
        ratios.sort_by(f64::total_cmp);
        let median = ratios[ratios.len() / 2];
        assert!(median >= least, "{stratum:?}: {median}");
    }
}

/// The same where representations show one direction only.
#[test]
fn the_best_policy_is_below_the_bound_with_directions() {
    for (stratum, least) in Stratum::ALL.into_iter().zip([0.9, 0.85, 0.8]) {
        let mut ratios = Vec::new();
        for seed in 0..SEEDS {
            let instance = tiny_with_directions(seed, stratum);
            assert!(instance.tree.has_directions());
            let (best, bound) = (exact(&instance).unwrap(), bound(&instance));
            assert!(best <= bound, "{stratum:?} {seed}: {best} > {bound}");
            ratios.push(best / bound);
        }
        ratios.sort_by(f64::total_cmp);
        let median = ratios[ratios.len() / 2];
        println!("{stratum:?}: {median:.3} of the bound");
        assert!(median >= least, "{stratum:?}: {median}");
    }
}

/// The exhaustive search does not beat what it could not do: with everything delivered at once, the best is all that fits.
#[test]
fn with_a_link_of_any_width_the_exact_value_is_the_quality_of_everything() {
    let mut instance = tiny(7, Stratum::Ample);
    instance.link = LinkTrace::constant("wide", 1_000_000_000_000, Time::ZERO).unwrap();
    instance.budget = u64::MAX;
    let best = exact(&instance).unwrap();
    let cheapest = CheapestBeneath::new(&instance.tree);
    let mut sum = 0.0;
    let mut seen = 0.0;
    for (frame, cut) in instance.cuts.iter().enumerate() {
        let Some(mut problem) = foresight_sim::bound::FrameBound::new(&instance.tree, &cheapest, cut) else { continue };
        seen += 1.0;
        // One after the other, one a frame: as many frames as representations are not complete.
        if frame > instance.tree.representations() {
            sum += problem.bound(foresight_sim::bound::Limits { wire: 1e9, memory: 1e9 }) - 1e-5;
        }
    }
    let complete = sum / seen;
    assert!(best >= complete - 1e-3 && best <= 1.0, "{best} {complete}");
}

fn supply(instance: &Instance, problem: &OverTime) -> Supply {
    let by =
        |frame: usize| instance.link.bytes_deliverable(Time::ZERO, tick_time(frame as u64 * TICKS_PER_FRAME)) as f64;
    let seen = instance.cuts.iter().filter(|c| c.total_weight > 0.0).count() as f64;
    let nonempty = |step: &std::ops::Range<usize>| {
        instance.cuts[step.clone()].iter().filter(|c| c.total_weight > 0.0).count() as f64
    };
    Supply {
        wire: problem.steps().iter().map(|step| by(step.end - 1)).collect(),
        memory: instance.budget as f64,
        // A frame is at most perfect.
        frames: problem.steps().iter().map(|step| nonempty(step) / seen).collect(),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(300) })]

    /// Weak duality: whatever the prices, no policy is above their bound.
    #[test]
    fn any_prices_prove_a_bound(seed in 0..1000u64, draws in prop::collection::vec(0.0..1.0f64, 600), which in 0..3usize) {
        let instance = tiny(seed, Stratum::ALL[which]);
        let best = exact(&instance).unwrap();
        let cheapest = CheapestBeneath::new(&instance.tree);
        for problem in OverTime::levels(&instance.tree, &cheapest, &instance.cuts) {
            let supply = supply(&instance, &problem);
            let steps = problem.steps().len();
            let all = supply.wire[steps - 1].max(1.0);
            let draw = |i: usize| draws[i % draws.len()];
            let mut capacity: Vec<f64> = (0..steps).map(|i| 2.0 * draw(i) * draw(7) / all).collect();
            capacity.sort_by(|a, b| b.total_cmp(a));
            let prices = Prices {
                capacity,
                memory: (0..steps).map(|i| draw(i + 13) * draw(5) / (supply.memory * steps as f64)).collect(),
                shown: (0..problem.size()[0]).map(|i| draw(i * 31 + 3) as f32).collect(),
                frame: (0..steps).map(|i| draw(3) * draw(i + 101)).collect(),
            };
            let mut dual = Dual::default();
            problem.dual(&supply, &prices, &mut dual);
            prop_assert!(best <= dual.value, "{best} > {}", dual.value);
        }
    }
}

fn terms<'a>(instance: &'a Instance, link: &'a LinkTrace, budget: u64) -> Terms<'a> {
    Terms { tree: &instance.tree, cuts: &instance.cuts, link, at_start: 0, budget }
}

/// What a price says against the bound with a little more: the bound is concave in the limits, so the rise is at most the
/// price's, and close to it for a small change.
#[test]
fn shadow_prices_are_the_slopes_of_the_bound() {
    let (mut predicted, mut measured) = ([0.0; 2], [0.0; 2]);
    for seed in 0..20 {
        let instance = tiny(seed, Stratum::Scarce);
        // A steady link, so that a little more of it is more in every frame.
        let link = LinkTrace::constant("steady", 200_000, Time::ZERO).unwrap();
        let here = &bounds(&terms(&instance, &link, instance.budget), &[Time::ZERO])[0];
        let delivered: Vec<f64> = (0..instance.cuts.len() as u64)
            .map(|f| {
                let at = |f: u64| tick_time(f * TICKS_PER_FRAME);
                link.bytes_deliverable(at(f.saturating_sub(1)), at(f)) as f64
            })
            .collect();
        let prices = ShadowPrices::new(std::slice::from_ref(here), &[delivered], instance.budget).unwrap();
        let wider = LinkTrace::constant("steady", 204_000, Time::ZERO).unwrap();
        let more_link = bounds(&terms(&instance, &wider, instance.budget), &[Time::ZERO])[0].mean_quality().unwrap();
        let more_memory = (instance.budget as f64 * 1.02) as u64;
        let more_memory = bounds(&terms(&instance, &link, more_memory), &[Time::ZERO])[0].mean_quality().unwrap();
        let value = here.mean_quality().unwrap();
        predicted[0] += 2.0 * prices.per_percent_of_link;
        predicted[1] += 2.0 * prices.per_percent_of_memory;
        measured[0] += more_link - value;
        measured[1] += more_memory - value;
    }
    assert!(predicted[0] > 0.0 && predicted[1] >= 0.0);
    for k in 0..2 {
        let off = (measured[k] - predicted[k]).abs();
        assert!(off <= 0.3 * predicted[k] + 2e-3, "{k}: {} predicted, {} measured", predicted[k], measured[k]);
    }
}

/// Extremes of memory, link and length: finite, in [0, 1], and never below what the exhaustive search finds.
#[test]
fn extremes_are_bounded_too() {
    let ordinary = tiny(3, Stratum::Matched);
    let steady = |rate| LinkTrace::constant("steady", rate, Time::ZERO).unwrap();
    for budget in [0, 1, 1 << 63, u64::MAX] {
        // A bit a second delivers no byte in four seconds.
        for link in [steady(1), steady(1_000_000_000_000_000)] {
            for frames in [1, 2, ordinary.cuts.len()] {
                let instance = Instance {
                    cuts: ordinary.cuts[ordinary.cuts.len() - frames..].to_vec(),
                    link: link.clone(),
                    budget,
                    tree: ordinary.tree.clone(),
                };
                let value = bound(&instance);
                let best = exact(&instance).unwrap();
                assert!((0.0..=1.0).contains(&value) && best <= value, "{budget} {frames}: {best} {value}");
                if budget == 0 || link.mean_rate() < 1.0 {
                    assert!(value <= 1.1e-5, "nothing can be there: {value}");
                }
            }
        }
    }
    let nothing = Instance { cuts: vec![Cut::default(); 5], ..ordinary };
    let found = &bounds(&terms(&nothing, &nothing.link, 1000), &[Time::ZERO])[0];
    assert_eq!((found.mean_quality(), found.per_link_byte.len()), (None, 5));
    assert!(bounds(&terms(&nothing, &nothing.link, 1000), &[]).is_empty());
    assert_eq!(exact(&nothing), Ok(0.0));
}

/// The best within limits that hold all the time, by going through the sets: what is resident throughout.
fn best_still(tree: &LodTree, cuts: &[Cut], budget: u64) -> f64 {
    use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
    use foresight_scheduler::benefit::quality::evaluate;
    use foresight_scheduler::lod_tree::RepId;
    let mut best = 0.0f64;
    for set in 0..1u32 << tree.representations() {
        let reps = (0..tree.representations() as u32).filter(|r| set >> r & 1 != 0).map(RepId);
        let mut coverage = Coverage::new(tree, Refinement::Partial);
        let mut decoded = 0;
        for rep in reps {
            coverage.insert(tree, rep);
            decoded += tree.decoded_bytes(rep);
        }
        if decoded <= budget {
            let qualities: Vec<f64> =
                cuts.iter().filter_map(|cut| evaluate(tree, cut, &coverage, |_| {}).mean()).collect();
            best = best.max(qualities.iter().sum::<f64>() / qualities.len().max(1) as f64);
        }
    }
    best
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    /// Groups, importances, boxes without thickness and cuts that change: what can be kept all the time is below the bound
    /// when it was there from the start.
    #[test]
    fn no_set_kept_throughout_is_above_the_bound(tape in prop::collection::vec(any::<u16>(), 0..300)) {
        let mut tape = Tape::new(tape);
        let tree = tape.tree(8);
        let opening = [0.15, 0.0, 1.0][tape.below(3)];
        let settings = CutSettings { opening, ..CutSettings::default() };
        let cuts: Vec<Cut> = (0..1 + tape.below(20))
            .map(|_| {
                let mut cut = Cut::default();
                cut.make(&tree, &tape.view(), Region::Frustum, &settings);
                cut
            })
            .collect();
        let decoded: u64 = (0..tree.representations() as u32).map(|r| tree.decoded_bytes(foresight_scheduler::lod_tree::RepId(r))).sum();
        let wire: u64 = (0..tree.representations() as u32).map(|r| tree.wire_bytes(foresight_scheduler::lod_tree::RepId(r))).sum();
        let link = LinkTrace::constant("thin", 1000, Time::ZERO).unwrap();
        for budget in [decoded, decoded / 2, decoded / 5] {
            let terms = Terms { tree: &tree, cuts: &cuts, link: &link, at_start: wire, budget };
            let found = &bounds(&terms, &[Time::ZERO])[0];
            let best = best_still(&tree, &cuts, budget);
            if let Some(over_time) = found.over_time {
                prop_assert!(best <= over_time + 1e-9, "{budget}: {best} > {over_time}");
            }
        }
    }
}
