//! The worst case on twenty scenes: a quadtree city of about 16 000 boxes, seen along a walk and a flight, with different
//! sets resident. First a table of gaps, evaluations and times; then the benchmarks proper.

mod quadtree;

use criterion::{BenchmarkId, Criterion};
use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::lod_tree::{LodTree, LodTreeError, RepId};
use foresight_scheduler::view::View;
use foresight_scheduler::worst_case::minimum::{MinimumSettings, certified, sampled, worst_views};
use foresight_scheduler::worst_case::neighbourhood::Neighbourhood;
use foresight_scheduler::worst_case::target::Targets;
use foresight_scheduler::worst_case::union::{self, UnionSettings};
use glam::{DQuat, DVec3};
use quadtree::{LOT, quadtree};
use std::hint::black_box;
use std::time::Duration;

const LEVELS: u32 = 7;

struct Scene {
    name: String,
    neighbourhood: Neighbourhood,
    coverage: Coverage,
}

/// Ten views of a walker in the streets (1.4 m/s, 0.8 rad/s) and ten of a flight 60 m up (15 m/s, 0.5 rad/s), ε = 0.25 s;
/// resident are all levels from the root down to one that is finer with each view.
fn scenes(tree: &LodTree) -> Vec<Scene> {
    let mut scenes = Vec::new();
    for i in 0..20u32 {
        let (walks, step) = (i < 10, f64::from(i % 10));
        let position = if walks {
            DVec3::new(13.5 + 45.0 * step, 1.7, 28.5 + 7.0 * step)
        } else {
            DVec3::new(30.0 * step - 100.0, 60.0, 40.0 - 25.0 * step)
        };
        let pitch = if walks { 0.0 } else { -0.25 };
        let orientation = DQuat::from_rotation_y(0.6 * step) * DQuat::from_rotation_x(pitch);
        let view = View { position, orientation, fov_y: 1.0, viewport: [1920, 1080] };
        let made = if walks {
            Neighbourhood::walking(view, 0.35, 0.2, DVec3::Y, 0.1, 1.0)
        } else {
            Neighbourhood::free(view, 3.75, 0.125)
        };
        let mut coverage = Coverage::new(tree, Refinement::Partial);
        let finest = LOT / 12.0 * libm::exp2(f64::from(i % 5));
        for rep in (0..tree.representations() as u32).map(RepId).filter(|&r| tree.error(r) >= finest) {
            coverage.insert(tree, rep);
        }
        if let Ok(neighbourhood) = made {
            let name = format!("{} {step}", if walks { "walk" } else { "flight" });
            scenes.push(Scene { name, neighbourhood: neighbourhood.with_stand_off(0.5), coverage });
        }
    }
    scenes
}

/// At decision time a third of a radian, offline the default.
fn cut(opening: f64) -> CutSettings {
    CutSettings { opening, ..CutSettings::default() }
}

const OPENINGS: [(&str, f64); 2] = [("decision", 0.3), ("offline", 0.15)];

fn table(tree: &LodTree, scenes: &[Scene], evaluations_max: u32) {
    println!("scene       setting   targets  boxes  evaluations  W         gap/Σw   sampled   Σw");
    for scene in scenes {
        for (setting, opening) in OPENINGS {
            let settings = if setting == "decision" {
                MinimumSettings::default()
            } else {
                MinimumSettings { evaluations_max, ..MinimumSettings::OFFLINE }
            };
            let made = Targets::new(tree, &scene.neighbourhood, &scene.coverage, &cut(opening));
            let Ok(targets) = made else { continue };
            let found = certified(&targets, &scene.neighbourhood, &settings);
            let estimate = sampled(&targets, &scene.neighbourhood, 64);
            if let (Ok(found), Ok(estimate)) = (found, estimate) {
                println!(
                    "{:11} {setting:9} {:7} {:6} {:12} {:9.5} {:7.2} % {:9.5} {:6.3}",
                    scene.name,
                    targets.len(),
                    found.boxes,
                    found.worth.evaluations,
                    found.worth.value,
                    100.0 * found.gap(),
                    estimate.value,
                    found.weight,
                );
            }
        }
        if let Ok(found) = union::worth(tree, &scene.neighbourhood, &scene.coverage, &UnionSettings::default()) {
            let relative = found.gap() / found.value;
            println!("{:11} union     {:31} {:9.5} {relative:9.2e}", scene.name, found.evaluations, found.value);
        }
    }
}

fn benchmarks(c: &mut Criterion, tree: &LodTree, scenes: &[Scene]) {
    let mut group = c.benchmark_group("worst case");
    for scene in [&scenes[2], &scenes[12]] {
        let (n, coverage) = (&scene.neighbourhood, &scene.coverage);
        let targets = Targets::new(tree, n, coverage, &cut(0.3));
        let Ok(targets) = targets else { continue };
        let settings = MinimumSettings::default();
        group.bench_function(BenchmarkId::new("targets", &scene.name), |b| {
            b.iter(|| Targets::new(tree, n, black_box(coverage), &cut(0.3)).map(|t| t.len()));
        });
        group.bench_function(BenchmarkId::new("one view", &scene.name), |b| b.iter(|| targets.at(black_box(n.view()))));
        group.bench_function(BenchmarkId::new("minimum, certified", &scene.name), |b| {
            b.iter(|| certified(black_box(&targets), n, &settings));
        });
        group.bench_function(BenchmarkId::new("minimum, worst of 16", &scene.name), |b| {
            b.iter(|| worst_views(black_box(&targets), n, 16, 3, 0.1));
        });
        group.bench_function(BenchmarkId::new("union", &scene.name), |b| {
            b.iter(|| union::worth(tree, n, black_box(coverage), &UnionSettings::default()));
        });
    }
    group.finish();
}

fn main() -> Result<(), LodTreeError> {
    let tree = quadtree(LEVELS)?;
    let scenes = scenes(&tree);
    // Tried out, not measured: the table stops early.
    let is_trial = std::env::args().any(|argument| argument == "--test");
    table(&tree, &scenes[..if is_trial { 2 } else { scenes.len() }], if is_trial { 100_000 } else { 20_000_000 });
    let mut c = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    benchmarks(&mut c, &tree, &scenes);
    c.final_summary();
    Ok(())
}
