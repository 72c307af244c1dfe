//! What a decision is made of: the cut of a view, a sampling of the objective, a marginal, and the decision itself.
//!
//! The world is a quadtree of boxes on a square, one representation a node. 4⁷ leaves are as many as the built-in city
//! has; 4¹⁰ are about 10⁶.

mod quadtree;

use criterion::{BatchSize, BenchmarkId, Criterion};
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::{LodTree, LodTreeError, NodeId, RepId};
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::predict::PredictedPath;
use foresight_scheduler::predict::motion::Speeds;
use foresight_scheduler::scheduler::{Scheduler, SchedulerError, SchedulerSettings};
use foresight_scheduler::select::horizon::{Horizon, HorizonSettings};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_scheduler::worst_case::Reach;
use glam::{DQuat, DVec3};
use quadtree::quadtree;
use std::hint::black_box;
use std::time::Duration;

const SMALL_LEVELS: u32 = 6;
const CITY_LEVELS: u32 = 7;
const LARGE_LEVELS: u32 = 10;

/// From above the roofs of the middle, looking ahead and a little down.
fn view() -> View {
    View {
        position: DVec3::new(3.0, 60.0, 5.0),
        orientation: DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-0.2),
        fov_y: 1.0,
        viewport: [1920, 1080],
    }
}

/// All but the finest two levels.
fn coarse(tree: &LodTree) -> Vec<RepId> {
    let is_coarse = |node: NodeId| !tree.is_leaf(node) && !tree.children(node).any(|child| tree.is_leaf(child));
    (0..tree.representations() as u32).map(RepId).filter(|&r| is_coarse(tree.node_of(r))).collect()
}

fn held(tree: &LodTree) -> Coverage {
    let mut coverage = Coverage::new(tree, Refinement::Partial);
    for rep in coarse(tree) {
        coverage.insert(tree, rep);
    }
    coverage
}

/// The objective as the policy samples it by default, from a camera at 10 m/s.
fn sample(horizon: &mut Horizon, tree: &LodTree, planned: &Coverage) {
    let settings = ForesightSettings::default();
    let bounds: Vec<f64> =
        (0..=settings.samples).map(|i| settings.horizon_s * i as f64 / settings.samples as f64).collect();
    let here = view();
    let views = bounds[1..].iter().map(|t| View { position: here.position + here.forward() * (10.0 * t), ..here });
    let paths = [PredictedPath { weight: 1.0, views: views.collect() }];
    let region = settings.reach.region(Speeds { linear: 10.0, angular: 0.5 }, settings.reuse_s);
    let sampled = HorizonSettings {
        alpha: settings.alpha,
        attenuation: settings.attenuation,
        tolerance: 0.1 * 5e-3,
        cut: settings.cut,
    };
    horizon.make(tree, planned, &paths, &bounds, (&here, region), &sampled);
}

fn cuts(c: &mut Criterion, city: &LodTree, large: &LodTree) {
    let mut group = c.benchmark_group("cut of a view");
    let reachable = Reach::default().region(Speeds { linear: 10.0, angular: 0.5 }, 0.25);
    for tree in [city, large] {
        let leaves = tree.nodes() - tree.nodes() / 4;
        for (name, region) in [("frustum", Region::Frustum), ("reachable", reachable)] {
            let mut cut = Cut::default();
            group.bench_function(BenchmarkId::new(name, leaves), |b| {
                b.iter(|| {
                    cut.make(tree, black_box(&view()), region, &CutSettings::default());
                    cut.patches.len()
                });
            });
        }
    }
    group.finish();
}

fn objective(c: &mut Criterion, city: &LodTree) {
    let mut coverage = held(city);
    let mut cut = Cut::default();
    cut.make(city, &view(), Region::Frustum, &CutSettings::default());
    c.bench_function("quality of a view", |b| b.iter(|| evaluate(city, &cut, black_box(&coverage), |_| {})));

    let mut horizon = Horizon::default();
    c.bench_function("sampling of the objective", |b| {
        b.iter(|| {
            sample(&mut horizon, city, black_box(&coverage));
            horizon.patches()
        });
    });
    let leaf = cut.patches.iter().map(|p| p.node).find(|&n| city.is_leaf(n)).and_then(|n| city.own(n).next());
    for (name, rep) in [("marginal of a leaf", leaf), ("marginal of the root", city.own(city.root()).next())] {
        if let Some(rep) = rep {
            c.bench_function(name, |b| b.iter(|| horizon.marginal(city, &mut coverage, black_box(rep), 0.3)));
        }
    }
}

/// What a client has fetched that was here a while: about 5,500 representations of the upper levels.
fn upper(tree: &LodTree) -> Vec<RepId> {
    let is_upper = |rep: &RepId| tree.ancestors(tree.node_of(*rep)).count() <= 7;
    (0..tree.representations() as u32).map(RepId).filter(is_upper).collect()
}

/// The first decision after a sampling is due, with the upper levels resident; and the one after half a turn.
fn decision(c: &mut Criterion, trees: &[&LodTree]) {
    let mut group = c.benchmark_group("decision of foresight");
    for tree in trees {
        let upper = upper(tree);
        let used: u64 = upper.iter().map(|&r| tree.decoded_bytes(r)).sum();
        for (name, spare, turned) in
            [("memory free", 64 << 20, false), ("memory full", 16 << 10, false), ("after half a turn", 64 << 20, true)]
        {
            group.bench_function(BenchmarkId::new(name, tree.representations()), |b| {
                let fresh = || {
                    let policy = Box::new(Foresight::checked("foresight", ForesightSettings::default())?);
                    let settings = SchedulerSettings::with_budget(used + spare);
                    let mut scheduler = Scheduler::checked(tree, settings, policy)?;
                    upper.iter().try_for_each(|&rep| scheduler.preload(rep))?;
                    let (mut here, mut now) = (view(), Time::ZERO);
                    if turned {
                        scheduler.observe(&here, now)?;
                        scheduler.next(now)?;
                        here.orientation = DQuat::from_rotation_y(core::f64::consts::PI) * here.orientation;
                        now = Time::from_secs(0.5);
                    }
                    Ok::<_, SchedulerError>((scheduler, here, now))
                };
                b.iter_batched(
                    fresh,
                    |prepared| {
                        let (mut scheduler, here, now) = prepared?;
                        scheduler.observe(&here, now)?;
                        let action = scheduler.next(now)?;
                        // Handed back, so that dropping it is not measured.
                        Ok::<_, SchedulerError>((action, scheduler))
                    },
                    BatchSize::LargeInput,
                );
            });
        }
    }
    group.finish();
}

fn main() -> Result<(), LodTreeError> {
    let (small, city, large) = (quadtree(SMALL_LEVELS)?, quadtree(CITY_LEVELS)?, quadtree(LARGE_LEVELS)?);
    let mut c = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(2))
        .configure_from_args();
    cuts(&mut c, &city, &large);
    objective(&mut c, &city);
    decision(&mut c, &[&small, &city, &large]);
    c.final_summary();
    Ok(())
}
